"""The radar: stated against true errors of every body's echo, and times."""

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks import mirrored_currents
from benchmarks.stated_errors.judged import Cheapest, Judged
from benchmarks.stated_errors.radar_cases import RadarCase
from twin.fidelity import Fidelity
from twin.radar.propagation.facets.adaptive_subdivision import WEAKEST
from twin.radar.propagation.facets.convergence import band_of
from twin.radar.propagation.result import Propagation
from twin.radar.propagation.scene.culling import OF_NOISE, noise_amplitude
from twin.radar.propagation.solvers import trace
from twin.trade.bodies import echoes_by_body, reference_bodies

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Of the truth where sums of currents would take too long; and spacing of those, in wavelengths.
_FINEST, _SPACING = Fidelity(radar_tolerance=0.005, radar_images=2), 1 / 8
_OWN_ERROR = 0.005  # of either truth, relative to a body's echo
_TOLERANCES, _BOUNCES, _IMAGES = (1.0, 0.5, 0.3, 0.1, 0.03, 0.01), (1, 2, 3), (0, 1)


@dataclass(frozen=True, eq=False)
class _Truth:
    """Echoes (n_bodies, n_frequencies) of bodies, named by their objects."""

    names: tuple[tuple[str, ...], ...]
    echo: Complex

    def of(self, objects: tuple[str, ...]) -> Complex:
        """The sum of what the objects belong to."""
        rows = [i for i, names in enumerate(self.names) if set(names) & set(objects)]
        return np.asarray(self.echo[rows].sum(axis=0))


def judged(case: RadarCase, *, search: bool = True) -> Iterator[Judged]:
    """Every body within 40 dB of the strongest, and above the noise."""
    fidelity, radar = Fidelity.within(case.tolerance), case.radar
    trace(case.scene, radar, fidelity=fidelity)  # compiles
    begin = time.process_time()
    propagation = trace(case.scene, radar, fidelity=fidelity)
    seconds = time.process_time() - begin
    truth = _truth(case, propagation)
    cheapest = _cheapest(case, truth, seconds) if search else None
    errors, estimates = _errors(case, propagation, truth, fidelity.radar_tolerance)
    for number, (body, estimate) in enumerate(estimates.items()):
        first = number == 0
        yield Judged(
            name=case.name,
            figure=body[0] if len(body) == 1 else f"{body[0]} and {len(body) - 1} more",
            tolerance=fidelity.radar_tolerance,
            stated=estimate,
            true=errors[body],
            truth_error=_OWN_ERROR,
            unit="of its echo",
            seconds=seconds if first else math.nan,
            cheapest=cheapest if first else None,
            searched=search and first,
            warnings=tuple(propagation.warnings) if first else (),
        )


def _truth(case: RadarCase, propagation: Propagation) -> _Truth:
    radar, frequencies = case.radar, band_of(case.radar.ofdm)
    if case.bounces:
        bodies = [o for o in case.scene.objects if o is not case.ground]
        spacing = _SPACING * radar.ofdm.wavelength_m
        echo = mirrored_currents.echoes(
            bodies, radar, frequencies, case.bounces, spacing, case.ground, least=4
        )
        return _Truth(tuple((o.name,) for o in bodies), echo)
    finest = trace(case.scene, radar, fidelity=_FINEST)
    found = reference_bodies(case.scene, radar, _FINEST, finest, 0)
    return _Truth(found.names, found.echo)


def _errors(
    case: RadarCase, propagation: Propagation, truth: _Truth, tolerance: float
) -> tuple[dict[tuple[str, ...], float], dict[tuple[str, ...], float]]:
    """Errors of bodies relative to their echoes, or to the least echo that counts; and what is
    stated of them. A body that is not told of is stated to be nothing.
    """
    radar, frequencies = case.radar, band_of(case.radar.ofdm)
    bodies = {body.objects: body.estimated_error for body in propagation.bodies}
    told = {name for objects in bodies for name in objects}
    silent = [names for names in truth.names if not told & set(names)]
    members = (*bodies, *silent)
    if not members:
        return {}, {}
    echo = echoes_by_body(propagation, members, radar, frequencies)
    true = np.array([truth.of(names) for names in members])
    level = _rms(echo)
    least = max(
        OF_NOISE * noise_amplitude(radar) / tolerance, WEAKEST * float(_rms(true).max(initial=0.0))
    )
    off = _rms(echo - true) / np.maximum(level, least)
    errors = dict(zip(members, off.tolist(), strict=True))
    return errors, {names: bodies.get(names, tolerance) for names in members}


def _cheapest(case: RadarCase, truth: _Truth, most_s: float) -> Cheapest | None:
    """The cheapest of all settings in which every body's error is within the tolerance, if it takes
    less than ``most_s``.
    """
    best: Cheapest | None = None
    permitted = Fidelity.within(case.tolerance).radar_tolerance
    for images in _IMAGES:
        for bounces in _BOUNCES:
            for tolerance in _TOLERANCES:
                fidelity = Fidelity(
                    radar_tolerance=tolerance, radar_bounces=bounces, radar_images=images
                )
                begin = time.process_time()
                trace(case.scene, case.radar, fidelity=fidelity)
                first = time.process_time() - begin
                if first > 3 * most_s + 0.5:
                    break
                begin = time.process_time()
                propagation = trace(case.scene, case.radar, fidelity=fidelity)
                seconds = time.process_time() - begin
                if seconds > most_s:
                    break
                errors, _ = _errors(case, propagation, truth, permitted)
                if max(errors.values(), default=0.0) <= permitted:
                    knobs = f"tolerance {tolerance:g}, {bounces} bounces, {images} images"
                    best, most_s = Cheapest(seconds, knobs), seconds
                    break
    return best


def _rms(values: Complex) -> Array:
    found: Array = np.sqrt(np.mean(np.abs(values) ** 2, axis=-1))
    return found

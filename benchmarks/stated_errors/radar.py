"""The radar: stated against true errors of every body's echo, and times."""

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from itertools import product

import numpy as np
from numpy.typing import NDArray

from benchmarks import mirrored_currents
from benchmarks.stated_errors.judged import Cheapest, Judged
from benchmarks.stated_errors.radar_cases import RadarCase
from benchmarks.timing import processor_time
from twin.fidelity import Fidelity, Tolerance
from twin.radar.propagation.facets.convergence import band_of
from twin.radar.propagation.facets.error_budget import WEAKEST
from twin.radar.propagation.result import Propagation
from twin.radar.propagation.scene.culling import OF_NOISE, noise_amplitude
from twin.radar.propagation.solvers import trace
from twin.trade.bodies import Bodies, echoes_by_body, reference_bodies

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Truths where sums of currents would take too long, and of waves round obstacles everywhere; and
#: spacings of those sums, in wavelengths. Each twice: the difference is the error of the finer one.
_FINE, _FINEST = (
    Fidelity(
        radar_tolerance=tolerance,
        radar_bounces=5,
        radar_images=3,
        radar_shadow_db=60.0,
        radar_shadowed=cells,
    )
    for tolerance, cells in ((0.01, 2000), (0.005, 4000))
)
_SPACINGS = (1 / 9, 1 / 16)
#: Of the stated error, up to which the solver's part of a truth matters little; and the part where
#: all of it is the solver's.
_LITTLE, _ALL = 0.5, math.inf
_BODIES = 5  # of a case at most: the strongest, and others down to the faintest
_TOLERANCES, _BOUNCES, _IMAGES = (1.0, 0.5, 0.3, 0.1, 0.03, 0.01), (1, 2, 3), (0, 1)
_SHADOWED = (0, 1000)


@dataclass(frozen=True, eq=False)
class _Truth:
    """Echoes (n_bodies, n_frequencies) of bodies, named by their objects, their errors, and the
    part of them that the solver itself gave, at its finest; ``source``: of the rest.
    """

    names: tuple[tuple[str, ...], ...]
    echo: Complex
    error: Complex
    of_solver: Complex
    source: str

    def of(self, objects: tuple[str, ...]) -> tuple[Complex, Complex, Complex]:
        """Sums of what the objects belong to: echo, error, part of the solver."""
        rows = [i for i, names in enumerate(self.names) if set(names) & set(objects)]
        parts = (part[rows].sum(axis=0) for part in (self.echo, self.error, self.of_solver))
        one, other, third = parts
        return one, other, third


@dataclass(frozen=True)
class _Compared:
    """Error of a body, that stated of it, that of the truth, and the part of the truth that the
    solver itself gave, relative to its echo.
    """

    objects: tuple[str, ...]
    true: float
    stated: float
    truth_error: float
    of_solver: float

    @property
    def beyond_truth(self) -> float:
        """The error without that of the truth."""
        return math.sqrt(max(self.true**2 - self.truth_error**2, 0.0))

    @property
    def is_independent(self) -> bool:
        """Whether the solver's part of the truth, were it wholly wrong, would matter little."""
        return self.of_solver <= _LITTLE * self.stated

    def source(self, of_rest: str) -> str:
        """Where the truth is from."""
        if self.of_solver >= _ALL:
            return "the solver at its finest"
        if not self.of_solver:
            return of_rest
        return f"{of_rest}; {100 * self.of_solver:.2g} % of the echo by the solver at its finest"


def judged(case: RadarCase, *, search: bool = True) -> Iterator[Judged]:
    """Every body within 40 dB of the strongest, and above the noise."""
    fidelity, radar = Tolerance(case.tolerance).knobs(), case.radar
    trace(case.scene, radar, fidelity=fidelity)  # compiles
    seconds, (propagation, *_) = processor_time(lambda: trace(case.scene, radar, fidelity=fidelity))
    truth = _truth(case, propagation)
    cheapest = _cheapest(case, truth, seconds) if search else None
    compared = _errors(case, propagation, truth, fidelity.radar_tolerance)
    rows = np.unique(np.linspace(0, len(compared) - 1, _BODIES).round().astype(int))
    for number in rows.tolist() if compared else ():
        body, first = compared[number], number == 0
        others = f" and {len(body.objects) - 1} more" if body.objects[1:] else ""
        yield Judged(
            name=case.name,
            figure=f"{body.objects[0]}{others}",
            tolerance=fidelity.radar_tolerance,
            stated=body.stated,
            true=body.true,
            truth_error=body.truth_error,
            unit="of its echo",
            truth=body.source(truth.source),
            is_independent=body.is_independent,
            seconds=seconds if first else math.nan,
            cheapest=cheapest if first else None,
            searched=search and first,
            warnings=tuple(propagation.warnings) if first else (),
        )


def _truth(case: RadarCase, propagation: Propagation) -> _Truth:
    radar, frequencies = case.radar, band_of(case.radar.ofdm)
    finest, fine = (trace(case.scene, radar, fidelity=each) for each in (_FINEST, _FINE))
    if not case.bounces:
        found = reference_bodies(case.scene, radar, _FINEST, finest, 0)
        own, less_exact = (
            echoes_by_body(p, found.names, radar, frequencies) for p in (finest, fine)
        )
        is_sampled = np.reshape(found.is_sampled, (-1, 1))
        beside = own - _direct(case, found) if is_sampled.any() else own
        of_solver = np.where(is_sampled, beside, found.echo)
        source = "direct echo summed by brute force"
        return _Truth(found.names, found.echo, own - less_exact, of_solver, source)
    bodies = [o for o in case.scene.objects if o is not case.ground]
    names = tuple((o.name,) for o in bodies)
    coarse, exact = (
        mirrored_currents.echoes(
            bodies,
            radar,
            frequencies,
            case.bounces,
            spacing * radar.ofdm.wavelength_m,
            case.ground,
            least=4,
        )
        for spacing in _SPACINGS
    )
    # Currents know no waves round obstacles.
    around, less_exact = (
        _around_obstacles(case, names, *pair) for pair in ((finest, _FINEST), (fine, _FINE))
    )
    error = exact - coarse + around - less_exact
    return _Truth(names, exact + around, error, around, "sums of currents")


def _direct(case: RadarCase, found: Bodies) -> Complex:
    """Direct echoes of bodies as the solver finds them, (n_bodies, n_frequencies)."""
    alone = _FINEST.with_(radar_bounces=1, radar_images=0, radar_shadowed=0)
    direct = trace(case.scene, case.radar, fidelity=alone)
    return echoes_by_body(direct, found.names, case.radar, found.frequencies_hz)


def _around_obstacles(
    case: RadarCase, names: tuple[tuple[str, ...], ...], whole: Propagation, fidelity: Fidelity
) -> Complex:
    """What waves round obstacles add to each body, (n_bodies, n_frequencies)."""
    radar, frequencies = case.radar, band_of(case.radar.ofdm)
    without = trace(case.scene, radar, fidelity=fidelity.with_(radar_shadowed=0))
    both = (echoes_by_body(p, names, radar, frequencies) for p in (whole, without))
    return np.asarray(np.subtract(*both))


def _errors(
    case: RadarCase, propagation: Propagation, truth: _Truth, tolerance: float
) -> list[_Compared]:
    """Of bodies, the strongest first, relative to their echoes or to the least echo that counts.
    Bodies that the solver tells nothing of are stated to be nothing, to the tolerance.
    """
    radar, frequencies = case.radar, band_of(case.radar.ofdm)
    bodies = {body.objects: body.estimated_error for body in propagation.bodies}
    told = {name for objects in bodies for name in objects}
    members = (*bodies, *(names for names in truth.names if not told & set(names)))
    if not members:
        return []
    echo = echoes_by_body(propagation, members, radar, frequencies)
    true, own, by_solver = (np.array(x) for x in zip(*map(truth.of, members), strict=True))
    level = _rms(true)
    least = max(OF_NOISE * noise_amplitude(radar) / tolerance, WEAKEST * float(level.max()))
    over = np.maximum(_rms(echo), least)
    off, uncertain, part = (_rms(each) / over for each in (echo - true, own, by_solver))
    is_whole = np.all(by_solver == true, axis=1) & (level > 0)
    return [
        _Compared(
            members[i],
            float(off[i]),
            float(bodies.get(members[i], tolerance)),
            float(uncertain[i]),
            _ALL if is_whole[i] else float(part[i]),
        )
        for i in np.argsort(-level, kind="stable")
        if level[i] > 0 or off[i] > 0
    ]


def _cheapest(case: RadarCase, truth: _Truth, most_s: float) -> Cheapest | None:
    """The cheapest of all settings in which every body's error is within the tolerance, if it takes
    less than ``most_s``.
    """
    best: Cheapest | None = None
    permitted = Tolerance(case.tolerance).knobs().radar_tolerance
    for shadowed, images, bounces in product(_SHADOWED, _IMAGES, _BOUNCES):
        for tolerance in _TOLERANCES:
            fidelity = Fidelity(
                radar_tolerance=tolerance,
                radar_bounces=bounces,
                radar_images=images,
                radar_shadowed=shadowed,
            )
            begin = time.process_time()
            trace(case.scene, case.radar, fidelity=fidelity)  # compiles
            first = time.process_time() - begin
            if first > 3 * most_s + 0.5:
                break
            traced = partial(trace, case.scene, case.radar, fidelity=fidelity)
            seconds, (propagation, *_) = processor_time(traced)
            if seconds > most_s:
                break
            errors = [c.beyond_truth for c in _errors(case, propagation, truth, permitted)]
            if max(errors, default=0.0) <= permitted:
                knobs = (
                    f"tolerance {tolerance:g}, {bounces} bounces, {images} images, "
                    f"{shadowed} cells in shadows"
                )
                best, most_s = Cheapest(seconds, knobs), seconds
                break
    return best


def _rms(values: Complex) -> Array:
    found: Array = np.sqrt(np.mean(np.abs(values) ** 2, axis=-1))
    return found

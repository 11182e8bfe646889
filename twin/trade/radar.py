"""Rungs of the radar: who finds the echoes, and the tolerances of finding and of synthesis.

All against physical optics at a finer tolerance, the closest that there is to the scene's meshes:
what the cheaper descriptions leave out, or declare otherwise, is their error. Rough surfaces are
not here: their speckle is one draw of many, and no error.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.fidelity import PRESETS, Fidelity
from twin.progress import OpenStage
from twin.radar import RadarDesign
from twin.radar.acquisition import contributions
from twin.radar.propagation.result import Propagation
from twin.radar.propagation.scene.atmosphere import Air
from twin.radar.propagation.solvers import trace
from twin.radar.synthesis import Contributions, direct_sum, synthesize
from twin.scene import Scene
from twin.trade.bodies import Bodies, errors_of, reference_bodies
from twin.trade.measurement import Cost, Measurement
from twin.trade.meter import metered

Complex = NDArray[np.complex128]

#: Who finds the echoes, tolerances of the synthesis.
_RUNGS: tuple[tuple[Fidelity, tuple[float, ...]], ...] = (
    (Fidelity(radar="targets"), (1e-6,)),
    (Fidelity(radar="paths"), (1e-6,)),
    (Fidelity(radar_tolerance=PRESETS["draft"].radar_tolerance), (1e-3,)),
    (Fidelity(), (1e-3, 1e-6, 1e-10)),
    (Fidelity(radar_tolerance=PRESETS["reference"].radar_tolerance), (1e-6,)),
)
_REFERENCE = "reference channel"
_FINEST = Fidelity(radar="optics", radar_tolerance=0.01)
_ROWS, _COLUMNS = 64, 32  # of the bins compared: edges of band and interval, the rest at random
_MOST_TERMS = 2e8  # of the direct sum, some seconds: of many echoes fewer bins are compared


def radar_stages() -> list[str]:
    """Stages of `measure_radar`, in their order."""
    names = [_REFERENCE]
    for finder, tolerances in _RUNGS:
        names += [_finding(finder), *(_synthesis(finder, t) for t in tolerances)]
    return names


@dataclass(frozen=True, eq=False)
class _Bins:
    """Bins that are compared, and the channel there by direct sum in float64; and bodies."""

    rows: NDArray[np.intp]
    columns: NDArray[np.intp]
    channel: Complex
    bodies: Bodies

    @property
    def rms(self) -> float:
        return float(np.sqrt(np.mean(np.abs(self.channel) ** 2)))


def measure_radar(
    scene: Scene, radar: RadarDesign, seed: int, stage: OpenStage
) -> list[Measurement]:
    """Every rung against the direct sum over the echoes of the reference.

    The error over noise is that of the range-Doppler map: the error's whole energy, as if it were
    one echo, against the noise of one cell. An echo left out is exactly that; what a tolerance
    leaves is spread over the map, and less. Empty where the scene sends no echo at all.
    """
    with stage(_REFERENCE):
        bins = _reference(scene, radar, seed)
    if bins.rms == 0:
        return []
    measured = []
    for finder, tolerances in _RUNGS:

        def found_in(run: int, finder: Fidelity = finder) -> Propagation:
            return trace(scene, radar, fidelity=finder, seed=seed + 1 + run)

        with stage(_finding(finder)):
            finding, found = metered(found_in)
        for tolerance in tolerances:
            with stage(_synthesis(finder, tolerance)):
                rung = replace(finder, nufft_tolerance=tolerance)
                measured.append(_rung(radar, rung, finding, found[0], bins))
    return measured


def _reference(scene: Scene, radar: RadarDesign, seed: int) -> _Bins:
    wave = radar.channel_waveform
    finest = trace(scene, radar, fidelity=_FINEST, seed=seed)
    bodies = reference_bodies(scene, radar, _FINEST, finest, seed)
    echoes = _echoes(finest, radar)
    fewer = min(1.0, (_MOST_TERMS / (_ROWS * _COLUMNS * max(len(echoes.delay_s), 1))) ** 0.5)
    rng = np.random.default_rng([seed, 6])
    rows, columns = (
        np.unique([0, n - 1, *rng.choice(n, min(n, max(round(fewer * most), 4)), replace=False)])
        for n, most in ((wave.n_subcarriers, _ROWS), (wave.n_slots, _COLUMNS))
    )
    f, t = wave.frequency_offsets_hz[rows], wave.slot_times_s[columns]
    return _Bins(rows, columns, direct_sum(echoes, f, t, wave.carrier_hz), bodies)


def _rung(
    radar: RadarDesign, rung: Fidelity, finding: Cost, found: Propagation, bins: _Bins
) -> Measurement:
    wave = radar.channel_waveform
    echoes = _echoes(found, radar)
    tolerance = rung.nufft_tolerance
    cost, channels = metered(lambda run: synthesize(echoes, wave, tolerance)[_sampled(bins)])
    off = np.abs(channels[0] - bins.channel)
    rms = float(np.sqrt(np.mean(off**2)))
    relative = rms / bins.rms
    of_meshes = rung.radar == "optics"
    known = [name for name, value in PRESETS.items() if _same(value, rung)]
    return Measurement(
        ladder="radar",
        name=_name(rung) + (f" ({known[0]})" if known else ""),
        fidelity=rung,
        cost=_both(finding, cost),
        error=relative,
        unit="of the channel",
        over_noise=rms / _noise(radar),
        detail={
            "error_db": 20 * float(np.log10(relative)) if relative else -np.inf,
            "largest": float(off.max()) / bins.rms,
            "paths": len(found.paths),
            "echoes": len(found.echoes.delay_s),
        },
        note=f"{bins.channel.size} bins of {wave.n_subcarriers * wave.n_slots}",
        bodies=errors_of(bins.bodies, found, radar, rung.radar_tolerance) if of_meshes else (),
    )


def _finding(finder: Fidelity) -> str:
    return f"radar {_finder(finder)}"


def _synthesis(finder: Fidelity, tolerance: float) -> str:
    return f"{_finding(finder)}, synthesis {tolerance:.0e}"


def _name(rung: Fidelity) -> str:
    return f"{_finder(rung)}, synthesis {rung.nufft_tolerance:.0e}"


def _finder(rung: Fidelity) -> str:
    if rung.radar != "optics":
        return str(rung.radar)
    return f"{rung.radar}, tolerance {rung.radar_tolerance:g}"


def _echoes(found: Propagation, radar: RadarDesign) -> Contributions:
    """Of the first step, transmitter and receiver, which stand for the others."""
    return radar.burst.seen(contributions(found, radar, Air()))


def _noise(radar: RadarDesign) -> float:
    """Channel error, rms over bins, whose energy in one cell of the map equals the noise there.

    A bin's noise is the sample's over the sent power; the transform gains by all bins.
    """
    wave = radar.channel_waveform
    per_bin = radar.sample_noise_w / radar.front_end.transmit_power_w.value
    return float(np.sqrt(per_bin / (wave.n_subcarriers * wave.n_slots)))


def _both(a: Cost, b: Cost) -> Cost:
    """One after the other."""
    return Cost(
        a.seconds + b.seconds,
        a.low_s + b.low_s,
        a.high_s + b.high_s,
        min(a.runs, b.runs),
        max(a.peak_bytes, b.peak_bytes),
    )


def _sampled(bins: _Bins) -> Any:
    return np.ix_(bins.rows, bins.columns)


def _same(preset: Fidelity, rung: Fidelity) -> bool:
    knobs = ("radar", "radar_tolerance", "nufft_tolerance")
    return preset == replace(preset, **{name: getattr(rung, name) for name in knobs})

"""Fidelity levels of the radar: the solver, and the tolerances of solver and synthesis.

The reference is physical optics at a finer tolerance with edges and waves round obstacles, the most
accurate solution for the scene's meshes; whatever cheaper models leave out, or declare differently,
is their error. Surface clutter is left out of all: it is one realisation of a random process, not
an error.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hardware.formatting import number
from twin.fidelity import PRESETS, Fidelity, Tolerance
from twin.progress import OpenStage
from twin.radar import RadarDesign
from twin.radar.acquisition import contributions
from twin.radar.propagation.facets.body_scattering import OF_TOLERANCE
from twin.radar.propagation.result import Propagation
from twin.radar.propagation.scene.atmosphere import Atmosphere
from twin.radar.propagation.solvers import solver_of, trace
from twin.radar.synthesis import Contributions, demodulated, direct_sum, synthesize
from twin.scene import Scene
from twin.trade.bodies import Bodies, errors_of, reference_bodies
from twin.trade.measurement import RADAR_KNOBS, Cost, LevelMeasurement
from twin.trade.meter import measure_cost

Complex = NDArray[np.complex128]

#: Reflections at bodies and at large surfaces as many as bounds of what they add ask for.
_BY_BOUNDS = Fidelity(radar_bounces=None, radar_images=None)
#: What `twin run` takes without knobs, less clutter.
_AS_RUN = Tolerance().knobs().with_(radar="optics")
#: Solver, and tolerances of the synthesis.
_LEVELS: tuple[tuple[Fidelity, tuple[float, ...]], ...] = (
    (Fidelity(radar="targets"), (1e-6,)),
    (Fidelity(radar="paths"), (1e-6,)),
    (Fidelity(radar_tolerance=PRESETS["draft"].radar_tolerance), (1e-6,)),
    (Fidelity(), (1e-3, 1e-6, 1e-10)),
    (_AS_RUN, (1e-6,)),
    (_BY_BOUNDS.with_(radar_tolerance=PRESETS["reference"].radar_tolerance), (1e-6,)),
)
_REFERENCE = "reference channel"
#: Edges and cells as numbers, which are computed however faint they are.
_FINEST = _BY_BOUNDS.with_(
    radar_tolerance=0.01,
    radar_edges=PRESETS["reference"].radar_edges,
    radar_shadowed=PRESETS["reference"].radar_shadowed,
)
_ROWS, _COLUMNS = 64, 32  # of the bins compared: edges of band and interval, the rest at random
_MOST_TERMS = 2e8  # of the direct sum, some seconds: of many echoes fewer bins are compared


def radar_stages() -> list[str]:
    """Stages of `measure_radar`, in their order."""
    names = [_REFERENCE]
    for finder, tolerances in _LEVELS:
        names += [_tracing(finder), *(_synthesis(finder, t) for t in tolerances)]
    return names


def reference_tolerance() -> float:
    """Error of the echoes of the reference, but for those that are sampled by brute force."""
    return _FINEST.radar_tolerance


@dataclass(frozen=True, eq=False)
class _ReferenceBins:
    """Bins to compare, the reference channel there by direct sum in float64, and bodies."""

    rows: NDArray[np.intp]
    columns: NDArray[np.intp]
    channel: Complex
    bodies: Bodies

    @property
    def rms(self) -> float:
        return float(np.sqrt(np.mean(np.abs(self.channel) ** 2)))


def measure_radar(
    scene: Scene, radar: RadarDesign, seed: int, stage: OpenStage
) -> list[LevelMeasurement]:
    """Every level against the direct sum over the echoes of the reference.

    The error over noise refers to the range-Doppler map: the energy of the whole error, as if it
    were one echo, over the noise of one cell. That is exact for a missing echo, and an upper bound
    for errors spread over the map. Empty where the scene has no echo at all.
    """
    with stage(_REFERENCE):
        bins = _reference(scene, radar, seed)
    if bins.rms == 0:
        return []
    measured = []
    for finder, tolerances in _LEVELS:

        def trace_echoes(run: int, finder: Fidelity = finder) -> Propagation:
            return trace(scene, radar, fidelity=finder, seed=seed + 1 + run)

        with stage(_tracing(finder)):
            tracing_cost, propagations = measure_cost(trace_echoes, least=_timed_runs(finder))
        for tolerance in tolerances:
            with stage(_synthesis(finder, tolerance)):
                level = replace(finder, nufft_tolerance=tolerance)
                measured.append(_measure_level(radar, level, tracing_cost, propagations[0], bins))
    return measured


def _timed_runs(finder: Fidelity) -> int:
    """Of what takes seconds one beside the warm-up."""
    return 1 if finder.radar_bounces is None else 3


def _reference(scene: Scene, radar: RadarDesign, seed: int) -> _ReferenceBins:
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
    return _ReferenceBins(rows, columns, direct_sum(echoes, f, t, wave.carrier_hz), bodies)


def _measure_level(
    radar: RadarDesign,
    level: Fidelity,
    tracing_cost: Cost,
    propagation: Propagation,
    bins: _ReferenceBins,
) -> LevelMeasurement:
    wave = radar.channel_waveform
    echoes = _echoes(propagation, radar)
    tolerance = level.nufft_tolerance
    cost, _ = measure_cost(lambda run: demodulated(echoes, wave, tolerance)[_sampled(bins)])
    # What is compared is the channel in the middle of each slot, whose every bin stands for itself.
    off = np.abs(synthesize(echoes, wave, tolerance)[_sampled(bins)] - bins.channel)
    rms = float(np.sqrt(np.mean(off**2)))
    relative = rms / bins.rms
    known = [name for name, value in PRESETS.items() if _same(value, level)]
    return LevelMeasurement(
        model="radar",
        name=_name(level) + (f" ({known[0]})" if known else ""),
        fidelity=level,
        cost=_both(tracing_cost, cost),
        error=relative,
        unit="of the channel",
        over_noise=rms / _noise(radar),
        detail={
            "error_db": 20 * float(np.log10(relative)) if relative else -np.inf,
            "largest": float(off.max()) / bins.rms,
            "paths": len(propagation.names),
            "echoes": len(propagation.echoes),
        },
        note=f"{bins.channel.size} bins of {wave.n_subcarriers * wave.n_slots}",
        bodies=errors_of(
            bins.bodies,
            propagation,
            radar,
            level.radar_tolerance,
            synthesis=tolerance * bins.rms,
        )
        if solver_of(level).has_tolerance
        else (),
        leaves_out=_leaves_out(level),
    )


def _leaves_out(level: Fidelity) -> str:
    """What a level has no model of, in words; clutter is in none."""
    if level.radar == "targets":
        return "all meshes: declared points alone"
    silent = ["edges"] * (level.radar_edges == 0)
    silent += ["waves round obstacles to bodies"] * (level.radar_shadowed == 0)
    if not solver_of(level).has_tolerance:
        return "; ".join(["bodies other than by tables of their far fields", *silent])
    if level.radar_bounces is None:
        share = number(100 * OF_TOLERANCE * level.radar_tolerance, 2)
        return "; ".join([f"what is bounded by {share} % of an echo, each effect", *silent])
    beyond = f"reflections beyond {level.radar_bounces} at bodies, {level.radar_images} at surfaces"
    return "; ".join([beyond, *silent])


def _tracing(finder: Fidelity) -> str:
    return f"radar {_solver_name(finder)}"


def _synthesis(finder: Fidelity, tolerance: float) -> str:
    return f"{_tracing(finder)}, synthesis {tolerance:.0e}"


def _name(level: Fidelity) -> str:
    return f"{_solver_name(level)}, synthesis {level.nufft_tolerance:.0e}"


def _solver_name(level: Fidelity) -> str:
    if not solver_of(level).has_tolerance:
        return str(level.radar)
    name = f"{level.radar}, tolerance {level.radar_tolerance:g}"
    if level.radar_edges is None:
        return f"{name}, as run: all by bounds"
    return f"{name}, reflections by bounds" if level.radar_bounces is None else name


def _echoes(propagation: Propagation, radar: RadarDesign) -> Contributions:
    """Echoes of the first step, transmitter and receiver, which represent the others."""
    return radar.burst.seen(contributions(propagation, radar, Atmosphere()))


def _noise(radar: RadarDesign) -> float:
    """Channel error, rms over bins, whose energy in one cell of the map equals the noise there.

    The noise of a bin is that of a sample over the sent power, divided by the processing gain.
    """
    wave = radar.channel_waveform
    per_bin = radar.sample_noise_w / radar.front_end.transmit_power_w.value
    return float(np.sqrt(per_bin / (wave.n_subcarriers * wave.n_slots)))


def _both(a: Cost, b: Cost) -> Cost:
    """Cost of two computations, one after the other."""
    return Cost(
        a.seconds + b.seconds,
        a.low_s + b.low_s,
        a.high_s + b.high_s,
        min(a.runs, b.runs),
        max(a.peak_bytes, b.peak_bytes),
    )


def _sampled(bins: _ReferenceBins) -> Any:
    return np.ix_(bins.rows, bins.columns)


def _same(preset: Fidelity, level: Fidelity) -> bool:
    return preset == replace(preset, **{name: getattr(level, name) for name in RADAR_KNOBS})

"""Assumptions and warnings of a capture."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hardware.formatting import number
from hardware.records import RadarRecord
from hardware.waveform import C_M_PER_S
from twin.accuracy import missed_effects
from twin.geometry import are_too_large, shapes_of
from twin.radar.device.design import RadarDesign
from twin.radar.device.front_end import full_scale_w, image_rejection_db
from twin.radar.device.phase_noise import residual_rad
from twin.radar.propagation.facets.convergence import unconverged, worst_by_body
from twin.radar.propagation.one_way.motion import lengthening, relative_motion
from twin.radar.propagation.result import Propagation
from twin.radar.propagation.scene.atmosphere import Atmosphere
from twin.radar.propagation.scene.materials import with_generic_properties
from twin.radar.propagation.scene.scattering_models import ScatteringModel
from twin.radar.propagation.solvers import Solver
from twin.radar.truth import TrueTarget
from twin.scene import Scene, SceneObject
from twin.scene.enclosure import encloses
from twin.scene.objects import Target
from twin.warned import CaptureWarning

Array = NDArray[np.float64]

_FAINT_DB = -40.0  # bodies below the strongest whose rates are not warned of
_BENT_RAD = 0.02  # phase that a model of a path leaves out from which it is warned of
#: Phase by which wavefronts bend over the antennas from which directions are off by more than the
#: vehicle states: by four stated errors at 1.6 rad, by one at 0.8 (37 dB, 48 antennas in a row).
_CURVED_RAD = 0.5
_COARSE = 0.05  # of an echo, 0.4 dB: error by coarse facets from which it is warned of
_NOISY_RAD = 0.3  # phase noise of an echo from which its square matters

#: Holds for every capture.
MODEL_ASSUMPTIONS = (
    "places, velocities and accelerations are those of a burst's middle, or of each instant at "
    "which it is traced; delays of second order in time about it, and to first order in v / c",
)


def assumptions(
    scene: Scene,
    radar: RadarDesign,
    bursts: Sequence[Propagation],
    air: Atmosphere,
    solver: Solver,
) -> tuple[str, ...]:
    """Everything that a capture takes for granted, the design's assumed values included; what the
    propagation takes for granted is that of the first burst.
    """
    values = [said for _, said in radar.assumed()]
    targets = [
        f"cross-section of {t.name} = {number(t.rcs_m2, 4)} m^2: "
        f"{t.origin.removeprefix('assumed: ')}"
        for t in scene.targets
        if t.origin.startswith("assumed: ")
    ]
    return (
        *solver.assumptions,
        *MODEL_ASSUMPTIONS,
        _antennas(radar),
        *_steps(radar),
        *_front_end(radar),
        air.describe(radar.ofdm.carrier_hz),
        *bursts[0].assumptions,
        *unconverged(worst_by_body(body for burst in bursts for body in burst.bodies)),
        *values,
        *targets,
    )


def warnings(
    scene: Scene,
    radar: RadarDesign,
    bursts: Sequence[Propagation],
    truth: tuple[TrueTarget, ...],
    record: RadarRecord,
    solver: Solver,
) -> tuple[CaptureWarning, ...]:
    """What contradicts itself; the scene is that of the first burst."""
    farthest = max((t.range_m for t in truth), default=0.0)
    fastest = max((abs(t.range_rate_m_per_s) for t in truth), default=0.0)
    fastest = max(fastest, _fastest(bursts[0]))
    messages = radar.warnings(farthest, fastest)
    place = scene.rig.position_m + scene.rig.device("radar")[0]
    inside = [item.name for item in scene.objects if encloses(item, place)]
    if inside:
        text = f"the radar stands inside {', '.join(inside)}"
        messages.append(CaptureWarning("design", text))
    hidden = [t.name for t in truth if not t.visible]
    if hidden:
        messages.append(CaptureWarning("hidden", f"no direct path to {', '.join(hidden)}"))
    surfaces = {a.name for a in bursts[0].roles if a.role is ScatteringModel.SURFACE}
    coarse = []
    if solver.is_float32:
        coarse = [o.name for o in scene.objects if o.name in surfaces and _too_large(o, place)]
    if coarse:
        text = (
            f"triangles of {', '.join(coarse)} are so large that float32 rays may lose their echo "
            "or count it again (off by up to 300 % in what was tried): divide them"
        )
        messages.append(CaptureWarning("rendering", text))
    messages += [CaptureWarning("model", text) for text in _generic(scene, bursts[0])]
    messages += [CaptureWarning("model", text) for text in bursts[0].warnings]
    bodies = worst_by_body(body for burst in bursts for body in burst.bodies)
    messages += [CaptureWarning("rendering", text) for text in unconverged(bodies)]
    messages += [CaptureWarning("tolerance", text) for text in not_followed(bursts)]
    messages += _coarse(scene, radar, bursts[0])
    if not bursts[0].instants:
        messages += _bends(scene, radar)
    messages += _curved(radar, truth, bursts[0])
    messages += _noise(radar, farthest)
    if not any(len(burst.contributions) for burst in bursts):
        what = "noise and leakage" if radar.leakage else "noise"
        text = f"no echo at all: the record holds {what} only"
        messages.append(CaptureWarning("no-echo", text))
    clipped, n_slots = int(np.count_nonzero(record.flags)), record.flags.size
    if clipped:
        text = f"{clipped} of {n_slots} slots clip: lower front_end.noise_counts"
        messages.append(CaptureWarning("saturated", text, void=clipped == n_slots))
    elif not record.iq.any():
        text = "all counts are 0: raise front_end.noise_counts, or front_end.adc_bits"
        messages.append(CaptureWarning("underexposed", text, void=True))
    return tuple(messages)


def not_followed(bursts: Sequence[Propagation]) -> list[str]:
    """On effects that no model follows although they may add more than is permitted, each at the
    burst where it may add the most; none that a warning of the first burst tells.
    """
    told = {each.effect: each.bound for each in bursts[0].decisions if each.is_told}
    missed = missed_effects(
        decision
        for burst in bursts
        for decision in burst.decisions
        if decision.bound > told.get(decision.effect, 0.0)
    )
    return [f"{text}; the stated errors contain it" for text in missed]


def _generic(scene: Scene, propagation: Propagation) -> list[str]:
    """On unknown materials of objects whose mesh answers."""
    answers = {ScatteringModel.SURFACE, ScatteringModel.OPTICS, ScatteringModel.TABLE}
    names = {a.name for a in propagation.roles if a.role in answers}
    return with_generic_properties(scene, names)


def _antennas(radar: RadarDesign) -> str:
    common = f"vertical polarisation alone, {radar.antenna.describe()}"
    if radar.elements is None:
        return f"one transmit and one receive antenna at one place, {common}"
    burst = radar.burst
    alone, turns = radar.ofdm.max_velocity_m_per_s, radar.channel_waveform.max_velocity_m_per_s
    return (
        f"{len(burst.transmitters_m)} transmitters take turns by slot, so range rates are "
        f"unambiguous to +/- {turns:.3g} m/s (one alone: {alone:.3g}); "
        f"{len(burst.receivers_m)} receivers; {common}; the coupling of antennas left out"
    )


def _steps(radar: RadarDesign) -> list[str]:
    if radar.steps is None:
        return []
    return [
        f"{radar.steps.count.value} carrier steps: materials as at the first, mirrors and "
        "cross-sections answer in proportion to the wavelength"
    ]


def _front_end(radar: RadarDesign) -> list[str]:
    """What is modelled of the faults, and what is not."""
    off = [
        name
        for name, there in (
            ("no leakage between antennas", radar.leakage),
            ("no phase noise", radar.oscillator),
            ("branches of the mixer alike", np.isfinite(image_rejection_db(radar))),
            ("a converter of 16 bits after averaging", radar.front_end.adc_bits),
        )
        if not there
    ]
    lines = ["; ".join(off)] if off else []
    lines.append(
        f"full scale {_dbm(full_scale_w(radar)):.1f} dBm at the receivers' ports"
        + (
            f", mirror images {image_rejection_db(radar):.1f} dB down"
            if np.isfinite(image_rejection_db(radar))
            else ""
        )
    )
    if radar.oscillator:
        lines.append(
            "phase noise beyond half the band is left out, of the rest its square; within a symbol "
            "it repeats with it"
        )
    return lines


def _noise(radar: RadarDesign, farthest_m: float) -> list[CaptureWarning]:
    if radar.oscillator is None:
        return []
    delay = 2 * min(farthest_m or np.inf, radar.ofdm.max_range_m) / C_M_PER_S
    left = residual_rad(radar.oscillator, radar.ofdm, delay) * np.sqrt(radar.ofdm.repeats)
    if left < _NOISY_RAD:
        return []
    text = (
        f"oscillator: {left:.2g} rad of phase noise are left on an echo, too much for a model to "
        f"first order: {100 * (1 - np.exp(-(left**2) / 2)):.0f} % of its amplitude should be lost"
    )
    return [CaptureWarning("model", text)]


def _curvature_rad(radar: RadarDesign, range_m: float) -> float:
    """Phase by which a wavefront bends over the antennas, there and back."""
    burst = radar.burst
    widest = sum(
        float(np.max(np.sum(places**2, axis=1)))
        for places in (burst.transmitters_m, burst.receivers_m)
    )
    return float(np.pi * widest / (radar.ofdm.wavelength_m * range_m))


def _curved(
    radar: RadarDesign, truth: Sequence[TrueTarget], burst: Propagation
) -> list[CaptureWarning]:
    """Of declared targets, and of bodies that are none of them."""
    declared = {target.name for target in truth}
    near = [(target.name, target.range_m) for target in truth] + [
        (body.name, body.ranges_m[0])
        for body in burst.bodies
        if body.level_db > _FAINT_DB and declared.isdisjoint(body.objects)
    ]
    bent = [(name, _curvature_rad(radar, max(range_m, 1e-3))) for name, range_m in near]
    return [
        CaptureWarning(
            "design",
            f"{name} is so near that wavefronts bend by {bend:.2g} rad over the antennas: the "
            "vehicle takes them for plane, so that direction and level are off by more than it "
            "states",
        )
        for name, bend in bent
        if bend > _CURVED_RAD
    ]


def _too_large(item: SceneObject, place: Array) -> bool:
    """Whether a renderer's rays would need the object divided; the radar's are not."""
    return bool(are_too_large(item.vertices_m - place, item.geometry.faces).any())


def _fastest(propagation: Propagation) -> float:
    """Largest range rate within any body that is not far fainter than the strongest, m/s."""
    rates = [
        abs(rate)
        for body in propagation.bodies
        if body.level_db > _FAINT_DB
        for rate in body.range_rates_m_per_s
    ]
    return max((rate for rate in rates if np.isfinite(rate)), default=0.0)


def _bends(scene: Scene, radar: RadarDesign) -> list[CaptureWarning]:
    """Warnings of targets whose range is no parabola in time: they pass near and fast, or turn."""
    if scene.at_rest and not scene.rig.moves:
        return []
    ends = np.clip(np.array([-1.0, 1.0]) * radar.burst_s / 2, *scene.span_s)
    carriers = {target.object for target in scene.targets}
    # Motions of limbs take milliseconds each.
    alone = replace(scene, objects=tuple(o for o in scene.objects if o.name in carriers))
    then = [alone.after(float(time)) for time in ends]
    off = np.zeros((2, len(scene.targets)))
    for k, target in enumerate(scene.targets):
        towards = _towards(scene, target)
        distance = float(np.linalg.norm(towards))
        velocity, faster = relative_motion(scene, target)
        rate, acceleration = lengthening(velocity, towards / distance, distance, faster)
        exact = [np.linalg.norm(_towards(world, world.targets[k])) for world in then]
        off[:, k] = exact - (distance + (rate + acceleration / 2 * ends) * ends)
    bends = np.abs(off).max(axis=0, initial=0.0).tolist()
    found = [_bend(*pair, radar) for pair in zip(scene.targets, bends, strict=True)]
    return [bend for bend in found if bend]


def _towards(scene: Scene, target: Target) -> Array:
    place: Array = scene.rig.position_m + scene.rig.device("radar")[0]
    return np.asarray(target.position_m) - place


def _bend(target: Target, bend_m: float, radar: RadarDesign) -> CaptureWarning | None:
    phase = 4 * np.pi * bend_m / radar.ofdm.wavelength_m
    if phase < _BENT_RAD:
        return None
    return CaptureWarning(
        "model",
        f"{target.name} passes so near and fast that its range is off a parabola by {bend_m:.2g} m "
        "at the interval's ends, which is left out: its echo is off by up to "
        f"{100 * min(phase, 2.0):.3g} % of itself",
    )


def _coarse(scene: Scene, radar: RadarDesign, propagation: Propagation) -> list[CaptureWarning]:
    """Warning of meshes too coarse for the wavelength, with the error of the worst one's echo."""
    scattering = {a.name for a in propagation.roles if a.role is ScatteringModel.OPTICS}
    items = [item for item in scene.objects if item.name in scattering]
    wave_number = 2 * np.pi / radar.ofdm.wavelength_m
    shapes = shapes_of([item.geometry for item in items])
    shares = [2 * wave_number * shape.depth_m for shape in shapes]
    coarse = sum(share > _COARSE for share in shares)
    if not coarse:
        return []
    worst = int(np.argmax(shares))
    if shares[worst] > 1:
        error = "whose facets reflect as separate plates"
    else:
        error = f"whose echo has an error of {20 * np.log10(1 + shares[worst]):.1f} dB rms"
    others = f" (and {coarse - 1} more, by less)" if coarse > 1 else ""
    text = (
        "facets are too coarse for the wavelength if they stand for a smooth surface: worst "
        f"{items[worst].name}, {error}{others}; a finer mesh is more exact"
    )
    return [CaptureWarning("model", text)]


def _dbm(power_w: float) -> float:
    return float(10 * np.log10(power_w * 1e3))

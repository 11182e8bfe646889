"""One acquisition of the single-pixel camera, from scene and system to a record of counts."""

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hardware.records import SpiRecord
from twin import __version__
from twin.camera.light import emitter_light, sun_light
from twin.camera.truth import Truth, render_truth
from twin.detector import FrontEnd, NoiseBudget, expose, noise_budget
from twin.optics.radiometry import Collection, collection
from twin.optics.spectra import SUN_ASSUMPTION, in_band_fraction, responsivity_a_per_w, sun_in_band
from twin.optics.transport import Pinhole, Quality
from twin.scene import Scene
from twin.scene.mitsuba import mitsuba_scene
from twin.system import Sky, System
from twin.toml import Sourced

Array = NDArray[np.float64]
#: Opens a named stage of the work; what is run inside belongs to it.
Stage = Callable[[str], AbstractContextManager[Any]]

#: Holds for every capture; printed with it.
MODEL_ASSUMPTIONS = (
    "surfaces are Lambertian, two-sided and flat-shaded; air is clear",
    SUN_ASSUMPTION,
    "cells are equal and have sharp edges; dark cells emit nothing (infinite contrast)",
    "the filter is flat inside its band and does not shift with angle "
    "(a real one moves 6-11 nm at 10 deg)",
    "lens: a pinhole in position, a flat pupil in power (cos^4 vignetting), in focus everywhere",
    "nothing moves during a frame; emitter power does not fluctuate",
    "amplifier: full settling within each exposure, white noise, linear up to the rails",
)


@dataclass(frozen=True, eq=False)
class Capture:
    """A record with everything the twin knows about it. Only ``record`` exists on the vehicle.

    ``cells_e`` (rows, columns) are the electrons that each cell, lit alone for one exposure, gives
    in the mean (a line sensor's columns side by side): what reconstructions are compared with.
    ``cells_error_e`` is their Monte-Carlo standard error. ``snr`` is cells_e over the noise of a
    reconstructed pixel (inverse transform of the patterns shown). ``background_w`` is the sun's
    power on one detector, mean over the detectors.
    """

    record: SpiRecord
    truth: Truth
    cells_e: Array
    cells_error_e: Array
    snr: Array
    noise: NoiseBudget
    lens: Collection
    signal_w: Array
    background_w: float
    sun_irradiance_w_per_m2: float
    in_band_fraction: float
    illuminance_lx: float
    assumptions: tuple[str, ...]
    warnings: tuple[str, ...]


def capture(
    scene: Scene,
    system: System,
    *,
    seed: int = 0,
    quality: Quality | None = None,
    rendered: Any = None,
    stage: Stage = lambda name: nullcontext(),
) -> Capture:
    """Acquire one frame.

    Parameters
    ----------
    scene, system
        What is looked at, and with what.
    seed
        Of every random draw: same seed, same counts, bit for bit.
    quality
        Knobs of the path tracer.
    rendered
        `mitsuba_scene(scene)`, when it is at hand already.
    stage
        Called with each stage's name, for progress and timing.
    """
    quality = quality or Quality()
    emitter, detector, lens = devices(scene, system)
    shape = (system.emitter.rows.value, system.emitter.columns.value)
    light_seed, sun_seed, noise_seed = np.random.SeedSequence(seed).spawn(3)

    n_detectors = system.n_detectors
    seeds = [int(s.generate_state(1)[0]) for s in (light_seed, sun_seed)]

    with stage("scene"):
        world = mitsuba_scene(scene) if rendered is None else rendered
    with stage("transport"):
        light = emitter_light(
            world, emitter, detector, shape, n_detectors, quality=quality, seed=seeds[0]
        )
    with stage("sun"):
        lux = Sourced(value=scene.sun.illuminance_lx, source="scene.toml")
        above = sun_in_band(system.sky or Sky(illuminance_lx=lux), system.filter)
        irradiance = above.irradiance_w_per_m2
        sun = sun_light(
            world, detector, scene.sun.direction, n_detectors, quality=quality, seed=seeds[1]
        )
    with stage("truth"):
        truth = render_truth(world, emitter, (shape[0], shape[1] * n_detectors))
    with stage("detector"):
        responsivity = responsivity_a_per_w(system.detector, system.emitter, system.filter)
        fraction = in_band_fraction(system.emitter, system.filter)
        collected = lens.transmission * lens.pupil_area_m2
        watt = system.emitter.radiant_intensity_w_per_sr.value * fraction * collected
        signal_w = system.patterns.signal(watt * light.cells.T)
        background_w = irradiance * collected * sun
        front_end = FrontEnd.of(system, responsivity)
        rng = np.random.default_rng(noise_seed)
        counts, flags = expose(signal_w + background_w, front_end, rng=rng)
        budget = noise_budget(signal_w, background_w, front_end)
        by_detector = [
            noise_budget(s, b, front_end).pixel_noise_e(system.patterns)
            for s, b in zip(signal_w.T, background_w, strict=True)
        ]
    to_electrons = watt * front_end.electrons_per_watt
    cells_e = to_electrons * _picture(light.cells, shape)
    noise_e = _picture(np.tile(np.array(by_detector)[:, None], (1, shape[0] * shape[1])), shape)
    record = _record(scene, system, front_end, counts, flags)
    return Capture(
        record=record,
        truth=truth,
        cells_e=cells_e,
        cells_error_e=to_electrons * _picture(light.error, shape),
        snr=cells_e / noise_e,
        noise=budget,
        lens=lens,
        signal_w=signal_w,
        background_w=float(background_w.mean()),
        sun_irradiance_w_per_m2=irradiance,
        in_band_fraction=fraction,
        illuminance_lx=above.illuminance_lx,
        assumptions=(*MODEL_ASSUMPTIONS, *scene.assumptions, *_assumed(system)),
        warnings=_warnings(system, counts, flags, fraction, cells_e),
    )


def _picture(by_detector: Array, shape: tuple[int, int]) -> Array:
    """Cells of all detectors (n_detectors, n_cells) as one picture, detectors side by side."""
    return np.hstack(list(by_detector.reshape(-1, *shape)))


def devices(scene: Scene, system: System) -> tuple[Pinhole, Pinhole, Collection]:
    """Emitter and detector where the rig holds them, and the detector's lens."""
    lens = collection(system)
    half = np.radians(system.emitter.field_of_view_deg.value) / 2
    emitter = Pinhole(*scene.rig.device("emitter"), tan_half_field=float(np.tan(half)))
    origin, axes = scene.rig.device("detector")
    return emitter, Pinhole(origin, axes, lens.tan_half_field, lens.outline), lens


def _record(
    scene: Scene,
    system: System,
    front_end: FrontEnd,
    counts: NDArray[np.int32],
    flags: NDArray[np.uint8],
) -> SpiRecord:
    n = len(counts)
    period_ns = system.acquisition.pattern_period_s.value * 1e9
    x, y, z, w = scene.rig.pose.rotation.as_quat()
    return SpiRecord(
        counts=counts,
        device_time_ns=np.rint(np.arange(n) * period_ns).astype(np.int64),
        sequence=np.arange(n, dtype=np.uint32),
        flags=flags,
        patterns=system.patterns,
        integration_time_s=system.acquisition.integration_time_s.value,
        electrons_per_count=front_end.electrons_per_count,
        offset_counts=front_end.offset_counts,
        adc_bits=front_end.adc_bits,
        device=f"twin {__version__}: {system.name}",
        pose=np.array([*scene.rig.pose.position_m, w, x, y, z]),
    )


def _assumed(system: System) -> tuple[str, ...]:
    return tuple(
        f"{name} = {value.value}: {value.assumed}"
        for name, value in system.values()
        if value.assumed
    )


def _warnings(
    system: System,
    counts: NDArray[np.int32],
    flags: NDArray[np.uint8],
    in_band: float,
    cells_e: Array,
) -> tuple[str, ...]:
    found = []
    top = 2**system.readout.adc_bits.value - 1
    for rail, remedy in ((top, "its gain is too high"), (0, "adc_offset_v is too low")):
        hits = int((counts == rail).any(axis=1).sum())
        if hits:
            found.append(f"{hits} of {len(counts)} exposures saturate the ADC: readout: {remedy}")
    full = int(np.count_nonzero(flags)) - int(((counts == 0) | (counts == top)).any(axis=1).sum())
    if full > 0:
        found.append(f"{full} of {len(counts)} exposures fill the well: readout.full_well_e")
    if in_band == 0 or system.emitter.radiant_intensity_w_per_sr.value == 0:
        found.append("no light of the emitter passes the filter, or it emits none")
    elif not cells_e.any():
        found.append("no light of the emitter comes back: nothing in the field of view")
    return tuple(found)

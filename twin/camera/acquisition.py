"""One acquisition of the single-pixel camera, from scene and system to a record of counts."""

from contextlib import nullcontext
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hardware.records import SpiRecord
from twin import __version__
from twin.camera.light import Rendered, Stage, render
from twin.camera.truth import Truth
from twin.detector import FrontEnd, NoiseBudget, expose, noise_budget
from twin.optics.radiometry import Collection, collection
from twin.optics.spectra import (
    SUN_ASSUMPTION,
    in_band_fraction,
    responsivity_a_per_w,
    sun_in_band,
)
from twin.optics.transport import Quality
from twin.scene import Scene
from twin.system import Sky, System
from twin.toml import Sourced

Array = NDArray[np.float64]

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
    world: Any = None,
    stage: Stage = lambda name: nullcontext(),
) -> Capture:
    """Acquire one frame: `render`, then `measure`.

    Parameters
    ----------
    scene, system
        What is looked at, and with what.
    seed
        Of every random draw: same seed, same counts, bit for bit.
    quality
        Knobs of the path tracer.
    world
        `mitsuba_scene(scene)`, when it is at hand already.
    stage
        Called with each stage's name, for progress and timing.
    """
    light_seed, noise_seed = np.random.SeedSequence(seed).spawn(2)
    rendered = render(
        scene, system, quality=quality or Quality(), seed=light_seed, world=world, stage=stage
    )
    with stage("detector"):
        return measure(scene, system, rendered, rng=np.random.default_rng(noise_seed))


def measure(
    scene: Scene, system: System, rendered: Rendered, *, rng: np.random.Generator
) -> Capture:
    """Light to counts: filter, lens, detector, amplifier and converter of a system."""
    lens = collection(system)
    collected = lens.transmission * lens.pupil_area_m2
    fraction = in_band_fraction(system.emitter, system.filter)
    watt = system.emitter.radiant_intensity_w_per_sr.value * fraction * collected
    signal_w = system.patterns.signal(watt * rendered.light.cells.T)
    own_sky = Sky(illuminance_lx=Sourced(value=scene.sun.illuminance_lx, source="scene.toml"))
    sky = sun_in_band(system.sky or own_sky, system.filter)
    background_w = sky.irradiance_w_per_m2 * collected * rendered.sun

    responsivity = responsivity_a_per_w(system.detector, system.emitter, system.filter)
    front_end = FrontEnd.of(system, responsivity)
    counts, flags = expose(signal_w + background_w, front_end, rng=rng)
    cells_e = watt * front_end.electrons_per_watt * rendered.light.cells
    error_e = watt * front_end.electrons_per_watt * rendered.light.error
    noise_e = [
        noise_budget(signal, sun, front_end).pixel_noise_e(system.patterns)
        for signal, sun in zip(signal_w.T, background_w, strict=True)
    ]
    return Capture(
        record=_record(scene, system, front_end, counts, flags),
        truth=rendered.truth,
        cells_e=_picture(cells_e, system),
        cells_error_e=_picture(error_e, system),
        snr=_picture(cells_e / np.array(noise_e)[:, None], system),
        noise=noise_budget(signal_w, background_w, front_end),
        lens=lens,
        signal_w=signal_w,
        background_w=float(background_w.mean()),
        sun_irradiance_w_per_m2=sky.irradiance_w_per_m2,
        in_band_fraction=fraction,
        illuminance_lx=sky.illuminance_lx,
        assumptions=(*MODEL_ASSUMPTIONS, *scene.assumptions, *_assumed(system)),
        warnings=_warnings(system, counts, flags, fraction, cells_e),
    )


def _picture(by_detector: Array, system: System) -> Array:
    """Cells of all detectors (n_detectors, n_cells) as one picture, detectors side by side."""
    shape = (system.emitter.rows.value, system.emitter.columns.value)
    return np.hstack(list(by_detector.reshape(-1, *shape)))


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

"""One acquisition of the single-pixel camera, from scene and system to a record of counts."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hardware.records import SpiRecord
from twin.camera import light
from twin.camera.backscatter_ranging import BackscatterRangeError, backscatter_range_error
from twin.camera.chain import Chain
from twin.camera.distortion import distortions
from twin.camera.illumination import amplifier_residue, dark_share, residual_share
from twin.camera.light import Rendered, render
from twin.camera.truth import Truth
from twin.camera.verdict import (
    Verdict,
    blind,
    coarse,
    hidden_by_both,
    judge,
    lagging,
    recorded,
)
from twin.detector import Detector, NoiseBudget
from twin.fidelity import Fidelity, Noise
from twin.optics.emission import emission_matrix, independent_patterns
from twin.optics.radiometry import Collection
from twin.optics.spectra import SUN_ASSUMPTION
from twin.optics.weather import air_of_system
from twin.progress import OpenStage, silently
from twin.scene import Scene
from twin.system import System
from twin.warned import CaptureWarning, is_void

Array = NDArray[np.float64]

#: Optical depth one way from which air's own light scattered more than once is above 1 % in fog.
_THICK = 0.25

#: Radius of the Airy disc over half the field from which it is warned of.
_SMEARED = 0.05

#: Of a cell's light: what sums in float64 may be off.
_ROUNDING = 1e-13

#: Holds for every capture through air.
AIR_ASSUMPTION = (
    "air: alike everywhere, with two lobes after Henyey and Greenstein; light to a surface is "
    "followed through every scattering, light back from it, along the straight way, through those "
    "by less than 90 deg; the air's own light, of emitter and sun, is scattered once"
)

#: Holds for every capture; printed with it.
MODEL_ASSUMPTIONS = (
    "surfaces are Lambertian, two-sided and flat-shaded",
    SUN_ASSUMPTION,
    "nothing moves during a frame",
    "amplifier: linear up to the rails",
)


@dataclass(frozen=True, eq=False)
class Capture:
    """A record with everything the twin knows about it. Only ``record`` exists on the vehicle.

    ``cells_e`` (rows, columns) are the electrons that each cell, lit alone for one exposure, gives
    in the mean (a line sensor's columns side by side). ``cells_error_e`` is their Monte-Carlo
    standard error; ``backscatter_e`` the part of them that the air sent back. ``snr`` is what an
    image keeps of ``scene_e``, what the scene sent back and reconstructions are compared with, over
    noise and distortion of a reconstructed pixel (inverse transform of the patterns shown): what
    exposures leave in the next ones and what rails cut off (`Distortion`); 0 where the detector
    stands at a rail. ``range_error``: what backscatter does to distances by time of flight, None
    where there is none of it. ``background_w`` is the sun's power on one detector, their mean.
    """

    record: SpiRecord
    truth: Truth
    cells_e: Array
    cells_error_e: Array
    backscatter_e: Array
    snr: Array
    noise: NoiseBudget
    lens: Collection
    signal_w: Array
    background_w: float
    sun_irradiance_w_per_m2: float
    in_band_fraction: float
    illuminance_lx: float
    assumptions: tuple[str, ...]
    warnings: tuple[CaptureWarning, ...]
    range_error: BackscatterRangeError | None = None

    @property
    def verdict(self) -> Verdict:
        """What an image made of the record can show."""
        return judge(self.scene_e, self.snr, self.warnings, self.range_error)

    @property
    def scene_e(self) -> Array:
        """Electrons that each cell has from the scene: ``cells_e`` without backscatter."""
        return _without(self.cells_e, self.backscatter_e)

    @property
    def measured_scene_e(self) -> Array:
        """``scene_e``, NaN in cells that the patterns do not measure."""
        patterns = self.record.patterns
        unknown = patterns.unmeasured_cells.reshape(patterns.rows, patterns.columns)
        return np.where(
            np.tile(unknown, self.cells_e.shape[1] // patterns.columns), np.nan, self.scene_e
        )

    @property
    def void(self) -> bool:
        """Whether the record holds nothing that an image could be made of."""
        return is_void(self.warnings)


def stages(system: System) -> tuple[str, ...]:
    """Names of the stages of `capture`."""
    return (*light.stages(system), "detector")


def capture(
    scene: Scene,
    system: System,
    *,
    seed: int = 0,
    fidelity: Fidelity | None = None,
    mesh_scene: Any = None,
    stage: OpenStage = silently,
    detector: Detector | None = None,
) -> Capture:
    """Acquire one frame: `render`, then `measure`.

    Parameters
    ----------
    scene, system
        What is looked at, and with what.
    seed
        Of every random draw: same seed, same counts, bit for bit.
    fidelity
        Knobs, each with the error it bounds.
    mesh_scene
        `mitsuba_scene(scene)`, when it is at hand already.
    stage
        Called with each stage's name, for progress and timing.
    detector
        A user's own, a `Detector`, in place of the system's detector and readout, whose area, pole
        and integration time still count; it must be of the same integration time.

    >>> from twin.fidelity import PRESETS
    >>> from twin.scene import load_scene
    >>> from twin.system import load_system
    >>> system = load_system("workable")
    >>> taken = capture(load_scene("table1"), system, seed=1, fidelity=PRESETS["draft"])
    >>> taken.record.counts.shape == (system.n_exposures, system.n_detectors)
    True
    """
    light_seed, noise_seed = np.random.SeedSequence(seed).spawn(2)
    fidelity = fidelity or Fidelity()
    rendered = render(
        scene, system, fidelity=fidelity, seed=light_seed, mesh_scene=mesh_scene, stage=stage
    )
    with stage("detector"):
        rng = np.random.default_rng(noise_seed)
        return measure(scene, system, rendered, rng=rng, noise=fidelity.noise, detector=detector)


def measure(
    scene: Scene,
    system: System,
    rendered: Rendered,
    *,
    rng: np.random.Generator,
    noise: Noise = "full",
    detector: Detector | None = None,
) -> Capture:
    """Light to counts: filter, lens, detector, amplifier and converter of a system."""
    chain = Chain.of(system, scene.sun, detector)
    power = chain.powers(rendered)
    signal_w, counts, flags = chain.take(power, rng=rng, noise=noise)
    sun_w = float(chain.open_share.mean()) * power.sun_w
    budgets = chain.noise_by_detector(signal_w, power.sun_w)
    noise_e = np.array([budget.cells_noise_e(system.patterns) for budget in budgets])
    # An image is the sum over all shutters; a dark cell's light is in every exposure alike.
    to_e = (1 - dark_share(system)) * chain.front_end.electrons_per_watt
    cells_e = to_e * power.cells_w.sum(axis=0)
    of_cells = np.sqrt(len(chain.shutters)) * noise_e
    of_image = np.median(of_cells, axis=1)
    sky, depth_m = chain.sky, rendered.truth.depth_m
    record = chain.record(scene.rig.pose, counts, flags)
    # At a rail the response's slope is zero, and so is what can be told of the light; as it is of
    # cells that the patterns do not measure.
    found = distortions(chain, power)
    gone = blind(record) | found.total.hides(of_image)
    kept = np.maximum(found.total.kept, 0)[:, None]
    off = np.hypot(of_cells, found.total.error_e[:, None])
    backscatter_e = to_e * power.backscatter_w.sum(axis=0)
    scene_e = _without(cells_e, backscatter_e)
    snr = np.where(gone[:, None] | record.patterns.unmeasured_cells, 0.0, kept * scene_e / off)
    range_error = backscatter_range_error(
        record, to_e * power.cells_w, to_e * power.backscatter_w, noise_e
    )
    budget = chain.noise(signal_w, sun_w)
    spoilt = (
        *recorded(record, found.clipping, of_image),
        *lagging(found.lag, of_image, _left_over(system)),
    )
    return Capture(
        record=record,
        truth=rendered.truth,
        cells_e=_image(cells_e, system),
        cells_error_e=_image(to_e * power.error_w, system),
        backscatter_e=_image(backscatter_e, system),
        snr=_image(snr, system),
        noise=budget,
        lens=chain.lens,
        signal_w=signal_w.reshape(-1, signal_w.shape[-1]),
        background_w=float(sun_w.mean()),
        sun_irradiance_w_per_m2=float(sky.sun_w_per_m2[0]),
        in_band_fraction=float(sky.emitter[0]),
        illuminance_lx=sky.illuminance_lx,
        assumptions=(*_assumptions(scene, system), *_own(detector)),
        warnings=(
            *spoilt,
            *hidden_by_both(found, of_image, gone, spoilt),
            *_warnings(system, budget, float(sky.emitter.max()), scene_e, depth_m),
            *_diffraction(system, chain.lens),
            *(range_error.warnings if range_error else ()),
            *rendered.warnings,
        ),
        range_error=range_error,
    )


def _own(detector: Detector | None) -> tuple[str, ...]:
    if detector is None:
        return ()
    return (f"detector: {type(detector).__name__} in place of the system's detector and readout",)


def _without(cells_e: Array, backscatter_e: Array) -> Array:
    """Light of the scene; what is left of it by rounding alone is none."""
    rest = cells_e - backscatter_e
    return np.where(rest > _ROUNDING * cells_e, rest, 0.0)


def _image(by_detector: Array, system: System) -> Array:
    """Cells of all detectors (n_detectors, n_cells) as one image, detectors side by side."""
    shape = (system.emitter.rows.value, system.emitter.columns.value)
    return np.hstack(list(by_detector.reshape(-1, *shape)))


def _assumptions(scene: Scene, system: System) -> tuple[str, ...]:
    air = (AIR_ASSUMPTION,) if system.weather else ()
    return (*MODEL_ASSUMPTIONS, *air, *_idealised(system), *scene.assumptions, *_assumed(system))


def _idealised(system: System) -> tuple[str, ...]:
    """What the system's file leaves out, and what that is taken to be."""
    emitter, optics = system.emitter, system.optics
    left_out = {
        "the emitter's field is flat": emitter.viewing_angle_deg,
        "its cells have sharp edges": emitter.blur_rms_deg if emitter.has_lens else True,
        "its cells are equal": emitter.intensity_spread,
        "dark cells emit nothing": emitter.contrast_ratio,
        "its power does not fluctuate": emitter.intensity_noise,
        "it switches at once": emitter.switching_time_s,
        "the filter does not shift with angle (a real one moves 6-11 nm at 10 deg)": (
            system.filter.effective_index
        ),
        "lens: cos^4 is its only vignetting": optics.edge_illumination,
        "it images sharply": optics.blur_rms_deg,
        "its pupil is a point, in focus everywhere": optics.focus_m,
        "amplifier: white noise": system.readout.flicker_corner_hz,
        "it settles within each exposure": system.readout.bandwidth_hz,
        "there is no air": system.weather,
    }
    taken = [what for what, given in left_out.items() if given is None]
    return ("not in the system's file: " + "; ".join(taken),) if taken else ()


def _diffraction(system: System, lens: Collection) -> list[CaptureWarning]:
    """A pupil so small that its own Airy disc smears the field."""
    airy = 1.22 * system.emitter.peak_wavelength_m.value / lens.pupil_diameter_m
    share = airy / lens.tan_half_field
    if share < _SMEARED:
        return []
    return [
        CaptureWarning(
            "model",
            "the detector is too small for geometrical optics: diffraction at its pupil of "
            f"{lens.pupil_diameter_m:.2g} m blurs the field's edge by {100 * share:.2g} % of its "
            "half width, which is left out: optics.f_number, detector.width_m",
        )
    ]


def _thick_air(system: System, depth_m: Array) -> list[CaptureWarning]:
    air, seen = air_of_system(system), depth_m[np.isfinite(depth_m)]
    if air is None or not seen.size:
        return []
    depth = air.extinction_per_m * float(np.median(seen))
    if depth < _THICK:
        return []
    return [
        CaptureWarning(
            "model",
            f"half of the surfaces stand behind an optical depth of {depth:.2g} or more: light "
            "that meets no surface and is scattered by the air more than once is left out; it lies "
            "evenly over the image, in fog some 3 % of all light at 0.5, 6 % at 1 and 10 % at 2; "
            "the real image is hazier",
        )
    ]


def _assumed(system: System) -> tuple[str, ...]:
    return tuple(
        f"{name} = {value.value}: {value.assumed}"
        for name, value in system.values()
        if value.assumed
    )


def _warnings(
    system: System,
    noise: NoiseBudget,
    in_band: float,
    scene_e: Array,
    depth_m: Array,
) -> tuple[CaptureWarning, ...]:
    return (
        *coarse(noise),
        *_no_light(system, in_band, scene_e, depth_m),
        *_narrow_filter(system, in_band),
        *_thick_air(system, depth_m),
        *_crosstalk(system, float(depth_m.min())),
    )


def _left_over(system: System) -> dict[str, float]:
    """Share of the exposure before in each one, by the field that it comes from."""
    shares = {
        "emitter.switching_time_s": residual_share(system),
        "readout.bandwidth_hz": amplifier_residue(system),
    }
    return {field: share for field, share in shares.items() if share}


def _no_light(
    system: System, in_band: float, scene_e: Array, depth_m: Array
) -> list[CaptureWarning]:
    if in_band == 0 or system.emitter.radiant_intensity_w_per_sr.value == 0:
        text = "no light of the emitter passes the filter, or it emits none"
    elif not scene_e.any() and system.weather and np.isfinite(depth_m).any():
        text = "no light of the emitter comes back: the air lets none through"
    elif not scene_e.any():
        text = "no light of the emitter comes back: nothing in the field of view"
    else:
        return []
    return [CaptureWarning("no-light", text, void=True)]


def _narrow_filter(system: System, in_band: float) -> list[CaptureWarning]:
    line, width = system.emitter.line_fwhm_m.value, system.filter.width_m.value
    curves = system.emitter.spectrum_csv or system.filter.transmission_csv
    if curves is not None or width >= line or in_band == 0:
        return []
    return [
        CaptureWarning(
            "design",
            f"the filter, {width * 1e9:g} nm, is narrower than the emitter's line, "
            f"{line * 1e9:g} nm: {in_band:.1%} of its light passes",
        )
    ]


def _crosstalk(system: System, distance_m: float) -> list[CaptureWarning]:
    """Bare LEDs each light the whole field."""
    if system.emitter.has_lens or not np.isfinite(distance_m):
        return []
    told_apart = independent_patterns(emission_matrix(system.emitter, distance_m))
    return [
        CaptureWarning(
            "design",
            f"bare LEDs: at {distance_m:.3g} m only {told_apart} of {system.patterns.n_cells} "
            "images differ by more than 1 % of the signal; a projection lens would tell all apart",
        )
    ]

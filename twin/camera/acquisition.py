"""One acquisition of the single-pixel camera, from scene and system to a record of counts."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hardware.records import SpiRecord
from twin.accuracy import Decision
from twin.camera import light
from twin.camera.backscatter_ranging import BackscatterRangeError, backscatter_range_error
from twin.camera.cell_noise import cells_noise_e as noise_of_cells
from twin.camera.chain import Chain
from twin.camera.distortion import distortions
from twin.camera.frozen import frozen_warnings
from twin.camera.illumination import amplifier_residue, dark_share, residual_share
from twin.camera.lit_frame import LitFrame, lit_frame
from twin.camera.model_error import NO_ERROR, ModelError, model_error, side_by_side
from twin.camera.moving_frame import FrameLight
from twin.camera.noise_draws import NoiseDraws
from twin.camera.rendered import RenderedLight
from twin.camera.shutters import farthest_gate_m
from twin.camera.truth import Truth
from twin.camera.verdict import (
    ImageVerdict,
    combined_warnings,
    judge,
    lag_warnings,
    quantisation_warnings,
    saturated_detectors,
    warnings_of_record,
)
from twin.detector import Detector, FrontEnd, NoiseBudget
from twin.errors import check_kind, check_seed
from twin.fidelity import Accuracy, Noise, knobs_of
from twin.optics.emission import emission_matrix, independent_patterns
from twin.optics.radiometry import Collection
from twin.optics.solar_irradiance import SUN_ASSUMPTION
from twin.optics.weather import air_of_system
from twin.progress import OpenStage, silently
from twin.scene import Scene
from twin.system import System
from twin.warned import CaptureWarning, is_void

Array = NDArray[np.float64]

#: One-way optical depth above which multiply scattered light of the air exceeds 1 % in fog.
_THICK = 0.25

#: Radius of the Airy disc over half the field above which a warning is given.
_LARGE_AIRY_DISC = 0.05

#: Rounding error of sums in float64, relative to a cell's light.
_ROUNDING = 1e-13

#: Holds for every capture through air.
AIR_ASSUMPTION = (
    "air: homogeneous, with a phase function of two Henyey-Greenstein lobes; all scatterings are "
    "traced on the way to a surface and back, up to fidelity.air_orders; backscatter and airlight "
    "are scattered once"
)

#: Holds for a detector whose field follows the lit cell.
SCAN_ASSUMPTION = (
    "scanning receiver: its field is centred on the lit spot at every distance, as behind a common "
    "mirror; only light of the first bounce comes from there, all other is left out"
)

#: Holds for every capture; printed with it.
MODEL_ASSUMPTIONS = (
    "surfaces are Lambertian, two-sided and flat-shaded",
    SUN_ASSUMPTION,
    "amplifier: linear up to the rails",
)

#: Holds where light is rendered once for all exposures of a frame, and where it is not.
STILL_ASSUMPTION = "nothing moves during a frame"
MOVING_ASSUMPTION = "the truth of a frame in which things move is that of its middle"


@dataclass(frozen=True, eq=False)
class Capture:
    """A record with the truth behind it. Only ``record`` exists on the vehicle.

    Where things move during the frame, all that is one number for a frame is that of its middle:
    truth, cells and what follows from them, so that reconstructions are compared with the image in
    the middle; ``signal_w`` is of each exposure, and the record's pose that of the start.

    ``cells_e`` (rows, columns) are the mean electrons of each cell, lit alone for one exposure (a
    line sensor's columns side by side). ``cells_error_e`` is their Monte-Carlo standard error,
    ``light_systematic_e`` a bound of what the render left out, and ``decisions`` say
    which effects it holds and why;
    ``backscatter_e`` the part that the air scattered back, ``scene_e`` the rest, with which
    reconstructions are compared. ``snr`` is the signal of ``scene_e`` in a reconstructed pixel
    (inverse transform of the patterns shown) over its noise and distortion, which are the lag
    between exposures and clipping (`Distortion`); 0 where the detector is saturated, and everywhere
    in a void record.
    ``range_error``: error of time-of-flight distances due to backscatter, None where there is none.
    ``background_w`` is the sun's power on one detector, mean over the detectors. ``distance_m``:
    half the way from the emitter over each cell's surface to the detector, infinite where none is.
    ``noise_draws``: what else the sensor might have read of the same light.
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
    light_systematic_e: Array
    distance_m: Array
    noise_draws: NoiseDraws
    decisions: tuple[Decision, ...] = ()
    range_error: BackscatterRangeError | None = None
    model_error: ModelError = NO_ERROR

    @property
    def verdict(self) -> ImageVerdict:
        """Quality of an image of this record."""
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
        """Whether no image can be reconstructed from the record."""
        return is_void(self.warnings)


def stages(system: System) -> tuple[str, ...]:
    """Names of the stages of `capture`."""
    return (*light.stages(system), "detector")


def capture(
    scene: Scene,
    system: System,
    *,
    seed: int = 0,
    fidelity: Accuracy | None = None,
    mesh_scene: Any = None,
    stage: OpenStage = silently,
    detector: Detector | None = None,
) -> Capture:
    """Acquire one frame: `render`, then `measure`.

    Parameters
    ----------
    scene, system
        Scene and design of the camera.
    seed
        Of all random numbers: same seed, same counts, bit for bit.
    fidelity
        Knobs, each with the error it bounds; a preset's name; or a `Tolerance`. Default:
        `Tolerance()`, light to a fifth of the sensor's noise.
    mesh_scene
        `mitsuba_scene(scene)`, if already built.
    stage
        Called with each stage's name, for progress and timing.
    detector
        A user's own `Detector`, in place of the system's detector and readout. Detector area,
        amplifier bandwidth and integration time of the system still apply; the integration time of
        both must be the same.

    >>> from twin.fidelity import PRESETS
    >>> from twin.scene import load_scene
    >>> from twin.system import load_system
    >>> system = load_system("workable")
    >>> result = capture(load_scene("table1"), system, seed=1, fidelity=PRESETS["draft"])
    >>> result.record.counts.shape == (system.n_exposures, system.n_detectors)
    True
    """
    check_kind("scene", scene, Scene, "twin.load_scene")
    check_kind("system", system, System, "twin.load_system")
    check_seed(seed)
    light_seed, noise_seed = np.random.SeedSequence(seed).spawn(2)
    knobs = knobs_of(fidelity)
    lit = lit_frame(
        scene,
        system,
        fidelity=knobs,
        seed=light_seed,
        mesh_scene=mesh_scene,
        stage=stage,
        detector=detector,
    )
    with stage("detector"):
        rng = np.random.default_rng(noise_seed)
        return measure_lit(lit, system, rng=rng, noise=knobs.noise, detector=detector)


def measure_lit(
    lit: LitFrame,
    system: System,
    *,
    rng: np.random.Generator,
    noise: Noise = "full",
    detector: Detector | None = None,
) -> Capture:
    """The light of a frame to counts, as `measure`."""
    return measure(
        lit.scene, system, lit.rendered, rng=rng, noise=noise, detector=detector, frame=lit.motion
    )


def measure(
    scene: Scene,
    system: System,
    rendered: RenderedLight,
    *,
    rng: np.random.Generator,
    noise: Noise = "full",
    detector: Detector | None = None,
    frame: FrameLight | None = None,
) -> Capture:
    """Light to counts: filter, lens, detector, amplifier and converter of a system.

    ``frame``: light of each exposure where something moves; the scene and the light rendered are
    then those of its middle.
    """
    chain = Chain.of(system, scene.sun, detector)
    power = chain.powers(rendered)
    mean_w, open_w = (frame.signal_w, frame.sun_w) if frame else (None, None)
    signal_w, counts, flags = chain.measure_frame(
        power, rng=rng, noise=noise, mean_w=mean_w, sun_w=open_w
    )
    sun_w = float(chain.open_share.mean()) * power.sun_w
    cells_noise_e = noise_of_cells(chain, power, signal_w)
    noise_e = cells_noise_e / np.sqrt(len(chain.shutters))
    # An image is the sum over all shutters; the light of dark cells is the same in every exposure.
    to_e = (1 - dark_share(system)) * chain.front_end.electrons_per_watt
    cells_e = to_e * power.cells_w.sum(axis=0)
    image_noise_e = np.median(cells_noise_e, axis=1)
    sky, depth_m = chain.sky, rendered.truth.depth_m
    record = chain.record(frame.pose if frame else scene.rig.pose, counts, flags)
    own = "" if type(chain.front_end) is FrontEnd else type(chain.front_end).__name__
    # At a rail the slope of the response is zero, and so is the SNR; as it is in cells that the
    # patterns do not measure.
    distortion = distortions(chain, power)
    hidden = saturated_detectors(record, own) | distortion.total.hides(image_noise_e)
    signal_factor = np.maximum(distortion.total.signal_factor, 0)[:, None]
    noise_and_error_e = np.hypot(cells_noise_e, distortion.total.cells_error_e)
    backscatter_e = to_e * power.backscatter_w.sum(axis=0)
    scene_e = _without(cells_e, backscatter_e)
    unknown = hidden[:, None] | record.patterns.unmeasured_cells
    snr = np.where(unknown, 0.0, signal_factor * scene_e / noise_and_error_e)
    range_error = backscatter_range_error(
        record, to_e * power.cells_w, to_e * power.backscatter_w, noise_e
    )
    budget = chain.noise(signal_w, sun_w)
    record_warnings = (
        *warnings_of_record(record, distortion.clipping, image_noise_e, own),
        *lag_warnings(distortion.lag, image_noise_e, _lag_shares(system)),
    )
    warnings = (
        *record_warnings,
        *combined_warnings(distortion, image_noise_e, hidden, record_warnings),
        *_warnings(system, budget, float(sky.emitter.max()), scene_e, depth_m),
        *_diffraction(system, chain.lens),
        *(range_error.warnings if range_error else ()),
        *rendered.warnings,
        *(frame.warnings if frame else frozen_warnings(scene, chain, rendered)),
    )
    return Capture(
        record=record,
        truth=rendered.truth,
        cells_e=side_by_side(cells_e, system),
        cells_error_e=side_by_side(to_e * power.error_w, system),
        backscatter_e=side_by_side(backscatter_e, system),
        snr=side_by_side(np.zeros_like(snr) if is_void(warnings) else snr, system),
        noise=budget,
        lens=chain.lens,
        signal_w=signal_w.reshape(-1, signal_w.shape[-1]),
        background_w=float(sun_w.mean()),
        sun_irradiance_w_per_m2=float(sky.sun_w_per_m2[0]),
        in_band_fraction=float(sky.emitter[0]),
        illuminance_lx=sky.illuminance_lx,
        assumptions=(*_assumptions(scene, system, frame), *_own(own)),
        warnings=warnings,
        light_systematic_e=side_by_side(to_e * power.left_out_w, system),
        decisions=(*rendered.decisions, *((frame.decision,) if frame else ())),
        range_error=range_error,
        model_error=replace(
            model_error(chain, power, signal_w), scatter=frame.sun_scatter if frame else 0.0
        ),
        noise_draws=NoiseDraws(chain, power, record, noise=noise, mean_w=mean_w, sun_w=open_w),
        distance_m=rendered.half_paths_m(),
    )


def _own(detector: str) -> tuple[str, ...]:
    told = f"detector: {detector} in place of the system's detector and readout"
    return (told,) if detector else ()


def _without(cells_e: Array, backscatter_e: Array) -> Array:
    """Light of the scene; a difference within rounding counts as 0."""
    rest = cells_e - backscatter_e
    return np.where(rest > _ROUNDING * cells_e, rest, 0.0)


def _assumptions(scene: Scene, system: System, frame: FrameLight | None) -> tuple[str, ...]:
    air = (AIR_ASSUMPTION,) if system.weather else ()
    scan = (SCAN_ASSUMPTION,) if system.optics.is_scanned else ()
    sampled = (system.sampling_note,) if system.sampling_note else ()
    rest = (MOVING_ASSUMPTION if frame else STILL_ASSUMPTION,)
    fixed = (*MODEL_ASSUMPTIONS, *rest, *air, *scan, *sampled)
    return (*fixed, *_idealised(system), *scene.assumptions, *_assumed(system))


def _idealised(system: System) -> tuple[str, ...]:
    """Idealisations of whatever the system's file leaves out."""
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
    ideal = [assumption for assumption, given in left_out.items() if given is None]
    return ("not in the system's file: " + "; ".join(ideal),) if ideal else ()


def _diffraction(system: System, lens: Collection) -> list[CaptureWarning]:
    """Warning of a pupil so small that its Airy disc blurs the edge of the field."""
    airy = 1.22 * system.emitter.peak_wavelength_m.value / lens.pupil_diameter_m
    share = airy / lens.tan_half_field
    if share < _LARGE_AIRY_DISC:
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
            f"half of the surfaces are behind an optical depth of {depth:.2g} or more: light that "
            "hits no surface and is scattered by the air more than once is left out; it is spread "
            "evenly over the image, in fog about 3 % of all light at 0.5, 6 % at 1 and 10 % at 2; "
            "the real image has less contrast",
        )
    ]


def _assumed(system: System) -> tuple[str, ...]:
    return tuple(said for _, said in system.assumed())


def _warnings(
    system: System,
    noise: NoiseBudget,
    in_band: float,
    scene_e: Array,
    depth_m: Array,
) -> tuple[CaptureWarning, ...]:
    return (
        *quantisation_warnings(noise),
        *_no_light(system, in_band, scene_e, depth_m),
        *_narrow_filter(system, in_band),
        *_thick_air(system, depth_m),
        *_crosstalk(system, float(depth_m.min())),
    )


def _lag_shares(system: System) -> dict[str, float]:
    """Share of the preceding exposure in each exposure, by the field that causes it."""
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
    elif not scene_e.any() and farthest_gate_m(system) < depth_m.min() < np.inf:
        text = (
            "no light of the emitter comes back: what is in the field of view lies beyond the last "
            f"gate, at {depth_m.min():.3g} m or more (time_of_flight.gate_delays_s)"
        )
    elif not scene_e.any() and system.weather and np.isfinite(depth_m).any():
        text = "no light of the emitter comes back: the air transmits none"
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
    """Warning of bare LEDs, each of which lights the whole field."""
    if system.emitter.has_lens or not np.isfinite(distance_m):
        return []
    n_images = independent_patterns(emission_matrix(system.emitter, distance_m))
    return [
        CaptureWarning(
            "design",
            f"bare LEDs: at {distance_m:.3g} m only {n_images} of {system.patterns.n_cells} images "
            "differ by more than 1 % of the signal; with a projection lens all would",
        )
    ]

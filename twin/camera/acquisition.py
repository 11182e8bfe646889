"""One acquisition of the single-pixel camera, from scene and system to a record of counts."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hardware.described import Described
from hardware.records import SpiRecord
from twin.accuracy import Decision, missed_effects
from twin.camera import light
from twin.camera.assumptions import assumptions
from twin.camera.backscatter_ranging import BackscatterRangeError, backscatter_range_error
from twin.camera.cell_noise import cells_noise_e as noise_of_cells
from twin.camera.chain import Chain, Powers
from twin.camera.design_warnings import design_warnings, lag_shares
from twin.camera.distortion import Distortions, distortions
from twin.camera.frozen import frozen_error
from twin.camera.illumination import dark_share
from twin.camera.lit_frame import LitFrame, lit_frame
from twin.camera.model_error import NO_ERROR, ModelError, model_error, side_by_side
from twin.camera.moving_frame import FrameLight
from twin.camera.noise_draws import NoiseDraws
from twin.camera.rendered import RenderedLight
from twin.camera.sun_in_frame import sun_warnings
from twin.camera.truth import Truth
from twin.camera.verdict import (
    ImageVerdict,
    combined_warnings,
    judge,
    lag_warnings,
    lit_cells,
    saturated_detectors,
    warnings_of_record,
)
from twin.detector import Detector, FrontEnd, NoiseBudget
from twin.errors import check_kind, check_seed
from twin.fidelity import Accuracy, Noise, knobs_of
from twin.kept_results import KeptResults
from twin.optics.radiometry import Collection
from twin.progress import OpenStage, silently
from twin.scene import Scene
from twin.system import System
from twin.warned import CaptureWarning, is_void

Array = NDArray[np.float64]

#: Rounding error of sums in float64, relative to a cell's light.
_ROUNDING = 1e-13


@dataclass(frozen=True, eq=False, repr=False)
class Capture(Described):
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
    between exposures and clipping (`Distortion`), with what clipping takes of all cells alike; 0
    where the detector is saturated, and everywhere in a void record.
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
        return judge(self.lit, self.snr, self.warnings, self.range_error)

    @property
    def lit(self) -> NDArray[np.bool_]:
        """Cells that show a surface and have light from it, (rows, columns)."""
        return lit_cells(self.scene_e, self.truth.albedo)

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
    kept: KeptResults | None = None,
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
    kept
        Where light is kept from one process to the next: that of the same scene, system, seed and
        ``fidelity``, by this version, is taken from there, bit for bit. Of systems with a user's
        own parts nothing is.

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
        kept=kept,
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
    # An image is the sum over all shutters; the light of dark cells is the same in every exposure.
    to_e = (1 - dark_share(system)) * chain.front_end.electrons_per_watt
    record = chain.record(frame.pose if frame else scene.rig.pose, counts, flags)
    own = "" if type(chain.front_end) is FrontEnd else type(chain.front_end).__name__
    cells_e = to_e * power.cells_w.sum(axis=0)
    backscatter_e = to_e * power.backscatter_w.sum(axis=0)
    scene_e = _without(cells_e, backscatter_e)
    cells_noise_e = noise_of_cells(chain, power, signal_w)
    image_noise_e = np.median(cells_noise_e, axis=1)
    distortion = distortions(chain, power)
    hidden = saturated_detectors(record, own) | distortion.total.hides(image_noise_e)
    range_error = backscatter_range_error(
        record,
        to_e * power.cells_w,
        to_e * power.backscatter_w,
        cells_noise_e / np.sqrt(len(chain.shutters)),
    )
    budget = chain.noise(signal_w, sun_w)
    record_warnings = (
        *warnings_of_record(record, distortion.clipping, image_noise_e, own),
        *lag_warnings(distortion.lag, image_noise_e, lag_shares(system)),
    )
    sky, depth_m = chain.sky, rendered.truth.depth_m
    decisions = (*rendered.decisions, *((frame.decision,) if frame else ()))
    if frame:
        scatter, of_motion = frame.sun_scatter, frame.warnings
    else:
        scatter, of_motion = frozen_error(scene, chain, rendered)
    may_be_missed = bool(rendered.light.error.any())
    warnings = (
        *record_warnings,
        *combined_warnings(distortion, image_noise_e, hidden, record_warnings),
        *design_warnings(
            system,
            chain.lens,
            budget,
            float(sky.emitter.max()),
            scene_e,
            depth_m,
            may_be_missed=may_be_missed,
        ),
        *(range_error.warnings if range_error else ()),
        *rendered.warnings,
        *(CaptureWarning("tolerance", text) for text in missed_effects(decisions)),
        *of_motion,
        *sun_warnings(scene, system),
    )
    snr = np.zeros_like(scene_e)
    if not is_void(warnings):
        snr = _snr(scene_e, cells_noise_e, distortion)
        # As at a rail, where the slope of the response is zero.
        snr[hidden[:, None] | record.patterns.unmeasured_cells] = 0.0
    return Capture(
        record=record,
        truth=rendered.truth,
        cells_e=side_by_side(cells_e, system),
        cells_error_e=side_by_side(to_e * power.error_w, system),
        backscatter_e=side_by_side(backscatter_e, system),
        snr=side_by_side(snr, system),
        noise=budget,
        lens=chain.lens,
        signal_w=signal_w.reshape(-1, signal_w.shape[-1]),
        background_w=float(sun_w.mean()),
        sun_irradiance_w_per_m2=float(sky.sun_w_per_m2[0]),
        in_band_fraction=float(sky.emitter[0]),
        illuminance_lx=sky.illuminance_lx,
        assumptions=assumptions(scene, system, moves=frame is not None, detector=own),
        warnings=warnings,
        light_systematic_e=side_by_side(to_e * power.left_out_w, system),
        decisions=decisions,
        range_error=range_error,
        model_error=replace(
            model_error(chain, power, signal_w),
            scatter=scatter,
            of_exposures=_error_of_exposures(frame, to_e, power, system),
        ),
        noise_draws=NoiseDraws(
            chain,
            power,
            record,
            noise=noise,
            seed=int(rng.spawn(1)[0].integers(2**63)),  # draws nothing of the record's own noise
            mean_w=mean_w,
            sun_w=open_w,
        ),
        distance_m=rendered.half_paths_m(),
    )


def _snr(scene_e: Array, cells_noise_e: Array, distortion: Distortions) -> Array:
    """Of cells, (n_detectors, n_cells)."""
    signal_factor = np.maximum(distortion.total.signal_factor, 0)[:, None]
    # What rails take of all cells alike depends on the light: unlike lag's, no calibration gives it
    # back, and it is an error of each cell.
    cut_e = np.abs(distortion.clipping.signal_factor - 1)[:, None] * scene_e
    error_e = np.hypot(cells_noise_e, distortion.total.cells_error_e)
    snr: Array = signal_factor * scene_e / np.hypot(error_e, cut_e)
    return snr


def _error_of_exposures(
    frame: FrameLight | None, to_e: float, power: Powers, system: System
) -> Array | None:
    """What paths of the exposures' light err by in each cell; where that is not told, as much as
    those of the truth.
    """
    if frame is None or frame.signal_w is None:
        return None
    error_w = power.error_w if frame.paths_error_w is None else frame.paths_error_w
    return side_by_side(to_e * np.broadcast_to(error_w, power.error_w.shape), system)


def _without(cells_e: Array, backscatter_e: Array) -> Array:
    """Light of the scene; a difference within rounding counts as 0."""
    rest = cells_e - backscatter_e
    return np.where(rest > _ROUNDING * cells_e, rest, 0.0)

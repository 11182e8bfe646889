"""Fidelity levels of the camera: paths, bounces, where they start; and the noise of an exposure."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from hardware.patterns import Patterns, PatternSet, RasterScan, fwht
from hardware.reconstruction.sensing import Sensing
from twin.camera.cell_noise import cells_noise_e
from twin.camera.chain import Chain, Powers
from twin.camera.illumination import dark_share
from twin.camera.light import render_light
from twin.camera.mounting import light_problem
from twin.camera.rendered import RenderedLight
from twin.camera.truth import Truth, render_truth
from twin.detector import Detector
from twin.fidelity import PRESETS, Fidelity, Noise, Start
from twin.optics.problem import LightProblem
from twin.progress import OpenStage
from twin.scene import Scene
from twin.system import System
from twin.trade.measurement import Cost, LevelMeasurement
from twin.trade.meter import measure_cost

Array = NDArray[np.float64]

_REFERENCE = "reference light"
_DEPTHS = (1, 2, 4)
_TOLERANCES = (1.0, 0.5, 0.2, 0.1)
_REFERENCE_RUNS = 4
#: Paths of the reference in all: a few large cells need more each than many small ones.
_LEAST_PATHS = 2**22
_EXPOSURES, _DRAWS = 8, 20_000  # distributions compared, and how many numbers tell each


@dataclass(frozen=True, eq=False)
class CameraCase:
    """A scene and a system, with everything that is the same at every level."""

    scene: Scene
    system: System
    problem: LightProblem
    truth: Truth
    chain: Chain
    seed: int

    @classmethod
    def of(cls, scene: Scene, system: System, seed: int) -> "CameraCase":
        """Load the scene's triangles once and render its truth."""
        problem = light_problem(scene, system)
        truth = render_truth(problem.scene, problem.emitter, system.image_shape)
        return cls(scene, system, problem, truth, Chain.of(system, scene.sun), seed)

    def light(self, fidelity: Fidelity, *key: int) -> RenderedLight:
        """Light of emitter and sun; another key gives other random paths."""
        seeds = np.random.SeedSequence([self.seed, *key]).spawn(2)
        return render_light(self.problem, self.chain, self.truth, fidelity, seeds)

    @property
    def electrons_per_watt(self) -> float:
        """Electrons per watt of modulated light: dark cells emit the same in every exposure."""
        return (1 - dark_share(self.system)) * self.chain.front_end.electrons_per_watt


@dataclass(frozen=True, eq=False)
class CellSignals:
    """Electrons of each cell lit alone, (n_detectors, n_cells), all of them and their part that the
    patterns measure; and the sun's power on all detectors, W.
    """

    all_e: Array
    cells_e: Array
    sun_w: float

    @classmethod
    def of(cls, case: CameraCase, rendered: RenderedLight) -> "CellSignals":
        """Through lens, filter and shutters."""
        power = case.chain.powers(rendered)
        cells = case.electrons_per_watt * power.cells_w.sum(axis=0)
        measurable = measurable_part(cells, case.system.patterns)
        return cls(cells, measurable, float(power.sun_w.sum()))


@dataclass(frozen=True, eq=False)
class Reference:
    """Mean of several renders, and the noise of a pixel under it, (n_detectors,), electrons."""

    signals: CellSignals
    noise_e: Array
    rendered: RenderedLight


def reference_level(system: System) -> Fidelity:
    """The `reference` preset, with more paths per cell where cells are few."""
    cells = system.emitter.rows.value * system.emitter.columns.value * system.n_detectors
    side = math.ceil(math.sqrt(_LEAST_PATHS / cells))
    preset = PRESETS["reference"]
    return preset.with_(samples=max(preset.samples, side**2))


def light_levels(system: System) -> list[Fidelity]:
    """Numbers of paths and bounces; for a line sensor and a lens also where paths start; then
    tolerances.
    """
    finest = reference_level(system).samples
    samples = [4**power for power in range(20) if 4**power < finest]
    both = system.n_detectors > 1 and system.emitter.has_lens
    starts: tuple[Start, ...] = ("dual", "scatter") if both else ("auto",)
    uniform = [Fidelity(s, d, start=side) for side in starts for d in _DEPTHS for s in samples]
    return uniform + [Fidelity(light_tolerance=share) for share in _TOLERANCES]


def light_stages(system: System) -> list[str]:
    """Stages of `measure_light`, in their order."""
    renders = [_rendering_reference(run) for run in range(1 + _REFERENCE_RUNS)]
    return [*renders, *map(_rendering, light_levels(system))]


def noise_stages() -> list[str]:
    """Stages of `measure_noise`, in their order."""
    return [_drawing(kind) for kind in get_args(Noise)]


def _rendering_reference(run: int) -> str:
    """Stage of a render of the reference, each of which may take a minute; the first warms up."""
    return f"{_REFERENCE}, render {run + 1}"


def _rendering(level: Fidelity) -> str:
    return f"light: {_name(level)}"


def _drawing(kind: Noise) -> str:
    return f"noise: {kind}"


def measure_light(case: CameraCase, stage: OpenStage) -> tuple[Reference, list[LevelMeasurement]]:
    """Every level against the mean of several renders of the reference."""
    reference, own = _measure_reference(case, stage)
    measured = []
    for number, level in enumerate(light_levels(case.system), start=1):
        with stage(_rendering(level)):
            cost, rendered = measure_cost(partial(case.light, level, number))
            signals = [CellSignals.of(case, light) for light in rendered]
            measured.append(_compare_level(case, _name(level), level, cost, signals, reference))
    return reference, [*measured, own]


def _measure_reference(case: CameraCase, stage: OpenStage) -> tuple[Reference, LevelMeasurement]:
    """The mean of several renders, and one render's scatter about it."""
    finest = reference_level(case.system)

    def light(run: int) -> RenderedLight:
        with stage(_rendering_reference(run)):
            return case.light(finest, 0, run)

    cost, rendered = measure_cost(light, least=_REFERENCE_RUNS)
    signals = [CellSignals.of(case, one) for one in rendered]
    mean = CellSignals(
        np.mean([p.all_e for p in signals], axis=0),
        np.mean([p.cells_e for p in signals], axis=0),
        float(np.mean([p.sun_w for p in signals])),
    )
    reference = Reference(mean, _pixel_noise(case, rendered[0]), rendered[0])
    name = f"reference: {finest.samples} paths, {finest.max_depth} bounces"
    own = _compare_level(case, name, finest, cost, signals, reference)
    # Each render is part of the mean that it is compared with.
    unbiased = np.sqrt(len(signals) / (len(signals) - 1))
    errors = ("median_over_noise", "error_w", "relative")
    own = replace(
        own,
        error=own.error * unbiased,
        over_noise=own.over_noise * unbiased,
        over_cells=own.over_cells * unbiased,
        detail=own.detail | {key: own.detail[key] * unbiased for key in errors},
        note=f"scatter of {len(signals)} renders; their mean is what all are compared with",
    )
    return reference, own


def _compare_level(
    case: CameraCase,
    name: str,
    fidelity: Fidelity,
    cost: Cost,
    signals: list[CellSignals],
    reference: Reference,
) -> LevelMeasurement:
    """Root mean square over cells and runs."""
    off = np.stack([p.cells_e for p in signals]) - reference.signals.cells_e
    error = float(np.sqrt(np.mean(off**2)))
    over_noise = np.abs(off) / reference.noise_e[:, None]
    scale = float(np.sqrt(np.mean(reference.signals.cells_e**2)))
    total = float(np.mean([p.cells_e.sum() for p in signals]))
    sun_w = float(np.mean([p.sun_w for p in signals]))
    return LevelMeasurement(
        model="light",
        name=name,
        fidelity=fidelity,
        cost=cost,
        error=error,
        unit="e-",
        over_noise=float(np.sqrt(np.mean(over_noise**2))),
        detail={
            "median_over_noise": float(np.median(over_noise)),
            "error_w": error / case.electrons_per_watt,
            "relative": _ratio(error, scale),
            "total_light_off": _ratio(total, float(reference.signals.cells_e.sum()), 1.0) - 1,
            "sun_off": _ratio(sun_w, reference.signals.sun_w, 1.0) - 1,
        },
        over_cells=_over_cells(signals, reference.signals.all_e),
    )


def _over_cells(signals: list[CellSignals], true_e: Array) -> float:
    """Error of each cell's light over that light, or the cells' mean where that is more, as
    `Tolerance.cell_share` is; root mean square over cells and runs.
    """
    off = np.abs(np.stack([p.all_e for p in signals]) - true_e)
    each = np.broadcast_to(np.maximum(true_e, true_e.mean()), off.shape)
    over = np.divide(off, each, out=np.where(off, np.inf, 0.0), where=each > 0)
    return float(np.sqrt(np.mean(over**2)))


def _pixel_noise(case: CameraCase, rendered: RenderedLight) -> Array:
    """Noise of a pixel of the image, by detector, electrons."""
    chain = case.chain
    power = chain.powers(rendered)
    signal_w, _, _ = chain.measure_frame(power, rng=np.random.default_rng(0), noise="none")
    if isinstance(case.system.patterns, RasterScan):
        return np.asarray(np.sqrt(np.mean(cells_noise_e(chain, power, signal_w) ** 2, axis=1)))
    budgets = chain.noise_by_detector(signal_w, power.sun_w)
    pixel_e = np.array([budget.pixel_noise_e(case.system.patterns) for budget in budgets])
    return np.sqrt(len(chain.shutters)) * pixel_e


def _name(level: Fidelity) -> str:
    if level.light_tolerance is not None:
        return f"to {level.light_tolerance:g} of the noise"
    name = f"{level.samples} path{'s' if level.samples > 1 else ''}, "
    name += f"{level.max_depth} bounces" if level.max_depth > 1 else "direct"
    if level.start != "auto":
        name += f", {level.start}"
    known = [key for key, value in PRESETS.items() if value.quality == level.quality]
    return f"{name} ({known[0]})" if known else name


def _ratio(value: float, scale: float, of_nothing: float = 0.0) -> float:
    return value / scale if scale else of_nothing


def measure_noise(
    case: CameraCase, reference: Reference, stage: OpenStage
) -> list[LevelMeasurement]:
    """Levels of noise: distance of the distribution of an exposure's counts from the full one.

    Wasserstein distance, the mean shift of a sorted sample, of the worst of some exposures spread
    over the range of signals. The full level is the reference; the random difference of two of its
    samples is included in the errors of the others.
    """
    power = case.chain.powers(reference.rendered)
    levels: tuple[Noise, ...] = get_args(Noise)
    samples, measured = _samples(case, power, levels), []
    truth = samples["full"][0]
    spread = truth.std(axis=1)
    for level in levels:
        with stage(_drawing(level)):
            cost, _ = measure_cost(partial(_one_frame, case, power, level))
            shift = np.abs(samples[level][1] - truth).mean(axis=1)
            worst = int(np.argmax(shift / spread))
            own = float(shift[worst] / spread[worst])
            exact = level == "full"
            measured.append(
                LevelMeasurement(
                    model="noise",
                    name="no noise" if level == "none" else level,
                    fidelity=Fidelity(noise=level),
                    cost=cost,
                    error=0.0 if exact else float(shift[worst]),
                    unit="e-",
                    over_noise=0.0 if exact else own,
                    detail={"noise_e": float(spread[worst])},
                    note=f"the reference; two samples of it differ by {own:.2g} of the noise"
                    if exact
                    else f"shift of the distribution, worst of {len(truth)} exposures",
                )
            )
    return measured


def _one_frame(case: CameraCase, power: Powers, kind: Noise, seed: int) -> None:
    case.chain.measure_frame(power, rng=np.random.default_rng([case.seed, seed]), noise=kind)


def _samples(
    case: CameraCase, power: Powers, levels: Sequence[Noise]
) -> dict[Noise, tuple[Array, Array]]:
    """Samples of exposures spread over the range of signals."""
    rng = np.random.default_rng([case.seed, 2])
    signal_w, _, _ = case.chain.measure_frame(power, rng=rng, noise="none")
    light = signal_w + case.chain.open_share[:, None] * power.sun_w
    powers_w = np.quantile(light, np.linspace(0, 1, _EXPOSURES))
    return distributions(powers_w, case.chain.front_end, levels, rng)


def distributions(
    levels_w: Array, front_end: Detector, levels: Sequence[Noise], rng: np.random.Generator
) -> dict[Noise, tuple[Array, Array]]:
    """Two sorted samples of electrons for each level, (n_exposures, n_draws)."""

    def sample(kind: Noise) -> Array:
        powers_w = np.repeat(levels_w[None], _DRAWS, axis=0)
        counts, _ = front_end.expose(powers_w, rng=rng, noise=kind)
        # Spread over the converter's step, so that rounding does not count as a difference.
        electrons = (counts + rng.uniform(-0.5, 0.5, counts.shape)) * front_end.electrons_per_count
        return np.sort(electrons, axis=0).T

    return {kind: (sample(kind), sample(kind)) for kind in levels}


def measurable_part(cells: Array, patterns: Patterns) -> Array:
    """Part of images (n, n_cells) that the patterns shown can tell; the rest is never measured."""
    if isinstance(patterns, RasterScan):
        return cells
    if not isinstance(patterns, PatternSet):
        own = Sensing(patterns)
        return (own.pseudo_inverse @ own.forward(cells.T)).T
    if patterns.count == patterns.n_cells:
        return cells
    spectrum = fwht(cells.T)
    measured = np.zeros_like(spectrum)
    measured[patterns.indices] = spectrum[patterns.indices]
    return fwht(measured).T / patterns.n_cells

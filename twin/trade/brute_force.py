"""Independent check: Mitsuba's projector and path tracer on a sample of the patterns."""

from dataclasses import MISSING, dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hardware.formatting import with_error
from twin.camera.light import render_light
from twin.optics.devices import Device
from twin.optics.paths import TracingQuality
from twin.optics.problem import LightProblem
from twin.optics.reference import PatternRenderer
from twin.trade.camera import CameraCase, Reference, reference_level
from twin.trade.measurement import Cost, LevelMeasurement
from twin.trade.meter import measure_cost

Array = NDArray[np.float64]

_PATTERNS = 8  # exposures of the set: the first, all lit, and others at random
_SEEDS = 12
_SAMPLES = 16  # paths per pixel of its film, 64 x 64
_BOUNCES = 32  # more than in the reference
_TRANSPORT_RUNS = 4
#: Error of projected texels in steps of cos^3 and of film pixels of finite size together.
_ALLOWANCE = 2e-3
_SIGMAS = 4.0  # of Student's t with 11 degrees of freedom: 0.2 % false alarms


@dataclass(frozen=True)
class Agreement:
    """Light of the sampled patterns, transport over brute force minus 1, with its standard error.

    ``worst_sigmas``: largest deviation of a pattern over its own Monte-Carlo error.
    """

    difference: float
    standard_error: float
    worst_sigmas: float
    patterns: int
    of_exposures: int
    renders_each: int
    paths_each: int
    idealised: str

    @property
    def holds(self) -> bool:
        """Whether the two agree within their errors and that of the texture's steps."""
        return abs(self.difference) <= _SIGMAS * self.standard_error + _ALLOWANCE

    def __str__(self) -> str:
        off = with_error(100 * self.difference, 100 * self.standard_error, "%", sign=True)
        how = f"{self.patterns} of {self.of_exposures} exposures, {self.renders_each} renders each"
        return (
            f"transport over brute force: {off} ({how} of {self.paths_each} paths; worst "
            f"pattern {self.worst_sigmas:.1f} sigma){self.idealised}"
        )


def check(
    case: CameraCase, reference: Reference
) -> tuple[Agreement | None, LevelMeasurement | None]:
    """Agreement of the reference, and brute force as a level for comparison.

    (None, None) for bare LEDs: the projector has a lens. The level is None for line sensors, whose
    columns the reference renderer does not tell apart as fine.
    """
    system = case.system
    if not system.emitter.has_lens:
        return None, None
    masks, transport = _sampled_masks(case), _transport(case)
    renderer = PatternRenderer(_ideal_problem(case), max_depth=_BOUNCES)
    seeds = np.random.SeedSequence([case.seed, 4]).generate_state(len(masks) * (1 + _SEEDS))
    table = seeds.reshape(len(masks), -1).tolist()
    brute, costs = _renders(renderer, masks, table)
    agreement = _agreement(case, brute, transport, masks)
    if system.n_detectors > 1:
        return agreement, None
    return agreement, _measure_level(case, reference, brute, costs)


def _renders(
    renderer: PatternRenderer, masks: NDArray[np.uint8], seeds: list[list[int]]
) -> tuple[Array, list[Cost]]:
    """Signals, (n_patterns, n_seeds), and what one render of each pattern costs."""
    renders, costs = [], []
    for mask, row in zip(map(_square, masks), seeds, strict=True):

        def once(run: int, mask: Any = mask, row: list[int] = row) -> float:
            return renderer.render(mask, samples=_SAMPLES, seed=row[run])

        cost, signals = measure_cost(once, least=_SEEDS, most=_SEEDS)
        renders.append(signals)
        costs.append(cost)
    return np.array(renders), costs


def _sampled_masks(case: CameraCase) -> NDArray[np.uint8]:
    """The first exposure, all lit, and others at random; the all dark one is left out."""
    patterns = case.system.patterns
    first = 2 if patterns.mode == "differential" else 1
    others = np.arange(first, patterns.n_exposures)
    rng = np.random.default_rng([case.seed, 3])
    others_shown = rng.choice(others, min(_PATTERNS - 1, len(others)), replace=False)
    numbers = [0, *sorted(others_shown.tolist())]
    return np.concatenate([patterns.masks(slice(n, n + 1)) for n in numbers])


def _square(mask: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The pattern with the same number of texels in both directions: a projector's field has the
    aspect ratio of its texture, an emitter's is square. Rows and columns are powers of two.
    """
    rows, columns = mask.shape
    side = max(rows, columns)
    return np.kron(mask, np.ones((side // rows, side // columns), dtype=np.uint8))


def _transport(case: CameraCase) -> Array:
    """Light of each cell on all detectors together, by run, (n_runs, n_cells), between the same
    ideal devices.
    """
    level, light = reference_level(case.system), []
    for run in range(_TRANSPORT_RUNS):
        seeds = np.random.SeedSequence([case.seed, 5, run]).spawn(2)
        rendered = render_light(
            _ideal_problem(case),
            case.chain,
            case.truth,
            level,
            seeds,
            sun_quality=TracingQuality(1, 1),
        )
        light.append(rendered.light.cells.sum(axis=0))
    return np.array(light)


def _agreement(
    case: CameraCase, brute: Array, transport: Array, masks: NDArray[np.uint8]
) -> Agreement:
    signals = transport @ masks.reshape(len(masks), -1).T.astype(np.float64)  # (n_runs, n_patterns)
    whole, per_seed, per_run = brute.mean(axis=1).sum(), brute.sum(axis=0), signals.sum(axis=1)
    if not whole:
        return _described(case, 0.0, 0.0, 0.0, len(masks))
    error = np.hypot(_standard_error(per_seed), _standard_error(per_run)) / whole
    off = signals.mean(axis=0) - brute.mean(axis=1)
    own = np.hypot(_standard_error(brute.T), _standard_error(signals))
    worst = np.max(np.abs(off) / np.where(own, own, np.inf))
    difference = per_run.mean() / whole - 1
    return _described(case, float(difference), float(error), float(worst), len(masks))


def _described(
    case: CameraCase, off: float, error: float, worst: float, patterns: int
) -> Agreement:
    given = [*_set(case.problem.emitter, "emitter"), *_set(case.problem.detector, "detector")]
    return Agreement(
        difference=off,
        standard_error=error,
        worst_sigmas=worst,
        patterns=patterns,
        of_exposures=case.system.patterns.n_exposures,
        renders_each=_SEEDS,
        paths_each=_SAMPLES * 64**2,
        idealised=f"; both without {', '.join(given)}" if given else "",
    )


def _measure_level(
    case: CameraCase, reference: Reference, brute: Array, costs: list[Cost]
) -> LevelMeasurement:
    """Brute force for the whole set: its noise passes through the same inverse transform."""
    patterns = case.system.patterns
    per_value = np.sqrt(2.0) if patterns.mode == "differential" else 2.0
    sigma = np.sqrt(np.mean(brute.var(axis=1, ddof=1)))
    light = float(reference.rendered.light.cells.sum())
    to_e = float(reference.signals.cells_e.sum()) / light if light else 0.0
    error = float(per_value * sigma * np.sqrt(patterns.count) / patterns.n_cells * to_e)
    times = np.array([(c.low_s, c.seconds, c.high_s) for c in costs]).mean(axis=0)
    low, median, high = (patterns.n_exposures * times).tolist()
    return LevelMeasurement(
        model="light",
        name="brute force per pattern",
        fidelity=None,
        cost=Cost(median, low, high, _SEEDS, max(c.peak_bytes for c in costs)),
        error=error,
        unit="e-",
        over_noise=error / float(reference.noise_e[0]),
        detail={"error_w": error / case.electrons_per_watt},
        note=f"{brute.size} renders of {_SAMPLES * 64**2} paths timed, scaled to "
        f"{patterns.n_exposures}; noise alone",
    )


def _ideal_problem(case: CameraCase) -> LightProblem:
    problem = case.problem
    return replace(problem, emitter=_ideal(problem.emitter), detector=_ideal(problem.detector))


def _ideal(device: Device) -> Device:
    """The device as the reference renderer models it: a square, sharp, even field and a pinhole."""
    return Device(device.origin_m, device.axes, device.tan_half_field)


def _set(device: Device, whose: str) -> list[str]:
    """Names of the properties that `_ideal` leaves out."""
    known = [f for f in fields(Device) if f.default is not MISSING]
    return [f"{whose}.{f.name}" for f in known if getattr(device, f.name) != f.default]


def _standard_error(values: Array) -> Any:
    return values.std(axis=0, ddof=1) / np.sqrt(len(values))

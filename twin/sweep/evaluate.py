"""A run of points: rendered once per light, measured for each point."""

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from twin.camera.acquisition import Capture, measure
from twin.camera.light import Rendered, render
from twin.camera.mounting import devices
from twin.camera.repaint import can_repaint, render_unpainted
from twin.radar.acquisition import radar_capture
from twin.radar.evaluation import RadarEvaluation, evaluate_radar
from twin.sweep.closed_form import closed_form
from twin.sweep.metrics import Outcome, metric
from twin.sweep.setup import Setup, setup
from twin.sweep.study import Study

Array = NDArray[np.float64]
T = TypeVar("T")

_KEPT = 32  # renders and radar evaluations in memory


@dataclass(eq=False)
class Chunk:
    """Results of points ``start`` to ``stop``: by metric, what failed, how often was rendered."""

    start: int
    stop: int
    values: dict[str, Array]
    errors: dict[int, str] = field(default_factory=dict)
    renders: int = 0


class _Kept:
    """The last few results by key."""

    def __init__(self) -> None:
        self.items: OrderedDict[Any, Any] = OrderedDict()
        self.made = 0

    def get(self, key: Any, make: Callable[[], T]) -> T:
        if key not in self.items:
            self.items[key] = make()
            self.made += 1
            if len(self.items) > _KEPT:
                self.items.popitem(last=False)
        self.items.move_to_end(key)
        found: T = self.items[key]
        return found


_LIGHT, _RADAR = _Kept(), _Kept()  # per process


def evaluate_chunk(study: Study, start: int, stop: int) -> Chunk:
    """Evaluate points ``start`` to ``stop``; a point that fails is a row with its error."""
    if study.model == "closed-form":
        return _closed_form(study, start, stop)
    before = _LIGHT.made
    chunk = Chunk(start, stop, {name: np.full(stop - start, np.nan) for name in study.metrics})
    for index in range(start, stop):
        try:
            outcome = outcome_of(study, index)
            for name in study.metrics:
                value = metric(name, study.folder)(outcome)
                chunk.values[name][index - start] = float(value)
        except Exception as error:  # any user's function may fail in any way
            chunk.errors[index] = f"{type(error).__name__}: {error}"
            for values in chunk.values.values():
                values[index - start] = np.nan
    chunk.renders = _LIGHT.made - before
    return chunk


def _closed_form(study: Study, start: int, stop: int) -> Chunk:
    try:
        values = closed_form(study, study.columns(start, stop))
        return Chunk(start, stop, {name: np.asarray(v, np.float64) for name, v in values.items()})
    except ValueError as error:
        if stop - start == 1:
            nothing = {name: np.array([np.nan]) for name in study.metrics}
            return Chunk(start, stop, nothing, {start: f"{type(error).__name__}: {error}"})
    # Some point can't be: halve until it stands alone.
    middle = (start + stop) // 2
    first, second = _closed_form(study, start, middle), _closed_form(study, middle, stop)
    joined = {n: np.concatenate([first.values[n], second.values[n]]) for n in study.metrics}
    return Chunk(start, stop, joined, first.errors | second.errors)


def outcome_of(study: Study, index: int) -> Outcome:
    """Results of one point. Noise is drawn from (seed, point), light and radar from the seed alone:
    points differ by what is varied, not by how rays fell.
    """
    made = setup(study, study.point(index))

    def captured() -> Capture:
        rng = np.random.default_rng(np.random.SeedSequence([study.seed, index]))
        rendered = _rendered(made, study)
        return measure(made.scene, made.system, rendered, rng=rng, noise=made.fidelity.noise)

    def evaluated() -> RadarEvaluation:
        assert made.radar is not None  # a study with radar metrics has one
        radar, weather = made.radar, made.system.weather
        where = (study.scene, study.folder, made.scene_key())
        key = (*where, radar, weather, made.fidelity, study.seed)

        def work() -> RadarEvaluation:
            taken = radar_capture(
                made.scene, radar, seed=study.seed, fidelity=made.fidelity, weather=weather
            )
            return evaluate_radar(radar, taken)

        return _RADAR.get(key, work)

    return Outcome(made, captured, evaluated)


def _rendered(made: Setup, study: Study) -> Rendered:
    """Light of a point; points that differ only later on, or in paint, share one render."""
    emitter, detector, _ = devices(made.scene, made.system)
    paintable = can_repaint(made.system, made.fidelity)
    key = (
        study.scene,
        study.folder,
        made.scene_key(painted=not paintable),
        *(_device_key(device) for device in (emitter, detector)),
        made.system.picture_shape,
        made.system.n_detectors,
        made.system.weather,
        made.system.time_of_flight is None,
        # The air's extinction is that at the emitter's wavelength.
        made.system.emitter.peak_wavelength_m.value if made.system.weather else None,
        made.fidelity.quality,
        made.fidelity.start,
        study.seed,
    )
    draw = np.random.SeedSequence(study.seed)
    if paintable:
        unpainted = _LIGHT.get(
            key,
            lambda: render_unpainted(made.scene, made.system, fidelity=made.fidelity, seed=draw),
        )
        return unpainted.painted(made.scene)
    return _LIGHT.get(
        key, lambda: render(made.scene, made.system, fidelity=made.fidelity, seed=draw)
    )


def _device_key(device: Any) -> tuple[Any, ...]:
    return tuple(
        value.tobytes() if isinstance(value, np.ndarray) else value
        for value in vars(device).values()
    )

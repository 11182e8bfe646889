"""A run of points: rendered once per light, measured for each point."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hardware.radar.settings import Processing
from hardware.read_only import read_only
from twin.camera.acquisition import Capture, capture, measure
from twin.camera.moving_frame import world_in_motion
from twin.errors import InputError
from twin.fidelity import RadarFidelity
from twin.radar.acquisition import radar_capture
from twin.radar.evaluation import RadarEvaluation, evaluate_radar
from twin.sweep.closed_form import closed_form
from twin.sweep.inputs import ChangedError, Held, Inputs, inputs_of
from twin.sweep.metrics import Outcome, metric
from twin.sweep.names import ERRORS, columns_of
from twin.sweep.setup import Setup, setup
from twin.sweep.shared_light import light_of, renders
from twin.sweep.study import Study

Array = NDArray[np.float64]

_BURST = re.compile(r"^burst \d+: ")
_WORD = re.compile(r"(?<![\w/])[a-z]+(?![\w/])")  # no part of a figure or a unit
_WORDS = 5  # which tell kinds apart


@dataclass(eq=False)
class Chunk:
    """Results of some points, by column (`columns_of`) in their order; what failed, how often was
    rendered.

    ``warnings``: by kind and point, what was said; ``void``: points without a result that means
    anything, by ``camera`` and ``radar``.
    """

    points: NDArray[np.intp]
    values: dict[str, Array]
    errors: dict[int, str] = field(default_factory=dict)
    warnings: dict[str, dict[int, str]] = field(default_factory=dict)
    void: dict[str, list[int]] = field(default_factory=dict)
    renders: int = 0


def joined(chunks: Sequence[Chunk]) -> Chunk:
    """Results of points as one."""
    points = np.concatenate([chunk.points for chunk in chunks])
    whole = Chunk(points, {}, renders=sum(chunk.renders for chunk in chunks))
    for name in chunks[0].values:
        whole.values[name] = np.concatenate([chunk.values[name] for chunk in chunks])
    for chunk in chunks:
        whole.errors.update(chunk.errors)
        for kind, said in chunk.warnings.items():
            whole.warnings.setdefault(kind, {}).update(said)
        for side, marked in chunk.void.items():
            whole.void.setdefault(side, []).extend(marked)
    return whole


def in_one_line(error: BaseException) -> str:
    """Kind and words of an error, of which a user's own may have several lines."""
    return " ".join(f"{type(error).__name__}: {error}".split())


def failed(study: Study, index: int, why: str) -> Chunk:
    """A point that failed."""
    nothing = {name: np.array([np.nan]) for name in columns_of(study.metrics, study.model)}
    return Chunk(np.array([index]), nothing, {index: why})


_CAPTURES, _RADAR = Held(32), Held(32)  # per process, by content


def evaluate_chunk(study: Study, start: int, stop: int, inputs: Inputs | None = None) -> Chunk:
    """Evaluate points ``start`` to ``stop``, see `evaluate_points`."""
    return evaluate_points(study, np.arange(start, stop), inputs)


def evaluate_points(study: Study, points: NDArray[np.intp], inputs: Inputs | None = None) -> Chunk:
    """Evaluate points; one that fails is a row with its error. The closed form takes points that
    follow each other.

    ``inputs``: as the sweep found them when it began; default: as they are now. Raises InputError
    where they have changed since.
    """
    inputs = inputs or inputs_of(study)
    if study.model == "closed-form":
        chunk = _closed_form(study, int(points[0]), int(points[-1]) + 1, inputs)
    else:
        chunk = _rendered_points(study, points, inputs)
    inputs.check()
    return chunk


def _rendered_points(study: Study, points: NDArray[np.intp], inputs: Inputs) -> Chunk:
    before = renders()
    names = columns_of(study.metrics, study.model)
    chunk = Chunk(points, {name: np.full(len(points), np.nan) for name in names})
    measures = {name: metric(name, inputs) for name in study.metrics}
    for place, index in enumerate(points.tolist()):
        try:
            outcome = outcome_of(study, index, inputs)
            for name, measure_of in measures.items():
                measured = measure_of(outcome)
                chunk.values[name][place] = measured.value
                for kind in ERRORS:
                    error = getattr(measured, kind)
                    chunk.values[f"{name}.{kind}"][place] = error
            _note(chunk, index, outcome)
        except ChangedError:
            raise
        except (Exception, SystemExit) as error:  # any user's function may fail in any way
            chunk.errors[index] = in_one_line(error)
            for values in chunk.values.values():
                values[place] = np.nan
    chunk.renders = renders() - before
    return chunk


def _note(chunk: Chunk, index: int, outcome: Outcome) -> None:
    """Every warning of a point, and whether it leaves the point void."""
    for text in outcome.setup.scene.warnings:
        chunk.warnings.setdefault("scene", {}).setdefault(index, text)
    for side, taken in _captures(outcome):
        for warning in taken.warnings:
            chunk.warnings.setdefault(warning.kind, {}).setdefault(index, str(warning))
        if taken.void:
            chunk.void.setdefault(side, []).append(index)
    for text in outcome.radar.frame.warnings if "radar" in vars(outcome) else ():
        chunk.warnings.setdefault(kind_of(text), {}).setdefault(index, text)


def kind_of(text: str) -> str:
    """Kind of a warning of the radar's processing: its first words, without burst and figures."""
    return f"processing:{'-'.join(_WORD.findall(_BURST.sub('', text.lower()))[:_WORDS])}"


def _captures(outcome: Outcome) -> Iterator[tuple[str, Any]]:
    """What the metrics have made the twin take."""
    known = vars(outcome)
    if "capture" in known:
        yield "camera", outcome.capture
    if "radar" in known:
        yield "radar", outcome.radar.capture


def _closed_form(study: Study, start: int, stop: int, inputs: Inputs) -> Chunk:
    try:
        with np.errstate(all="ignore"):  # told of by point
            found = closed_form(study, study.columns(start, stop), inputs)
        columns = {n: np.asarray(v, np.float64) for n, v in found.metrics.items()}
        chunk = Chunk(np.arange(start, stop), columns)
        can_be = found.fault == ""
        for k in np.flatnonzero(~can_be).tolist():
            chunk.errors[start + k] = f"InputError: {found.fault[k]}"
        chunk.values = {n: np.where(can_be, column, np.nan) for n, column in columns.items()}
        for k in np.flatnonzero(can_be & (found.fill >= 1)).tolist():
            text = f"all cells lit are {100 * found.fill[k]:.3g} % of the converter's range or well"
            chunk.warnings.setdefault("saturated", {})[start + k] = text
            chunk.void.setdefault("camera", []).append(start + k)
        for k in np.flatnonzero(can_be & (found.left_out != "")).tolist():
            text = f"the closed form leaves out {found.left_out[k]}"
            chunk.warnings.setdefault("left_out", {})[start + k] = text
        for name, column in chunk.values.items():
            for i in np.flatnonzero(np.isnan(column)):
                why = f"InputError: {name} is not a number: values beyond what float64 holds"
                chunk.errors.setdefault(start + int(i), why)
        return chunk
    except ChangedError:
        raise
    except InputError as error:
        if stop - start == 1:
            return failed(study, start, in_one_line(error))
    # Some point can't be: halve until it stands alone.
    middle = (start + stop) // 2
    halves = ((start, middle), (middle, stop))
    return joined([_closed_form(study, *half, inputs) for half in halves])


def outcome_of(study: Study, index: int, inputs: Inputs | None = None) -> Outcome:
    """Results of one point: what `twin.capture` and `twin.radar_capture` give with its seed; to a
    tolerance the light is as fine as the point asks whose noise permits the least of all that share
    it (`light_of`). All points draw from the same seed, so they differ by what is varied, not by
    how rays fell; a parameter without effect leaves every bit as it is. Vary ``seed`` for draws of
    their own.
    """
    inputs = inputs or inputs_of(study)
    made = setup(study, study.point(index), inputs)

    def captured() -> Capture:
        key = inputs.stamp, study.digest, *_captured_by(made)
        return _CAPTURES.get(key, lambda: read_only(measured()))

    def measured() -> Capture:
        rng = np.random.default_rng(np.random.SeedSequence(made.seed).spawn(2)[1])
        if world_in_motion(made.scene, made.system, made.fidelity) is not None:
            # Of each exposure's own time, for this sensor: shared with no other point.
            return capture(made.scene, made.system, seed=made.seed, fidelity=made.fidelity)
        light = read_only(light_of(study, index, made, inputs))
        return measure(made.scene, made.system, light, rng=rng, noise=made.fidelity.noise)

    def evaluated() -> RadarEvaluation:
        assert made.radar is not None  # a study with radar metrics has one
        radar, weather = made.radar, made.system.weather
        knobs = made.fidelity.part(RadarFidelity)  # those of light leave the radar as it is
        how = Processing(detection=made.detection)
        key = (inputs.stamp, made.scene_key(), radar, weather, knobs, made.seed, how)

        def work() -> RadarEvaluation:
            taken = radar_capture(
                made.scene, radar, seed=made.seed, fidelity=made.fidelity, weather=weather
            )
            return read_only(evaluate_radar(radar, taken, how))

        return _RADAR.get(key, work)

    return Outcome(made, captured, evaluated)


def _captured_by(made: Setup) -> tuple[Any, ...]:
    """What a camera's record depends on: points that are only processed in other ways share it."""
    return made.scene_values, made.scene.sun, made.system, made.fidelity, made.seed

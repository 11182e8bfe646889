"""One test's comparison: run the method, hold it against its baseline, or make the baseline new."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from twin.accuracy import Interval
from twin.camera.rendered import RenderedLight
from twin.digest import digest, versions
from twin.fidelity import Accuracy, Fidelity, LightFidelity, Noise, RadarFidelity, knobs_of
from twin.files import InputError
from twin.radar import RadarCapture, RadarDesign, load_radar
from twin.regression.baseline import (
    Baseline,
    differences,
    read_baseline,
    rounded,
    write_baseline,
)
from twin.regression.metrics import CAMERA_METRICS, RADAR_METRICS, Metric
from twin.regression.model_error import ERROR_SEEDS, echo_errors, light_errors, of_views
from twin.regression.pictures import draw_echoes, draw_images, echo_example, image_example, save
from twin.regression.runs import (
    Method,
    RadarDetector,
    SeedResults,
    image_method,
    in_turn,
    radar_detector,
    repeated,
    run_camera,
    run_radar,
    vehicle_detector,
)
from twin.regression.statistics import Verdict, compare, repeats, smallest_loss
from twin.regression.truth import Truths
from twin.scene import Pose, Scene, load_scene
from twin.system import System, load_system

#: A method's outcome over seeds.
_Run = Callable[[Sequence[int]], SeedResults]
#: Mean figures by metric with the model's errors, worked out where they are needed.
_Errors = Callable[[], Mapping[str, Interval]]
#: Figure of a failure from outcome, example, figures before, verdicts.
_Draw = Callable[[SeedResults, dict[str, Any], dict[str, Any], Sequence[Verdict]], Figure]


@dataclass(frozen=True)
class _Shown:
    """What a baseline keeps of one seed to show, and how a failure is drawn beside it."""

    example: Callable[[SeedResults], dict[str, Any]]
    draw: _Draw


_IMAGES, _ECHOES = _Shown(image_example, draw_images), _Shown(echo_example, draw_echoes)
_DRAWS = "gives other figures of the same record each time; failures are counted, not paired"


@dataclass
class Regression:
    """What the fixture ``twin_regression`` gives; one for each test.

    ``baselines`` and ``pictures`` are folders, ``test`` the test's name in file names, ``node`` its
    name for pytest; ``reason`` that of ``--update-baseline``, ``notes`` what pytest's summary says.
    """

    truths: Truths
    baselines: Path
    pictures: Path
    test: str
    node: str
    reason: str | None
    notes: list[str]
    _named: set[str] = field(default_factory=set)

    def camera(
        self,
        scene: str | Path | Scene,
        system: str | Path | System = "workable",
        *,
        method: Method = "lmmse",
        seeds: int = 48,
        poses: Sequence[Pose] = (),
        fidelity: Accuracy | None = None,
        metrics: Sequence[Metric] = CAMERA_METRICS,
        false_alarm: float = 0.01,
        name: str = "",
    ) -> tuple[Verdict, ...]:
        """Compare a reconstruction with its baseline; the test fails when it became worse.

        Parameters
        ----------
        scene, system
            As for `twin.run`, or loaded already.
        method
            What `hardware.reconstruct` takes (a name in `hardware.reconstruction.METHODS`, a
            function of (values, noise_variance, sensing), ``file.py:function``), or a function from
            a record to an image (rows, columns) in electrons, detectors side by side, or to a
            `Reconstruction`.
        seeds
            Of the sensor's noise: 0 to ``seeds - 1``. More find smaller losses.
        poses
            Places from which the scene is seen, in turn from seed to seed; a render each. Without,
            the scene's own, and its mirror image every other seed.
        fidelity
            Knobs of the render and of the noise, each with the error it bounds.
        metrics
            Compared; a figure that is no number fails.
        false_alarm
            Probability that the test fails though nothing became worse by more than a tolerance.
        name
            Tells several comparisons of one test apart.
        """
        __tracebackhide__ = True
        views, design = _views(scene, poses), load_system(system)
        image_method(method)  # a wrong name is told before the render
        numbers, knobs = _seeds(seeds, len(views)), knobs_of(fidelity)
        light = [self.truths.light(view, design, knobs) for view in views]

        def run(view: int, numbers: Sequence[int]) -> SeedResults:
            return run_camera(
                views[view],
                design,
                light[view],
                method,
                numbers,
                metrics,
                knobs.noise,
                mirrored=not poses,
            )

        def errors() -> dict[str, Interval]:
            # Normal noise of the same draws changes little with the light, Poisson's a lot.
            noise: Noise = "none" if knobs.noise == "none" else "gaussian"

            def means(view: int, other: RenderedLight) -> dict[str, float]:
                few = range(min(ERROR_SEEDS, seeds))
                taken = (views[view], design, other, method, few, metrics, noise)
                return run_camera(*taken, mirrored=not poses).means()

            return of_views([light_errors(each, partial(means, i)) for i, each in enumerate(light)])

        setup = _setup("camera", views[0], poses, design, knobs.part(LightFidelity), seeds, metrics)
        runs = partial(in_turn, run, len(views))
        return self._hold(
            _IMAGES, runs, numbers, metrics, false_alarm, setup, errors, own=method, name=name
        )

    def radar(
        self,
        scene: str | Path | Scene,
        radar: str | Path | RadarDesign = "hybrid-79",
        *,
        detector: RadarDetector = vehicle_detector,
        seeds: int = 16,
        poses: Sequence[Pose] = (),
        fidelity: Accuracy | None = None,
        metrics: Sequence[Metric] = RADAR_METRICS,
        false_alarm: float = 0.01,
        name: str = "",
    ) -> tuple[Verdict, ...]:
        """Compare a detector with its baseline; the test fails when it became worse.

        ``detector`` is a function from a `RadarRecord` to detections, or what `hardware.Processing`
        takes: a function of (channel, waveform, image), ``file.py:function``, an installed name.
        All else is as for `camera`.
        """
        __tracebackhide__ = True
        views, design = _views(scene, poses), load_radar(radar)
        radar_detector(detector)  # a wrong one is told before the scene is traced
        numbers, knobs = _seeds(seeds, len(views)), knobs_of(fidelity, design.total_bandwidth_hz)
        captures = [self.truths.echo(view, design, knobs) for view in views]
        accuracy = knobs.nufft_tolerance

        def run(view: int, numbers: Sequence[int]) -> SeedResults:
            return run_radar(captures[view], design, detector, numbers, metrics, accuracy)

        def errors() -> dict[str, Interval]:
            def means(other: RadarCapture) -> dict[str, float]:
                few = range(min(ERROR_SEEDS, seeds))
                return run_radar(other, design, detector, few, metrics, accuracy).means()

            return of_views([echo_errors(capture, means) for capture in captures])

        setup = _setup("radar", views[0], poses, design, knobs.part(RadarFidelity), seeds, metrics)
        runs = partial(in_turn, run, len(views))
        return self._hold(
            _ECHOES, runs, numbers, metrics, false_alarm, setup, errors, own=detector, name=name
        )

    def _hold(
        self,
        shown: _Shown,
        run: _Run,
        seeds: Sequence[int],
        metrics: Sequence[Metric],
        false_alarm: float,
        setup: dict[str, Any],
        errors: _Errors,
        *,
        own: str | Callable[..., Any],
        name: str,
    ) -> tuple[Verdict, ...]:
        __tracebackhide__ = True
        method = own if isinstance(own, str) else _function_name(own)
        if name in self._named:
            pytest.fail(
                f"name: {name!r} is taken: one for each comparison of a test", pytrace=False
            )
        self._named.add(name)
        outcome = run(seeds)
        stem = f"{self.test}-{name}" if name else self.test
        path = self.baselines / f"{stem}.json"
        known, fault = None, ""
        try:
            known = read_baseline(path)
        except InputError as error:
            fault = str(error)
        if fault and self.reason is None:  # with a reason it is replaced
            pytest.fail(f"{fault}: {self._remedy('why')}", pytrace=False)
        if self.reason is not None:
            example = shown.example(outcome)
            self._update(
                path,
                known,
                outcome,
                metrics,
                false_alarm,
                setup,
                errors(),
                method=method,
                example=example,
            )
            return ()
        if known is None:
            pytest.fail(
                f"{path}: no such baseline; make one: {self._remedy('what it is for')}",
                pytrace=False,
            )
        # A knob newer than the baseline stood then where `Fidelity` has it, even if another value
        # is the default now; one that is gone is a change of the twin, which its figures are to
        # judge. Baselines of earlier versions have the knobs of the other sensor too.
        stood, usual = known.setup.get("fidelity", {}), Fidelity().said()
        fidelity = {name: stood.get(name, usual[name]) for name in setup["fidelity"]}
        if other := differences({**known.setup, "fidelity": fidelity}, setup):
            pytest.fail(
                f"{path}: made with another setup: {'; '.join(other)}; "
                f"{self._remedy('why it changed')}",
                pytrace=False,
            )
        views = _n_views(setup)
        # On the same records the model's error is the same, and cancels.
        is_same = known.records == outcome.records
        judge = partial(
            compare,
            metrics,
            known.arrays(),
            outcome.figures,
            false_alarm,
            views=views,
            errors=() if is_same else (known.errors(), errors()),
        )
        verdicts = judge(paired=is_same)
        failed = sorted({seed for verdict in verdicts for seed in verdict.failed})
        times = repeats(len(seeds), len(metrics), false_alarm)
        if is_same and not repeated(run, outcome, failed, times):
            self.notes.append(f"{self.node}: {_DRAWS}")
            verdicts = judge(paired=False)
        if any(verdict.worse for verdict in verdicts):
            picture = self.pictures / f"{stem}.png"
            save(shown.draw(outcome, known.example, known.figures, verdicts), picture)
            pytest.fail(self._told(method, known, verdicts, path, picture), pytrace=False)
        if any(verdict.better for verdict in verdicts):
            self.notes.append(f"{self.node}: better; keep it: {self._remedy('what improved')}")
        return verdicts

    def _update(
        self,
        path: Path,
        known: Baseline | None,
        outcome: SeedResults,
        metrics: Sequence[Metric],
        false_alarm: float,
        setup: dict[str, Any],
        errors: Mapping[str, Interval],
        *,
        method: str,
        example: dict[str, Any],
    ) -> None:
        __tracebackhide__ = True
        for metric in metrics:
            wrong = np.flatnonzero(~np.isfinite(outcome.figures[metric.name]))
            if wrong.size:
                value = outcome.figures[metric.name][wrong[0]]
                pytest.fail(
                    f"metrics: {metric.name} is {value} at seed {wrong[0]}, expected a number; "
                    "leave this metric out",
                    pytrace=False,
                )
        figures = {n: [rounded(v) for v in values] for n, values in outcome.figures.items()}
        model_error = {
            n: [rounded(e.standard_error), rounded(e.systematic)] for n, e in errors.items()
        }
        made = Baseline(setup, figures, outcome.records, example, (), model_error)
        if known and replace(known, example=example, history=()) == made:
            self.notes.append(f"{path}: as before, left alone")
            return
        views = _n_views(setup)
        find = partial(smallest_loss, n_metrics=len(metrics), false_alarm=false_alarm, views=views)
        finds = {
            m.name: float(f"{find(m, outcome.figures[m.name], error=errors[m.name]):.3g}")
            for m in metrics
        }
        entry = {
            "reason": self.reason,
            "method": method,
            "versions": versions(),
            "before": known.means() if known else None,
            "after": made.means(),
            "finds": finds,
        }
        history = (*(known.history if known else ()), entry)
        write_baseline(replace(made, history=history), path)
        self.notes.append(f"{path}: written; {_figures_of(entry)}")

    def _remedy(self, why: str) -> str:
        return f'pytest "{self.node}" --update-baseline "{why}"'

    def _told(
        self, method: str, known: Baseline, verdicts: Sequence[Verdict], path: Path, picture: Path
    ) -> str:
        last = known.history[-1]
        now = versions()
        changed = [
            f"{name} {last['versions'].get(name)} -> {version}"
            for name, version in now.items()
            if last["versions"].get(name) != version
        ]
        return "\n".join(
            [
                f"{method}: worse than its baseline ({last['method']}: {last['reason']})",
                *(f"  {verdict}" for verdict in verdicts),
                *([f"versions: {', '.join(changed)}"] if changed else []),
                f"baseline: {path}",
                f"pictures: {picture}",
                f"if it has to be so: {self._remedy('why')}",
            ]
        )


def _setup(
    kind: str,
    scene: Scene,
    poses: Sequence[Pose],
    design: System | RadarDesign,
    fidelity: LightFidelity | RadarFidelity,
    seeds: int,
    metrics: Sequence[Metric],
) -> dict[str, Any]:
    """What must not differ, in words where there are some; content by the start of its digest."""
    truths: dict[str, Any] = {"poses": [str(pose) for pose in poses]} if poses else {}
    if kind == "camera" and not poses:
        truths = {"truths": ["as rendered", "mirrored"]}
    return truths | {
        "kind": kind,
        "scene": f"{scene.name} {digest(scene)[:12]}",
        "design": f"{design.name} {digest(design)[:12]}",
        "fidelity": fidelity.said(),
        "seeds": seeds,
        "metrics": [metric.name for metric in metrics],
    }


def _n_views(setup: dict[str, Any]) -> int:
    return len(setup.get("poses", [""]))


def _views(scene: str | Path | Scene, poses: Sequence[Pose]) -> list[Scene]:
    """The scene from every pose, or as it is."""
    if isinstance(scene, Scene):
        return [scene.at(pose) for pose in poses] or [scene]
    return [load_scene(scene, pose) for pose in poses] or [load_scene(scene)]


def _seeds(seeds: int, n_views: int) -> range:
    if seeds < 2 * n_views:
        of = f" of each of {n_views} poses" if n_views > 1 else ""
        raise InputError(f"seeds: {seeds}: expected at least 2{of}, a test needs their scatter")
    return range(seeds)


def _function_name(function: Callable[..., Any]) -> str:
    return getattr(function, "__qualname__", type(function).__qualname__)


def _figures_of(entry: dict[str, Any]) -> str:
    before = entry["before"] or {}
    return ", ".join(
        f"{name} {f'{before[name]:.6g} -> ' if name in before else ''}{value:.6g} "
        f"(finds a loss of {entry['finds'][name]:.2g})"
        for name, value in entry["after"].items()
    )

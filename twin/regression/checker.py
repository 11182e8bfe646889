"""The fixture of a test: a camera's or a radar's method, compared with its baseline."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, NoReturn

import pytest

from twin.accuracy import Interval
from twin.camera.rendered import RenderedLight
from twin.digest import versions
from twin.fidelity import Accuracy, LightFidelity, Noise, RadarFidelity, knobs_of
from twin.files import InputError
from twin.radar import RadarCapture, RadarDesign, load_radar
from twin.regression.baseline import Baseline, read_baseline, write_baseline
from twin.regression.comparison import Comparison
from twin.regression.metrics import CAMERA_METRICS, RADAR_METRICS, Metric
from twin.regression.model_error import ERROR_SEEDS, echo_errors, light_errors, of_views
from twin.regression.pictures import ECHOES, IMAGES, save
from twin.regression.runs import (
    Method,
    RadarDetector,
    SeedResults,
    WrongResultError,
    image_method,
    in_turn,
    radar_detector,
    run_camera,
    run_radar,
    vehicle_detector,
)
from twin.regression.setup import differences, seeds_of, setup_of, views_of
from twin.regression.statistics import Verdict
from twin.regression.truth import Truths
from twin.scene import Pose, Scene
from twin.system import System, load_system

_NOT_REPEATED = "gives other figures of the same record each time; failures are counted, not paired"


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
        views, design = views_of(scene, poses), load_system(system)
        image_method(method)  # a wrong name is told before the render
        numbers, knobs = seeds_of(seeds, len(views)), knobs_of(fidelity)
        setup = setup_of(
            "camera", views[0], poses, design, knobs.part(LightFidelity), seeds, metrics
        )
        stem = self._stem(name)
        baseline = self._baseline(stem, setup, {"scene": views[0], "design": design})
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
            # Normal noise of the same draws follows the light; an avalanche's gamma draws do not.
            noise: Noise = "none" if knobs.noise == "none" else "gaussian"

            def means(view: int, other: RenderedLight) -> dict[str, float]:
                few = range(min(ERROR_SEEDS, seeds))
                scene = views[view]
                return run_camera(
                    scene, design, other, method, few, metrics, noise, mirrored=not poses
                ).means()

            return of_views([light_errors(each, partial(means, i)) for i, each in enumerate(light)])

        comparison = Comparison(
            method=_name_of(method),
            run=partial(in_turn, run, len(views)),
            errors=errors,
            seeds=numbers,
            metrics=metrics,
            false_alarm=false_alarm,
            setup=setup,
            pictures=IMAGES,
        )
        return self._verdicts(comparison, baseline, stem)

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
        views, design = views_of(scene, poses), load_radar(radar)
        radar_detector(detector)  # a wrong one is told before the scene is traced
        numbers, knobs = seeds_of(seeds, len(views)), knobs_of(fidelity, design.total_bandwidth_hz)
        setup = setup_of(
            "radar", views[0], poses, design, knobs.part(RadarFidelity), seeds, metrics
        )
        stem = self._stem(name)
        baseline = self._baseline(stem, setup, {"scene": views[0], "design": design})
        captures = [self.truths.echo(view, design, knobs) for view in views]
        accuracy = knobs.nufft_tolerance

        def run(view: int, numbers: Sequence[int]) -> SeedResults:
            return run_radar(captures[view], design, detector, numbers, metrics, accuracy)

        def errors() -> dict[str, Interval]:
            def means(other: RadarCapture) -> dict[str, float]:
                few = range(min(ERROR_SEEDS, seeds))
                return run_radar(other, design, detector, few, metrics, accuracy).means()

            return of_views([echo_errors(capture, means) for capture in captures])

        comparison = Comparison(
            method=_name_of(detector),
            run=partial(in_turn, run, len(views)),
            errors=errors,
            seeds=numbers,
            metrics=metrics,
            false_alarm=false_alarm,
            setup=setup,
            pictures=ECHOES,
        )
        return self._verdicts(comparison, baseline, stem)

    def _stem(self, name: str) -> str:
        """Name of a comparison's files; the test fails where it has been taken."""
        __tracebackhide__ = True
        if name in self._named:
            _fail(f"name: {name!r} is taken: one for each comparison of a test")
        self._named.add(name)
        return f"{self.test}-{name}" if name else self.test

    def _baseline(
        self, stem: str, setup: dict[str, Any], contents: Mapping[str, Scene | System | RadarDesign]
    ) -> Baseline | None:
        """The baseline to compare with, None where a new one is made; the test fails, before
        anything is rendered, where there is none with this setup.
        """
        __tracebackhide__ = True
        if self.reason is not None:
            return None
        path = self._path(stem)
        fault = ""  # told outside of the handler: pytest shows what an exception was raised in
        try:
            baseline = read_baseline(path)
        except InputError as error:
            fault = str(error)
        if fault:
            _fail(f"{fault}: {self._remedy('why')}")
        if baseline is None:
            _fail(f"{path}: no such baseline; make one: {self._remedy('what it is for')}")
        if apart := differences(baseline.setup, setup, contents):
            _fail(
                f"{path}: made with another setup: {'; '.join(apart)}; "
                f"{self._remedy('why it changed')}"
            )
        return baseline

    def _verdicts(
        self, comparison: Comparison, baseline: Baseline | None, stem: str
    ) -> tuple[Verdict, ...]:
        """Compare with the baseline, or make a new one where there is none to compare with."""
        __tracebackhide__ = True
        fault, outcome = "", None
        try:
            outcome = comparison.run(comparison.seeds)
        except WrongResultError as error:
            fault = str(error)
        if outcome is None:
            _fail(fault)
        path, picture = self._path(stem), self.pictures / f"{stem}.png"
        if baseline is None:
            self._update(comparison, outcome, path)
            return ()
        verdicts, repeats_itself = comparison.verdicts(outcome, baseline)
        if not repeats_itself:
            self.notes.append(f"{self.node}: {_NOT_REPEATED}")
        if any(verdict.worse for verdict in verdicts):
            before = baseline.example, baseline.figures
            save(comparison.pictures.draw(outcome, *before, verdicts), picture)
            _fail(self._failure(comparison.method, baseline, verdicts, path, picture))
        if any(verdict.better for verdict in verdicts):
            self.notes.append(f"{self.node}: better; keep it: {self._remedy('what improved')}")
        return verdicts

    def _update(self, comparison: Comparison, outcome: SeedResults, path: Path) -> None:
        """Write the new baseline, in place of a damaged one too."""
        __tracebackhide__ = True
        try:
            before = read_baseline(path)
        except InputError:
            before = None
        if fault := comparison.without_number(outcome):
            _fail(fault)
        new = comparison.new_baseline(outcome, before, self.reason or "")
        if new is None:
            self.notes.append(f"{path}: as before, left alone")
            return
        write_baseline(new, path)
        self.notes.append(f"{path}: written; {_figures_text(new.history[-1])}")

    def _path(self, stem: str) -> Path:
        return self.baselines / f"{stem}.json"

    def _remedy(self, why: str) -> str:
        return f'pytest "{self.node}" --update-baseline "{why}"'

    def _failure(
        self,
        method: str,
        baseline: Baseline,
        verdicts: Sequence[Verdict],
        path: Path,
        picture: Path,
    ) -> str:
        """What became worse, in lines."""
        last = baseline.history[-1]
        changed = [
            f"{name} {last['versions'].get(name)} -> {version}"
            for name, version in versions().items()
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


def _fail(text: str) -> NoReturn:
    __tracebackhide__ = True
    pytest.fail(text, pytrace=False)


def _name_of(method: Method | RadarDetector) -> str:
    if isinstance(method, str):
        return method
    return getattr(method, "__qualname__", type(method).__qualname__)


def _figures_text(entry: dict[str, Any]) -> str:
    """Figures of an entry of a baseline's history, with those before."""
    before = entry["before"] or {}
    return ", ".join(
        f"{name} {f'{before[name]:.6g} -> ' if name in before else ''}{value:.6g} "
        f"(finds a loss of {entry['finds'][name]:.2g})"
        for name, value in entry["after"].items()
    )

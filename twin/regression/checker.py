"""One test's comparison: run the method, hold it against its baseline, or make the baseline new."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from twin.digest import digest, versions
from twin.fidelity import Fidelity
from twin.files import InputError
from twin.radar import RadarDesign, load_radar
from twin.regression.baseline import (
    Baseline,
    differences,
    read_baseline,
    rounded,
    write_baseline,
)
from twin.regression.metrics import CAMERA_METRICS, RADAR_METRICS, Metric
from twin.regression.pictures import draw_echoes, draw_images, echo_example, image_example, save
from twin.regression.runs import (
    Detector,
    Method,
    Outcome,
    image_method,
    run_camera,
    run_radar,
    vehicle_detector,
)
from twin.regression.statistics import Verdict, compare, smallest_loss
from twin.regression.truth import Truths
from twin.scene import Scene, load_scene
from twin.system import System, load_system

#: Figure of a failure from outcome, example, figures before, verdicts.
_Draw = Callable[[Outcome, dict[str, Any], dict[str, Any], Sequence[Verdict]], Figure]


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
        fidelity: Fidelity | None = None,
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
            Name in `hardware.reconstruction.METHODS`, or a function from a record to an image
            (rows, columns) in electrons, detectors side by side, or to a `Reconstruction`.
        seeds
            Of the sensor's noise: 0 to ``seeds - 1``. More find smaller losses.
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
        loaded, design = _scene(scene), load_system(system)
        image_method(method)  # a wrong name is told before the render
        numbers, fidelity = _seeds(seeds), fidelity or Fidelity()
        light = self.truths.light(loaded, design, fidelity)
        outcome = run_camera(
            loaded, design, light, method, numbers, metrics, fidelity.noise, mirrored=True
        )
        setup = _setup("camera", loaded, design, fidelity, seeds, metrics)
        what = method if isinstance(method, str) else _function_name(method)
        example = image_example(outcome)
        return self._hold(outcome, metrics, false_alarm, setup, what, example, draw_images, name)

    def radar(
        self,
        scene: str | Path | Scene,
        radar: str | Path | RadarDesign = "hybrid-79",
        *,
        detector: Detector = vehicle_detector,
        seeds: int = 16,
        fidelity: Fidelity | None = None,
        metrics: Sequence[Metric] = RADAR_METRICS,
        false_alarm: float = 0.01,
        name: str = "",
    ) -> tuple[Verdict, ...]:
        """Compare a detector with its baseline; the test fails when it became worse.

        ``detector`` is a function from a `RadarRecord` to detections; all else as for `camera`.
        """
        __tracebackhide__ = True
        loaded, design = _scene(scene), load_radar(radar)
        numbers, fidelity = _seeds(seeds), fidelity or Fidelity()
        capture = self.truths.echo(loaded, design, fidelity)
        accuracy = fidelity.nufft_tolerance
        outcome = run_radar(capture, design, detector, numbers, metrics, accuracy)
        setup = _setup("radar", loaded, design, fidelity, seeds, metrics)
        what, example = _function_name(detector), echo_example(outcome)
        return self._hold(outcome, metrics, false_alarm, setup, what, example, draw_echoes, name)

    def _hold(
        self,
        outcome: Outcome,
        metrics: Sequence[Metric],
        false_alarm: float,
        setup: dict[str, Any],
        method: str,
        example: dict[str, Any],
        draw: _Draw,
        name: str,
    ) -> tuple[Verdict, ...]:
        __tracebackhide__ = True
        if name in self._named:
            pytest.fail(
                f"name: {name!r} is taken: one for each comparison of a test", pytrace=False
            )
        self._named.add(name)
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
            self._update(path, known, outcome, metrics, false_alarm, setup, method, example)
            return ()
        if known is None:
            pytest.fail(
                f"{path}: no such baseline; make one: {self._remedy('what it is for')}",
                pytrace=False,
            )
        # A knob newer than the baseline stood then where it stands by default.
        fidelity = {**asdict(Fidelity()), **known.setup.get("fidelity", {})}
        if other := differences({**known.setup, "fidelity": fidelity}, setup):
            pytest.fail(
                f"{path}: made with another setup: {'; '.join(other)}; "
                f"{self._remedy('why it changed')}",
                pytrace=False,
            )
        same = known.records == outcome.records
        verdicts = compare(metrics, known.arrays(), outcome.figures, false_alarm, same_records=same)
        if any(verdict.worse for verdict in verdicts):
            picture = self.pictures / f"{stem}.png"
            save(draw(outcome, known.example, known.figures, verdicts), picture)
            pytest.fail(self._told(method, known, verdicts, path, picture), pytrace=False)
        if any(verdict.better for verdict in verdicts):
            self.notes.append(f"{self.node}: better; keep it: {self._remedy('what improved')}")
        return verdicts

    def _update(
        self,
        path: Path,
        known: Baseline | None,
        outcome: Outcome,
        metrics: Sequence[Metric],
        false_alarm: float,
        setup: dict[str, Any],
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
        if known and (known.setup, known.figures, known.records) == (
            setup,
            figures,
            outcome.records,
        ):
            self.notes.append(f"{path}: as before, left alone")
            return
        finds = {
            m.name: float(
                f"{smallest_loss(m, outcome.figures[m.name], len(metrics), false_alarm):.3g}"
            )
            for m in metrics
        }
        made = Baseline(setup, figures, outcome.records, example, ())
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
    design: System | RadarDesign,
    fidelity: Fidelity,
    seeds: int,
    metrics: Sequence[Metric],
) -> dict[str, Any]:
    """What must not differ, in words where there are some; content by the start of its digest."""
    truths = {"truths": ["as rendered", "mirrored"]} if kind == "camera" else {}
    return truths | {
        "kind": kind,
        "scene": f"{scene.name} {digest(scene)[:12]}",
        "design": f"{design.name} {digest(design)[:12]}",
        "fidelity": asdict(fidelity),
        "seeds": seeds,
        "metrics": [metric.name for metric in metrics],
    }


def _scene(scene: str | Path | Scene) -> Scene:
    return scene if isinstance(scene, Scene) else load_scene(scene)


def _seeds(seeds: int) -> range:
    if seeds < 2:
        raise ValueError(f"seeds: {seeds}: expected at least 2, a test needs their scatter")
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

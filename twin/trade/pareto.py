"""The Pareto front of time and error, measured by `run_trade` and `choose_fidelity`."""

from collections.abc import Callable
from pathlib import Path
from typing import get_args

import numpy as np

from hardware.patterns import PatternSet
from twin.errors import check_seed
from twin.fidelity import DEFAULT_SHARE, Fidelity, Tolerance
from twin.fidelity.knobs import is_number
from twin.files import InputError, check_out
from twin.progress import OpenStage, Stages, silently
from twin.radar import RadarDesign, load_radar
from twin.run_folder import figures_folder, named_folder, unless
from twin.scene import Scene, load_scene
from twin.system import System, load_system
from twin.trade.brute_force import Agreement, check
from twin.trade.camera import (
    CameraCase,
    light_stages,
    measure_light,
    measure_noise,
    noise_stages,
)
from twin.trade.choice import Choice, cheapest, most_accurate
from twin.trade.criterion import Criterion, criteria_of
from twin.trade.measurement import LevelMeasurement, Model
from twin.trade.meter import measure_cost
from twin.trade.radar import measure_radar, radar_stages, reference_tolerance
from twin.trade.result import Trade


def run_trade(
    scene: str | Path | Scene,
    system: str | Path | System = "workable",
    *,
    radar: str | Path | RadarDesign | None = "hybrid-79",
    tolerance: Tolerance | float = DEFAULT_SHARE,
    within_s: float | None = None,
    seed: int = 0,
    out: str | Path | None = None,
    begins: Callable[[], None] = lambda: None,
) -> tuple[Trade, Path]:
    """Measure every level on a scene and this machine, and write a folder.

    Parameters
    ----------
    scene, system, radar
        As in `twin.run`.
    tolerance
        Acceptable error of a level, in units of the sensor's own noise; or a `Tolerance`, whose
        share of a cell's light, level of an echo, or distance takes the place of the noise: the
        error of the cells' light, root mean square over the cells; the largest error of an echo of
        the bodies within 40 dB of the strongest. Scores of an image are refused.
    within_s
        In place of the cheapest level within the tolerance, the most accurate that takes no longer.
    seed
        Of all random numbers.
    out
        Folder to write to; default ``runs/trade-SCENE-SYSTEM`` with all settings that differ from
        the default. It is written completely or not at all, and refused before any work where it
        holds files of these names that are of no earlier trade.
    begins
        Called once all that is given has been checked, before the first measurement.

    Returns the result and the folder. Raises InputError and EngineError as `twin.run` does.

    It takes minutes (`tests/twin/test_trade.py` runs it)::

        scene, system = twin.load_scene("yard"), twin.load_system("workable")
        found, folder = twin.run_trade(scene, system.with_({"optics.f_number": 0.8}), radar=None)
        print(found.choices["light"].reason)
    """
    from twin.trade.report import write_trade

    check_out(out)
    design, sensor, asked = _inputs(system, radar, tolerance, seed)
    if within_s is not None and not 0 < within_s < np.inf:
        raise InputError(f"within: {within_s:g} s is not above 0")
    with Stages(len(stage_names(design, sensor))) as stages:
        with stages.stage("load"):
            loaded = scene if isinstance(scene, Scene) else load_scene(scene)
        folder = Path(out or _folder(loaded, design, sensor, asked, within_s, seed))
        with figures_folder(folder, "trade", "trade.csv", "trade.md", "trade.png") as partial:
            begins()
            trade = _measure(
                loaded, design, sensor, asked, within_s, seed, stages.stage, checked=True
            )
            write_trade(trade, partial)
    return trade, folder


def choose_fidelity(
    scene: str | Path | Scene,
    tolerance: Tolerance | float = DEFAULT_SHARE,
    *,
    system: str | Path | System = "workable",
    radar: str | Path | RadarDesign | None = "hybrid-79",
    seed: int = 0,
) -> Fidelity:
    """The cheapest fidelity whose measured error on a scene stays below the tolerance, as
    `run_trade` takes it; the most accurate one where none does.

    Measures as `run_trade` does, without the brute-force check and without writing anything. Costs
    are measured times: the order of levels of about equal time may change between runs.
    """
    design, sensor, asked = _inputs(system, radar, tolerance, seed)
    loaded = scene if isinstance(scene, Scene) else load_scene(scene)
    return _measure(loaded, design, sensor, asked, None, seed, silently, checked=False).fidelity


def _folder(
    scene: Scene,
    system: System,
    radar: RadarDesign | None,
    tolerance: Tolerance | float,
    within_s: float | None,
    seed: int,
) -> Path:
    is_absolute = isinstance(tolerance, Tolerance)
    asked = str(tolerance).replace(", ", "-") if is_absolute else f"{tolerance:g}"
    return named_folder(
        "trade",
        scene.name,
        system.name,
        *unless(radar.name if radar else None, "hybrid-79", "{}", "no-radar"),
        *unless(tolerance, DEFAULT_SHARE, f"tolerance_{asked}"),
        *unless(within_s, None, "within_{:g}_s"),
        *unless(seed, 0, "seed_{}"),
    )


def stage_names(system: System, radar: RadarDesign | None) -> list[str]:
    """Stages of a trade, in their order."""
    light = ["load", *light_stages(system), "brute force", *noise_stages()]
    return light + (radar_stages() if radar else [])


def _inputs(
    system: str | Path | System,
    radar: str | Path | RadarDesign | None,
    tolerance: Tolerance | float,
    seed: int,
) -> tuple[System, RadarDesign | None, Tolerance | float]:
    """With a tolerance that is a share of the noise alone as that number."""
    if isinstance(tolerance, Tolerance):
        share = tolerance.noise_share
        tolerance = share if tolerance == Tolerance(share) else tolerance
    elif not is_number(tolerance) or not 0 < tolerance < np.inf:
        raise InputError(
            f"tolerance: {tolerance!r:.60}: expected a number above 0, in units of the sensor's "
            "noise, or a twin.Tolerance"
        )
    check_seed(seed)
    design = None if radar is None else load_radar(radar)
    if isinstance(tolerance, Tolerance):
        tolerance.check_sensors(camera=True, radar=design is not None)
    _criteria(tolerance, design)  # refused before time is spent
    return load_system(system), design, tolerance


def _criteria(tolerance: Tolerance | float, radar: RadarDesign | None) -> dict[Model, Criterion]:
    return criteria_of(tolerance, radar.total_bandwidth_hz if radar else None)


def _measure(
    scene: Scene,
    system: System,
    radar: RadarDesign | None,
    tolerance: Tolerance | float,
    within_s: float | None,
    seed: int,
    stage: OpenStage,
    *,
    checked: bool,
) -> Trade:
    case = CameraCase.of(scene, system, seed)
    reference, measured = measure_light(case, stage)
    agreement = None
    if checked:
        with stage("brute force"):
            if isinstance(system.patterns, PatternSet):  # a user's own are not rendered one by one
                agreement, by_force = check(case, reference)
                measured += [by_force] if by_force else []
    measured += measure_noise(case, reference, stage)
    measured += measure_radar(scene, radar, seed, stage) if radar else []
    criteria, choices = _criteria(tolerance, radar), {}
    for model in get_args(Model):
        levels = [m for m in measured if m.model == model]
        if levels:
            choices[model] = (
                cheapest(levels, criteria[model])
                if within_s is None
                else most_accurate(levels, within_s)
            )
    return Trade(
        scene=scene.name,
        system=system.name,
        radar=radar.name if radar else None,
        tolerance=tolerance,
        criteria=criteria,
        within_s=within_s,
        seed=seed,
        measurements=tuple(measured),
        choices=choices,
        agreement=agreement,
        pixel_noise_e=float(np.median(reference.noise_e)),
        fft_s=_fft_s(),
        warnings=tuple(_warnings(measured, choices, agreement, radar, criteria)),
    )


def _fft_s() -> float:
    rng = np.random.default_rng(0)
    x = rng.normal(size=2**20) + 1j * rng.normal(size=2**20)
    return measure_cost(lambda run: np.fft.fft(x))[0].seconds


def _warnings(
    measured: list[LevelMeasurement],
    choices: dict[Model, Choice],
    agreement: Agreement | None,
    radar: RadarDesign | None,
    criteria: dict[Model, Criterion],
) -> list[str]:
    warnings = [f"{model}: {c.reason}" for model, c in choices.items() if not c.within]
    if agreement and not agreement.holds:
        warnings.append(f"the reference is off: {agreement}")
    of_light = criteria["light"]
    own = next(of_light.error(m) for m in measured if m.name.startswith("reference"))
    if own > of_light.limit:
        warnings.append(
            f"light: renders of the reference differ by {own:.2g} {of_light.unit}: errors of all "
            "levels are upper bounds"
        )
    if "radar" in choices:
        warnings += _of_reference(choices["radar"].measurement, criteria["radar"])
        unsettled = [e for e in choices["radar"].measurement.bodies if not e.is_converged]
        if unsettled:
            named = ", ".join(f"{e.body} ({100 * e.error:.2g} %)" for e in unsettled)
            warnings.append(
                f"radar: {choices['radar'].measurement.name}: echoes not converged: {named}"
            )
    if radar and "radar" not in choices:
        warnings.append(f"{radar.name}: no echo at all, so its levels cannot be compared")
    return warnings


def _of_reference(chosen: LevelMeasurement, criterion: Criterion) -> list[str]:
    """Where echoes are to be closer than the solver is that they are compared with."""
    own = reference_tolerance()
    by_solver = [e.body for e in chosen.bodies if e.is_against_solver]
    if criterion.is_over_noise or criterion.limit >= own or not by_solver:
        return []
    return [
        f"radar: {', '.join(by_solver)}: compared with echoes to {own:g} of themselves, more than "
        f"the {criterion.limit:.2g} asked for"
    ]

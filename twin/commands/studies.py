"""`twin sweep`, `show`, `trade`: design spaces, and speed against accuracy."""

import sys
import warnings
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TextIO

import typer

from hardware.commands.output import Output
from hardware.formatting import counted
from twin.commands import console_of
from twin.commands.arguments import (
    FidelityOption,
    SceneArgument,
    SchedulerOption,
    ToleranceOption,
    WithinOption,
    WorkersOption,
    knobs_for_scores,
    knobs_within,
    only_one,
    scores_asked,
    tolerance_of,
)

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    import xarray
    from matplotlib.figure import Figure

    from twin.fidelity import Accuracy
    from twin.sweep import Study

_REASONS = 3  # of failed points that are printed


def sweep(
    say: Output,
    study: Annotated[Path, typer.Argument(help="TOML file: what is varied, what is measured.")],
    out: Annotated[Path | None, typer.Option(help="Folder; default runs/NAME.")] = None,
    scheduler: SchedulerOption = None,
    workers: WorkersOption = None,
    yes: Annotated[bool, typer.Option("--yes", help="Agree to more than 1e7 points.")] = False,
    tolerance: ToleranceOption = None,
    fidelity: FidelityOption = None,
    within: WithinOption = None,
) -> None:
    """Sweep a design space; the same command resumes what was interrupted.

    A tolerance, fidelity or time given here takes the place of the tolerance or preset that the
    study sets; knobs that the study names stay.
    """
    from twin.sweep import load_study, run_sweep

    plan = load_study(study)
    accuracy = _accuracy_asked(
        say, plan, out, fidelity=fidelity, tolerance=tolerance, within=within
    )
    with _damage_told(say):
        done = run_sweep(
            plan,
            out=out,
            scheduler=scheduler,
            workers=workers,
            yes=yes,
            fidelity=accuracy,
            scores=scores_asked(tolerance),
        )
    failed = f", {done.n_failed} failed" if done.n_failed else ""
    void = f", {done.n_void} void" if done.n_void else ""
    coarse = "" if done.n_coarse is None else f", {done.n_coarse} of them coarse: off the front"
    results = done.out / "results.zarr"
    shared = f", from {counted(done.renders, 'render')} of light" if done.renders else ""
    say.verdict(f"{counted(done.n_points, 'point')}{coarse}{failed}{void}{shared}: {results}")
    say.add(
        points=done.n_points,
        failed=done.n_failed,
        void=done.n_void,
        coarse=done.n_coarse,
        renders=done.renders,
        results=results,
        without_effect=done.without_effect,
        reasons=[
            {"reason": reason, "points": n, "first": done.failed[reason]}
            for reason, n in done.reasons
        ],
    )
    for kind, n in done.warned:
        say.warn(f"{kind}: {counted(n, 'point')}, the first: {done.words[kind]}")
    if done.without_effect:
        say.warn(f"no metric changes with {', '.join(done.without_effect)}")
    for reason, n in done.reasons[:_REASONS]:
        which = f"{counted(n, 'point')}, the first {done.failed[reason]}"
        print(f"failed: {which}: {reason}", file=sys.stderr)
    if len(done.reasons) > _REASONS:
        print(f"failed: {len(done.reasons) - _REASONS} more reasons: error", file=sys.stderr)
    if done.n_failed:
        raise typer.Exit(1)


@contextmanager
def _damage_told(say: Output) -> "Iterator[None]":
    """Tell what Python would be warned of: damage to a sweep's folder."""
    from twin.sweep.checksums import DamagedWarning

    with warnings.catch_warnings():
        warnings.simplefilter("always", DamagedWarning)
        others = warnings.showwarning

        def show(
            message: Warning | str,
            category: type[Warning],
            filename: str,
            lineno: int,
            file: TextIO | None = None,
            line: str | None = None,
        ) -> None:
            if issubclass(category, DamagedWarning):
                say.warn(message)
            else:
                others(message, category, filename, lineno, file, line)

        warnings.showwarning = show
        yield


def _accuracy_asked(
    say: Output,
    study: "Study",
    out: Path | None,
    *,
    fidelity: str | None,
    tolerance: str | None,
    within: float | None,
) -> "Accuracy | None":
    """What the options ask for. What a time allows is measured on the first point, with the sensor
    for which its light is rendered, unless the folder has it; what a score takes is looked for
    there each time, and is the same each time.
    """
    from twin.fidelity import DEFAULT_SHARE
    from twin.sweep.accuracy import named_in, with_accuracy
    from twin.sweep.inputs import inputs_of
    from twin.sweep.plan import stored_accuracy
    from twin.sweep.run import folder_of
    from twin.sweep.setup import setup
    from twin.sweep.shared_light import strictest_sharing

    only_one(fidelity, tolerance, within)
    asked = tolerance_of(tolerance)
    of_score = scores_asked(tolerance)
    if within is None and of_score is None:
        return asked or fidelity
    to_share = with_accuracy(study, DEFAULT_SHARE)  # refused before time is spent
    if within is not None and (knobs := stored_accuracy(folder_of(study, out))):
        return knobs
    inputs = inputs_of(study)
    first = setup(study, study.point(0), inputs)
    scene, system, radar = first.scene, first.system, first.radar
    # A study assumes that nothing moves during a frame unless it names a tolerance of that.
    fixed = {"motion_tolerance": None, **{n: getattr(first.fidelity, n) for n in named_in(study)}}
    if of_score is not None:
        of_score.check_sensors(camera=True, radar=radar is not None)
        bandwidth_hz = radar.total_bandwidth_hz if radar else None
        return knobs_for_scores(say, lambda: scene, of_score, system, fixed, bandwidth_hz)
    assert within is not None
    strictest = strictest_sharing(to_share, 0, inputs)
    return knobs_within(say, lambda: strictest.scene, strictest.system, radar, within, fixed)


def show(
    say: Output,
    sweep: Annotated[Path, typer.Argument(help="Folder of a sweep.")],
    metric: Annotated[
        str | None, typer.Option(help="Metric to draw; default: the first of the study.")
    ] = None,
    x: Annotated[str | None, typer.Option(help="Parameter on the x axis.")] = None,
    y: Annotated[
        str | None, typer.Option(help="Parameter on the y axis; without it a line is drawn.")
    ] = None,
    front: Annotated[
        str | None, typer.Option(help="Second metric: draw and list the Pareto front of both.")
    ] = None,
    void: Annotated[
        bool, typer.Option("--void", help="Include points whose record is void.")
    ] = False,
    csv: Annotated[
        Path | None,
        typer.Option(
            help="CSV file to write: designs on the front, else all points; alone, without a "
            "picture."
        ),
    ] = None,
    out: Annotated[Path | None, typer.Option(help="PNG file; default in the folder.")] = None,
    save: Annotated[
        Path | None,
        typer.Option(help="TOML file to write: system of the best point by the metric."),
    ] = None,
    point: Annotated[
        int | None, typer.Option(help="Point to save in place of the best, by its number.")
    ] = None,
) -> None:
    """Draw a sweep: a metric over parameters, what moves it most, or a Pareto front of two, whose
    designs are listed; and save a design as a system of one's own.
    """
    from hardware.files import said, whole_file
    from twin.errors import InputError
    from twin.sweep import open_sweep
    from twin.sweep.dataset import metrics_of
    from twin.sweep.front import all_points, write_rows
    from twin.sweep.show import plot_front, plot_plane

    for option, file in {"csv": csv, "out": out, "save": save}.items():
        if file == Path():
            raise InputError(f"--{option}: is empty, expected a file to write")
    with _damage_told(say):
        data = open_sweep(sweep)
    needs_picture = metric is not None or out is not None or csv is None
    metric = metric or metrics_of(data)[0]
    if point is not None and save is None:
        raise InputError("--point: chooses the point to save; expected --save FILE.toml beside it")
    figure = None
    if front is not None:
        _tell_front(say, data, metric, front, void=void, csv=csv)
        figure = plot_front(data, metric, front, void=void)
    elif x is not None:
        figure = plot_plane(data, metric, x, y, void=void)
    elif save is None:
        try:
            figure = _tell_sensitivities(say, data, metric, void=void)
        except InputError as error:
            if needs_picture:
                raise
            say.line(f"note: no picture: {error}")
    if front is None and (figure is not None or csv is not None):
        _tell_warned(say, data, void=void)
    if csv is not None and front is None:
        write_rows(all_points(data, void=void), csv)
        say.written(csv)
    if figure is not None and (needs_picture or front or x):
        drawn = "-".join(filter(None, (metric, front))).replace(":", ".")
        picture = out or sweep / f"{drawn}.png"
        try:
            with whole_file(picture) as partial:
                figure.savefig(partial, dpi=150, format=picture.suffix[1:] or "png")
            say.written(picture)
        except OSError as error:  # a folder that can only be read
            if out is not None or csv is None:
                raise
            say.line(f"note: no picture: {said(error)}; --out FILE.png draws it elsewhere")
    if save is not None:
        _save_design(say, sweep, data, metric, point, void=void, path=save)


def _tell_warned(
    say: Output,
    data: "xarray.Dataset",
    points: "Sequence[int] | None" = None,
    *,
    void: bool = False,
) -> None:
    """Warnings that were given of some points, or of any that are not void."""
    from twin.sweep.dataset import void_points, warned_points

    if points is None and not void and (is_void := void_points(data)).any():
        n = f"{is_void.sum()} of {counted(is_void.size, 'point')}"
        say.line(f"note: {n} void, without figures: no warnings of these; --void counts them")
        points = (~is_void).nonzero()[0].tolist()
    for one in warned_points(data):
        some = one if points is None else one.of(points)
        if some.points:
            n = counted(len(some.points), "point")
            say.warn(f"{one.kind}: {n}, the first of the sweep: {one.words}")


def _tell_sensitivities(
    say: Output, data: "xarray.Dataset", metric: str, *, void: bool
) -> "Figure":
    """What moves a metric most, as lines and as a picture."""
    from twin.sweep.dataset import WITHOUT_NUMBER
    from twin.sweep.sensitivity import incomplete_sample, sensitivities, values_without_number
    from twin.sweep.show import plot_sensitivities

    shares = sensitivities(data, metric, void=void)
    for value in values_without_number(data, metric, void=void):
        say.line(f"note: shares without {value}: all its points are {WITHOUT_NUMBER}")
    ordered = sorted(shares.items(), key=lambda item: -item[1].first)
    for name, share in ordered:
        say.verdict(f"variance of {metric}, {share}: {name}")
    approximate = incomplete_sample(data, metric, void=void)
    if approximate:
        say.warn(f"variance of {metric}: {approximate}")
    say.add(
        metric=metric,
        sensitivities=[{"parameter": name, **vars(share)} for name, share in ordered],
        approximate=approximate or None,
    )
    return plot_sensitivities(data, metric, shares, void=void)


def _save_design(
    say: Output,
    sweep: Path,
    data: "xarray.Dataset",
    metric: str,
    point: int | None,
    *,
    void: bool,
    path: Path,
) -> None:
    """A point, or the best, as files, and the command that runs them."""
    from twin.sweep.chosen import best_point, check_point, chosen, is_coarse, write_chosen

    if point is None:
        best = best_point(data, metric, void=void)
        point = best.point
        say.verdict(f"best {metric}: {best} ({data[metric].attrs['long_name']})")
    check_point(data, point)
    if is_coarse(data, point):
        say.warn(f"point {point}: was computed to a coarse tolerance alone; see its errors")
    _tell_warned(say, data, [point])
    found = chosen(sweep, point, path)
    write_chosen(found)
    for file in found.files:
        say.written(file)
    if found.left_out:
        say.line(f"note: of point {point}, in no file: {', '.join(found.left_out)}")
    say.verdict(f"run it: {found.command}")
    say.add(point=point, run=found.command, left_out=found.left_out)


def _tell_front(
    say: Output,
    data: "xarray.Dataset",
    metric: str,
    second: str,
    *,
    void: bool,
    csv: Path | None,
) -> None:
    """The designs on a front as a table, and as a CSV file."""
    from rich.table import Table

    from twin.sweep.front import designs_on_front, write_rows

    designs = designs_on_front(data, metric, second, void=void)
    table = Table(box=None, title=designs.title)
    for head in designs.heads:
        table.add_column(head.replace(".", ".\n"), overflow="fold")
    for cells in designs.cells:
        table.add_row(*cells)
    console_of(say).print(table)
    say.verdict(designs.verdict)
    say.add(metrics=[metric, second], verdict=designs.verdict, designs=designs.rows)
    _tell_warned(say, data, [row["point"] for row in designs.rows])
    if csv is not None:
        write_rows(designs.rows, csv, designs.heads)
        say.written(csv)


def trade(
    say: Output,
    scene: SceneArgument,
    system: Annotated[str, typer.Option(help="Bundled system or TOML file.")] = "workable",
    radar: Annotated[str, typer.Option(help="Bundled radar or TOML file; `none`.")] = "hybrid-79",
    tolerance: Annotated[
        str | None,
        typer.Option(
            help="Error that counts as unseen: a share of the sensor's own noise (0.2), or an "
            "error of a cell's light (1 %), of an echo's level (0.5 dB), of a distance of the "
            "radar (2 mm); several with commas in between."
        ),
    ] = None,
    within: WithinOption = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of every random draw.")] = 0,
    out: Annotated[
        Path | None,
        typer.Option(help="Folder; default runs/trade-SCENE-SYSTEM and what is not the default."),
    ] = None,
) -> None:
    """Measure time, memory and error of every fidelity level on a scene, and choose one.

    It takes minutes: each level is computed several times, the reference of the light five times
    with 4 million paths or more. `--verbose` tells each level as it is finished.
    """
    from twin.errors import InputError
    from twin.fidelity import Tolerance
    from twin.trade import run_trade
    from twin.trade.report import as_code, print_trade, trade_content

    if tolerance is not None and within is not None:
        raise InputError("--tolerance, --within: expected one of them")

    def begins() -> None:
        if not say.verbose:
            say.line(
                "note: every level is computed several times, which takes minutes; -v tells each"
            )

    found, folder = run_trade(
        scene,
        system,
        radar=None if radar == "none" else radar,
        tolerance=tolerance_of(tolerance) or Tolerance(),
        within_s=within,
        seed=seed,
        out=out,
        begins=begins,
    )
    for warning in found.warnings:
        say.warn(warning)
    print_trade(found, console_of(say))
    take = as_code(found.fidelity)
    say.verdict(f"take: {take}")
    say.add(**{**trade_content(found), "verdict": take})
    say.written(folder / "trade.md")

"""`twin sweep`, `show`, `trade`: design spaces, and speed against accuracy."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hardware.commands.quantities import quantity_of
from twin.commands.arguments import (
    FidelityOption,
    SceneArgument,
    ToleranceOption,
    WithinOption,
    knobs_within,
    only_one,
)

if TYPE_CHECKING:
    from twin.fidelity import Accuracy
    from twin.sweep import Study

_REASONS = 3  # of failed points that are printed


def sweep(
    study: Annotated[Path, typer.Argument(help="TOML file: what is varied, what is measured.")],
    out: Annotated[Path | None, typer.Option(help="Folder; default runs/NAME.")] = None,
    scheduler: Annotated[
        str | None, typer.Option(help="A running Dask scheduler, tcp://HOST:PORT.")
    ] = None,
    workers: Annotated[int | None, typer.Option(help="Processes; default one a core.")] = None,
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
    accuracy = _accuracy_asked(plan, out, fidelity=fidelity, tolerance=tolerance, within=within)
    done = run_sweep(
        plan, out=out, scheduler=scheduler, workers=workers, yes=yes, fidelity=accuracy
    )
    failed = f", {done.n_failed} failed" if done.n_failed else ""
    void = f", {done.n_void} void" if done.n_void else ""
    print(
        f"{done.n_points} points{failed}{void}, {done.renders} renders: {done.out / 'results.zarr'}"
    )
    for kind, n in done.warned:
        print(f"warning: {kind}: {n} points", file=sys.stderr)
    if done.without_effect:
        print(f"warning: no metric changes with {', '.join(done.without_effect)}", file=sys.stderr)
    for reason, n in done.reasons[:_REASONS]:
        print(f"failed: {n} points: {reason}", file=sys.stderr)
    if len(done.reasons) > _REASONS:
        print(f"failed: {len(done.reasons) - _REASONS} more reasons: error", file=sys.stderr)
    if done.n_failed:
        raise typer.Exit(1)


def _accuracy_asked(
    study: "Study",
    out: Path | None,
    *,
    fidelity: str | None,
    tolerance: str | None,
    within: float | None,
) -> "Accuracy | None":
    """What the options ask for; a time is measured on the first point, unless the folder has it."""
    from twin.fidelity import DEFAULT_SHARE, Tolerance
    from twin.sweep.accuracy import with_accuracy
    from twin.sweep.inputs import inputs_of
    from twin.sweep.run import folder_of
    from twin.sweep.setup import setup
    from twin.sweep.store import stored_tolerance

    only_one(fidelity, tolerance, within)
    if within is None:
        return fidelity if tolerance is None else Tolerance.of(tolerance)
    with_accuracy(study, DEFAULT_SHARE)  # whether it takes any, before time is spent
    if knobs := stored_tolerance(folder_of(study, out)):
        return knobs
    first = setup(study, study.point(0), inputs_of(study))
    return knobs_within(lambda: first.scene, first.system, first.radar, within)


def show(
    sweep: Annotated[Path, typer.Argument(help="Folder of a sweep.")],
    metric: Annotated[str | None, typer.Option(help="What is drawn; default the first.")] = None,
    x: Annotated[str | None, typer.Option(help="Parameter to the right.")] = None,
    y: Annotated[str | None, typer.Option(help="Parameter upwards; none: a line.")] = None,
    front: Annotated[str | None, typer.Option(help="Second metric: a Pareto front.")] = None,
    void: Annotated[bool, typer.Option("--void", help="Draw points of void records too.")] = False,
    out: Annotated[Path | None, typer.Option(help="PNG file; default in the folder.")] = None,
) -> None:
    """Draw a sweep: a metric over parameters, a Pareto front, or what moves the metric most."""
    from twin.sweep import open_sweep
    from twin.sweep.dataset import metrics_of
    from twin.sweep.sensitivity import sensitivities
    from twin.sweep.show import plot_front, plot_plane, plot_sensitivities

    data = open_sweep(sweep)
    metric = metric or metrics_of(data)[0]
    if front is not None:
        figure = plot_front(data, metric, front, void=void)
    elif x is not None:
        figure = plot_plane(data, metric, x, y, void=void)
    else:
        shares = sensitivities(data, metric, void=void)
        for name, share in sorted(shares.items(), key=lambda item: -item[1].first):
            print(f"{share}: {name}")
        figure = plot_sensitivities(data, metric, shares, void=void)
    out = out or sweep / f"{metric.replace(':', '.')}.png"
    figure.savefig(out, dpi=150)
    print(f"written: {out}")


def trade(
    scene: SceneArgument,
    system: Annotated[str, typer.Option(help="Bundled system or TOML file.")] = "workable",
    radar: Annotated[str, typer.Option(help="Bundled radar or TOML file; `none`.")] = "hybrid-79",
    tolerance: Annotated[
        float | None,
        typer.Option(
            help="Error that counts as unseen, over the sensor's own noise; default 0.2.",
            parser=quantity_of(None),
        ),
    ] = None,
    within: WithinOption = None,
    seed: Annotated[int, typer.Option(min=0, help="Of every random draw.")] = 0,
    out: Annotated[
        Path | None,
        typer.Option(help="Folder; default runs/trade-SCENE-SYSTEM and what is not the default."),
    ] = None,
) -> None:
    """Measure time, memory and error of every fidelity level on a scene, and choose one."""
    from rich.console import Console

    from twin.errors import InputError
    from twin.fidelity import DEFAULT_SHARE
    from twin.trade import run_trade
    from twin.trade.report import print_trade

    if tolerance is not None and within is not None:
        raise InputError("--tolerance, --within: expected one of them")
    found, folder = run_trade(
        scene,
        system,
        radar=None if radar == "none" else radar,
        tolerance=DEFAULT_SHARE if tolerance is None else tolerance,
        within_s=within,
        seed=seed,
        out=out,
    )
    for warning in found.warnings:
        print(f"warning: {warning}", file=sys.stderr)
    print_trade(found, Console(width=None if sys.stdout.isatty() else 150))
    print(f"written: {folder / 'trade.md'}")

"""`twin run`, `check`, `import`: a scene, and everything the sensors make of it."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hardware.formatting import number
from twin.commands import loading
from twin.commands.arguments import (
    FidelityOption,
    PoseOption,
    SceneArgument,
    ToleranceOption,
    WithinOption,
    knobs_asked,
)

if TYPE_CHECKING:
    from twin.job import Result


def run(
    scene: SceneArgument,
    *,
    system: Annotated[
        str, typer.Option(help="Bundled system or TOML file; `none`: the radar alone.")
    ] = "workable",
    compare: Annotated[
        str, typer.Option(help="System shown beside it; `none` for nothing.")
    ] = "paper",
    radar: Annotated[str, typer.Option(help="Bundled radar or TOML file; `none`.")] = "hybrid-79",
    pose: PoseOption = None,
    track: Annotated[
        str | None,
        typer.Option(help="Radar bursts along dx,dy,dz,count[,interval_s] (rig's frame, m, s)."),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of every random draw.")] = 0,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder to write; default runs/SCENE-SYSTEM and what is not the default."
        ),
    ] = None,
    paths: Annotated[bool, typer.Option("--paths", help="List the radar's paths.")] = False,
    sigmf: Annotated[bool, typer.Option("--sigmf", help="Export the radar's IQ.")] = False,
    fidelity: FidelityOption = None,
    tolerance: ToleranceOption = None,
    within: WithinOption = None,
    explain: Annotated[
        bool, typer.Option("--explain", help="List what was modelled and what not, and why.")
    ] = False,
    radar_model: Annotated[
        str | None,
        typer.Option(
            help="targets, paths, optics, rough or file.py:function, in place of fidelity's."
        ),
    ] = None,
    method: Annotated[
        str | None,
        typer.Option(help="Reconstruction beside the bundled ones: a name or file.py:function."),
    ] = None,
    detection: Annotated[
        str | None, typer.Option(help="Radar detection in place of CFAR: file.py:function.")
    ] = None,
) -> None:
    """Scene to image and range-Doppler map: simulate, measure, process, write a report."""
    with loading():
        from twin.job import run as run_job
        from twin.radar import load_radar
        from twin.radar.propagation.scene.scattering_models import ScatteringModel
        from twin.scene import load_scene, parse_pose, parse_track

    design = None if radar == "none" else load_radar(radar)
    camera = None if system == "none" else system
    at = parse_pose(pose) if pose is not None else None
    knobs = knobs_asked(
        lambda: load_scene(scene, at),
        camera,
        design,
        fidelity=fidelity,
        tolerance=tolerance,
        within=within,
    )
    result = run_job(
        scene,
        camera,
        compare=None if compare == "none" else compare,
        radar=design,
        pose=at,
        track=parse_track(track) if track is not None else None,
        seed=seed,
        out=out,
        fidelity=knobs.with_(radar=radar_model) if radar_model else knobs,
        paths=paths,
        sigmf=sigmf,
        method=method,
        detection=detection,
    )
    for warning in result.scene.warnings:
        print(f"warning: {warning}", file=sys.stderr)
    for evaluation in result.evaluations:
        for warning in evaluation.capture.warnings:
            print(f"warning: {evaluation.system.name}: {warning}", file=sys.stderr)
        print(evaluation)
    if result.radar:
        for warning in result.radar.capture.warnings:
            print(f"warning: {result.radar.radar.name}: {warning}", file=sys.stderr)
        tables = [
            a.name
            for a in result.radar.capture.propagation.roles
            if a.role is ScatteringModel.TABLE
        ]
        if tables:
            print(f"{result.radar.radar.name}: tables stand for {', '.join(tables)}")
        print(result.radar)
        if result.radar.picture:
            for seen in result.radar.picture.seen:
                print(
                    f"{seen.name}: seen {seen.down_range_m:.3f} m ahead, "
                    f"{seen.cross_range_m:+.3f} m to the left; "
                    f"cross-section {number(seen.rcs_m2)}, "
                    f"declared {number(seen.declared_rcs_m2)} m^2"
                )
    if explain:
        _print_decisions(result)
    print(f"report: {result.out / 'report.html'}")


def check(scene: SceneArgument, pose: PoseOption = None) -> None:
    """Validate a scene and list what it holds."""
    from rich.console import Console
    from rich.table import Table

    from twin.scene import load_scene, parse_pose
    from twin.scene.checking import check_scene

    loaded = load_scene(scene, parse_pose(pose) if pose is not None else None)
    columns = ("object", "triangles", "size (m)", "nearest (m)", "material", "reflectance", "")
    table = Table(*columns, title=f"{loaded.name}: {loaded.triangles} triangles", box=None)
    for row in check_scene(loaded):
        size = " x ".join(map(number, row.size_m))
        cells = (row.name, str(row.triangles), size, number(row.nearest_m))
        table.add_row(*cells, row.material, row.reflectance, "; ".join(row.remarks))
    Console(width=None if sys.stdout.isatty() else 140).print(table)
    print(f"rig: {loaded.rig.pose}")
    print(f"sun: {loaded.sun}")
    for warning in loaded.warnings:
        print(f"warning: {warning}", file=sys.stderr)


def import_(
    model: Annotated[Path, typer.Argument(help="glTF, OBJ, STL or PLY file.")],
    folder: Annotated[Path, typer.Argument(help="Scene folder to write, e.g. scenes/NAME.")],
    scale: Annotated[float, typer.Option(help="Metres per unit of the model.")] = 1.0,
    up: Annotated[
        str | None, typer.Option(help="The model's up axis, y or z; default y for glTF, z else.")
    ] = None,
    material: Annotated[
        str,
        typer.Option(help="Row of materials.toml for parts whose own material is none."),
    ] = "generic",
    texture_as_reflectance: Annotated[
        bool,
        typer.Option(
            "--texture-as-reflectance", help="Take visible pictures as reflectance at 1550 nm."
        ),
    ] = False,
) -> None:
    """Turn a model file into a scene folder."""
    from twin.scene.importing import import_model

    notes = import_model(
        model,
        folder,
        scale=scale,
        up=up,
        material=material,
        texture_as_reflectance=texture_as_reflectance,
    )
    for note in notes:
        print(f"note: {note}")
    print(f"scene: {folder}")


def _print_decisions(result: "Result") -> None:
    """What was taken and left out, as a table."""
    from rich.console import Console
    from rich.table import Table

    from twin.report.decisions import HEAD, decisions_of, rows

    table = Table(*HEAD, box=None, title="what was modelled, by bounds")
    for row in rows(decisions_of(result.evaluations, result.radar)):
        table.add_row(*row)
    Console(width=None if sys.stdout.isatty() else 150).print(table)

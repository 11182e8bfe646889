"""The command ``twin``. Errors are one line and exit code 2; nothing half-written stays behind."""

import signal
import sys
from pathlib import Path
from typing import Annotated

import typer

from twin.engine import EngineError

app = typer.Typer(
    name="twin",
    help="Digital twin of a vehicle's single-pixel camera and radar.",
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)

SceneArgument = Annotated[
    str, typer.Argument(help="Bundled scene, folder with scene.xml, or Mitsuba XML file.")
]
PoseOption = Annotated[
    str | None,
    typer.Option(help="Of the rig: x,y,z[,yaw[,pitch[,roll]]] in m and deg (x forward, z up)."),
]


@app.callback()
def _twin() -> None:
    """Digital twin of a vehicle's single-pixel camera and radar."""


@app.command()
def run(
    scene: SceneArgument,
    system: Annotated[str, typer.Option(help="Bundled system or TOML file.")] = "workable",
    compare: Annotated[
        str, typer.Option(help="System shown beside it; `none` for nothing.")
    ] = "paper",
    radar: Annotated[str, typer.Option(help="Bundled radar or TOML file; `none`.")] = "hybrid-79",
    pose: PoseOption = None,
    seed: Annotated[int, typer.Option(min=0, help="Of every random draw.")] = 0,
    out: Annotated[
        Path | None, typer.Option(help="Folder to write; default runs/SCENE-SYSTEM.")
    ] = None,
    paths: Annotated[bool, typer.Option("--paths", help="List the radar's paths.")] = False,
    sigmf: Annotated[bool, typer.Option("--sigmf", help="Export the radar's IQ.")] = False,
) -> None:
    """Scene to image and range-Doppler map: simulate, measure, process, write a report."""
    import numpy as np

    from twin.job import run as run_job
    from twin.scene import parse_pose

    result = run_job(
        scene,
        system,
        compare=None if compare == "none" else compare,
        radar=None if radar == "none" else radar,
        pose=parse_pose(pose) if pose is not None else None,
        seed=seed,
        out=out,
        paths=paths,
        sigmf=sigmf,
    )
    for warning in result.scene.warnings:
        print(f"warning: {warning}", file=sys.stderr)
    for evaluation in result.evaluations:
        for warning in evaluation.capture.warnings:
            print(f"warning: {evaluation.system.name}: {warning}", file=sys.stderr)
        best, score = evaluation.reconstructions[0], evaluation.scores[0]
        print(
            f"{evaluation.system.name}: SNR per pixel {np.median(evaluation.capture.snr):.2g} "
            f"(median), {best.method} PSNR {score.psnr_db:.1f} dB, SSIM {score.ssim:.2f}"
        )
    if result.radar:
        for warning in result.radar.capture.warnings:
            print(f"warning: {result.radar.radar.name}: {warning}", file=sys.stderr)
        hit = sum(target is not None for target in result.radar.matches)
        print(
            f"{result.radar.radar.name}: {hit} of {len(result.radar.capture.truth)} targets "
            f"among {len(result.radar.detections)} detections"
        )
    print(f"report: {result.out / 'report.html'}")


@app.command()
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
        size = " x ".join(f"{s:.3g}" for s in row.size_m)
        cells = (row.name, str(row.triangles), size, f"{row.nearest_m:.3g}")
        table.add_row(*cells, row.material, row.reflectance, "; ".join(row.remarks))
    Console(width=None if sys.stdout.isatty() else 140).print(table)
    print(f"rig: {loaded.rig.pose}")
    print(f"sun: {loaded.sun}")
    for warning in loaded.warnings:
        print(f"warning: {warning}", file=sys.stderr)


@app.command("import")
def import_(
    model: Annotated[Path, typer.Argument(help="glTF, OBJ, STL or PLY file.")],
    folder: Annotated[Path, typer.Argument(help="Scene folder to write, e.g. scenes/NAME.")],
    scale: Annotated[float, typer.Option(help="Metres per unit of the model.")] = 1.0,
    up: Annotated[
        str | None, typer.Option(help="The model's up axis, y or z; default y for glTF, z else.")
    ] = None,
    material: Annotated[str, typer.Option(help="Row of materials.toml for all parts.")] = "generic",
) -> None:
    """Turn a model file into a scene folder."""
    from twin.scene.importing import import_model

    for note in import_model(model, folder, scale=scale, up=up, material=material):
        print(f"note: {note}")
    print(f"scene: {folder}")


@app.command()
def budget(
    system: Annotated[str, typer.Option(help="Bundled system or TOML file.")] = "paper",
    whole_line: Annotated[
        bool, typer.Option("--whole-line", help="All of the emitter's line passes the filter.")
    ] = False,
    before_lens: Annotated[
        bool, typer.Option("--filter-before-lens", help="The filter shifts with field angle.")
    ] = False,
    out: Annotated[Path | None, typer.Option(help="Folder for budget.json and budget.png.")] = None,
) -> None:
    """Re-derive the paper's Table 1 and frame rates in closed form."""
    from rich.console import Console

    from twin.budget import SENSORS, audit, frame_rates, link_of
    from twin.budget.report import print_budget, write_budget
    from twin.files import InputError, whole_folder
    from twin.system import load_part, load_system

    if out is not None and not str(out).strip("."):
        raise InputError("out: is empty, expected a folder to write to")
    design = load_system(system)
    parts = [load_part(name) for name in SENSORS]
    options = {"whole_line": whole_line, "filter_before_lens": before_lens}
    rows = [audit(link_of(design, part, **options), part) for part in parts]
    rates = [rate for part in parts if "paper" not in part.name for rate in frame_rates(part)]
    print_budget(rows, rates, Console(width=None if sys.stdout.isatty() else 150))
    for name, value in design.values():
        if value.assumed and name.split(".")[0] in ("emitter", "filter", "optics", "sky"):
            print(f"assumed: {name} = {value.value}: {value.assumed}")
    if out is not None:
        with whole_folder(out) as folder:
            write_budget(rows, rates, folder)
        print(f"written: {out / 'budget.json'}")


@app.command()
def parts(
    name: Annotated[
        str | None, typer.Argument(help="Bundled part or TOML file; none: list them.")
    ] = None,
    plot: Annotated[Path | None, typer.Option(help="PNG of the part's spectral curve.")] = None,
) -> None:
    """List the catalogue's parts, or one part's values with their sources."""
    from twin.system import load_part, part_names

    if name is None:
        for known in part_names():
            part = load_part(known)
            print(f"{part.kind} {known}: {part.description}")
        return
    part = load_part(name)
    print(f"{part.kind} {part.name}: {part.description}")
    for field, value in part.values():
        origin = f"assumed: {value.assumed}" if value.assumed else value.source
        print(f"  {field} = {value.value}  ({origin})")
    if plot is not None:
        from twin.report.part_figure import plot_part

        plot_part(part).savefig(plot, format="png")
        print(f"written: {plot}")


@app.command()
def schema(
    kind: Annotated[str, typer.Argument(help="system, radar, part or scene.")] = "system",
) -> None:
    """Print the JSON Schema of a TOML file, for editors that check while one types."""
    import json

    from twin.files import InputError
    from twin.radar.design import RadarDesign
    from twin.scene.settings import SceneSettings
    from twin.system import Part, System
    from twin.toml import Strict

    models: dict[str, type[Strict]] = {
        "system": System,
        "radar": RadarDesign,
        "part": Part,
        "scene": SceneSettings,
    }
    if kind not in models:
        raise InputError(f"schema: {kind!r}: expected {', '.join(models)}")
    print(json.dumps(models[kind].model_json_schema(), indent=1))


@app.command()
def systems() -> None:
    """List the bundled optical systems and radars."""
    from twin.radar.design import load_radar, radar_names
    from twin.system import load_system, system_names

    for name in system_names():
        print(f"system {name}: {load_system(name).description}")
    for name in radar_names():
        print(f"radar {name}: {load_radar(name).description}")


def main() -> None:
    """Entry point: run a command, turn expected errors into one line and exit code 2."""
    from twin.files import InputError

    signal.signal(signal.SIGINT, _interrupt)
    signal.signal(signal.SIGTERM, _interrupt)
    try:
        code = app(sys.argv[1:] or ["--help"], standalone_mode=False)
        if not _interrupted:
            sys.exit(code)
    except (InputError, OSError, EngineError) as error:
        message = str(error)
    except Exception as error:
        if not _interrupted:
            if not hasattr(error, "format_message"):  # how usage errors are told from faults
                raise
            message = error.format_message()
    except KeyboardInterrupt:
        pass
    if _interrupted:
        print("twin: interrupted, nothing half-written is left", file=sys.stderr)
        sys.exit(130)
    print(f"twin: error: {' '.join(message.split())}", file=sys.stderr)
    sys.exit(2)


_interrupted: list[int] = []


def _interrupt(number: int, _: object) -> None:
    """Remember the signal: libraries in between may turn the exception into another one."""
    _interrupted.append(number)
    raise KeyboardInterrupt

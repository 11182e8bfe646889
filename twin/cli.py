"""The command ``twin``. Errors are one line and exit code 2; nothing half-written stays behind."""

import os
import signal
import sys
from pathlib import Path
from typing import Annotated

import typer

from twin.engine import EngineError
from twin.progress import interrupts

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
    track: Annotated[
        str | None,
        typer.Option(help="Radar bursts along dx,dy,dz,count[,interval_s] (rig's frame, m, s)."),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of every random draw.")] = 0,
    out: Annotated[
        Path | None, typer.Option(help="Folder to write; default runs/SCENE-SYSTEM.")
    ] = None,
    paths: Annotated[bool, typer.Option("--paths", help="List the radar's paths.")] = False,
    sigmf: Annotated[bool, typer.Option("--sigmf", help="Export the radar's IQ.")] = False,
    fidelity: Annotated[str, typer.Option(help="draft, standard or reference.")] = "standard",
    radar_model: Annotated[
        str | None, typer.Option(help="targets, paths, optics or rough, in place of fidelity's.")
    ] = None,
) -> None:
    """Scene to image and range-Doppler map: simulate, measure, process, write a report."""
    import numpy as np

    from twin.job import run as run_job
    from twin.scene import parse_pose, parse_track

    result = run_job(
        scene,
        system,
        compare=None if compare == "none" else compare,
        radar=None if radar == "none" else radar,
        pose=parse_pose(pose) if pose is not None else None,
        track=parse_track(track) if track is not None else None,
        seed=seed,
        out=out,
        fidelity=_fidelity(fidelity, radar_model),
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
            f"(median), {best.method}: {score}"
        )
    if result.radar:
        for warning in result.radar.capture.warnings:
            print(f"warning: {result.radar.radar.name}: {warning}", file=sys.stderr)
        hit = sum(target is not None for target in result.radar.matches)
        print(
            f"{result.radar.radar.name}: {hit} of {len(result.radar.capture.truth)} targets "
            f"among {len(result.radar.detections)} detections"
        )
        if result.radar.picture:
            for seen in result.radar.picture.seen:
                print(
                    f"{seen.name}: seen {seen.down_range_m:.3f} m ahead, "
                    f"{seen.cross_range_m:+.3f} m to the left; cross-section {seen.rcs_m2:.3g}, "
                    f"declared {seen.declared_rcs_m2:.3g} m^2"
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
def trade(
    scene: SceneArgument,
    system: Annotated[str, typer.Option(help="Bundled system or TOML file.")] = "workable",
    radar: Annotated[str, typer.Option(help="Bundled radar or TOML file; `none`.")] = "hybrid-79",
    tolerance: Annotated[
        float, typer.Option(help="Error that counts as unseen, over the sensor's own noise.")
    ] = 0.2,
    seed: Annotated[int, typer.Option(min=0, help="Of every random draw.")] = 0,
    out: Annotated[
        Path | None, typer.Option(help="Folder to write; default runs/trade-SCENE-SYSTEM.")
    ] = None,
) -> None:
    """Measure time, memory and error of every rung on a scene, and say which one to take."""
    from rich.console import Console

    from twin.trade import trade as run_trade
    from twin.trade.report import print_trade

    found, folder = run_trade(
        scene,
        system,
        radar=None if radar == "none" else radar,
        tolerance=tolerance,
        seed=seed,
        out=out,
    )
    for warning in found.warnings:
        print(f"warning: {warning}", file=sys.stderr)
    print_trade(found, Console(width=None if sys.stdout.isatty() else 150))
    print(f"written: {folder / 'trade.md'}")


@app.command()
def serve(
    scene: SceneArgument,
    spi: Annotated[
        str | None, typer.Option(help="Where the camera sits: pty, or tcp:HOST:PORT.")
    ] = None,
    radar: Annotated[
        str | None, typer.Option(help="Where the radar's radio listens: tcp:HOST:PORT.")
    ] = None,
    system: Annotated[str, typer.Option(help="The camera: bundled system or TOML.")] = "workable",
    design: Annotated[str, typer.Option(help="Bundled radar or TOML file.")] = "prototype",
    pace: Annotated[
        str, typer.Option(help="real: device time is the host's; fast: it never waits.")
    ] = "real",
    pose: PoseOption = None,
    seed: Annotated[int, typer.Option(min=0, help="Of every random draw.")] = 0,
    spi_fault: Annotated[
        list[str] | None,
        typer.Option(help="NAME=CHANCE per frame: drop, flip, stall, reset ...; repeatable."),
    ] = None,
    radar_fault: Annotated[
        list[str] | None,
        typer.Option(help="NAME=CHANCE per burst: overflow, late, stall ...; repeatable."),
    ] = None,
    radar_setup: Annotated[
        Path | None, typer.Option(help="JSON to write: schedule and front end for a driver.")
    ] = None,
) -> None:
    """Virtual devices: the twin behind the devices' own protocols, until interrupted."""
    from typing import get_args

    from twin.files import InputError
    from twin.scene import load_scene, parse_pose
    from twin.serve.clock import Pace
    from twin.serve.serving import parse_address, run, serve_camera, serve_radar

    if pace not in get_args(Pace):
        raise InputError(f"pace: {pace!r}, expected {' or '.join(get_args(Pace))}")
    if spi is None and radar is None:
        raise InputError("serve: nothing to serve, expected --spi or --radar or both")
    how: Pace = "real" if pace == "real" else "fast"
    spi_at = parse_address(spi) if spi not in (None, "pty") else None
    radar_at = parse_address(radar) if radar is not None else None
    for address in (spi_at, radar_at):
        if address is not None and not address.loopback:
            print(f"warning: {address.host}: whoever reaches it can use it", file=sys.stderr)
    loaded = load_scene(scene, parse_pose(pose) if pose is not None else None)
    devices = []
    if spi is not None:
        devices.append(
            serve_camera(loaded, system, spi_at, pace=how, faults=spi_fault or (), seed=seed)
        )
    if radar_at is not None:
        devices.append(
            serve_radar(
                loaded,
                design,
                radar_at,
                pace=how,
                faults=radar_fault or (),
                seed=seed,
                setup=radar_setup,
            )
        )
    for device in devices:
        print(f"{device.name}: {device.url}", flush=True)
    run(devices)


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
def rcs(
    mesh: Annotated[Path, typer.Argument(help="PLY, OBJ, STL or glTF file.")],
    carrier_hz: Annotated[float, typer.Option("--carrier-hz", help="Carrier frequency.")],
    azimuth: Annotated[
        str, typer.Option(help="START:STOP:STEP in deg, ends included; or one number.")
    ],
    elevation: Annotated[float, typer.Option(help="Of the radar above the xy plane, deg.")] = 0.0,
    polarization: Annotated[str, typer.Option(help="V or H; VH, HV: sent, then received.")] = "V",
    distance: Annotated[
        float | None, typer.Option(help="From the mesh's origin, m; default: far field.")
    ] = None,
    edges: Annotated[bool, typer.Option("--edges", help="Add diffraction at sharp edges.")] = False,
    scale: Annotated[float, typer.Option(help="Metres per unit of the mesh.")] = 1.0,
    permittivity: Annotated[
        str | None, typer.Option(help="Relative, such as 5.3-0.4j; default: a conductor.")
    ] = None,
    thickness: Annotated[
        float | None, typer.Option(help="Of a dielectric sheet, m; default: a solid.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="CSV to write, with a PNG beside; default: print it.")
    ] = None,
) -> None:
    """Radar cross-section of a mesh over azimuth, by physical optics."""
    from twin.rcs import Request, csv_lines, run

    result = run(
        Request(
            mesh,
            carrier_hz,
            azimuth,
            elevation,
            polarization,
            distance,
            edges,
            scale,
            permittivity,
            thickness,
        ),
        out,
    )
    for warning in result.warnings:
        print(f"warning: {warning}", file=sys.stderr)
    if out is None:
        print("\n".join(csv_lines(result)))
    else:
        print(f"written: {out}, {out.with_suffix('.png')}")


@app.command()
def sweep(
    study: Annotated[Path, typer.Argument(help="TOML file: what is varied, what is measured.")],
    out: Annotated[Path | None, typer.Option(help="Folder; default runs/NAME.")] = None,
    scheduler: Annotated[
        str | None, typer.Option(help="A running Dask scheduler, tcp://HOST:PORT.")
    ] = None,
    workers: Annotated[int | None, typer.Option(help="Processes; default one a core.")] = None,
    yes: Annotated[bool, typer.Option("--yes", help="Agree to more than 1e7 points.")] = False,
) -> None:
    """Sweep a design space; the same command resumes what was interrupted."""
    from twin.sweep import sweep as run_sweep

    done = run_sweep(study, out=out, scheduler=scheduler, workers=workers, yes=yes)
    failed = f", {done.n_failed} failed" if done.n_failed else ""
    print(f"{done.n_points} points{failed}, {done.renders} renders: {done.out / 'results.zarr'}")


@app.command()
def show(
    sweep: Annotated[Path, typer.Argument(help="Folder of a sweep.")],
    metric: Annotated[str | None, typer.Option(help="What is drawn; default the first.")] = None,
    x: Annotated[str | None, typer.Option(help="Parameter to the right.")] = None,
    y: Annotated[str | None, typer.Option(help="Parameter upwards; none: a line.")] = None,
    front: Annotated[str | None, typer.Option(help="Second metric: a Pareto front.")] = None,
    out: Annotated[Path | None, typer.Option(help="PNG file; default in the folder.")] = None,
) -> None:
    """Draw a sweep: a metric over parameters, a Pareto front, or what moves the metric most."""
    from twin.sweep import open_sweep
    from twin.sweep.show import plot_front, plot_plane, plot_sensitivities

    data = open_sweep(sweep)
    metric = metric or next(str(name) for name in data.data_vars if name != "error")
    if front is not None:
        figure = plot_front(data, metric, front)
    elif x is not None:
        figure = plot_plane(data, metric, x, y)
    else:
        figure = plot_sensitivities(data, metric)
    out = out or sweep / f"{metric.replace(':', '.')}.png"
    figure.savefig(out, dpi=150)
    print(f"written: {out}")


@app.command()
def safety(
    system: Annotated[str, typer.Option(help="Bundled system or TOML file.")] = "workable",
    out: Annotated[Path | None, typer.Option(help="Folder for safety.json.")] = None,
) -> None:
    """Margin to the exposure limits of the eye, beside the same light at 850 nm."""
    from rich.console import Console

    from twin.budget.safety import assumptions, hazards, print_safety, write_safety
    from twin.files import InputError, whole_folder
    from twin.system import load_system

    if out is not None and not str(out).strip("."):
        raise InputError("out: is empty, expected a folder to write to")
    design = load_system(system)
    try:
        rows = hazards(design)
    except ValueError as error:
        raise InputError(f"{system}: emitter.peak_wavelength_m: {error}") from error
    rows += hazards(design, 850e-9)
    print_safety(design, rows, Console(width=None if sys.stdout.isatty() else 150))
    for line in assumptions(design):
        print(f"assumed: {line}")
    if out is not None:
        with whole_folder(out) as folder:
            write_safety(design, rows, folder)
        print(f"written: {out / 'safety.json'}")


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
        if not interrupts:
            sys.exit(code)
    except (InputError, OSError, EngineError) as error:
        message = str(error)
    except Exception as error:
        if not interrupts:
            if not hasattr(error, "format_message"):  # how usage errors are told from faults
                raise
            message = error.format_message()
    except KeyboardInterrupt:
        pass
    if interrupts:
        print("twin: interrupted, nothing half-written is left", file=sys.stderr)
        sys.stderr.flush()
        os._exit(130)  # threads of a library that was still loading would abort an orderly exit
    print(f"twin: error: {' '.join(message.split())}", file=sys.stderr)
    sys.exit(2)


def _interrupt(number: int, _: object) -> None:
    """Remember the signal: libraries in between may turn the exception into another one."""
    interrupts.append(number)
    raise KeyboardInterrupt

"""`twin run`, `check`, `import`: a scene, and everything the sensors make of it."""

import os
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hardware.commands.output import Output
from hardware.commands.quantities import quantity_of
from hardware.formatting import counted, number
from twin.child_process import Helper
from twin.commands import console_of, loading
from twin.commands.arguments import (
    FidelityOption,
    MotionOption,
    PoseOption,
    SceneArgument,
    ToleranceOption,
    WithinOption,
    knobs_asked,
    scores_asked,
)

if TYPE_CHECKING:
    from twin.job import Result
    from twin.radar import RadarDesign
    from twin.radar.evaluation import RadarEvaluation
    from twin.scene import Scene
    from twin.system import System


def run(
    say: Output,
    scene: SceneArgument,
    *,
    system: Annotated[
        str, typer.Option(help="Bundled system or TOML file; `none`: the radar alone.")
    ] = "workable",
    compare: Annotated[
        str, typer.Option(help="System to compare with; `none`: no comparison.")
    ] = "paper",
    radar: Annotated[
        str, typer.Option(help="Bundled radar or TOML file; `none`: no radar.")
    ] = "hybrid-79",
    pose: PoseOption = None,
    track: Annotated[
        str | None,
        typer.Option(help="Radar bursts along dx,dy,dz,count[,interval_s] (rig's frame, m, s)."),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of every random draw.")] = 0,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder to write; default runs/SCENE-SYSTEM with the options that differ."
        ),
    ] = None,
    paths: Annotated[bool, typer.Option("--paths", help="List the radar's paths.")] = False,
    sigmf: Annotated[bool, typer.Option("--sigmf", help="Export the radar's IQ.")] = False,
    figures: Annotated[
        bool, typer.Option("--figures", help="Draw PNG files, for slides, beside the report.")
    ] = False,
    fidelity: FidelityOption = None,
    tolerance: ToleranceOption = None,
    within: WithinOption = None,
    motion_tolerance: MotionOption = None,
    explain: Annotated[
        bool, typer.Option("--explain", help="List which effects were modelled or not, and why.")
    ] = False,
    radar_model: Annotated[
        str | None,
        typer.Option(
            help="Model of the echoes: targets, paths, optics, auto, rough or file.py:function."
        ),
    ] = None,
    method: Annotated[
        str | None,
        typer.Option(help="Reconstruction to add to the bundled ones: a name or file.py:function."),
    ] = None,
    detection: Annotated[
        str | None, typer.Option(help="Radar detection in place of CFAR: file.py:function.")
    ] = None,
    anew: Annotated[
        bool,
        typer.Option("--anew", help="Compute light and echoes that an earlier run has kept again."),
    ] = False,
) -> None:
    """Simulate both sensors over a scene, process their records, write a report."""
    helper = None
    if "none" not in (system, radar) and within is None and len(os.sched_getaffinity(0)) > 1:
        helper = Helper("twin.job")  # before anything else: it takes seconds to load
    with loading():
        from twin.job import run as run_job
        from twin.kept_results import KeptResults
        from twin.radar import load_radar
        from twin.report.summary import summary
        from twin.scene import load_scene, parse_pose, parse_track

    design = None if radar == "none" else load_radar(radar)
    camera = None if system == "none" else system
    at = parse_pose(pose) if pose is not None else None
    knobs = knobs_asked(
        say,
        lambda: load_scene(scene, at),
        camera,
        design,
        fidelity=fidelity,
        tolerance=tolerance,
        within=within,
        motion_tolerance=motion_tolerance,
        radar_model=radar_model or None,
    )
    kept = None if anew else KeptResults.of_user()
    result = run_job(
        scene,
        camera,
        compare=None if compare == "none" else compare,
        radar=design,
        pose=at,
        track=parse_track(track) if track is not None else None,
        seed=seed,
        out=out,
        fidelity=knobs,
        score_tolerance=scores_asked(tolerance),
        paths=paths,
        sigmf=sigmf,
        figures=figures,
        method=method,
        detection=detection,
        command=shlex.join(["twin", *sys.argv[1:]]),
        helper=helper,
        kept=kept,
    )
    if kept and kept.problem:
        say.warn(
            f"not all light and echoes are kept for later runs: {kept.problem}; the variable "
            "UGV_TWIN_CACHE names another folder"
        )
    if result.kept:
        say.line(
            f"{' and '.join(result.kept)}: of an earlier run, with the same scene, sensor and "
            "accuracy; --anew computes them again"
        )
    _tell_verdicts(say, result)
    if result.radar:
        _tell_roles(say, result.radar)
    if explain:
        _print_decisions(say, result)
    say.add(
        scene=result.scene.name,
        out=result.out,
        seconds=result.seconds,
        kept=result.kept,
        **summary(result.scene, result.view, result.evaluations, result.radar),
    )
    say.written(result.out / "report.html", name="report")


def _tell_verdicts(say: Output, result: "Result") -> None:
    """Warnings, and what each sensor achieved."""
    for note in result.scene.notes:
        say.line(f"note: {note}")
    for warning in result.scene.warnings:
        say.warn(warning)
    verdicts = []
    for evaluation in result.evaluations:
        if sampled := evaluation.system.sampling_note:
            say.line(f"note: {evaluation.system.name}: {sampled}")
        for warning in evaluation.warnings:
            say.warn(f"{evaluation.system.name}: {warning}")
        say.verdict(evaluation)
        verdicts.append({"of": evaluation.system.name, "verdict": str(evaluation)})
    if result.radar:
        name = result.radar.radar.name
        for warning in result.radar.warnings:
            say.warn(f"{name}: {warning}")
        say.verdict(result.radar)
        verdicts.append({"of": name, "verdict": str(result.radar)})
    say.add(verdicts=verdicts)


def _tell_roles(say: Output, radar: "RadarEvaluation") -> None:
    """Objects for which tables stand, and targets in the picture of a track."""
    from twin.radar.propagation.scene.scattering_models import ScatteringModel

    roles = radar.capture.propagation.roles
    tables = [role.name for role in roles if role.role is ScatteringModel.TABLE]
    if tables:
        say.line(f"{radar.radar.name}: tables stand for {', '.join(tables)}")
    for seen in radar.picture.seen if radar.picture else ():
        say.line(
            f"{seen.name}: seen {seen.down_range_m:.3f} m ahead, "
            f"{seen.cross_range_m:+.3f} m to the left; cross-section {number(seen.rcs_m2)}, "
            f"declared {number(seen.declared_rcs_m2)} m^2"
        )


def check(
    say: Output,
    scene: SceneArgument,
    *,
    pose: PoseOption = None,
    system: Annotated[
        str, typer.Option(help="Camera whose cells motion is given in; `none`.")
    ] = "workable",
    radar: Annotated[
        str,
        typer.Option(
            help="Radar whose cells motion is given in, and whose materials are checked; `none`."
        ),
    ] = "hybrid-79",
) -> None:
    """Check a scene: objects, sizes, speeds, and materials without values for the radar."""
    from rich.table import Table

    from twin.scene import load_scene, parse_pose
    from twin.scene.checking import check_scene
    from twin.system import load_system

    camera = None if system == "none" else load_system(system)
    loaded = load_scene(scene, parse_pose(pose) if pose is not None else None)
    # Not before: it loads Dr.Jit, and a scene looks for its libLLVM.
    from twin.radar import load_radar

    design = None if radar == "none" else load_radar(radar)
    columns = ("object", "triangles", "size (m)", "nearest (m)", "material", "reflectance", "")
    table = Table(*columns, title=f"{loaded.name}: {loaded.triangles} triangles", box=None)
    rows = check_scene(loaded)
    for row in rows:
        size = " x ".join(map(number, row.size_m))
        cells = (row.name, str(row.triangles), size, number(row.nearest_m))
        table.add_row(*cells, row.material, row.reflectance, "; ".join(row.remarks))
    console_of(say, 140).print(table)
    say.line(f"rig: {loaded.rig.pose}")
    say.line(f"sun: {loaded.sun}")
    if loaded.rig.moves or not loaded.at_rest:
        _print_motion(say, loaded, camera, design)
    for note in loaded.notes:
        say.line(f"note: {note}")
    told = list(loaded.warnings)
    if design is not None:
        from twin.radar.propagation.scene.materials import (
            with_generic_properties,
            without_radio_properties,
        )

        of_materials = [
            *with_generic_properties(loaded, {item.name for item in loaded.objects}),
            *without_radio_properties(loaded, design.ofdm.carrier_hz),
        ]
        told += [f"{design.name}: {text}" for text in of_materials]
    for warning in told:
        say.warn(warning)
    odd = sum(bool(row.remarks) for row in rows)
    warnings = counted(len(told), "warning")
    verdict = f"{counted(len(rows), 'object')}, {odd} with remarks, {warnings}"
    say.verdict(f"{loaded.name}: {verdict}")
    say.add(
        scene=loaded.name,
        verdict=verdict,
        triangles=loaded.triangles,
        objects=rows,
        notes=loaded.notes,
        rig=loaded.rig.pose,
        sun=loaded.sun,
    )


def _print_motion(
    say: Output, scene: "Scene", camera: "System | None", design: "RadarDesign | None"
) -> None:
    """What moves, as a table."""
    from rich.table import Table

    from twin.report.motion import HEAD, headline, motion_reports

    table = Table(*HEAD, title=headline(scene, camera, design), box=None)
    reports = motion_reports(scene, camera, design)
    for report in reports:
        table.add_row(*report.cells)
    console_of(say).print(table)
    say.add(motion=reports)


def import_(
    say: Output,
    model: Annotated[Path, typer.Argument(help="glTF, OBJ, STL or PLY file.")],
    folder: Annotated[Path, typer.Argument(help="Scene folder to write, e.g. scenes/NAME.")],
    scale: Annotated[
        float,
        typer.Option(
            help="Metres per unit of the model: 0.001, or `1 mm`.", parser=quantity_of("m")
        ),
    ] = 1.0,
    up: Annotated[
        str | None, typer.Option(help="The model's up axis, y or z; default y for glTF, else z.")
    ] = None,
    material: Annotated[
        str,
        typer.Option(help="Row of materials.toml for parts without a known material."),
    ] = "generic",
    texture_as_reflectance: Annotated[
        bool,
        typer.Option(
            "--texture-as-reflectance", help="Use visible textures as reflectance at 1550 nm."
        ),
    ] = False,
) -> None:
    """Import a model file as a scene folder."""
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
        say.line(f"note: {note}")
    say.add(notes=notes)
    say.verdict(f"scene: {folder}")


def _print_decisions(say: Output, result: "Result") -> None:
    """What was taken and left out, as a table."""
    from rich.table import Table

    from twin.report.decisions import HEAD, decisions_of, rows

    table = Table(*HEAD, box=None, title="what was modelled, by bounds")
    for row in rows(decisions_of(result.evaluations, result.radar)):
        table.add_row(*row)
    console_of(say).print(table)

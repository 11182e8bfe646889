"""The main job: a scene and its sensors in, a folder with report, truth and records out."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from hardware.described import Described
from hardware.radar.own_detection import Detect, OwnDetection
from hardware.radar.settings import Processing
from hardware.reconstruction import Method, method_of
from hardware.reconstruction.registry import Solve
from hardware.records import write_radar_record, write_record
from hardware.records.sigmf import export_sigmf
from twin.camera.acquisition import capture
from twin.camera.acquisition import stages as camera_stages
from twin.camera.asked_scores import warned_of_scores
from twin.camera.evaluation import Evaluation, evaluate
from twin.camera.mounting import light_problem
from twin.camera.truth import write_truth
from twin.camera.view import View, render_view
from twin.child_process import Helper
from twin.engine import use_cores
from twin.errors import check_seed
from twin.fidelity import Accuracy, Fidelity, Tolerance, knobs_of_sensors
from twin.files import InputError, check_out
from twin.kept_results import KeptResults
from twin.progress import Stages, StageTimes
from twin.radar import RadarDesign, load_radar, radar_capture
from twin.radar.acquisition import STAGES as RADAR_STAGES
from twin.radar.evaluation import (
    RadarEvaluation,
    evaluate_radar,
    write_detections,
    write_paths,
    write_truth_table,
)
from twin.report import write_report, write_summary
from twin.run_folder import default_folder, run_folder, settings_of
from twin.scene import Pose, Scene, Track, load_scene
from twin.scene.mitsuba import mitsuba_scene
from twin.system import System, Weather, load_system

#: Triangles of a scene that two processes may hold.
_MOST_TWICE = 1_000_000
_Camera = tuple[View | None, tuple[Evaluation, ...]]


@dataclass(frozen=True, eq=False, repr=False)
class Result(Described):
    """What a run computed; the first evaluation is the system asked for. Of a radar alone there is
    no view and no evaluation. ``kept``: what was taken from earlier runs, light or echoes.
    """

    scene: Scene
    view: View | None
    evaluations: tuple[Evaluation, ...]
    radar: RadarEvaluation | None
    out: Path
    seconds: dict[str, float]
    kept: tuple[str, ...] = ()


def run(
    scene: str | Path | Scene,
    system: str | Path | System | None = "workable",
    *,
    compare: str | Path | System | None = "paper",
    radar: str | Path | RadarDesign | None = "hybrid-79",
    pose: Pose | None = None,
    track: Track | None = None,
    seed: int = 0,
    out: str | Path | None = None,
    fidelity: Accuracy | None = None,
    score_tolerance: Tolerance | None = None,
    paths: bool = False,
    sigmf: bool = False,
    figures: bool = False,
    method: str | Method | Solve | None = None,
    detection: str | Detect | None = None,
    command: str | None = None,
    helper: Helper | None = None,
    kept: KeptResults | None = None,
) -> Result:
    """Run both chains on a scene and write everything to a folder.

    Parameters
    ----------
    scene
        Bundled scene, folder with ``scene.xml``, Mitsuba XML file, or a scene.
    system, compare
        Bundled system, TOML file, or a system (None: no camera, the radar alone, in air that does
        not attenuate); the second is shown beside the first (None: nothing is).
    radar
        Bundled radar, TOML file, or a design (None: no radar).
    pose
        Of the rig, in place of the scene's own.
    track
        Stops of the rig at which the radar takes a burst each, in place of the scene's own.
    seed
        Of every random draw.
    out
        Folder to write to; default ``runs/SCENE-SYSTEM`` with all that is not the default, such as
        ``runs/yard-workable-seed_3``. It appears whole or not at all, and is of this run alone:
        files of the run before go, and those of somebody else are never overwritten.
    fidelity
        Knobs, each with the error it bounds; a preset's name; or a `Tolerance`, the error that the
        model may add. Default: `Tolerance()`, light to a fifth of the sensor's noise, each body's
        echo to 10 % of its level.
    score_tolerance
        For whose scores ``fidelity`` was chosen (`twin.fidelity_for_scores`): images whose scores
        are less exact are warned of.
    paths, sigmf
        Also write the radar's paths as ``paths.csv``, its IQ as SigMF.
    figures
        Whether to draw PNG files too, for slides: loading Matplotlib and drawing takes longer than
        all the rest of a report, which has charts of its own.
    method
        A reconstruction shown beside the bundled ones: a name, a function, ``file.py:function``,
        see `hardware.reconstruct`.
    detection
        In place of the vehicle's CFAR: a function, ``file.py:function`` or an installed name, see
        `hardware.Processing`.

    Raises InputError (one line: file, field, value, what was expected) and EngineError.

    >>> from twin.fidelity import PRESETS
    >>> result = run("yard", radar=None, compare=None, fidelity=PRESETS["draft"], out="first")
    >>> sorted(path.name for path in result.out.glob("*.h5"))
    ['record.h5']
    """
    systems = _systems(system, compare)
    design = None if radar is None else load_radar(radar)
    if not systems and design is None:
        raise InputError("system, radar: both are none, expected at least one of them")
    check_out(out)
    check_seed(seed)
    solve = None if method is None else method_of(method)
    how = Processing(detection=detection)
    bandwidth_hz = design.total_bandwidth_hz if design else None
    knobs = knobs_of_sensors(fidelity, camera=bool(systems), bandwidth_hz=bandwidth_hz)
    with Stages(len(stage_names(systems, design, figures=figures))) as stages:
        with stages.stage("load"):
            world = load_scene(scene, pose)
            world = replace(world, track=track) if track else world
        settings = settings_of(
            world.name,
            [system.name for system in systems],
            design.name if design else None,
            seed,
            pose,
            track,
            knobs,
            method=solve.name if solve else None,
            detection=how.detection.name if isinstance(how.detection, OwnDetection) else None,
            command=command,
        )
        folder = default_folder(settings) if out is None else Path(out)
        with run_folder(folder, settings) as partial:
            of_camera = (world, systems, seed, knobs, method, kept)
            apart = _asked(helper, *of_camera) if systems and design else None
            view, evaluations = (None, ()) if apart else _camera(*of_camera, stages)
            echoes: RadarEvaluation | None = None
            try:
                if design:
                    weather = systems[0].weather if systems else None
                    echoes = _radar(world, design, weather, seed, knobs, stages, how, kept)
                    _write_radar(echoes, partial, paths=paths, sigmf=sigmf)
                if apart:
                    view, evaluations = _answer(apart, stages, kept)
            finally:
                if apart:
                    use_cores(1)
            if score_tolerance:
                evaluations = tuple(warned_of_scores(e, score_tolerance) for e in evaluations)
            if evaluations:
                first = evaluations[0].capture
                write_truth(first.truth, partial / "truth.exr")
                write_record(first.record, partial / "record.h5")
            write_summary(world, view, evaluations, echoes, partial)
            if figures:
                with stages.stage("figures"):
                    _write_figures(view, evaluations, echoes, partial)
            found = tuple(dict.fromkeys(kept.found)) if kept else ()
            settings["kept"] = found
            write_report(world, view, evaluations, echoes, settings, stages, partial)
    return Result(world, view, evaluations, echoes, folder, stages.seconds, found)


def stage_names(
    systems: Sequence[System], radar: RadarDesign | None, *, figures: bool = False
) -> list[str]:
    """Stages of a run, in their order."""
    names = ["load"]
    if systems:
        names.append("scene")
        for system in systems:
            names += [*camera_stages(system), "reconstruction"]
        names.append("view")
    if radar:
        names += [*RADAR_STAGES, "radar processing"]
    return [*names, *(["figures"] if figures else []), "charts"]


def _camera(
    scene: Scene,
    systems: Sequence[System],
    seed: int,
    fidelity: Fidelity,
    method: str | Method | Solve | None,
    kept: KeptResults | None,
    stages: StageTimes,
) -> _Camera:
    """What every system sees; of none, nothing."""
    if not systems:
        return None, ()
    with stages.stage("scene"):
        rendered = mitsuba_scene(scene)
    solve = None if method is None else method_of(method)
    evaluations = []
    for system in systems:
        taken = capture(
            scene,
            system,
            seed=seed,
            fidelity=fidelity,
            mesh_scene=rendered,
            stage=stages.stage,
            kept=kept,
        )
        with stages.stage("reconstruction"):
            evaluations.append(evaluate(system, taken, method=solve))
    with stages.stage("view"):
        first = evaluations[0]
        intensity = first.system.emitter.radiant_intensity_w_per_sr.value
        view = render_view(
            light_problem(scene, first.system, rendered),
            sun_irradiance_w_per_m2=first.capture.sun_irradiance_w_per_m2,
            radiant_intensity_w_per_sr=intensity * first.capture.in_band_fraction,
            seed=seed,
        )
    return view, tuple(evaluations)


def _asked(helper: Helper | None, scene: Scene, *others: Any) -> Helper | None:
    """The helper, if it now computes the camera; else None."""
    if helper is None or scene.triangles > _MOST_TWICE:
        return None
    if not helper.ask(_camera_apart, scene, *others):
        return None
    use_cores(1 / 2)
    return helper


def _camera_apart(
    scene: Scene,
    systems: Sequence[System],
    seed: int,
    fidelity: Fidelity,
    method: str | Method | Solve | None,
    kept: KeptResults | None,
) -> tuple[_Camera, dict[str, float], KeptResults | None]:
    """In the helper: what `_camera` gives, the time in s of its stages, and what was kept."""
    use_cores(1 / 2)
    times = StageTimes()
    found = _camera(scene, systems, seed, fidelity, method, kept, times)
    return found, times.seconds, kept


def _answer(helper: Helper, stages: Stages, kept: KeptResults | None) -> _Camera:
    """What the helper has computed."""
    computed, seconds, theirs = helper.answer()
    for name, took_s in seconds.items():
        stages.ended(name, took_s)
    if kept:
        kept.add(theirs)
    return computed


def _radar(
    scene: Scene,
    design: RadarDesign,
    weather: Weather | None,
    seed: int,
    fidelity: Fidelity,
    stages: Stages,
    how: Processing,
    kept: KeptResults | None,
) -> RadarEvaluation:
    taken = radar_capture(
        scene,
        design,
        seed=seed,
        fidelity=fidelity,
        weather=weather,
        stage=stages.stage,
        kept=kept,
    )
    with stages.stage("radar processing"):
        return evaluate_radar(design, taken, how, scene=scene)


def _write_radar(radar: RadarEvaluation, folder: Path, *, paths: bool, sigmf: bool) -> None:
    write_radar_record(radar.capture.record, folder / "radar.h5")
    write_detections(radar, folder / "detections.csv")
    write_truth_table(radar.capture.truth, folder / "truth.csv")
    if paths:
        write_paths(radar.capture.propagation.paths, folder / "paths.csv")
    if sigmf:
        export_sigmf(radar.capture.record, folder / "radar")


def _write_figures(
    view: View | None,
    evaluations: Sequence[Evaluation],
    radar: RadarEvaluation | None,
    folder: Path,
) -> None:
    from twin.report.drawings import write_figures  # loads Matplotlib, which takes half a second

    write_figures(view, evaluations, radar, folder)


def _systems(
    system: str | Path | System | None, compare: str | Path | System | None
) -> list[System]:
    if system is None:
        return []
    chosen = load_system(system)
    if compare is None:
        return [chosen]
    other = load_system(compare)
    if other == chosen:  # nothing to see beside itself
        other = load_system("workable" if chosen.name == "paper" else "paper")
    if other.name == chosen.name:
        other = other.model_copy(update={"name": f"{other.name} (compared)"})
    return [chosen, other]

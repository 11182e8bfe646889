"""`twin drive`: both sensors along the trajectories of a scene, into one log."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hardware.commands.output import Output
from hardware.commands.quantities import quantity_of
from twin.commands.arguments import (
    FidelityOption,
    MotionOption,
    SceneArgument,
    SchedulerOption,
    ToleranceOption,
    WithinOption,
    WorkersOption,
    knobs_asked,
    named_knobs,
    only_one,
)

if TYPE_CHECKING:
    from twin.drive import DeviceClock
    from twin.drive.run import Driven


def drive(
    say: Output,
    scene: SceneArgument,
    *,
    out: Annotated[Path, typer.Option(help="Log to write (MCAP), or to continue.")],
    duration: Annotated[
        float | None,
        typer.Option(
            help="Length of the drive; default that of the scene's trajectories.",
            parser=quantity_of("s"),
        ),
    ] = None,
    system: Annotated[str, typer.Option(help="Bundled system or TOML file; `none`.")] = "workable",
    radar: Annotated[str, typer.Option(help="Bundled radar or TOML file; `none`.")] = "hybrid-79",
    radar_period: Annotated[
        float | None,
        typer.Option(
            help="Time from burst to burst of the radar; default 100 ms, or a burst if that is "
            "longer.",
            parser=quantity_of("s"),
        ),
    ] = None,
    truth_period: Annotated[
        float,
        typer.Option(
            help="Time between samples of poses, twists and boxes; frames and bursts have more.",
            parser=quantity_of("s"),
        ),
    ] = 0.1,
    camera_offset: Annotated[
        float,
        typer.Option(help="Error of the camera's clock at the start.", parser=quantity_of("s")),
    ] = 0.0,
    camera_drift_ppm: Annotated[
        float, typer.Option(help="Drift of the camera's clock, ppm.")
    ] = 0.0,
    radar_offset: Annotated[
        float,
        typer.Option(help="Error of the radar's clock at the start.", parser=quantity_of("s")),
    ] = 0.0,
    radar_drift_ppm: Annotated[float, typer.Option(help="Drift of the radar's clock, ppm.")] = 0.0,
    seed: Annotated[int, typer.Option(min=0, help="Seed of every random draw.")] = 0,
    tolerance: ToleranceOption = None,
    fidelity: FidelityOption = None,
    within: WithinOption = None,
    motion_tolerance: MotionOption = None,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
) -> None:
    """Drive a scene: records of both sensors and the truth in one log (MCAP), as `ugv process`
    reads it. The same command goes on with a drive that was cut short, to the same bytes.
    """
    import math

    from hardware.interruption import asked_to_end
    from twin.drive import Drive
    from twin.drive import drive as record
    from twin.drive.log import stored_fidelity
    from twin.drive.run import progress_of
    from twin.errors import InputError
    from twin.progress import continued
    from twin.radar import load_radar
    from twin.scene import load_scene
    from twin.system import load_system

    if out == Path():
        raise InputError("--out: is empty, or the current folder; expected a file to write to")
    if not out.parent.is_dir():
        raise InputError(f"--out: {out.parent} is no folder")
    continued[:] = [out]
    world = load_scene(scene)
    camera = None if system == "none" else load_system(system)
    design = None if radar == "none" else load_radar(radar)
    last_s = world.span_s[1]
    if duration is None and not math.isfinite(last_s):
        raise InputError(f"--duration: nothing ends the motion of {world.name}, expected a time")
    camera_clock = _clock("camera", camera_offset, camera_drift_ppm)
    radar_clock = _clock("radar", radar_offset, radar_drift_ppm)
    only_one(fidelity, tolerance, within)
    # What a time allows is measured, never twice the same: a log goes on with what was chosen.
    stored = None if within is None else stored_fidelity(out)
    if stored is None:
        knobs = knobs_asked(
            say,
            lambda: world,
            camera,
            design,
            fidelity=fidelity,
            tolerance=tolerance,
            within=within,
            motion_tolerance=motion_tolerance,
        )
    else:
        knobs = stored.with_(named_knobs(motion_tolerance, None))
        say.line(f"{out}: by the knobs of its first call, --within measures none anew")
    if radar_period is None:
        radar_period = max(Drive.radar_period_s, design.burst_s if design else 0.0)
    plan = Drive(
        scene=world,
        system=camera,
        radar=design,
        duration_s=last_s if duration is None else duration,
        fidelity=knobs,
        seed=seed,
        radar_period_s=radar_period,
        truth_period_s=truth_period,
        camera_clock=camera_clock,
        radar_clock=radar_clock,
    )
    with asked_to_end() as over, progress_of(plan) as tell:
        done = record(plan, out, workers=workers, scheduler=scheduler, over=over, tell=tell)
    _tell(say, done, plan.duration_s, out)


def _clock(device: str, offset_s: float, drift_ppm: float) -> "DeviceClock":
    """Raises InputError with the device's name for numbers that are no clock's."""
    from twin.drive import DeviceClock
    from twin.errors import InputError

    try:
        return DeviceClock(offset_s, drift_ppm)
    except InputError as error:
        raise InputError(f"clock of the {device}: {error}") from None


def _tell(say: Output, done: "Driven", duration_s: float, out: Path) -> None:
    """What was recorded; ends with status 130 where the drive was stopped."""
    from hardware.formatting import counted, number, quantity_text

    if done.resumed:
        kept = "complete already" if done.complete and done.computed_s == 0 else "gone on with"
        say.line(f"{out}: {kept}, {done.resumed} events were there")
    covered, whole = (quantity_text(time_s, "s", 4) for time_s in (done.covered_s, duration_s))
    pace = f"; computed at {number(done.pace)} of real time" if done.computed_s else ""
    say.verdict(f"{done.events} events, {covered} of {whole}{pace}")
    say.add(
        events=done.events,
        resumed=done.resumed,
        covered_s=done.covered_s,
        of_real_time=done.pace,
        complete=done.complete,
    )
    for one in done.warned:
        records = counted(one.records, "record")
        say.warn(f"{one.sensor}: {one.kind}: {records} of this call, the first: {one.words}")
    if done.events:
        say.written(out)
    if not done.complete:
        how = "; the same command continues it" if done.events else " before its first event"
        say.warn(f"the drive was stopped{how}")
        raise typer.Exit(130)

"""Arguments that several commands take."""

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hardware.commands.output import Output
from hardware.commands.quantities import quantity_of
from hardware.formatting import quantity_text

if TYPE_CHECKING:
    from twin.fidelity import Fidelity, Tolerance
    from twin.radar import RadarDesign
    from twin.scene import Scene
    from twin.system import System

SceneArgument = Annotated[
    str, typer.Argument(help="Bundled scene, folder with scene.xml, or Mitsuba XML file.")
]
PoseOption = Annotated[
    str | None,
    typer.Option(help="Pose of the rig: x,y,z[,yaw[,pitch[,roll]]] in m and deg (z up)."),
]
ToleranceOption = Annotated[
    str | None,
    typer.Option(
        help="Error that the model may have: a share of the sensors' own noise (0.2), or an error "
        "of a cell's light (1 %), of an echo's level (0.5 dB), of a distance of the radar (2 mm), "
        "of a score of the image (PSNR 0.1 dB, SSIM 0.01); several with commas in between."
    ),
]
FidelityOption = Annotated[
    str | None,
    typer.Option(
        help="Fixed knobs: draft, standard or reference; default: knobs that follow from a "
        "tolerance of 0.2."
    ),
]


WithinOption = Annotated[
    float | None,
    typer.Option(
        help="In place of a tolerance: time that a frame of each sensor may take on this machine, "
        "after the first; the smallest tolerance that this time allows is used, or else coarser "
        "knobs.",
        parser=quantity_of("s"),
    ),
]


MotionOption = Annotated[
    str | None,
    typer.Option(
        help="Error of motion within a camera's frame, over an exposure's noise; `none`: nothing "
        "moves during a frame. Default: half of the tolerance, or the preset's value."
    ),
]


SchedulerOption = Annotated[
    str | None, typer.Option(help="A running Dask scheduler, tcp://HOST:PORT.")
]
WorkersOption = Annotated[
    int | None,
    typer.Option(
        help="Processes; default one a core, as far as memory allows; 0: no other than this one."
    ),
]


def named_knobs(motion_tolerance: str | None, radar_model: str | None) -> dict[str, Any]:
    """The knobs that `--motion-tolerance`, a number or ``none``, and `--radar-model` name.

    Raises InputError for text that is no number.
    """
    from hardware.units import quantity
    from twin.errors import InputError

    named: dict[str, Any] = {} if radar_model is None else {"radar": radar_model}
    if motion_tolerance == "none":
        named["motion_tolerance"] = None
    elif motion_tolerance is not None:
        try:
            named["motion_tolerance"] = quantity(motion_tolerance, None, bare=True)
        except InputError as error:
            raise InputError(f"--motion-tolerance: {motion_tolerance!r}: {error}") from None
    return named


def tolerance_of(asked: str | None) -> "Tolerance | None":
    """The option `--tolerance`. Raises InputError that names it."""
    from twin.errors import InputError
    from twin.fidelity import Tolerance

    try:
        return None if asked is None else Tolerance.of(asked)
    except InputError as error:
        raise InputError(f"--{error}") from None


def knobs_asked(
    say: Output,
    load: "Callable[[], Scene]",
    system: "System | str | None",
    radar: "RadarDesign | None",
    *,
    fidelity: str | None,
    tolerance: str | None,
    within: float | None,
    motion_tolerance: str | None = None,
    radar_model: str | None = None,
) -> "Fidelity":
    """The knobs that the options ask for; what a time allows, or a score takes, is measured on the
    scene that ``load`` gives, with the tolerance of motion and the radar's model that are named,
    and printed. Raises InputError.
    """
    from twin.fidelity import knobs_of_sensors

    only_one(fidelity, tolerance, within)
    bandwidth_hz = radar.total_bandwidth_hz if radar else None
    fixed = named_knobs(motion_tolerance, radar_model)
    if within is None:
        asked = tolerance_of(tolerance)
        if asked is not None and asked.of_scores:
            asked.check_sensors(camera=system is not None, radar=radar is not None)
            assert system is not None
            return knobs_for_scores(say, load, asked, system, fixed, bandwidth_hz)
        accuracy = asked if fidelity is None else fidelity
        has_camera = system is not None
        knobs = knobs_of_sensors(accuracy, camera=has_camera, bandwidth_hz=bandwidth_hz)
        return knobs.with_(fixed)
    return knobs_within(say, load, system, radar, within, fixed)


def scores_asked(tolerance: str | None) -> "Tolerance | None":
    """The option where it asks for scores, else None."""
    asked = tolerance_of(tolerance)
    return asked if asked and asked.of_scores else None


def knobs_for_scores(
    say: Output,
    load: "Callable[[], Scene]",
    tolerance: "Tolerance",
    system: "System | str",
    fixed: Mapping[str, Any],
    bandwidth_hz: float | None = None,
) -> "Fidelity":
    """The knobs by which scores are as exact as asked, beside ``fixed`` ones, found on the scene
    and printed.
    """
    from twin.trade import fidelity_for_scores

    chosen = fidelity_for_scores(
        load(), tolerance, system=system, bandwidth_hz=bandwidth_hz, fixed=fixed
    )
    say.line(f"tolerance {tolerance}: {chosen}")
    for warning in chosen.warnings:
        say.warn(f"tolerance {tolerance}: {warning}")
    return chosen.fidelity


def only_one(fidelity: str | None, tolerance: str | None, within: float | None) -> None:
    """Raise InputError where more than one of the options is given."""
    from twin.errors import InputError

    if sum(given is not None for given in (fidelity, tolerance, within)) > 1:
        raise InputError("--fidelity, --tolerance, --within: expected one of them")


def knobs_within(
    say: Output,
    load: "Callable[[], Scene]",
    system: "System | str | None",
    radar: "RadarDesign | None",
    within: float,
    fixed: Mapping[str, Any],
) -> "Fidelity":
    """The knobs that a frame's time allows on this machine beside ``fixed`` ones, measured and
    printed.
    """
    from twin.trade import fidelity_within

    chosen = fidelity_within(load(), within, system=system, radar=radar, fixed=fixed)
    say.line(f"within {quantity_text(within, 's')}: {chosen}")
    for warning in chosen.warnings:
        say.warn(f"within {quantity_text(within, 's')}: {warning}")
    return chosen.fidelity

"""`twin serve`: the twin behind the protocols of the devices."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hardware.commands.output import Output
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
    from twin.serve.serving import Address


def serve(
    say: Output,
    scene: SceneArgument,
    *,
    system: Annotated[str, typer.Option(help="The camera: bundled system or TOML.")] = "workable",
    radar: Annotated[str, typer.Option(help="The radar: bundled design or TOML.")] = "prototype",
    spi_at: Annotated[
        str | None, typer.Option(help="Where the camera listens: pty, tcp:PORT, or tcp:HOST:PORT.")
    ] = None,
    radar_at: Annotated[
        str | None,
        typer.Option(help="Where the radar's radio listens: tcp:HOST:PORT; takes three ports."),
    ] = None,
    pace: Annotated[
        str, typer.Option(help="real: devices take as long as real ones; fast: they never wait.")
    ] = "real",
    pose: PoseOption = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of every random draw.")] = 0,
    spi_fault: Annotated[
        list[str] | None,
        typer.Option(help="NAME=CHANCE per frame: drop, flip, stall, reset ...; repeatable."),
    ] = None,
    radar_fault: Annotated[
        list[str] | None,
        typer.Option(help="NAME=CHANCE per burst: overflow, late, stall ...; repeatable."),
    ] = None,
    radar_reuse: Annotated[
        int,
        typer.Option(
            min=1,
            help="Sweeps traced together: later ones reuse echoes of the first on unchanged paths.",
        ),
    ] = 1,
    fidelity: FidelityOption = None,
    tolerance: ToleranceOption = None,
    within: WithinOption = None,
    motion_tolerance: MotionOption = None,
    spi_settings: Annotated[
        Path | None, typer.Option(help="TOML to write: patterns and times for a driver.")
    ] = None,
    radar_setup: Annotated[
        Path | None, typer.Option(help="JSON to write: schedule and front end for a driver.")
    ] = None,
    spi: Annotated[str | None, typer.Option(hidden=True)] = None,
    design: Annotated[str | None, typer.Option(hidden=True)] = None,
) -> None:
    """Serve virtual devices: the twin behind the devices' own protocols, until interrupted."""
    from typing import get_args

    from twin.files import InputError
    from twin.radar import load_radar
    from twin.scene import load_scene, parse_pose
    from twin.serve.clock import Pace
    from twin.serve.serving import run, serve_camera, serve_radar
    from twin.serve.world import SharedWorld

    if pace not in get_args(Pace):
        raise InputError(f"pace: {pace!r}, expected {' or '.join(get_args(Pace))}")
    if spi is not None or design is not None or radar.startswith("tcp:"):
        raise InputError(
            "serve: --system and --radar name the designs, --spi-at and --radar-at where they are"
        )
    if spi_at is None and radar_at is None:
        raise InputError("serve: nothing to serve, expected --spi-at or --radar-at or both")
    _check_written("--spi-settings", spi_settings, "--spi-at", spi_at)
    _check_written("--radar-setup", radar_setup, "--radar-at", radar_at)
    how: Pace = "real" if pace == "real" else "fast"
    camera_address, radio_address = _addresses(spi_at, radar_at)
    for address in (camera_address, radio_address):
        if address is not None and not address.loopback:
            say.warn(f"{address.host}: whoever reaches it can use it")

    def tell(text: str) -> None:
        """On stderr: the first line of stdout is an address."""
        if not say.quiet:
            print(text, file=sys.stderr, flush=True)

    loaded = load_scene(scene, parse_pose(pose) if pose is not None else None)
    sweeper = load_radar(radar) if radio_address is not None else None
    if within is not None or scores_asked(tolerance) is not None:
        tell("choosing the accuracy; addresses are printed when devices can be reached")
    knobs = knobs_asked(
        say,
        lambda: loaded,
        system if spi_at is not None else None,
        sweeper,
        fidelity=fidelity,
        tolerance=tolerance,
        within=within,
        motion_tolerance=motion_tolerance,
    )
    both = spi_at is not None and radio_address is not None
    world = SharedWorld(how) if both else None
    devices = []
    if spi_at is not None:
        tell("camera: computing the first frame; its address is printed when it can be reached")
        devices.append(
            serve_camera(
                loaded,
                system,
                camera_address,
                pace=how,
                faults=spi_fault or (),
                seed=seed,
                fidelity=knobs,
                settings=spi_settings,
                world=world,
            )
        )
    if radio_address is not None and sweeper is not None:
        tell("radar: computing the first sweep; its address is printed when it can be reached")
        devices.append(
            serve_radar(
                loaded,
                sweeper,
                radio_address,
                pace=how,
                faults=radar_fault or (),
                seed=seed,
                fidelity=knobs,
                setup=radar_setup,
                reuse=radar_reuse,
                world=world,
            )
        )
    for device in devices:
        device.listen()
    for device in devices:
        say.verdict(f"{device.name}: {device.url}")
    run(devices)


def _check_written(option: str, file: Path | None, where: str, place: str | None) -> None:
    """Raises InputError for a file of a device that is not served, or that cannot be written."""
    from twin.files import InputError

    if file is not None and place is None:
        raise InputError(f"{option}: expected {where} too, that device is not served")
    if file is not None and not file.absolute().parent.is_dir():
        raise InputError(f"{option}: {file.parent} is no folder")


def _addresses(spi_at: str | None, radar_at: str | None) -> "tuple[Address | None, Address | None]":
    """Of camera and radio, where they are served over TCP; their ports are checked."""
    from twin.serve.serving import check_ports, parse_address

    camera = radio = None
    if spi_at is not None and spi_at != "pty":
        camera = parse_address(spi_at, "--spi-at", "pty")
    if radar_at is not None:
        radio = parse_address(radar_at, "--radar-at")
    if camera is not None and radio is not None:
        check_ports(camera, radio)
    return camera, radio

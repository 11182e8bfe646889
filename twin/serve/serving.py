"""The virtual devices of ``twin serve``, each behind its protocol."""

import ipaddress
import logging
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from hardware.drivers.radio.setup import write_setup
from hardware.drivers.settings import write_settings
from hardware.records import SpiRecord
from twin.camera.stream import MovingFrames, moves, still_light, stills
from twin.fidelity import Accuracy
from twin.files import InputError
from twin.radar import RadarDesign, load_radar
from twin.scene import Scene
from twin.serve.camera import VirtualCamera
from twin.serve.clock import DeviceClock, Pace
from twin.serve.configuration import settings_of
from twin.serve.faults import CameraFaults, RadioFaults, parse_faults
from twin.serve.frames import FramesOfRuns
from twin.serve.line import Line, TcpPort, Terminal
from twin.serve.prefetcher import Prefetcher
from twin.serve.radio import VirtualRadio
from twin.serve.serial import CameraServer
from twin.serve.sweeps import RadarSweep, RadarSweeps, SweepsOfWorld
from twin.serve.world import SharedWorld
from twin.serve.zeromq import RadioServer
from twin.system import System, load_system

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Address:
    """Where a device listens."""

    host: str
    port: int

    @property
    def loopback(self) -> bool:
        """Whether only this machine reaches it."""
        return ipaddress.ip_address(self.host).is_loopback


def parse_address(text: str, option: str = "address", *forms: str) -> Address:
    """``tcp:HOST:PORT``, or ``tcp:PORT`` on loopback. Raises InputError for anything else, with the
    option and all that it takes: ``forms`` beside these.
    """
    kind, _, rest = text.partition(":")
    host, _, port = rest.rpartition(":")
    host = host.strip("[]") or "127.0.0.1"
    try:
        if kind != "tcp" or not 1 <= int(port) <= 65533:
            raise ValueError
        address = Address(host, int(port))
        _ = address.loopback
    except ValueError:
        expected = ", ".join((*forms, "tcp:PORT"))
        raise InputError(
            f"{option}: {text!r:.60}, expected {expected} (of this machine alone) or "
            "tcp:HOST:PORT, HOST an IP address, PORT 1 to 65533"
        ) from None
    return address


def check_ports(camera: Address, radio: Address) -> None:
    """Raise InputError where the camera's port is one of the three that the radio uses."""
    if camera.host == radio.host and 0 <= camera.port - radio.port <= 2:
        raise InputError(
            f"--spi-at: port {camera.port}: the radar uses the ports {radio.port} to "
            f"{radio.port + 2}, expected another one"
        )


@dataclass(frozen=True)
class ServedDevice:
    """A device that can be reached at a URL after ``listen``; ``run`` serves it until ``stop``."""

    name: str
    url: str
    run: Callable[[], None]
    stop: Callable[[], None]
    listen: Callable[[], None] = lambda: None


def serve_radar(
    scene: Scene,
    radar: str | Path | RadarDesign,
    address: Address,
    *,
    pace: Pace = "real",
    faults: Sequence[str] = (),
    seed: int = 0,
    fidelity: Accuracy | None = None,
    setup: Path | None = None,
    reuse: int = 1,
    world: SharedWorld | None = None,
) -> ServedDevice:
    """The radar behind its radio.

    Parameters
    ----------
    scene, radar, fidelity
        As in `radar_capture`, the design by name or file.
    address
        Where the radio listens; it uses the two next ports as well.
    pace, faults
        Of the clock; ``NAME=CHANCE`` of `RadioFaults`.
    seed
        Of the first sweep; sweep k has ``seed + k``.
    setup
        Setup file of the driver to write.
    reuse
        As in `RadarSweeps`.
    world
        The one that `serve_camera` shows too: where something moves, the radar begins in it when it
        is first tuned, and tells how far its sweeps are behind it.

    Raises InputError.
    """
    fault_chances, design = parse_faults(faults, RadioFaults), load_radar(radar)
    world = world if moves(scene) else None
    of_world = SweepsOfWorld(RadarSweeps(scene, design, seed, fidelity, reuse))
    sweeps = Prefetcher(of_world, begins_later=world is not None)

    def later(begins_s: float) -> Prefetcher[RadarSweep]:
        scene.after(begins_s)  # what forbids it is told now
        begun = begins_s, virtual.schedule.sweep_s
        if sweeps.begin_again(*begun):
            return sweeps
        sweeps.close()
        return Prefetcher(of_world, *begun)

    virtual = VirtualRadio(
        design,
        sweeps,
        clock=DeviceClock(pace),
        faults=fault_chances,
        seed=seed,
        world=world,
        later=later,
    )
    server = RadioServer(
        virtual,
        address.host,
        address.port,
        n_samples=virtual.n_samples,
        faults=fault_chances,
        seed=seed,
    )
    if setup is not None:
        write_setup(virtual.schedule, virtual.front_end, setup)
    url = f"zmq://{address.host}:{address.port}"
    return ServedDevice(virtual.device, url, server.run, server.stop)


def serve_camera(
    scene: Scene,
    system: str | Path | System,
    address: Address | None,
    *,
    pace: Pace = "real",
    faults: Sequence[str] = (),
    seed: int = 0,
    fidelity: Accuracy | None = None,
    settings: Path | None = None,
    world: SharedWorld | None = None,
) -> ServedDevice:
    """The single-pixel camera behind its protocol, at an address or on a pseudo-terminal (None).

    Each run gives the records of `stills` with ``seed``, from the first on, or of `MovingFrames`
    where something moves: then it begins at the scene's own instant, and frames that take longer to
    compute than to measure are sent late, of which a warning tells; with a ``world`` it begins at
    what that is like at the start of the run. ``settings`` is the settings file of the driver to
    write; the rest as `serve_radar`. Raises InputError.
    """
    fault_chances, design = parse_faults(faults, CameraFaults), load_system(system)
    if settings is not None:
        write_settings(settings_of(design), settings)
    if moves(scene) or scene.sun.moves:
        ahead = FramesOfRuns(scene, design, seed, fidelity)
        MovingFrames(scene, design, seed, fidelity)(0)  # errors are told now
        ahead.wait()

        def records(asked: System) -> Iterator[SpiRecord]:
            begins_s = world.begin() if world else 0.0
            scene.after(begins_s)  # refused now where its trajectories have ended
            frames = ahead(asked, begins_s)
            if frames.begins_s < begins_s:
                _log.warning(
                    "%s: goes on with the frames of the run before, of which none came: they show "
                    "the world of %.3g s ago",
                    *(design.name, begins_s - frames.begins_s),
                )
            return frames
    else:
        light = still_light(scene, design, seed=seed, fidelity=fidelity)

        def records(asked: System) -> Iterator[SpiRecord]:
            return stills(scene, asked, seed=seed, fidelity=fidelity, lit=light)

    clock = DeviceClock(pace, fault_chances.drift)
    line: Line = (
        Terminal() if address is None else TcpPort(address.host, address.port, at_once=False)
    )
    server = CameraServer(
        lambda send, overrun: VirtualCamera(
            design,
            scene.sun,
            records,
            clock=clock,
            send=send,
            overrun=overrun,
        ),
        line,
        clock=clock,
        faults=fault_chances,
        seed=seed,
    )
    return ServedDevice(f"twin: {design.name}", line.url, server.run, server.stop, line.listen)


def run(devices: Sequence[ServedDevice]) -> None:
    """Serve all until interrupted."""
    threads = [threading.Thread(target=device.run, daemon=True) for device in devices]
    for thread in threads:
        thread.start()
    try:
        for thread in threads:
            thread.join()
    finally:
        for device in devices:
            device.stop()

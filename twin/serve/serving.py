"""What ``twin serve`` runs: the devices of one scene, each behind its protocol."""

import ipaddress
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from hardware.drivers.radio.setup import write_setup
from twin.fidelity import Fidelity
from twin.files import InputError
from twin.radar import RadarDesign, RadarEcho, load_radar, radar_echo
from twin.scene import Pose, Scene, load_scene
from twin.serve.clock import DeviceClock, Pace
from twin.serve.faults import parse_faults
from twin.serve.radio import VirtualRadio
from twin.serve.zeromq import RadioServer


@dataclass(frozen=True)
class Address:
    """Where a device listens."""

    host: str
    port: int

    @property
    def loopback(self) -> bool:
        """Whether only this machine reaches it."""
        return self.host == "localhost" or ipaddress.ip_address(self.host).is_loopback


def parse_address(text: str) -> Address:
    """``tcp:HOST:PORT``, or ``tcp:PORT`` on loopback. Raises InputError for anything else."""
    kind, _, rest = text.partition(":")
    host, _, port = rest.rpartition(":")
    host = host.strip("[]") or "127.0.0.1"
    try:
        if kind != "tcp" or not 1 <= int(port) <= 65533:
            raise ValueError
        address = Address(host, int(port))
        _ = address.loopback
    except ValueError:
        raise InputError(f"{text!r}: expected tcp:HOST:PORT, HOST an IP address") from None
    return address


def echoes(
    scene: Scene, radar: RadarDesign, seed: int, fidelity: Fidelity | None = None
) -> Callable[[int], RadarEcho]:
    """The scene's answer to each sweep: sweep k is what a run with ``seed + k`` records."""
    return lambda sweep: radar_echo(scene, radar, seed=seed + sweep, fidelity=fidelity)


def serve_radar(
    scene: str | Path,
    address: Address,
    *,
    radar: str | Path | RadarDesign = "hybrid-79",
    pose: Pose | None = None,
    pace: Pace = "real",
    faults: Sequence[str] = (),
    seed: int = 0,
    fidelity: Fidelity | None = None,
    setup: Path | None = None,
    listening: Callable[[VirtualRadio], None] = lambda radio: None,
) -> None:
    """Serve the radar of a scene until interrupted.

    ``setup`` names a file for what the driver must know; ``listening`` is called once the radio can
    be reached. The rest as `twin.job.run`. Raises InputError.
    """
    found = parse_faults(faults)
    design, loaded = load_radar(radar), load_scene(scene, pose)
    virtual = VirtualRadio(
        design,
        echoes(loaded, design, seed, fidelity),
        clock=DeviceClock(pace),
        faults=found,
        seed=seed,
    )
    server = RadioServer(
        virtual, address.host, address.port, n_samples=virtual.n_samples, faults=found, seed=seed
    )
    if setup is not None:
        write_setup(virtual.schedule, virtual.front_end, setup)
    listening(virtual)
    server.run()

"""The twin as a source of records, ``twin:SCENE``.

The vehicle finds it by the entry point ``ugv.sources``. Records are those of
`twin.camera.stream.stills` and `twin.serve.sweeps.RadarSweeps`, without a protocol in between:

    twin:yard                                  the camera of the system ``workable``
    twin:scenes/yard?system=mine.toml&seed=3   another camera, another seed
    twin:yard?radar=hybrid-79&system=none      the radar
    twin:yard?pace=fast                        as fast as records are computed
"""

import heapq
import threading
import time
from collections.abc import Generator, Iterator
from contextlib import ExitStack, contextmanager
from itertools import chain, count
from typing import get_args
from urllib.parse import parse_qsl, unquote

from pydantic import ValidationError

from hardware.drivers import SpiSettings
from hardware.drivers.clock import ClockModel
from hardware.errors import DeviceError
from hardware.recording.reading import Received
from hardware.records import RadarRecord, SpiRecord
from twin.camera.stream import MovingFrames, moves, still_light, stills
from twin.errors import EngineError, InputError
from twin.fidelity import Accuracy
from twin.radar import load_radar
from twin.scene import Scene, load_scene
from twin.serve.clock import DeviceClock, Pace
from twin.serve.configuration import configure_system
from twin.serve.prefetcher import Prefetcher
from twin.serve.sweeps import RadarSweeps
from twin.system import System, load_system

_OPTIONS = {"system": "workable", "radar": "none", "seed": "0", "pace": "real"}
#: Interval at which ``over`` is checked while waiting.
_LOOK_S = 0.1


def records(
    url: str,
    settings: SpiSettings | None = None,
    *,
    over: threading.Event | None = None,
    fidelity: Accuracy | None = None,
) -> Generator[Received, None, None]:
    """Records of a scene without end, in the order of device time.

    Parameters
    ----------
    url
        ``twin:SCENE?OPTION=VALUE&...``. The scene and the options ``system``, ``radar`` (a name,
        a file, or ``none``), ``seed`` and ``pace`` are as ``twin serve`` takes them.
    settings
        Settings of the camera; default: those of its system.
    over
        Event that ends the records.
    fidelity
        Accuracy settings, each with the error it bounds.

    A record is yielded once the device would have measured it (``real``), or as soon as it is
    computed (``fast``); one that takes longer to compute than to measure comes late. The scene is
    read, and rendered for the camera, before this returns. Raises
    InputError for errors in the URL, in the files that it names or in the settings; DeviceError
    where the engine fails.
    """
    name, options = _parsed(url)
    paces: dict[str, Pace] = {pace: pace for pace in get_args(Pace)}
    if options["pace"] not in paces:
        raise InputError(f"{url}: pace: {options['pace']!r}, expected {' or '.join(paces)}")
    if not (options["seed"].isascii() and options["seed"].isdecimal()):
        raise InputError(f"{url}: seed: {options['seed']!r}, expected a whole number from 0 on")
    if options["system"] == options["radar"] == "none":
        raise InputError(f"{url}: neither a system nor a radar")
    scene, seed = load_scene(name), int(options["seed"])
    camera = radar = None
    if options["system"] != "none":
        system = _system(url, options["system"], settings)
        with _engine_as_device(url):
            camera = _camera(scene, system, seed, fidelity)
    if options["radar"] != "none":
        radar = RadarSweeps(scene, load_radar(options["radar"]), seed, fidelity)
    clock = DeviceClock(paces[options["pace"]])
    return _received(camera, radar, clock, over or threading.Event())


def _camera(
    scene: Scene, system: System, seed: int, fidelity: Accuracy | None
) -> Iterator[SpiRecord]:
    """Records of a camera: its first frame is computed before this returns."""
    if not (moves(scene) or scene.sun.moves):
        light = still_light(scene, system, seed=seed, fidelity=fidelity)
        return stills(scene, system, seed=seed, fidelity=fidelity, lit=light)
    frames = MovingFrames(scene, system, seed, fidelity)
    return chain([frames(0)], map(frames, count(1)))


@contextmanager
def _engine_as_device(name: str) -> Iterator[None]:
    """Raise errors of the engine as errors of a device, which the vehicle knows."""
    try:
        yield
    except EngineError as error:
        raise DeviceError(f"{name}: {error}") from error


def _parsed(url: str) -> tuple[str, dict[str, str]]:
    """Scene and options of a URL."""
    scene, _, query = url.partition(":")[2].partition("?")
    try:
        options = dict(parse_qsl(query, keep_blank_values=True, strict_parsing=bool(query)))
    except ValueError as error:
        raise InputError(f"{url}: {query!r}, expected OPTION=VALUE&OPTION=VALUE") from error
    if unknown := options.keys() - _OPTIONS.keys():
        raise InputError(f"{url}: option {min(unknown)!r} is none of {', '.join(_OPTIONS)}")
    if not scene:
        raise InputError(f"{url}: expected a scene, twin:SCENE?OPTION=VALUE&OPTION=VALUE")
    return unquote(scene), _OPTIONS | options


def _system(url: str, name: str, settings: SpiSettings | None) -> System:
    system = load_system(name)
    if settings is None:
        return system
    try:
        return configure_system(system, settings)
    except (InputError, ValidationError) as error:
        raise InputError(f"{url}: settings: {' '.join(str(error).split())}") from error


def _received(
    camera: Iterator[SpiRecord] | None,
    radar: RadarSweeps | None,
    clock: DeviceClock,
    over: threading.Event,
) -> Generator[Received, None, None]:
    """Records of both in the order of their start, on a host's clock that started with the
    device's.
    """
    zero_ns = time.time_ns()
    model = ClockModel(zero_ns, -zero_ns, 0.0, 0.0)
    with ExitStack() as stack:
        sensors: list[Iterator[tuple[int, str, SpiRecord | RadarRecord]]] = []
        if camera is not None:
            sensors.append(_timed("/spi/record", camera))
        if radar is not None:
            prefetcher = Prefetcher(radar.record)
            stack.callback(prefetcher.close)
            sensors.append(_timed("/radar/record", _prefetched(prefetcher, over)))
            stack.enter_context(_engine_as_device("radar"))
        for _, topic, record in heapq.merge(*sensors, key=lambda item: item[0]):
            end_ns = int(record.device_time_ns.flat[-1])
            while (left_s := clock.left_s(end_ns)) > 0 and not over.is_set():
                time.sleep(min(left_s, _LOOK_S))
            if over.is_set():
                return
            yield Received(topic, record, zero_ns + end_ns, model)


def _prefetched(
    prefetcher: Prefetcher[RadarRecord], over: threading.Event
) -> Iterator[RadarRecord]:
    for number in count():
        while not prefetcher.ready(number, _LOOK_S):
            if over.is_set():
                return
        yield prefetcher(number)


def _timed(
    topic: str, records: Iterator[SpiRecord] | Iterator[RadarRecord]
) -> Iterator[tuple[int, str, SpiRecord | RadarRecord]]:
    return ((int(record.device_time_ns.flat[0]), topic, record) for record in records)

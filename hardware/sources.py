"""Where records come from, by URL: a device, a log, or whatever else an installed package offers.

``replay:run.mcap`` plays a log at its own pace, ``replay:run.mcap?pace=fast`` as fast as it is
read. ``zmq://HOST:PORT``, ``uhd:type=b200``: a radar's radio, a record a sweep. ``/dev/ttyACM0``,
``socket://host:port``, ``rfc2217://host:port``: a camera. Other schemes are found under the
entry-point group ``ugv.sources``, by which an installed package offers a function that gives the
records: ``f(url, settings, over=...)``, as `open_source` takes them. The digital twin offers
``twin:SCENE``.
"""

import threading
import time
from collections.abc import Callable, Generator
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from hardware.drivers.clock import ClockFilter
from hardware.errors import InputError
from hardware.recording.ending import Ending
from hardware.recording.reading import Received, read_records

if TYPE_CHECKING:
    from hardware.drivers import SpiSettings
    from hardware.drivers.radio import RadioDriver, Schedule
    from hardware.records import RadarFrontEnd


class SourceError(InputError):
    """A URL that leads to no records: of no known kind, or of a kind that is not installed."""


Records: TypeAlias = Generator[Received, None, None]

#: Exchanges of time with a radio before its first record; then one a record.
_FIRST_EXCHANGES = 8
#: Between looks whether it is over, while waiting.
_LOOK_S = 0.1


def open_source(
    url: str,
    settings: "SpiSettings | None" = None,
    setup: "tuple[Schedule, RadarFrontEnd] | None" = None,
    *,
    over: threading.Event | None = None,
    ending: Ending | None = None,
) -> Records:
    """Records of a source, as they come; close the generator to end it.

    Parameters
    ----------
    url
        See above.
    settings
        Of a camera.
    setup
        Of a radio, as `hardware.drivers.radio.setup.read_setup` reads it.
    over
        Ends the wait for a device that is silent: set it from another thread or a signal's
        handler. What the driver raises then means nothing.
    ending
        Filled in with what is wrong with a log; without it a warning is logged.

    Raises SourceError for a URL of no known kind, a file that is no log, a camera without settings,
    a radio without a setup, a package that is not installed; what a driver or an installed package
    raises.
    """
    scheme, colon, rest = url.partition(":")
    if scheme == "replay":
        path, _, query = rest.partition("?")
        if query not in ("", "pace=fast", "pace=real"):
            raise SourceError(f"{url}: {query!r} is neither 'pace=fast' nor 'pace=real'")
        speed = float("inf") if query == "pace=fast" else 1.0
        return replay(path, speed=speed, over=over, ending=ending)
    if scheme in ("uhd", "zmq"):
        if setup is None:
            raise SourceError(f"{url}: a radio needs a setup")
        return _radio(url, *setup, over or threading.Event())
    if colon and (installed := _installed(scheme)):
        return installed(url, settings, over=over)
    if colon and not scheme.startswith("/") and not rest.startswith("//"):
        raise SourceError(f"{url}: no installed package offers {scheme}:")
    if Path(url).is_file():
        raise SourceError(
            f"{url}: is a file, expected the URL of a sensor, or a log (NAME.mcap); `ugv "
            "reconstruct` and `ugv detect` read the records (HDF5) of a camera and a radar"
        )
    if settings is None:
        raise SourceError(f"{url}: a camera needs settings (a TOML file of patterns and times)")
    return _camera(url, settings, over)


def replay(
    path: str | Path,
    *,
    speed: float = 1.0,
    over: threading.Event | None = None,
    ending: Ending | None = None,
) -> Records:
    """Records of a log at the pace at which they came, times ``speed``, until ``over`` is set.

    ``ending`` and what is raised: as `read_records`.
    """
    if not speed > 0:
        raise InputError(f"speed: {speed} is not positive")
    over, first_ns, begun_s = over or threading.Event(), None, time.monotonic()
    for received in read_records(path, ending):
        first_ns = received.host_ns if first_ns is None else first_ns
        due_s = begun_s + (received.host_ns - first_ns) * 1e-9 / speed
        while (left_s := due_s - time.monotonic()) > 0 and not over.is_set():
            time.sleep(min(left_s, _LOOK_S))
        if over.is_set():
            return
        yield received


def _camera(url: str, settings: "SpiSettings", over: threading.Event | None) -> Records:
    from hardware.drivers import SpiCamera

    with SpiCamera(url, settings, over=over) as camera:
        for record in camera.records():
            yield Received("/spi/record", record, time.time_ns(), camera.clock)


def _radio(
    url: str, schedule: "Schedule", front_end: "RadarFrontEnd", over: threading.Event
) -> Records:
    from hardware.drivers.radio import RadioError, acquire, open_radio

    clock = ClockFilter(url)
    with open_radio(url, sample_rate_hz=schedule.waveform.bandwidth_hz, over=over) as radio:
        for _ in range(_FIRST_EXCHANGES):
            _exchange(radio, clock)
        while not over.is_set():
            try:
                record = acquire(radio, schedule, front_end)
            except RadioError:
                with suppress(RadioError):  # which warns where its clock was set meanwhile
                    _exchange(radio, clock)
                raise
            host_ns = time.time_ns()
            _exchange(radio, clock)
            yield Received("/radar/record", record, host_ns, clock.model)


def _exchange(radio: "RadioDriver", clock: ClockFilter) -> None:
    sent_ns, device_ns, returned_ns = time.time_ns(), radio.now_ns(), time.time_ns()
    if returned_ns >= sent_ns:  # unless the host's clock was set back meanwhile
        clock.add(sent_ns, device_ns, device_ns, returned_ns)


def _installed(scheme: str) -> "Callable[..., Records] | None":
    """What an installed package offers for a scheme. Raises SourceError where it does not load."""
    from importlib.metadata import entry_points

    for point in entry_points(group="ugv.sources", name=scheme):
        try:
            return point.load()
        except ImportError as error:
            package = point.dist.name if point.dist else point.value
            extras = f"[{','.join(point.extras)}]" if point.extras else ""
            raise SourceError(
                f"{scheme}: {package} offers it, but what that needs is not installed ({error}): "
                f"pip install '{package}{extras}'"
            ) from error
    return None

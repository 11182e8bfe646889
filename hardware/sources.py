"""Where records come from, by URL: a device, a log, or whatever else an installed package offers.

``replay:run.mcap`` plays a log at its own pace, ``replay:run.mcap?pace=fast`` as fast as it is
read. ``/dev/ttyACM0``, ``socket://host:port``, ``rfc2217://host:port``: a camera. Other schemes
(``twin:``, radios) are found under the entry-point group ``ugv.sources``: a function of URL and
settings that gives the records.
"""

import time
from collections.abc import Callable, Generator
from pathlib import Path
from typing import TypeAlias

from hardware.drivers import SpiCamera, SpiSettings
from hardware.recording.reading import Received, read_records

Records: TypeAlias = Generator[Received, None, None]


def open_source(url: str, settings: SpiSettings | None = None) -> Records:
    """Records of a source, as they come; close the generator to end it.

    Raises ValueError for a URL of no known kind, or a camera without settings; what a driver
    raises.
    """
    scheme, _, rest = url.partition(":")
    if scheme == "replay":
        path, _, query = rest.partition("?")
        if query not in ("", "pace=fast", "pace=real"):
            raise ValueError(f"{url}: {query!r} is neither 'pace=fast' nor 'pace=real'")
        return replay(path, speed=float("inf") if query == "pace=fast" else 1.0)
    if rest and (found := _installed(scheme)):
        return found(url, settings)
    if settings is None:
        raise ValueError(f"{url}: a camera needs settings")
    return _camera(url, settings)


def replay(path: str | Path, *, speed: float = 1.0) -> Records:
    """Records of a log at the pace at which they came, times ``speed``."""
    if not speed > 0:
        raise ValueError(f"speed: {speed} is not positive")
    first_ns, begun_s = None, time.monotonic()
    for received in read_records(path):
        first_ns = received.host_ns if first_ns is None else first_ns
        due_s = begun_s + (received.host_ns - first_ns) * 1e-9 / speed
        time.sleep(max(due_s - time.monotonic(), 0))
        yield received


def _camera(url: str, settings: SpiSettings) -> Records:
    with SpiCamera(url, settings) as camera:
        for record in camera.records():
            yield Received("/spi/record", record, time.time_ns(), camera.clock)


def _installed(scheme: str) -> Callable[[str, SpiSettings | None], Records] | None:
    from importlib.metadata import entry_points

    for point in entry_points(group="ugv.sources", name=scheme):
        return point.load()
    return None

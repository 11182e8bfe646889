"""Records from several sources at once into one log."""

import logging
import queue
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from hardware.recording import Log, Received
from hardware.recording.ending import Ending
from hardware.sources import Records, open_source

if TYPE_CHECKING:
    from hardware.drivers import SpiSettings
    from hardware.drivers.radio import Schedule
    from hardware.records import RadarFrontEnd

_log = logging.getLogger(__name__)

#: Records that may wait for the disk; then the sources wait.
_WAITING = 64
#: Longest time that the sources have to let go of their devices at the end.
_GRACE_S = 3.0


@dataclass(frozen=True)
class _Ended:
    """A source gives no more; why, where it did not end by itself."""

    url: str
    error: Exception | None = None


@dataclass(frozen=True)
class _Sources:
    """What the threads that read the sources share with the one that writes the log."""

    waiting: "queue.Queue[Received | _Ended]" = field(default_factory=lambda: queue.Queue(_WAITING))
    over: threading.Event = field(default_factory=threading.Event)

    def put(self, item: Received | _Ended) -> None:
        while not self.over.is_set():
            try:
                self.waiting.put(item, timeout=0.1)
                return
            except queue.Full:
                continue


def capture(
    urls: Sequence[str],
    log: Log,
    settings: "SpiSettings | None" = None,
    setup: "tuple[Schedule, RadarFrontEnd] | None" = None,
    *,
    duration_s: float = float("inf"),
    records: int = 0,
    over: threading.Event | None = None,
    endings: dict[str, Ending] | None = None,
) -> Iterator[Received]:
    """Write what sources send to a log, and pass it on.

    ``settings`` and ``setup`` as `open_source` takes them, for all cameras and all radios. Ends
    with the last source, after ``duration_s``, after so many ``records`` (0: no limit), or when
    ``over`` is set. Each source is waited for by itself, as long as its own driver says: one that
    is silent or fails holds up none of the others, is logged as a warning, and its error is raised
    at the end, after everything that came is written. At the end the sources have 3 s to let go of
    their devices; one that is still busy then is left behind, with a warning. ``endings`` is filled
    in, by URL, with what is wrong with logs among the sources; without it warnings are logged.
    """
    shared, over = _Sources(), over or threading.Event()
    if endings is not None:
        endings |= {url: Ending() for url in urls}
    # Told before any thread runs: a URL of no known kind is an error of the call.
    sources = [
        open_source(url, settings, setup, over=shared.over, ending=(endings or {}).get(url))
        for url in urls
    ]
    threads = [
        threading.Thread(
            target=_feed, args=(url, source, _prefix(n), shared), name=url, daemon=True
        )
        for n, (url, source) in enumerate(zip(urls, sources, strict=True))
    ]
    failed: Exception | None = None
    for thread in threads:
        thread.start()
    try:
        deadline, left, written = time.monotonic() + duration_s, len(threads), 0
        while left and time.monotonic() < deadline and not over.is_set():
            try:
                item = shared.waiting.get(timeout=0.1)
            except queue.Empty:
                log.tick()
                continue
            if isinstance(item, _Ended):
                left -= 1
                failed = item.error or failed
                if item.error and left:
                    _log.warning("%s: ended (%s); the others go on", item.url, item.error)
                continue
            log.record(item.topic, item.record, host_ns=item.host_ns, clock=item.clock)
            written += 1
            yield item
            if written == records:
                break
    finally:
        shared.over.set()
        _join(threads)
    if failed:
        raise failed


def _join(threads: Sequence[threading.Thread]) -> None:
    until = time.monotonic() + _GRACE_S
    for thread in threads:
        thread.join(max(0.0, until - time.monotonic()))
        if thread.is_alive():
            _log.warning("%s: does not end, and is left behind", thread.name)


def _prefix(n: int) -> str:
    """Sources after the first stand under a name of their own, so that topics stay apart."""
    return f"/source{n + 1}" if n else ""


def _feed(url: str, source: Records, prefix: str, shared: _Sources) -> None:
    try:
        with closing(source):
            for received in source:
                shared.put(replace(received, topic=prefix + received.topic))
                if shared.over.is_set():
                    return
        shared.put(_Ended(url))
    except Exception as error:
        shared.put(_Ended(url, error))

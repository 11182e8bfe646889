"""Records from several sources at once into one log."""

import queue
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from typing import TYPE_CHECKING

from hardware.recording import Log, Received
from hardware.sources import Records, open_source

if TYPE_CHECKING:
    from hardware.drivers import SpiSettings
    from hardware.drivers.radio import FrontEnd, Schedule

#: Records that may wait for the disk; then the sources wait.
_WAITING = 64


def capture(
    urls: Sequence[str],
    log: Log,
    settings: "SpiSettings | None" = None,
    setup: "tuple[Schedule, FrontEnd] | None" = None,
    *,
    duration_s: float = float("inf"),
    records: int = 0,
) -> Iterator[Received]:
    """Write what sources send to a log, and pass it on.

    ``settings`` and ``setup`` as `open_source` takes them, for all cameras and all radios. Ends
    with the sources, after ``duration_s``, or after so many ``records`` (0: no limit). An error of
    a source is raised, after what came before it is written.
    """
    waiting: queue.Queue[Received | Exception | None] = queue.Queue(_WAITING)
    over = threading.Event()
    sources = [open_source(url, settings, setup) for url in urls]
    threads = [
        threading.Thread(target=_feed, args=(source, _prefix(n), waiting, over))
        for n, source in enumerate(sources)
    ]
    for thread in threads:
        thread.start()
    try:
        deadline, left, written = time.monotonic() + duration_s, len(threads), 0
        while left and time.monotonic() < deadline and (not records or written < records):
            try:
                item = waiting.get(timeout=0.1)
            except queue.Empty:
                log.tick()
                continue
            if isinstance(item, Exception):
                raise item
            if item is None:
                left -= 1
                continue
            log.record(item.topic, item.record, host_ns=item.host_ns, clock=item.clock)
            written += 1
            yield item
    finally:
        over.set()
        for thread in threads:
            thread.join()


def _prefix(n: int) -> str:
    """Sources after the first stand under a name of their own, so that topics stay apart."""
    return f"/source{n + 1}" if n else ""


def _feed(
    source: Records,
    prefix: str,
    waiting: "queue.Queue[Received | Exception | None]",
    over: threading.Event,
) -> None:
    def put(item: Received | Exception | None) -> None:
        while not over.is_set():
            try:
                waiting.put(item, timeout=0.1)
                return
            except queue.Full:
                continue

    try:
        with closing(source):
            for received in source:
                put(replace(received, topic=prefix + received.topic))
                if over.is_set():
                    break
        put(None)
    except Exception as error:
        put(error)

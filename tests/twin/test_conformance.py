"""Whatever gives a camera's records, gives them alike: one set of assertions, five sources.

A device is tried too where UGV_DEVICE names its URL; UGV_DEVICE_SETTINGS may name a TOML file of
settings as `ugv capture` takes it.
"""

import os
import zlib
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from itertools import islice
from unittest.mock import ANY

import numpy as np
import pytest
import serial
from asking import asking
from virtual_camera import PATIENCE, SETTINGS, direct, served

from hardware import PatternSet, SpiRecord
from hardware.drivers import SpiCamera, SpiSettings
from hardware.drivers.messages import (
    MODE_CODES,
    UPLOADED,
    Arm,
    Configure,
    Message,
    Query,
    Refusal,
    Upload,
)
from hardware.drivers.settings import read_settings
from hardware.drivers.table import table_bytes
from hardware.recording import Log
from hardware.records import Flag
from hardware.sources import open_source

SETS = 5


class Source:
    """Gives records; ``lacks`` says of each property that does not apply why it does not."""

    settings = SETTINGS
    lacks: dict[str, str] = {}

    def needs(self, *properties: str) -> None:
        for name in properties:
            if name in self.lacks:
                pytest.skip(self.lacks[name])

    def runs(self, wanted: SpiSettings, runs: int = 1) -> list[list[SpiRecord]]:
        """So many runs one after another, each without end until it is stopped."""
        raise NotImplementedError

    def uploads(self, wanted: list[SpiSettings]) -> list[int]:
        """Tables sent for each run of a line that is opened once."""
        raise NotImplementedError

    def table_crc(self, wanted: SpiSettings) -> int:
        """CRC-32 of the patterns that it shows."""
        (record, *_), *_ = self.runs(wanted)
        return zlib.crc32(table_bytes(record.patterns))


class Twin(Source):
    lacks = {
        "runs": "the twin's records have no runs: asked again, it begins again",
        "upload": "nothing is sent to the twin itself",
        "cells": "the twin's cells are those of its emitter",
        "overexposure": "the twin's converter spans the light that there is",
    }

    def __init__(self, world) -> None:
        self.world = world

    def runs(self, wanted: SpiSettings, runs: int = 1) -> list[list[SpiRecord]]:
        return [direct(self.world, wanted, SETS) for _ in range(runs)]


class Driven(Source):
    """Behind bytes: whatever a URL leads to."""

    def __init__(self, url: str) -> None:
        self.url = url

    def runs(self, wanted: SpiSettings, runs: int = 1) -> list[list[SpiRecord]]:
        found = []
        with SpiCamera(self.url, wanted, patience=PATIENCE) as camera:
            for _ in range(runs):
                records = camera.records()
                found.append(list(islice(records, SETS)))
                records.close()
            assert (
                camera.statistics.lost,
                camera.statistics.rejected,
                camera.statistics.restarts,
            ) == (0, 0, 0)
        return found

    def uploads(self, wanted: list[SpiSettings]) -> list[int]:
        sent = []
        with SpiCamera(self.url, wanted[0], patience=PATIENCE) as camera:
            for camera.settings in wanted:
                before = camera.statistics.uploads
                check(camera.acquire(), camera.settings)
                sent.append(camera.statistics.uploads - before)
        return sent

    def table_crc(self, wanted: SpiSettings) -> int:
        with SpiCamera(self.url, wanted, patience=PATIENCE) as camera:
            camera.acquire()
            return camera.status().table_crc


class BehindBytes(Driven):
    lacks = {"overexposure": Twin.lacks["overexposure"]}


class FirmwareInC(Driven):
    overexposed = replace(SETTINGS, patterns=PatternSet(32, 32, 32), gain=1)


class Device(Driven):
    lacks = {
        "same counts": "a device has noise",
        "overexposure": "whether a device saturates depends on what it looks at",
    }

    def __init__(self, url: str) -> None:
        super().__init__(url)
        if path := os.environ.get("UGV_DEVICE_SETTINGS"):
            self.settings = read_settings(path)


class Replay(Source):
    why = "a log was measured as it was: it cannot be configured"
    lacks = {
        "configuration": why,
        "cells": why,
        "overexposure": why,
        "runs": "a log has no runs: played again, it begins again",
        "upload": why,
    }

    def __init__(self, path: str) -> None:
        self.path = path

    def runs(self, wanted: SpiSettings, runs: int = 1) -> list[list[SpiRecord]]:
        url = f"replay:{self.path}?pace=fast"
        return [[found.record for found in open_source(url)] for _ in range(runs)]


@pytest.fixture(scope="module")
def log(world, tmp_path_factory: pytest.TempPathFactory):
    """Log of the twin behind bytes."""
    path = tmp_path_factory.mktemp("log") / "run.mcap"
    with served(world) as server, Log(path) as log:
        url = server.line.url
        for received in islice(open_source(url, SETTINGS), SETS):
            log.record(received.topic, received.record, clock=received.clock)
    return path


@contextmanager
def opened(kind: str, request: pytest.FixtureRequest) -> Iterator[Source]:
    match kind:
        case "twin":
            yield Twin(request.getfixturevalue("world"))
        case "pty":
            with served(request.getfixturevalue("world")) as server:
                yield BehindBytes(server.line.url)
        case "firmware":
            with request.getfixturevalue("firmware").running("--fast") as path:
                yield FirmwareInC(path)
        case "replay":
            yield Replay(request.getfixturevalue("log"))
        case "device":
            if not (url := os.environ.get("UGV_DEVICE")):
                pytest.skip("UGV_DEVICE names no device")
            yield Device(url)


@pytest.fixture(params=["twin", "pty", "firmware", "replay", "device"])
def source(request: pytest.FixtureRequest):
    with opened(request.param, request) as found:
        yield found


def check(record: SpiRecord, wanted: SpiSettings) -> None:
    """The record is one of what was asked for."""
    n = wanted.patterns.n_exposures * len(wanted.shutters)
    assert record.patterns == wanted.patterns
    assert record.counts.shape[0] == n
    assert record.counts.shape[1] % wanted.patterns.n_arms == 0
    assert (record.counts.dtype, record.sequence.dtype) == (np.int32, np.uint32)
    assert (record.device_time_ns.dtype, record.flags.dtype) == (np.int64, np.uint8)
    assert record.sequence.shape == record.device_time_ns.shape == record.flags.shape == (n,)
    assert record.integration_time_s == pytest.approx(wanted.integration_time_s, rel=0.01)
    assert 0 <= record.counts.min() <= record.counts.max() < 2**record.adc_bits
    assert record.device


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"order": "natural", "count": 7},
        {"order": "cake-cutting", "mode": "plain"},
        {"order": "zigzag", "mode": "reference", "count": 256},
        {"order": "prior-variance", "mode": "s-matrix", "count": 1},
        {"order": "interleaved", "count": 100},
    ],
    ids=["as-set-up", "few", "plain", "reference", "one", "interleaved"],
)
def test_a_record_is_what_was_asked_for(source: Source, changes: dict[str, object]) -> None:
    if changes:
        source.needs("configuration")
    wanted = source.settings
    wanted = replace(wanted, patterns=replace(wanted.patterns, **changes))
    (records,) = source.runs(wanted)
    assert len(records) == SETS
    for record in records:
        check(record, wanted)


def test_exposures_are_numbered_and_timed_without_a_gap(source: Source) -> None:
    """Over the whole run: one number after another, one pattern period after another."""
    (records,) = source.runs(source.settings)
    sequence = np.concatenate([record.sequence for record in records])
    assert np.array_equal(sequence, np.arange(len(sequence)))
    period_ns = np.diff(np.concatenate([record.device_time_ns for record in records]))
    assert period_ns.min() >= 1e9 * records[0].integration_time_s
    assert np.ptp(period_ns) <= 1  # rounded to nanoseconds
    if source.settings.pattern_period_s:
        assert period_ns.mean() == pytest.approx(1e9 * source.settings.pattern_period_s, rel=0.01)


def test_flags_tell_of_start_up_and_of_nothing_else(source: Source) -> None:
    (records,) = source.runs(source.settings)
    flags = np.concatenate([record.flags for record in records])
    assert not flags[1:].any()
    assert flags[0] in (0, Flag.RESET)


def test_what_is_too_bright_is_flagged(source: Source) -> None:
    """Exactly the exposures of which a detector stands at its limit."""
    source.needs("overexposure", "configuration")
    (records,) = source.runs(source.overexposed)
    for record in records:
        railed = (record.counts == 2**record.adc_bits - 1).any(axis=1)
        assert np.array_equal((record.flags & Flag.SATURATED) > 0, railed)
        assert 0 < railed.sum() < len(railed)


def test_after_a_stop_it_starts_again(source: Source) -> None:
    """Numbers begin anew, the clock does not; no reset is flagged."""
    source.needs("runs")
    first, second = source.runs(source.settings, runs=2)
    assert second[0].sequence[0] == 0
    assert second[0].device_time_ns[0] > first[-1].device_time_ns[-1]
    assert not any(record.flags.any() for record in second)
    for record in second:
        check(record, source.settings)


def test_the_same_settings_give_the_same(source: Source) -> None:
    """The same patterns, however often; and from a scene at rest without noise of its own, or with
    noise of a seed, the same counts.
    """
    wanted = source.settings
    expected = zlib.crc32(table_bytes(wanted.patterns))
    assert source.table_crc(wanted) == source.table_crc(wanted) == expected
    source.needs("same counts")
    first, second = source.runs(wanted, runs=2)
    for one, two in zip(first, second, strict=True):
        assert np.array_equal(one.counts, two.counts)


def test_other_settings_give_other_patterns(source: Source) -> None:
    source.needs("configuration")
    wanted = source.settings
    other = replace(wanted, patterns=replace(wanted.patterns, order="walsh", count=9))
    expected = zlib.crc32(table_bytes(other.patterns))
    assert source.table_crc(other) == expected != source.table_crc(wanted)


def test_a_table_is_sent_only_where_the_device_does_not_hold_it(source: Source) -> None:
    """Again: not. Another of the same size, and the first after it: yes. After an order by name,
    which leaves no room for it: yes.
    """
    source.needs("upload")
    here = replace(source.settings, upload=True)
    there = replace(here, patterns=replace(here.patterns, order="walsh"))
    assert here.patterns.n_exposures == there.patterns.n_exposures
    by_name = replace(here, upload=False)
    sent = source.uploads([here, here, there, there, here, by_name, here])
    assert sent[1:] == [0, 1, 0, 1, 0, 1]


def test_what_is_held_of_a_table(source: Source) -> None:
    """PROTOCOL.md, section 5, request by request: kept whole, for order 255 and the same size; the
    first portion forgets it; in part it is not kept.
    """
    source.needs("upload")
    table = table_bytes(PatternSet(16, 16, 8, "natural", "plain"))
    held, turned = (len(table), zlib.crc32(table)), table[::-1]
    plain, s_matrix = (MODE_CODES.index(mode) for mode in ("plain", "s-matrix"))
    uploaded = Configure(16, 16, 8, UPLOADED, plain, 0, 0, 80e-6, 0.0)
    with closing(serial.serial_for_url(source.url, timeout=2)) as line:
        ask = asking(line)

        def told(request: Message) -> tuple[int, int]:
            ask(request)
            status = ask(Query())
            return status.table_bytes, status.table_crc

        assert told(uploaded)[0] < len(table)
        assert told(Upload(0, table)) == held
        assert told(uploaded) == held
        assert ask(uploaded).table_crc == held[1]
        assert told(replace(uploaded, mode=s_matrix)) == held
        assert ask(Upload(1, b"x")).code == Refusal.TABLE
        assert told(Query()) == held
        assert told(Upload(0, turned[:5])) == (5, ANY)
        assert told(Upload(0, turned[:5])) == (5, ANY)
        assert told(Upload(5, turned[5:])) == (len(table), zlib.crc32(turned))
        assert ask(Arm(held[1])).code == Refusal.TABLE
        assert ask(replace(uploaded, gain=99)).code == Refusal.UNSUPPORTED
        assert told(Query()) == (len(table), zlib.crc32(turned))
        assert told(replace(uploaded, count=7)) == (0, 0)
        assert told(Upload(0, table[:5])) == (5, ANY)
        assert told(uploaded) == (0, 0)
        assert told(Upload(0, table)) == held
        assert told(replace(uploaded, order=0)) == held  # the same patterns, by their name
        assert told(uploaded) == (0, 0)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"integration_time_s": 1e-12, "pattern_period_s": 1e-4}, "integration_time_s"),
        ({"integration_time_s": 1e6, "pattern_period_s": 1e6}, "integration_time_s"),
        ({"integration_time_s": 1e-4, "pattern_period_s": 1e-5}, "pattern_period_s"),
        ({"patterns": PatternSet(2**13, 2**13, 1)}, "cells"),
    ],
    ids=["too-short", "too-long", "period", "cells"],
)
def test_the_impossible_is_refused(source: Source, changes: dict[str, object], says: str) -> None:
    """With an error that names what is wrong; then the possible is still done."""
    source.needs("configuration", *(["cells"] if says == "cells" else []))
    with pytest.raises(ValueError, match=says):
        source.runs(replace(source.settings, **changes))
    (records,) = source.runs(source.settings)
    check(records[0], source.settings)

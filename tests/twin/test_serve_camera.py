"""The virtual camera: behind the protocol's bytes the twin is the twin; its faults show or mend."""

import math
import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing, nullcontext
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rfc2217_port import behind_rfc2217
from virtual_camera import PATIENCE, QUICK, SEED, SETTINGS, direct, served

from hardware import PatternSet, own_patterns
from hardware.drivers import DeviceError, LinkError, Patience, SpiCamera, SpiSettings
from hardware.drivers.framing import Deframer, ProtocolFrame, encode
from hardware.drivers.messages import (
    Configure,
    Identify,
    Identity,
    Refusal,
    Refused,
    Start,
    Status,
    Upload,
    from_frame,
    to_frame,
)
from hardware.drivers.settings import read_settings, write_settings
from hardware.patterns import hadamard_rows
from hardware.recording import Log
from hardware.records import Flag, Shutter, SpiRecord
from hardware.sources import open_source
from twin import cli
from twin.camera.acquisition import capture
from twin.camera.stream import stills
from twin.files import InputError
from twin.serve.camera import VirtualCamera
from twin.serve.clock import DeviceClock
from twin.serve.configuration import configure_system, settings_of
from twin.serve.faults import CameraFaults, parse_faults
from twin.serve.frames import FramesAhead
from twin.serve.line import TcpPort, Terminal
from twin.system import load_system


class _TakesItsTime(FramesAhead):
    """Each frame is there 3 s after it was first asked for."""

    def __init__(self, records: Iterator[SpiRecord]) -> None:
        self._records, self._asked_s = records, math.nan

    def __next__(self) -> SpiRecord:
        self._asked_s = math.nan
        return next(self._records)

    def ready(self) -> bool:
        now_s = time.monotonic()
        self._asked_s = now_s if math.isnan(self._asked_s) else self._asked_s
        return now_s - self._asked_s > 3.0

    def close(self) -> None:
        pass


def test_a_camera_that_is_late_is_waited_for(world) -> None:
    """At the device's pace a frame of 6 ms takes 3 s, in which the camera answers that it runs and
    sends nothing: it is not started anew, and no set is lost.
    """
    with (
        served(world, pace="real", frames=_TakesItsTime) as server,
        SpiCamera(server.line.url, SETTINGS) as camera,
    ):
        records = list(camera.records(sets=2))
        statistics = camera.statistics
    assert (statistics.lost, statistics.restarts) == (0, 0)
    for record, expected in zip(records, direct(world, SETTINGS, 2), strict=True):
        np.testing.assert_array_equal(record.counts, expected.counts)


def test_a_fast_camera_whose_records_take_time_answers(world) -> None:
    """Records of 0.1 s each, which the camera makes itself: a request waits for one, not for all
    that go to the line together (1.2 s).
    """

    def slowly(records: Iterator[SpiRecord]) -> Iterator[SpiRecord]:
        for record in records:
            time.sleep(0.1)
            yield record

    with (
        served(world, pace="fast", frames=slowly) as server,
        SpiCamera(server.line.url, SETTINGS) as camera,
    ):
        waits_s = []
        for _ in zip(range(3), camera.records(), strict=False):
            asked_s = time.monotonic()
            camera.status()
            waits_s.append(time.monotonic() - asked_s)
    assert max(waits_s) < 0.5


@pytest.mark.parametrize("line", ["pty", "tcp", "rfc2217"])
def test_camera_and_twin_give_the_same_counts(world, line: str, tmp_path: Path) -> None:
    """100 sets through protocol and driver: counts bit for bit those of the twin directly; and so
    are those of the log of them, replayed. By a terminal, by TCP, and by a terminal behind TCP.
    """
    sits = TcpPort("127.0.0.1", 0) if line == "tcp" else Terminal()
    with (
        served(world, sits) as server,
        behind_rfc2217(server.line.url) if line == "rfc2217" else nullcontext(sits.url) as url,
        SpiCamera(url, SETTINGS) as camera,
    ):
        records = list(camera.records(sets=100))
        statistics = camera.statistics
    assert (statistics.lost, statistics.rejected, statistics.refused, statistics.restarts) == (
        0,
        0,
        0,
        0,
    )
    expected = direct(world, SETTINGS, 100)
    assert len(records) == 100
    for number, (got, wanted) in enumerate(zip(records, expected, strict=True)):
        assert np.array_equal(got.counts, wanted.counts)
        flags = wanted.flags.copy()
        flags[0] |= Flag.RESET if number == 0 else 0
        assert np.array_equal(got.flags, flags)
        within = got.device_time_ns - records[0].device_time_ns[0]
        assert np.array_equal(within, wanted.device_time_ns)
        assert np.array_equal(got.sequence, wanted.sequence)
        for name in ("electrons_per_count", "offset_counts", "adc_bits", "integration_time_s"):
            assert getattr(got, name) == getattr(wanted, name)
        assert got.device == wanted.device
    assert len({got.counts.tobytes() for got in records}) == 100
    with Log(tmp_path / "run.mcap") as log:
        for record in records:
            log.record("/spi/record", record)
    replayed = [r.record for r in open_source(f"replay:{tmp_path / 'run.mcap'}?pace=fast")]
    assert len(replayed) == 100
    for again, got in zip(replayed, records, strict=True):
        for name in ("counts", "flags", "device_time_ns", "sequence"):
            assert np.array_equal(getattr(again, name), getattr(got, name))


def test_its_own_setting_gives_the_record_of_a_run(world) -> None:
    """Nothing changed by the host: the first record is `capture`'s."""
    scene, system, _ = world
    shown = system.acquisition
    own = SpiSettings(system.patterns, shown.integration_time_s.value, shown.pattern_period_s.value)
    with served(world) as server, SpiCamera(server.line.url, own) as camera:
        record = camera.acquire()
    taken = capture(scene, system, seed=SEED, fidelity=QUICK).record
    assert np.array_equal(record.counts, taken.counts)


@pytest.mark.parametrize(
    ("patterns", "integration_s"),
    [
        (PatternSet(16, 16, 256, "walsh"), 40e-6),
        (PatternSet(16, 16, 10, "zigzag", "reference"), 80e-6),
        (PatternSet(16, 16, 17, "total-variation", "s-matrix"), 20e-6),
    ],
)
def test_what_the_host_asks_for(world, patterns: PatternSet, integration_s: float) -> None:
    wanted = replace(SETTINGS, patterns=patterns, integration_time_s=integration_s)
    with served(world) as server, SpiCamera(server.line.url, wanted) as camera:
        records = list(camera.records(sets=2))
    for got, expected in zip(records, direct(world, wanted, 2), strict=True):
        assert np.array_equal(got.counts, expected.counts)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"patterns": PatternSet(8, 8, 64)}, "rows, columns: the emitter has 16 x 16 cells"),
        ({"patterns": PatternSet(16, 16, 2, mode="complementary")}, "complementary"),
        ({"gain": 1}, "gain: no such step"),
        ({"integration_time_s": 1e-8}, "integration_time_s: outside"),
        ({"pattern_period_s": 81e-6}, "pattern_period_s: shorter"),
        ({"shutters": (Shutter(1e7),)}, "shutters: this camera has"),
    ],
)
def test_what_the_camera_cannot_do_is_refused(world, change, says: str) -> None:
    with (
        served(world) as server,
        SpiCamera(server.line.url, replace(SETTINGS, **change)) as camera,
        pytest.raises(DeviceError, match=says),
    ):
        camera.acquire()


@pytest.mark.parametrize("mode", ["differential", "plain", "reference"])
def test_any_table_that_is_uploaded_is_shown(world, mode: str) -> None:
    """A user's own binary patterns, and any rows of the Hadamard matrix as such."""
    own = own_patterns(np.random.default_rng(0).integers(0, 2, (24, 16, 16)), mode)
    rows = PatternSet.of(16, 16, [7, 0, 200, 9], mode)
    as_own = own_patterns(hadamard_rows(rows.indices, 256), mode, shape=(16, 16))
    for asked, shown in ((own, own), (rows, as_own)):
        wanted = replace(SETTINGS, patterns=asked)
        with served(world) as server, SpiCamera(server.line.url, wanted) as camera:
            record = camera.acquire()
        (expected,) = direct(world, replace(SETTINGS, patterns=shown), 1)
        assert np.array_equal(record.counts, expected.counts)
        assert record.patterns == asked


def test_an_uploaded_table_is_shown_and_outlives_a_restart(world) -> None:
    """Counts are those of the order by its name; PROTOCOL.md, section 5, says what is kept."""
    patterns = PatternSet(16, 16, 32, "walsh", "s-matrix")
    wanted = replace(SETTINGS, patterns=patterns, upload=True)
    with served(world) as server, SpiCamera(server.line.url, wanted) as camera:
        first, second = camera.acquire(), camera.acquire()
        uploads = camera.statistics.uploads
    (expected,) = direct(world, wanted, 1)
    for record in (first, second):
        assert np.array_equal(record.counts, expected.counts)
    assert uploads == 1


def talk(world):
    """A camera without a line: what it answers to frames."""
    scene, system, light = world
    sent = bytearray()
    clock = DeviceClock("fast")
    camera = VirtualCamera(
        system,
        scene.sun,
        lambda made: stills(scene, made, seed=SEED, fidelity=QUICK, lit=light),
        clock=clock,
        send=lambda data: sent.extend(data) is None,
    )

    def ask(frame: ProtocolFrame):
        sent.clear()
        camera.receive(encode(frame))
        (answer,) = Deframer().feed(bytes(sent))
        assert answer.tag == frame.tag
        return from_frame(answer)

    ask.camera = camera
    return ask


def test_requests_out_of_place(world) -> None:
    ask = talk(world)
    configure = Configure(16, 16, 4, 1, 0, 0, 0, 80e-6, 100e-6)
    for request, code in (
        (ProtocolFrame(0x7F, 3, b""), Refusal.UNKNOWN),
        (ProtocolFrame(0x02, 3, b"short"), Refusal.MALFORMED),
        (ProtocolFrame(0x01, 3, b"x"), Refusal.MALFORMED),
        (to_frame(Upload(0, b"x"), 3), Refusal.STATE),
        (ProtocolFrame(0x04, 3, bytes(4)), Refusal.STATE),
        (to_frame(Start(1, 1), 3), Refusal.STATE),
        (ProtocolFrame(0x81, 3, bytes(64)), Refusal.UNKNOWN),
        (ProtocolFrame(0xC1, 3, b"short"), Refusal.UNKNOWN),
        (ProtocolFrame(0xFF, 3, b"\x01\xcc"), Refusal.UNKNOWN),
    ):
        answer = ask(request)
        assert isinstance(answer, Refused)
        assert answer.code == code
    made = ask(to_frame(configure, 4))
    assert ask(ProtocolFrame(0x04, 5, bytes(4))).code == Refusal.TABLE
    for _ in range(2):
        status = ask(ProtocolFrame(0x04, 5, made.table_crc.to_bytes(4, "little")))
        assert isinstance(status, Status)
    started = ask(to_frame(Start(7, 1), 6))
    assert (started.run, started.state, started.booted) == (7, 3, 0)
    assert ask(to_frame(Start(7, 1), 6)).run == 7
    assert ask(to_frame(configure, 4)).code == Refusal.STATE


def test_bytes_from_anyone(world) -> None:
    """Whatever comes in, frames of anything among it, the camera answers the next request."""
    ask = talk(world)

    @given(data=st.binary(max_size=300), typed=st.integers(0, 255))
    @settings(max_examples=500, deadline=None)
    def send(data: bytes, typed: int) -> None:
        ask(ProtocolFrame(typed, 9, data))
        ask.camera.receive(data + b"\0")
        assert isinstance(ask(ProtocolFrame(0x07, 2, b"")), Status)

    send()


FAULTS = {
    "drop": CameraFaults(drop=0.05),
    "duplicate": CameraFaults(duplicate=0.3),
    "reorder": CameraFaults(reorder=0.1),
    "flip": CameraFaults(flip=0.05),
    "split": CameraFaults(split=0.5),
    "stall": CameraFaults(stall=0.02, stall_s=0.05),
    "overrun": CameraFaults(overrun=0.1),
    "all": CameraFaults(
        drop=0.01, duplicate=0.02, reorder=0.01, flip=0.01, split=0.1, overrun=0.02
    ),
}


@pytest.mark.parametrize("name", list(FAULTS))
def test_what_arrives_is_right_and_what_does_not_is_named(world, name: str) -> None:
    """40 sets of 4 frames on a bad line: every exposure is either the twin's or marked as lost, and
    every lost frame was told by its number.
    """
    lost: list[int] = []
    wanted = replace(SETTINGS, exposures_per_frame=16)
    with (
        served(world, faults=FAULTS[name], seed=1) as server,
        SpiCamera(server.line.url, wanted, patience=PATIENCE, on_loss=lost.extend) as camera,
    ):
        records = list(camera.records(sets=40))
        statistics = camera.statistics
    assert statistics.restarts == 0
    expected = {int(k): r for k, r in enumerate(direct(world, wanted, 40))}
    gone = set(range(160))
    for record in records:
        number = int(record.sequence[0]) // 64
        here = (record.flags & Flag.LOST) == 0
        assert np.array_equal(record.counts[here], expected[number].counts[here])
        frames = here.reshape(4, 16)
        assert (frames.all(axis=1) | ~frames.any(axis=1)).all()
        gone -= {4 * number + int(k) for k in np.flatnonzero(frames.all(axis=1))}
    assert gone == set(lost)
    assert bool(lost) == (name in ("drop", "reorder", "flip", "overrun", "all"))


def test_a_reset_begins_anew(world) -> None:
    """Counts after a reset are the run's from its start, flagged as the first of a start-up."""
    with (
        served(world, faults=CameraFaults(reset=0.05), seed=4) as server,
        SpiCamera(server.line.url, SETTINGS, patience=PATIENCE) as camera,
    ):
        records = list(islice(camera.records(), 60))
        statistics = camera.statistics
    assert statistics.restarts >= 1
    starts = [k for k, r in enumerate(records) if r.flags[0] & Flag.RESET]
    assert len(starts) >= 2
    first = direct(world, SETTINGS, 1)[0]
    for k in starts:
        here = (records[k].flags & Flag.LOST) == 0
        assert np.array_equal(records[k].counts[here], first.counts[here])


def test_a_line_that_is_cut_is_opened_again(world) -> None:
    lost: list[int] = []
    with (
        served(world, TcpPort("127.0.0.1", 0), faults=CameraFaults(hang_up=0.05), seed=1) as server,
        SpiCamera(server.line.url, SETTINGS, patience=PATIENCE, on_loss=lost.extend) as camera,
    ):
        records = list(camera.records(sets=30))
        assert camera.statistics.reconnects >= 1
    expected = direct(world, SETTINGS, 30)
    for record in records:
        here = (record.flags & Flag.LOST) == 0
        number = int(record.sequence[0]) // 64
        assert np.array_equal(record.counts[here], expected[number].counts[here])


def test_the_clock_drifts(world) -> None:
    """A clock that gains a tenth: 0.5 s of the host are 0.55 s of the device, between the times at
    which the host has asked and was answered.
    """

    def asked(camera: SpiCamera) -> tuple[int, int, int]:
        before = time.monotonic_ns()
        return before, camera.status().time_ns, time.monotonic_ns()

    with (
        served(world, pace="real", faults=CameraFaults(drift=0.1)) as server,
        SpiCamera(server.line.url, SETTINGS, patience=PATIENCE) as camera,
    ):
        early, first, begun = asked(camera)
        time.sleep(0.5)
        ended, second, late = asked(camera)
    least, most = ended - begun, late - early
    assert 1.1 * least - 1e6 <= second - first <= 1.1 * most + 1e6


def test_a_second_host_is_refused(world) -> None:
    with served(world, TcpPort("127.0.0.1", 0)) as server:
        with SpiCamera(server.line.url, SETTINGS, patience=PATIENCE) as camera:
            with pytest.raises(DeviceError, match="another host is connected"):
                SpiCamera(server.line.url, SETTINGS, patience=PATIENCE)
            assert camera.acquire().counts.shape == (64, 1)
        with SpiCamera(server.line.url, SETTINGS, patience=PATIENCE) as again:
            assert again.acquire().counts.shape == (64, 1)


@pytest.mark.parametrize("gap_s", [0.0, 0.02, 0.1])
def test_a_host_begins_with_a_clean_line(world, gap_s: float) -> None:
    """Though the one before has left half a frame, and left a moment ago."""
    ask = encode(to_frame(Identify(), 3))
    with served(world, TcpPort("127.0.0.1", 0)) as server:
        port = int(server.line.url.rpartition(":")[2])
        for _ in range(4):
            with socket.create_connection(("127.0.0.1", port), 5) as line:
                line.sendall(ask + ask[: len(ask) // 2])
                assert line.recv(4096)
            time.sleep(gap_s)
            with socket.create_connection(("127.0.0.1", port), 5) as line:
                line.sendall(ask)
                (answer,) = Deframer().feed(line.recv(4096))
                assert isinstance(from_frame(answer), Identity)
            time.sleep(0.1)


def test_while_nobody_listens_frames_are_dropped_and_counted(world) -> None:
    """In real time a run outlives its line: what nobody took is flagged as overrun."""
    with served(world, Terminal(), pace="real") as server:
        wanted = replace(SETTINGS, exposures_per_frame=64)
        with SpiCamera(server.line.url, wanted, patience=PATIENCE) as camera:
            records = camera.records()
            later = [next(records)]
            # 6.4 ms a frame of 160 bytes: the terminal's and our own 64 KiB fill in 6 s, unless the
            # machine has other work.
            for wait_s in (6.0, 12.0, 24.0):
                time.sleep(wait_s)
                later += islice(records, 600)
                if camera.status().dropped:
                    break
            assert camera.status().dropped > 0
            records.close()
    flags = np.concatenate([record.flags for record in later])
    assert (flags & Flag.OVERRUN).any()


@pytest.mark.parametrize("text", ["fire=1", "flip=2", "drift=x"])
def test_faults_that_are_none(text: str) -> None:
    with pytest.raises(InputError, match="fault"):
        parse_faults([text], CameraFaults)


def test_a_port_that_is_taken(world) -> None:
    with closing(socket.create_server(("127.0.0.1", 0))) as other:
        port = other.getsockname()[1]
        with pytest.raises(InputError, match=rf"spi: tcp:127\.0\.0\.1:{port}: "):
            TcpPort("127.0.0.1", port)


def test_a_port_lets_nobody_in_until_it_listens() -> None:
    """While another device is computed nobody would answer a host that is let in."""
    with closing(socket.create_server(("127.0.0.1", 0))) as other:
        port = other.getsockname()[1]
    with closing(TcpPort("127.0.0.1", port, at_once=False)) as port_held:
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection(("127.0.0.1", port), timeout=1)
        port_held.listen()
        socket.create_connection(("127.0.0.1", port), timeout=1).close()
    held = TcpPort("127.0.0.1", port, at_once=False)
    with (
        closing(TcpPort("127.0.0.1", port)),
        pytest.raises(InputError, match=rf"spi: tcp:127\.0\.0\.1:{port}: Address already in use"),
    ):
        held.listen()


@pytest.mark.whole
def test_the_command(tmp_path: Path) -> None:
    """The settings that it writes are those of the system, and a driver measures with them."""
    settings = tmp_path / "camera.toml"
    command = [sys.executable, "-m", "twin", "serve", "yard"]
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}
    options = ["--spi-at", "pty", "--pace", "fast", "--system", "led-16x16"]
    options += ["--spi-settings", str(settings)]
    with subprocess.Popen(
        [*command, *options], stdout=subprocess.PIPE, env=environment, text=True
    ) as process:
        line = process.stdout.readline()
        found = re.search(r"led-16x16: (/dev/\S+)", line)
        assert found, line
        shown = load_system("led-16x16")
        own = read_settings(settings)
        assert own.patterns == shown.patterns
        assert own.integration_time_s == shown.acquisition.integration_time_s.value
        assert own.pattern_period_s == shown.acquisition.pattern_period_s.value
        with SpiCamera(found[1], own, patience=PATIENCE) as camera:
            assert camera.acquire().counts.any()
        process.send_signal(signal.SIGINT)
        assert process.wait(20) == 130
    nothing = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert nothing.returncode == 2
    assert nothing.stderr == (
        "twin: error: serve: nothing to serve, expected --spi-at or --radar-at or both\n"
    )


PHASES = {"modulation_hz": [10e6, 1e7 / 3], "contrast": 0.9}
GATES = {"pulse_width_s": 7e-9, "pulse_rate_hz": 1e5, "gate_width_s": 8e-9}


@pytest.mark.parametrize("shown", [{}, PHASES, GATES | {"gate_delays_s": [1e-8, 1e-8 / 3]}])
def test_settings_of_a_system_change_nothing_of_it(tmp_path: Path, shown: dict) -> None:
    """What `--spi-settings` writes, read back and set, is the system's own measurement."""
    changes = {f"time_of_flight.{name}": value for name, value in shown.items()}
    system = load_system("led-16x16").with_(changes)
    write_settings(settings_of(system), tmp_path / "camera.toml")
    measured = configure_system(system, read_settings(tmp_path / "camera.toml"))
    assert measured.patterns == system.patterns
    for field in ("integration_time_s", "pattern_period_s", "order", "mode"):
        assert (
            getattr(measured.acquisition, field).value == getattr(system.acquisition, field).value
        )


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--spi", "pty"], "--system and --radar name the designs, --spi-at and --radar-at where"),
        (["--radar", "tcp:5555", "--design", "prototype"], "--radar-at where they are"),
        (["--spi-settings", "camera.toml", "--radar-at", "tcp:5555"], "expected --spi-at too"),
        (["--radar-setup", "radar.json", "--spi-at", "pty"], "expected --radar-at too"),
        (["--spi-at", "pty", "--spi-settings", "nowhere/c.toml"], "nowhere is no folder"),
    ],
)
def test_options_that_do_not_fit(monkeypatch, capsys, options: list[str], message: str) -> None:
    monkeypatch.setattr(sys, "argv", ["twin", "serve", "yard", *options])
    with pytest.raises(SystemExit):
        cli.main()
    assert message in capsys.readouterr().err


def test_nobody_there() -> None:
    with pytest.raises(LinkError):
        SpiCamera("socket://127.0.0.1:9", SETTINGS, patience=Patience(reconnect_s=0.1))

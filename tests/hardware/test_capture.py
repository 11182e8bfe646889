"""`ugv capture` with sources that are silent, fail or come too late, and however it is ended."""

import json
import os
import re
import resource
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zmq
from log_records import camera_record
from ugv_command import SETTINGS, started, ugv

from hardware.capture import capture
from hardware.drivers import DeviceError, Patience, SpiCamera
from hardware.drivers.messages import State
from hardware.drivers.radio import RadioError, Schedule
from hardware.drivers.radio.setup import read_setup, write_setup
from hardware.drivers.settings import read_settings
from hardware.radar import OfdmWaveform
from hardware.recording import Log, read_records
from hardware.recording.ending import Ending
from hardware.recording.kinds import Record
from hardware.records import Flag, QuaternionPose, RadarFrontEnd, RadarRecord


def burst_of_noise() -> RadarRecord:
    wave = OfdmWaveform(79e9, 16, 1e6, 256, 4e-6, 3, 0.0)
    rng = np.random.default_rng(0)
    return RadarRecord(
        iq=np.rint(rng.normal(0, 100, (1, 1, 256, 1, 16, 2))).astype(np.int16),
        device_time_ns=4000 * np.arange(256).reshape(1, 1, 256),
        flags=np.zeros((1, 1, 256), np.uint8),
        carriers_hz=np.array([79e9]),
        transmitter=np.zeros(256, np.uint8),
        waveform=wave,
        front_end=RadarFrontEnd(1e-9, 0.01),
        device="noise",
        pose=(QuaternionPose(),),
    )


SCHEDULE = Schedule(OfdmWaveform(2.5e9, 64, 312.5e3, 16, 3.6e-6, 1, 0.4e-6), (2.5e9,), 2e-3)
#: The silent radio asks for this much patience; nothing below may take a third of it.
PATIENCE_S, SOON_S = 60.0, 20.0


@contextmanager
def radio(
    burst: Callable[[dict[str, Any]], dict[str, Any] | None],
    now_ns: Callable[[], int] = time.monotonic_ns,
) -> Iterator[str]:
    """URL of a radio by RADIO.md that answers bursts as told, with the samples that it was sent
    where it is not late; None: not at all. ``now_ns``: its clock.
    """
    context, running = zmq.Context(), True
    socket = context.socket(zmq.ROUTER)
    port = socket.bind_to_random_port("tcp://127.0.0.1")
    told = {"device": "peer", "receivers": 1, "sample_rate_hz": 20e6, "patience_s": PATIENCE_S}

    def serve() -> None:
        while running:
            if not socket.poll(20):
                continue
            sender, _, text, *samples = socket.recv_multipart()
            command = json.loads(text)
            answers: dict[str, dict[str, Any] | None] = {
                "open": told,
                "tune": {"carrier_hz": command.get("carrier_hz"), "time_ns": 5},
                "time": {"time_ns": now_ns()},
                "close": {},
            }
            answer = burst(command) if command["do"] == "burst" else answers[command["do"]]
            if answer is not None:
                answer = {"number": command["number"], **answer}
                heard = samples if answer.get("faults") == [] else []
                socket.send_multipart([sender, b"", json.dumps(answer).encode(), *heard])

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield f"zmq://127.0.0.1:{port}"
    finally:
        running = False
        thread.join()
        context.destroy(linger=0)


def silent(command: dict[str, Any]) -> None:
    return None


def late(command: dict[str, Any]) -> dict[str, Any]:
    return {"start_ns": command["start_ns"], "faults": ["late"], "gaps": []}


def on_time(command: dict[str, Any]) -> dict[str, Any]:
    return late(command) | {"faults": []}


def refused(command: dict[str, Any]) -> dict[str, Any]:
    return {"error": "the antenna is off"}


@pytest.fixture
def files(tmp_path: Path) -> list[str | Path]:
    """Options that name settings of a camera and setup of a radio."""
    (tmp_path / "camera.toml").write_text(SETTINGS)
    write_setup(SCHEDULE, RadarFrontEnd(1e-9, 0.01), tmp_path / "radar.json")
    return ["--settings", tmp_path / "camera.toml", "--radar-setup", tmp_path / "radar.json"]


def wait_for(path: Path, size: int) -> None:
    """Until a log has grown, so that the command is at its work."""
    until = time.monotonic() + 30
    while not (path.exists() and path.stat().st_size > size):
        assert time.monotonic() < until
        time.sleep(0.02)


def ended(process: "subprocess.Popen[str]") -> tuple[str, str]:
    """What a command said; killed where it does not end soon."""
    try:
        return process.communicate(timeout=SOON_S)
    finally:
        process.kill()
        process.wait()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_silent_source_does_not_hold_the_end(
    number: signal.Signals, files: list[str | Path], tmp_path: Path
) -> None:
    """A radio that says nothing for as long as it likes: a signal ends the command all the same."""
    with radio(silent) as url:
        process = started("capture", url, "-o", tmp_path / "run.mcap", *files)
        wait_for(tmp_path / "run.mcap", 0)
        time.sleep(0.5)
        begun = time.monotonic()
        process.send_signal(number)
        out, err = ended(process)
    assert time.monotonic() - begun < 6
    assert "stopped" in out
    assert f"{tmp_path / 'run.mcap'}: not written, nothing came in " in out
    assert process.returncode == 2
    assert err.strip() == f"ugv: error: {url}: no record came"
    assert not (tmp_path / "run.mcap").exists()


def test_a_silent_source_does_not_outlast_the_duration(
    files: list[str | Path], tmp_path: Path
) -> None:
    with radio(silent) as url:
        begun = time.monotonic()
        process = started("capture", url, "-o", tmp_path / "run.mcap", "--duration", "1", *files)
        ended(process)
    assert time.monotonic() - begun < 12
    assert process.returncode == 2


def ignore_interrupts() -> None:
    """What a shell without job control does to a program in the background."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


@pytest.mark.parametrize("how", ["SIGTERM", "SIGHUP", "SIGINT in the background"])
def test_a_signal_finishes_the_log_and_stops_the_camera(
    how: str, firmware: Any, files: list[str | Path], tmp_path: Path
) -> None:
    run = tmp_path / "run.mcap"
    with firmware.running() as path:
        before = ignore_interrupts if "background" in how else None
        process = started("capture", path, "-o", run, *files, preexec_fn=before)
        wait_for(run, 20_000)
        process.send_signal(getattr(signal, how.split()[0]))
        out, err = ended(process)
        with SpiCamera(path, read_settings(files[1])) as camera:
            assert camera.status().state == State.ARMED
    assert process.returncode == 0, err
    ending = Ending()
    n = len(list(read_records(run, ending)))
    assert ending.fault is None
    assert f"{n} records" in out


@pytest.mark.quick(3)
@pytest.mark.parametrize("how", ["SIGINT", "SIGTERM", "SIGHUP"])
@pytest.mark.parametrize(
    ("command", "limit"),
    [("capture", "--records"), ("capture", "--duration"), ("process", "--records")],
)
def test_a_signal_before_all_has_come_is_no_success(
    how: str, command: str, limit: str, firmware: Any, files: list[str | Path], tmp_path: Path
) -> None:
    """What came is in the log, whole; the status tells a script that it is not all."""
    run = tmp_path / "run.mcap"
    given = [*files, *(["--method", "zero-fill"] if command == "process" else [])]
    with firmware.running() as path:
        process = started(command, path, "-o", run, "-q", limit, "1000000", *given)
        wait_for(run, 5_000)
        process.send_signal(getattr(signal, how))
        _, err = ended(process)
    assert process.returncode == 1, err
    of = "1000000 records" if limit == "--records" else r"1e\+06 s"
    assert re.search(rf"^warning: stopped by a signal after [\d.]+ of {of}$", err, re.MULTILINE)
    ending = Ending()
    assert list(read_records(run, ending)) or command == "process"
    assert ending.fault is None


def test_a_log_gets_its_footer_also_when_processing_is_ended(firmware: Any, tmp_path: Path) -> None:
    (tmp_path / "camera.toml").write_text(SETTINGS)
    with firmware.running() as path:
        process = started(
            "process", path, "-o", tmp_path / "images.mcap", "--method", "zero-fill",
            "--settings", tmp_path / "camera.toml",
        )  # fmt: skip
        wait_for(tmp_path / "images.mcap", 5_000)
        process.send_signal(signal.SIGTERM)
        ended(process)
    ending = Ending()
    list(read_records(tmp_path / "images.mcap", ending))
    assert (process.returncode, ending.fault) == (0, None)


@pytest.mark.parametrize("broken", [silent, refused])
def test_the_others_go_on_and_the_error_comes_at_the_end(
    broken: Callable[[dict[str, Any]], Any],
    firmware: Any,
    files: list[str | Path],
    tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
) -> None:
    """A camera beside a radio that answers no burst, or refuses each: all of its records come."""
    settings, setup = read_settings(files[1]), read_setup(files[3])
    found, begun = [], time.monotonic()
    with firmware.running() as path, radio(broken) as url, Log(tmp_path / "run.mcap") as log:
        incoming = capture([url, path], log, settings, setup, records=100)
        if broken is silent:
            found = list(incoming)
        else:
            with pytest.raises(RadioError, match="the antenna is off"):
                found.extend(incoming)
            (told,) = [r for r in caplog.messages if "the others go on" in r]
            assert told.startswith(f"{url}: ended (")
    assert time.monotonic() - begun < SOON_S
    assert len(found) == len(list(read_records(tmp_path / "run.mcap"))) == 100
    assert {received.topic for received in found} == {"/source2/spi/record"}


def test_a_camera_that_measures_nothing_is_given_up(firmware: Any, files: list[str | Path]) -> None:
    """It answers every question and sends no frame, however often it is started."""
    patience = Patience(reply_s=0.05, attempts=2, reconnect_s=1.0)
    settings = read_settings(files[1])
    with (
        firmware.running("--stall-after", "0") as path,
        SpiCamera(path, settings, patience=patience) as camera,
        pytest.raises(DeviceError, match="measures nothing, though it was started anew 2 times"),
    ):
        camera.acquire()


def test_a_radar_that_heard_nothing_is_an_error_with_advice(
    files: list[str | Path], tmp_path: Path
) -> None:
    """Every burst came too late: the records hold zeros alone."""
    with radio(late) as url:
        run = tmp_path / "run.mcap"
        process = started("capture", url, "-o", run, "--records", "3", *files)
        out, err = ended(process)
    assert process.returncode == 2
    assert "3 records" in out
    assert err.count("\n") == 1
    for part in ("0 of 3 records can be processed: every slot is overrun", "lead_s", "--pace fast"):
        assert part in err
    assert len(list(read_records(run))) == 3


def replayed(record: Record, folder: Path) -> "subprocess.CompletedProcess[str]":
    """`ugv capture -q` of a log of one record."""
    log = folder / "log.mcap"
    with Log(log) as writing:
        writing.record("/record", record, host_ns=1)
    return ugv("capture", f"replay:{log}?pace=fast", "-o", folder / "run.mcap", "-q")


def lost(record: Record, share: float) -> Record:
    """A record whose first exposures or slots were lost."""
    flags = np.zeros_like(record.flags)
    flags.reshape(-1)[: round(share * flags.size)] = Flag.LOST
    return replace(record, flags=flags)


@pytest.mark.parametrize("make", [camera_record, burst_of_noise])
def test_records_that_cannot_be_processed_are_an_error(make: Any, tmp_path: Path) -> None:
    """As the live sensor's; they are in the log all the same."""
    done = replayed(lost(make(), 1.0), tmp_path)
    assert done.returncode == 2
    assert "/record: 0 of 1 records can be processed, the first since: " in done.stderr
    assert len(list(read_records(tmp_path / "run.mcap"))) == 1


def test_a_burst_that_is_processed_in_part_is_told(tmp_path: Path) -> None:
    """Fewer slots are lost than are worth a warning, but a quarter of the burst with them."""
    record = burst_of_noise()
    record.flags[0, 0, 64] = Flag.LOST
    done = replayed(record, tmp_path)
    assert done.returncode == 0
    assert done.stderr == (
        "warning: /record: 1 of 1 records are processed in part: slots are lost\n"
    )


@pytest.mark.parametrize(
    ("record", "told"),
    [
        (replace(burst_of_noise(), iq=np.zeros_like(burst_of_noise().iq)), "IQ is all zero"),
        (
            replace(lost(camera_record(), 0.0), counts=np.zeros_like(camera_record().counts)),
            "same count in every exposure",
        ),
    ],
    ids=["radar", "camera"],
)
def test_zeros_alone_are_told(record: Record, told: str, tmp_path: Path) -> None:
    """As processing tells it: a dead input is no recording."""
    done = replayed(record, tmp_path)
    assert done.returncode == 0
    assert "/record: 1 of 1 records hold nothing, the first since: " in done.stderr
    assert told in done.stderr


@pytest.mark.parametrize("flagged", [True, False])
def test_samples_at_the_rail_are_saturated(flagged: bool, tmp_path: Path) -> None:
    """Also where the device does not say so."""
    record = burst_of_noise()
    record.iq[:] = 2**15 - 1
    record.flags[:] = Flag.SATURATED * flagged
    told = "warning: /record: 100 % of its 256 slots are saturated\n"
    assert told in replayed(record, tmp_path).stderr


def test_processing_a_log_that_was_cut_says_how_to_finish_it(
    firmware: Any, files: list[str | Path], tmp_path: Path
) -> None:
    run = tmp_path / "run.mcap"
    with firmware.running() as path, Log(run) as log:
        list(capture([path], log, read_settings(files[1]), records=3))
    run.write_bytes(run.read_bytes()[:-50])
    process = started("process", run, "-o", tmp_path / "images.mcap", "--method", "zero-fill")
    out, err = ended(process)
    assert process.returncode == 0
    assert len(re.findall(r"/spi/record, record \d, \d+\.\d{3} s: image", out)) == 3
    assert err.count(f"`ugv recover {run}` finishes it") == 1


def test_slots_that_were_lost_are_warned_of(files: list[str | Path], tmp_path: Path) -> None:
    """All bursts but the first are late: no error, but no silence either."""
    bursts = iter(range(1000))

    def later(command: dict[str, Any]) -> dict[str, Any]:
        return late(command) if next(bursts) else on_time(command)

    with radio(later) as url:
        process = started("capture", url, "-o", tmp_path / "run.mcap", "--records", "3", *files)
        _, err = ended(process)
    assert process.returncode == 0, err
    assert re.search(r"warning: /radar/record: 66\.7 % of its 48 slots are overrun", err)


def test_a_place_on_the_rig_that_is_none_is_told_by_its_file(
    files: list[str | Path], tmp_path: Path
) -> None:
    (rig := tmp_path / "rig.toml").write_text("spi = [0, 0, [], 1, 0, 0, 0]\n")
    done = ugv("capture", "spi:///dev/null", *files, "--rig", rig, "-o", tmp_path / "x.mcap")
    assert done.returncode == 2
    assert f"{rig}: spi: [0, 0, [], 1, 0, 0, 0], expected 7 finite numbers" in done.stderr


def test_a_duration_of_nothing_is_refused(files: list[str | Path], tmp_path: Path) -> None:
    process = started(
        "capture", "zmq://x:1", "-o", tmp_path / "run.mcap", "--duration", "0", *files
    )
    _, err = ended(process)
    assert process.returncode == 2
    assert "--duration: 0 s, expected more than 0 s" in err


def test_a_log_that_is_cut_short_while_it_is_written_is_an_error(
    firmware: Any, files: list[str | Path], tmp_path: Path
) -> None:
    run = tmp_path / "run.mcap"
    with firmware.running() as path:
        process = started("capture", path, "-o", run, *files)
        wait_for(run, 3000)
        os.truncate(run, 0)
        _, err = ended(process)
    assert process.returncode == 2
    assert "was cut short while it was written" in err


def test_records_that_a_full_disk_took_are_not_counted_as_written(
    firmware: Any, files: list[str | Path], tmp_path: Path
) -> None:
    """Where files may not grow beyond 60 kB: no more are stated than can be read, and how many may
    be lost. What was being written when the disk was full may be whole or not.
    """
    run = tmp_path / "run.mcap"

    def small_files() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, 60_000))

    with firmware.running() as path:
        process = started("capture", path, "-o", run, *files, preexec_fn=small_files)
        out, err = ended(process)
    assert process.returncode == 2
    assert "run.mcap: File too large" in err
    n = len(list(read_records(run, Ending())))
    stated = re.search(r"run.mcap: (\d+) records in .*; (\d+) more had come and may not", out)
    assert stated is not None, out
    in_writing = 1
    assert 0 < int(stated[1]) <= n <= int(stated[1]) + int(stated[2]) + in_writing


def test_a_radio_whose_clock_was_set_back_ends_with_the_cause(
    files: list[str | Path], tmp_path: Path
) -> None:
    """A burst that waits for a time of before: no answer, and a clock that tells why."""
    bursts, set_back = iter(range(1000)), threading.Event()

    def restarted(command: dict[str, Any]) -> dict[str, Any] | None:
        if next(bursts) < 2:
            return on_time(command)
        set_back.set()
        return {"error": "no such time"}

    now_ns = lambda: 7 if set_back.is_set() else time.monotonic_ns()  # noqa: E731
    with radio(restarted, now_ns) as url:
        process = started("capture", url, "-o", tmp_path / "run.mcap", *files)
        _, err = ended(process)
    assert process.returncode == 2
    assert re.search(r"zmq://\S+: its clock jumped by -\d", err)
    assert err.rstrip().endswith("no such time")

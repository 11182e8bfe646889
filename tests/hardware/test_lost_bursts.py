"""Commands go on behind a burst that a loss of data leaves nothing of, and tell of it."""

import json
import subprocess
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from radar_cubes import CARRIERS, HALF, STEP, WIDE, Echo, cube
from ugv_command import ugv

from hardware.recording import Log
from hardware.recording.kinds import kind_of
from hardware.records import Flag, RadarRecord, write_radar_record


def _record(n_bursts: int = 1, rate_m_per_s: float = 2.0) -> RadarRecord:
    """A point at 9 m."""
    pose = np.tile([0, 0, 0, 1, 0, 0, 0.0], (n_bursts, 1))
    point = Echo((9.0, 0, 0), 1e-9, (rate_m_per_s, 0, 0))
    return cube(WIDE, [point], noise_w=1e-14, pose=pose)


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """Of three records the second has no two slots one after another, by the clock alone."""
    path, record = tmp_path / "drive.mcap", _record()
    with Log(path) as log:
        for number in range(3):
            times = record.device_time_ns + number * 10**8
            if number == 1:
                times = times + 50_000 * np.arange(WIDE.n_slots)
            log.record(
                "/radar/record", replace(record, device_time_ns=times), host_ns=number * 10**8
            )
    return path


def test_process_goes_on_behind_it(log: Path) -> None:
    done = ugv("process", log, "--json")
    assert not done.returncode, done.stderr
    assert json.loads(done.stdout)["records"] == 2
    assert "/radar/record, record 2: not processed: burst 0, step 0, slot 1: after" in done.stderr
    assert "/radar/record, record 3, 0.200 s: burst 0: 1 detections" in done.stderr
    assert [each["record"] for each in json.loads(done.stdout)["results"]] == [1, 3]


def test_spectrogram_goes_on_behind_it(log: Path) -> None:
    done = ugv("spectrogram", log, "--at", "9 m", "--json")
    assert not done.returncode, done.stderr
    table = np.genfromtxt(log.with_name("drive-spectrogram.csv"), delimiter=",")
    np.testing.assert_allclose(table[0, 1:], [0.0, 0.2], atol=1e-6)
    told = f"{log}: left out: burst 1, step 0, slot 1: after a gap; too little is left"
    assert done.stderr.count(told) == 1


def test_calibrate_goes_on_behind_it(log: Path, tmp_path: Path) -> None:
    of_target = ("--distance", "9 m", "--cross-section", "1 m^2")
    done = ugv("calibrate", "radar", log, "-o", tmp_path / "radar.h5", *of_target)
    assert not done.returncode, done.stderr
    told = f"{log}: record 2: left out: burst 0, step 0, slot 1: after a gap"
    assert told in done.stderr
    assert "two-way gain" in done.stdout


def test_calibrate_numbers_records_as_the_log_does(tmp_path: Path) -> None:
    """Those behind one of which nothing is left had the numbers of those that are left."""
    path = tmp_path / "drive.mcap"
    with Log(path) as log:
        for number, first_lost in enumerate((WIDE.n_slots, 0, WIDE.n_slots, 20)):
            record = _record()
            record.flags[0, 0, first_lost:] = Flag.LOST
            log.record("/radar/record", record, host_ns=number * 10**8)
    of_target = ("--distance", "9 m", "--cross-section", "1 m^2")
    done = ugv("calibrate", "radar", path, "-o", tmp_path / "radar.h5", *of_target)
    assert not done.returncode, done.stderr
    assert f"{path}: record 2: left out: burst 0, step 0, slot 0: flagged" in done.stderr
    assert f"{path}: record 4: burst 0, step 0, slot 20: flagged as lost" in done.stderr


_SPECTROGRAM = ("spectrogram", "--at", "9 m")
_CALIBRATE = ("calibrate", "radar", "--distance", "9 m", "--cross-section", "1 m^2")


def _log_with_lost_slots(path: Path, lost: Sequence[Sequence[int]], rate: float = 2.0) -> None:
    """A record for each list of lost slots, of one burst."""
    with Log(path) as log:
        for number, slots in enumerate(lost):
            record = _record(rate_m_per_s=rate)
            record.flags[0, 0, slots], record.iq[0, 0, slots] = Flag.LOST, 0
            times = record.device_time_ns + number * 10**8
            log.record("/radar/record", replace(record, device_time_ns=times), host_ns=number)


@pytest.mark.parametrize("lost", [[[20]], [[20], [9, 40], [63]]])
def test_calibrate_takes_what_is_left_of_bursts(lost: list[list[int]], tmp_path: Path) -> None:
    """As from whole bursts, within 4 standard errors, and each loss is told; bursts that lost a
    slot were left out, and without a whole one there was no calibration.
    """
    made = []
    for name, slots in (("whole", [[]] * len(lost)), ("cut", lost)):
        path = tmp_path / f"{name}.mcap"
        _log_with_lost_slots(path, slots, rate=0.0)
        done = ugv(*_CALIBRATE, path, "--out", tmp_path / "radar.h5", "--json")
        assert not done.returncode, done.stderr
        made.append(json.loads(done.stdout))
    for quantity in ("range_offset", "two_way_gain"):
        unit = "m" if quantity == "range_offset" else "db"
        (whole, _), (cut, error) = (
            [one[f"{quantity}_{unit}"], one[f"{quantity}_error_{unit}"]] for one in made
        )
        assert abs(cut - whole) < 4 * error
    assert not made[0]["warnings"]
    for record, slots in enumerate(lost, 1):
        name = f"record {record}: " * (record > 1)
        told = f"{name}burst 0, step 0, slot {slots[0]}: flagged as lost ({len(slots)} of 64 slots"
        assert any(told in warning for warning in made[1]["warnings"])


def test_calibrate_without_an_echo_tells_what_is_lost(tmp_path: Path) -> None:
    path = tmp_path / "drive.mcap"
    _log_with_lost_slots(path, [[20]])
    there = (*_CALIBRATE[:3], "15 m", *_CALIBRATE[4:])
    done = ugv(*there, path, "--out", tmp_path / "radar.h5")
    assert done.returncode == 2
    assert (
        "none within 1 m of the target at 15 m; burst 0, step 0, slot 20: flagged as lost (1 of "
        "64 slots lost); processed are slots 21 to 63 of step 0" in done.stderr
    )


def test_a_spectrogram_takes_what_is_left_of_bursts(tmp_path: Path) -> None:
    """At the rates of whole bursts, and the time of the middle of what is left: 43 slots behind the
    lost one end a burst as 64 do, so that it is 21 / 2 slots later.
    """
    path = tmp_path / "drive.mcap"
    _log_with_lost_slots(path, [[20], [], [20]])
    done = ugv(*_SPECTROGRAM, path)
    assert not done.returncode, done.stderr
    table = np.genfromtxt(path.with_name("drive-spectrogram.csv"), delimiter=",")
    later_s = 10.5 * WIDE.slot_period_s
    np.testing.assert_allclose(table[0, 1:], [0.0, 0.1 - later_s, 0.2], atol=1e-6)
    assert len(table) == 1 + 4 * WIDE.n_slots
    strongest = table[1:, 0][table[1:, 1:].argmax(axis=0)]
    np.testing.assert_allclose(strongest, 2.0, atol=WIDE.velocity_cell_m_per_s / 4)
    for burst in (0, 2):
        told = f"{path}: burst {burst}, step 0, slot 20: flagged as lost (1 of 64 slots lost)"
        assert done.stderr.count(told) == 1


def test_a_spectrogram_numbers_bursts_as_the_user_does(tmp_path: Path) -> None:
    """Warnings had the number within the record, 0, and ``--burst`` counts through the log."""
    path = tmp_path / "drive.mcap"
    _log_with_lost_slots(path, [[], [], [20]])
    done = ugv(*_SPECTROGRAM, path, "--burst", 2)
    assert not done.returncode, done.stderr
    told = [line for line in done.stderr.splitlines() if line.startswith("warning: ")]
    assert told
    assert all(line.startswith(f"warning: {path}: burst 2") for line in told)


def test_a_spectrogram_leaves_out_a_part_of_the_band(tmp_path: Path) -> None:
    """Of carrier steps behind a loss; by itself the burst is shown."""
    record = cube(STEP, [Echo((4.0, 0, 0))], carriers_hz=CARRIERS, leakage=(1e-7, 1.1e-9))
    cut = replace(record, flags=record.flags.copy(), device_time_ns=record.device_time_ns + 10**9)
    cut.flags[0, 20, 3] = Flag.LOST
    path = tmp_path / "drive.mcap"
    with Log(path) as log:
        for number, one in enumerate((record, cut)):
            log.record("/radar/record", one, host_ns=number)
    over_all, alone = (ugv("spectrogram", path, "--at", "4 m", *of) for of in ((), ("--burst", 1)))
    assert (over_all.returncode, alone.returncode) == (0, 0)
    told = f"warning: {path}: left out: burst 1, step 20, slot 3: flagged as lost (1 of 400 slots"
    assert told in over_all.stderr
    assert "1 bursts in" in over_all.stdout
    assert "left out" not in alone.stderr


def _log_with_a_broken_message(path: Path) -> None:
    """Of three records the second ends too early, in a whole chunk."""
    kind = kind_of(_record())
    with Log(path) as log:
        for number in range(3):
            record = _record()
            times = record.device_time_ns + number * 10**8
            record = replace(record, device_time_ns=times)
            if number == 1:
                cut = kind.pack(record, 1, "radar", None)[:-100]
                log.message("/radar/record", kind.definition, cut, 1, 1)
            else:
                log.record("/radar/record", record, host_ns=number)


_SIGMF = pytest.param(("export",), marks=pytest.mark.library("sigmf"))


@pytest.mark.parametrize(
    "command", [_SPECTROGRAM, _CALIBRATE, ("process",), ("replay",), ("info",), _SIGMF]
)
def test_a_message_that_cannot_be_read_is_left_out(
    command: tuple[str, ...], tmp_path: Path
) -> None:
    """Counted, named and told as other lost data; it ended each of them."""
    path = tmp_path / "drive.mcap"
    _log_with_a_broken_message(path)
    out = () if command[0] in ("replay", "info") else ("--out", tmp_path / "result")
    done = ugv(*command, path, *out, "--json")
    assert done.returncode == 1, done.stderr
    told = (
        "damaged: /radar/record, record 2: message: ends after",
        "too early; left out: 1 unreadable record (/radar/record, record 2)\n",
    )
    assert all(text in done.stderr for text in told)
    assert "ugv recover" not in done.stderr
    document = json.loads(done.stdout)
    assert any("1 unreadable record" in text for text in document["warnings"])
    if command == ("process",):
        assert [each["record"] for each in document["results"]] == [1, 3]
    if command == ("replay",):
        assert len(document["records"]) == 2


def test_recover_copies_a_message_that_cannot_be_read_and_says_so(tmp_path: Path) -> None:
    """Status 0 and no word: each command of the recovered log then told it."""
    path = tmp_path / "drive.mcap"
    _log_with_a_broken_message(path)
    before = path.read_bytes()
    done = ugv("recover", path)
    assert done.returncode == 1
    told = f"warning: {path}: copied as they are: 1 unreadable record (/radar/record, record 2)\n"
    assert told in done.stderr
    assert path.read_bytes() == before
    assert [one.name for one in tmp_path.iterdir()] == [path.name]


def test_a_log_of_which_nothing_can_be_read_is_an_error(tmp_path: Path) -> None:
    path, kind = tmp_path / "drive.mcap", kind_of(_record())
    with Log(path) as log:
        for number in range(12):
            log.message("/radar/record", kind.definition, b"\0\1\0\0", number, number)
    done = ugv("process", path)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "no record in it (/radar/record, record 1: message: ends after 0 bytes" in done.stderr
    came = ugv("capture", f"replay:{path}", "--out", tmp_path / "again.mcap")
    assert came.returncode == 2
    assert "no record came (/radar/record, record 1: message: ends after 0 bytes" in came.stderr
    told = ugv("info", path).stderr
    assert "left out: 12 unreadable records (/radar/record, record 1; " in told
    assert "record 10; ...)" in told


@pytest.mark.parametrize("command", [_SPECTROGRAM, _CALIBRATE, ("process",)])
def test_a_damaged_log_is_told_alike(command: tuple[str, ...], tmp_path: Path) -> None:
    """Two of three said nothing of it in the document and by the exit status."""
    path = tmp_path / "drive.mcap"
    with Log(path) as log:
        for number in range(4):
            record = _record()
            times = record.device_time_ns + number * 10**8
            log.record("/radar/record", replace(record, device_time_ns=times), host_ns=number)
            log.flush()
    content = bytearray(path.read_bytes())
    content[len(content) // 2 : len(content) // 2 + 50] = bytes(50)
    path.write_bytes(content)
    done = ugv(*command, path, "--out", tmp_path / "result", "--json")
    assert done.returncode == 1, done.stderr
    told = f"{path}: damaged: "
    assert any(text.startswith(told) for text in json.loads(done.stdout)["warnings"])
    assert f"warning: {told}" in done.stderr


def _written(record: RadarRecord, folder: Path) -> tuple[Path, Path]:
    """A record in a file of its own, and burst by burst in a log."""
    file, path = folder / "r.h5", folder / "drive.mcap"
    write_radar_record(record, file)
    with Log(path) as log:
        for burst in range(len(record.iq)):
            one = slice(burst, burst + 1)
            log.record(
                "/radar/record",
                replace(
                    record,
                    iq=record.iq[one],
                    flags=record.flags[one],
                    device_time_ns=record.device_time_ns[one],
                    pose=record.pose[one],
                ),
                host_ns=burst * 10**8,
            )
    return file, path


def _ran(
    command: tuple[str, ...], record: RadarRecord, folder: Path
) -> tuple[Path, subprocess.CompletedProcess[str]]:
    """A command on a record, as a file or as a log of its bursts; and which that was."""
    file, log = _written(record, folder)
    source = file if command[0] in ("detect", "image") else log
    return source, ugv(*command, source, "--out", folder / "result")


@pytest.mark.parametrize("command", [("detect",), ("image",), ("process",), _SPECTROGRAM])
def test_a_record_of_zeros_alone_is_refused(command: tuple[str, ...], tmp_path: Path) -> None:
    """It ended with 0 detections, or a peak of -inf dBm, as if it were a scene without echoes."""
    record = _record(2)
    source, done = _ran(command, replace(record, iq=np.zeros_like(record.iq)), tmp_path)
    assert done.returncode == 2
    assert f"ugv: error: {source}: " in done.stderr
    assert "all zero" in done.stderr
    assert not (tmp_path / "result").exists()


@pytest.mark.quick(2)
@pytest.mark.parametrize("command", [("detect",), ("image",), ("process",), _SPECTROGRAM])
def test_a_burst_of_zeros_is_left_out(command: tuple[str, ...], tmp_path: Path) -> None:
    record = _record(3)
    record.iq[1] = 0
    _, done = _ran(command, record, tmp_path)
    assert not done.returncode, done.stderr
    assert "IQ is all zero" in done.stderr
    assert "left out" in done.stderr or "not processed" in done.stderr
    assert "-inf" not in done.stdout


@pytest.mark.quick(2)
@pytest.mark.parametrize(
    "command", [("detect",), ("image",), ("process",), _SPECTROGRAM, _CALIBRATE]
)
def test_a_burst_with_a_dead_receiver_is_left_out(command: tuple[str, ...], tmp_path: Path) -> None:
    """All but the image ended with it."""
    pair_m = np.array([[0, 0, 0], [0, HALF, 0]])
    pose = np.tile([0, 0, 0, 1, 0, 0, 0.0], (3, 1))
    record = cube(WIDE, [Echo((9.0, 0, 0), 1.0)], noise_w=1.0, receivers_m=pair_m, pose=pose)
    record.iq[1, :, :, 1] = 0
    _, done = _ran(command, record, tmp_path)
    assert not done.returncode, done.stderr
    assert "receiver 1: all samples are 0, while others have signals of" in done.stderr
    assert "left out" in done.stderr or "not processed" in done.stderr


def test_a_spectrogram_of_a_burst_of_zeros_is_refused(tmp_path: Path) -> None:
    record = _record(2)
    record.iq[1] = 0
    file, log = _written(record, tmp_path)
    for source in (file, log):
        done = ugv(*_SPECTROGRAM, source, "--burst", 1)
        assert done.stderr == f"ugv: error: {source}: burst 1: IQ is all zero\n"


@pytest.mark.parametrize(
    ("command", "told"),
    [
        (("detect",), "burst 0, step 0, slot 0: flagged as lost"),
        (("image",), "burst 0, step 0, slot 0: flagged as lost"),
        (_SPECTROGRAM, "no burst of a radar in it that can be used"),
        (_CALIBRATE, "no burst of a radar in it that can be used"),
    ],
)
def test_errors_name_the_file_once(command: tuple[str, ...], told: str, tmp_path: Path) -> None:
    """Of a record of which everything is lost; that of a log was `spectrogram: no interval`."""
    record = _record(2)
    record.flags[:] = Flag.LOST
    source, done = _ran(command, record, tmp_path)
    assert f"\nugv: error: {source}: {told}" in f"\n{done.stderr}"


def test_a_fault_of_reading_names_the_file_once(tmp_path: Path) -> None:
    """`calibrate` put its name before the one that was there."""
    path = tmp_path / "drive.mcap"
    path.write_bytes(b"no log")
    done = ugv(*_CALIBRATE, path, "--out", tmp_path / "result")
    assert done.returncode == 2
    assert done.stderr.count(str(path)) == 1


def test_detect_refuses_a_record_without_a_burst(tmp_path: Path) -> None:
    """It wrote a table without a row."""
    record, none = _record(), slice(0, 0)
    empty = {name: getattr(record, name)[none] for name in ("iq", "flags", "device_time_ns")}
    write_radar_record(replace(record, pose=record.pose[none], **empty), tmp_path / "r.h5")
    done = ugv("detect", tmp_path / "r.h5")
    assert done.stderr == f"ugv: error: {tmp_path / 'r.h5'}: iq: no burst in the record\n"


@pytest.fixture
def without_first(tmp_path: Path) -> Path:
    """Of three bursts nothing is left of the first."""
    record = _record(3)
    record.flags[0] = Flag.LOST
    write_radar_record(record, tmp_path / "r.h5")
    return tmp_path / "r.h5"


def test_detect_goes_on_behind_it(without_first: Path) -> None:
    done = ugv("detect", without_first)
    assert not done.returncode, done.stderr
    assert [f"burst {k}: 1 detections" in done.stdout for k in range(3)] == [False, True, True]
    assert "1 of 3 bursts left out (0), the first since: burst 0, step 0" in done.stderr


@pytest.fixture
def cut_to_two() -> RadarRecord:
    """Of three bursts the second is cut to two slots, on which a window that ends with 0 is 0."""
    record = _record(3)
    record.flags[1, :, 2:] = Flag.LOST
    return record


_NO_WEIGHT = (
    "burst {}, step 0, slot 2: flagged as lost (62 of 64 slots lost); the window '{}' has no "
    "weight on 2 slots"
)


@pytest.mark.parametrize("window", ["hann", "bartlett", "blackman"])
def test_detect_leaves_out_what_a_window_has_no_weight_on(
    window: str, cut_to_two: RadarRecord, tmp_path: Path
) -> None:
    write_radar_record(cut_to_two, tmp_path / "r.h5")
    done = ugv("detect", tmp_path / "r.h5", "--window", window)
    assert not done.returncode, done.stderr
    assert [f"r.h5: burst {k}: " in done.stdout for k in range(3)] == [True, False, True]
    assert _NO_WEIGHT.format(1, window) in done.stderr
    assert "RuntimeWarning" not in done.stderr


def test_process_leaves_out_what_a_window_has_no_weight_on(
    cut_to_two: RadarRecord, tmp_path: Path
) -> None:
    """A burst of a record, or the one burst of another."""
    of_one = _record()
    of_one.flags[0, :, 2:] = Flag.LOST
    with Log(tmp_path / "drive.mcap") as log:
        log.record("/radar/record", cut_to_two, host_ns=0)
        log.record("/radar/record", of_one, host_ns=10**8)
    done = ugv("process", tmp_path / "drive.mcap", "--window", "hann")
    assert not done.returncode, done.stderr
    assert [f"burst {k}: 1 detections" in done.stdout for k in range(3)] == [True, False, True]
    for burst in (1, 0):
        assert _NO_WEIGHT.format(burst, "hann") in done.stderr
    assert "RuntimeWarning" not in done.stderr


@pytest.mark.library("PIL")
def test_the_picture_is_of_the_first_burst_of_which_there_is_one(without_first: Path) -> None:
    done = ugv("detect", without_first, "--png", without_first.with_name("map.png"))
    assert not done.returncode, done.stderr
    assert without_first.with_name("map.png").exists()

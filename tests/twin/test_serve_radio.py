"""The virtual radio: behind a radio's bytes the twin is the twin, to the bit; its faults show."""

import os
import signal
import struct
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import psutil
import pytest
import zmq
from items_to_make import dies, reciprocal, with_process
from ugv_command import ugv
from virtual_radio import QUICK, SEED, direct, served, small, virtual

import twin.serve.sweeps
from hardware.drivers.radio import Fault, RadioError, acquire, open_radio, samples
from hardware.drivers.radio.setup import read_setup, write_setup
from hardware.drivers.radio.stream import StreamRadio
from hardware.drivers.radio.zeromq import ZeroMqRadio
from hardware.radar import channel
from hardware.recording import Log, read_records
from hardware.records import Flag
from hardware.sources import open_source
from twin import cli
from twin.engine import EngineError
from twin.fidelity import Fidelity
from twin.files import InputError
from twin.radar import load_radar, radar_capture, radar_echo
from twin.radar.device.design import RadarDesign
from twin.scene import load_scene
from twin.serve.clock import DeviceClock
from twin.serve.faults import RadioFaults
from twin.serve.prefetcher import Prefetcher
from twin.serve.radio import VirtualRadio
from twin.serve.sweeps import RadarSweeps


@pytest.fixture(scope="module")
def scene():
    return load_scene("yard")


def _setup(scene, design):
    radio = virtual(scene, design)
    return radio.schedule, radio.front_end


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("design", "sweeps"),
    [
        (load_radar("prototype"), 25),
        (small(), 20),
        (small(repeats=3, slot_period_s=12e-6), 10),
    ],
    ids=["prototype", "one-step", "repeats"],
)
def test_radio_and_twin_give_the_same_counts(
    scene, design: RadarDesign, sweeps: int, tmp_path: Path
) -> None:
    """Sweeps through schedule, driver and ZeroMQ, 625 bursts of the prototype's: IQ bit for bit
    that of the twin directly; and so is that of their log, replayed.
    """
    radio = virtual(scene, design)
    with served(radio) as port, open_radio(f"zmq://127.0.0.1:{port}") as driver:
        record = acquire(driver, radio.schedule, radio.front_end, bursts=sweeps)
    assert record.iq.any()
    for sweep in range(sweeps):
        expected = direct(scene, design, sweep)
        assert np.array_equal(record.iq[sweep], expected.iq[0])
        assert np.array_equal(record.flags[sweep], expected.flags[0])
        within = record.device_time_ns[sweep] - record.device_time_ns[sweep, 0, 0]
        assert np.array_equal(within, expected.device_time_ns[0])
    assert np.array_equal(record.carriers_hz, expected.carriers_hz)
    for name in ("root_watt_per_count", "transmit_power_w", "antenna_gain_dbi", "losses_db"):
        assert getattr(record.front_end, name) == getattr(expected.front_end, name)
    assert len(np.unique(record.iq.reshape(sweeps, -1), axis=0)) == sweeps
    with Log(tmp_path / "run.mcap") as log:
        log.record("/radar/record", record)
    (again,) = (r.record for r in open_source(f"replay:{tmp_path / 'run.mcap'}?pace=fast"))
    for name in ("iq", "flags", "device_time_ns"):
        assert np.array_equal(getattr(again, name), getattr(record, name))


def test_what_is_really_sent_is_what_comes_back(scene) -> None:
    """Half the level: a quarter of the echo. Other symbols: the same channel, once demodulated.
    Silence: noise alone.
    """
    design = small()
    wave = design.ofdm
    loud = replace(wave, symbols="flat")
    quiet = replace(QUICK, noise="none")

    def heard(level: float, waveform=wave):
        """Of the first sweep, so that nothing has moved."""
        radio = VirtualRadio(
            design, RadarSweeps(scene, design, SEED, quiet), clock=DeviceClock("fast")
        )
        schedule = replace(radio.schedule, waveform=waveform)
        return channel(acquire(radio, replace(schedule, level=level), radio.front_end))

    full = heard(0.5)
    radio = virtual(scene, design)
    rounding = radio.front_end.root_watt_per_count
    assert np.abs(full).max() > 100 * rounding
    assert np.abs(full - 2 * heard(0.25)).max() < 10 * rounding
    assert np.abs(full - 4 * heard(0.125, loud)).max() < 20 * rounding
    radio.tune(wave.carrier_hz)
    silent = radio.burst(np.zeros(radio.n_samples, dtype=np.complex64), 0)
    noise = silent.samples.reshape(16, 72)[:, 8:] * 32767
    # 8 counts rms in all: 4 sigma of the mean power of 1024 samples are 12.5 %.
    assert np.mean(np.abs(noise) ** 2) == pytest.approx(64, rel=0.125)


def test_a_plain_reader_and_writer(scene) -> None:
    """Nobody at the commands: whoever answers for samples and asks for samples has a plain virtual
    radio, as GNU Radio's and srsRAN's are. The bytes are those of the twin directly.
    """
    design = small()
    radio = virtual(scene, design)
    sent = samples.burst(design.ofdm, radio.level).tobytes()
    context = zmq.Context()
    transmit, receive = context.socket(zmq.REP), context.socket(zmq.REQ)
    with served(radio) as port:
        transmit.connect(f"tcp://127.0.0.1:{port + 2}")
        receive.connect(f"tcp://127.0.0.1:{port + 1}")
        receive.send(b"\xff")
        heard = b""
        while len(heard) < 2 * len(sent):
            if transmit.poll(10):
                (asked,) = struct.unpack("<i", transmit.recv())
                transmit.send(sent[: 8 * asked])
            if receive.poll(10):
                heard += receive.recv()
                receive.send(struct.pack("<i", 700))
        context.destroy(linger=0)
    for sweep in range(2):
        expected = direct(scene, design, sweep)
        burst = np.frombuffer(heard, "<c8")[sweep * radio.n_samples :][: radio.n_samples]
        symbols = burst.reshape(16, 72)[:, 8:] * 32767
        counts = np.stack([symbols.real, symbols.imag], axis=-1)
        assert np.array_equal(np.rint(counts), expected.iq[0, 0, :, 0])
        assert np.array_equal(burst.reshape(16, 72)[:, :8], burst.reshape(16, 72)[:, -8:])


def test_our_own_plain_driver(scene) -> None:
    design = small()
    radio = virtual(scene, design)
    with (
        served(radio) as port,
        StreamRadio(
            f"tcp://127.0.0.1:{port + 2}",
            f"tcp://127.0.0.1:{port + 1}",
            listen=False,
            carrier_hz=design.ofdm.carrier_hz,
            sample_rate_hz=radio.sample_rate_hz,
        ) as driver,
    ):
        record = acquire(driver, radio.schedule, radio.front_end, bursts=3)
    for sweep in range(3):
        expected = direct(scene, design, sweep)
        assert np.array_equal(record.iq[sweep], expected.iq[0])


def test_what_a_client_hears_can_be_watched(scene) -> None:
    radio = virtual(scene, small())
    context = zmq.Context()
    with served(radio) as port, ZeroMqRadio("127.0.0.1", port) as driver:
        driver.tune(radio.carriers_hz[0])
        heard = driver.burst(samples.burst(radio.waveform, radio.level), driver.now_ns())
        watch = context.socket(zmq.REQ)
        watch.connect(f"tcp://127.0.0.1:{port + 1}")
        watch.send(b"\xff")
        assert watch.recv() == heard.samples.tobytes()
        context.destroy(linger=0)


def test_a_second_client_is_refused_until_the_first_has_gone(scene) -> None:
    with served(virtual(scene, small())) as port:
        with (
            ZeroMqRadio("127.0.0.1", port),
            pytest.raises(RadioError, match="busy: another client has the radio"),
        ):
            ZeroMqRadio("127.0.0.1", port)
        with ZeroMqRadio("127.0.0.1", port) as again:
            assert again.now_ns() == 0


@pytest.mark.quick(1)
@pytest.mark.parametrize(
    ("name", "fault"),
    [
        ("overflow", Fault.OVERFLOW),
        ("out_of_sequence", Fault.OUT_OF_SEQUENCE),
        ("late", Fault.LATE),
        ("underflow", Fault.UNDERFLOW),
    ],
)
def test_faults_stand_in_the_record_and_nowhere_else(scene, name: str, fault: Fault) -> None:
    """Half of 40 bursts go wrong. What is not flagged is to the bit what it is without faults; a
    late burst is not played, so the next one is in its place.
    """
    design = small()
    clean = virtual(scene, design)
    bad = virtual(scene, design, faults=RadioFaults(**{name: 0.5}), seed=3)
    with served(bad) as port, ZeroMqRadio("127.0.0.1", port) as driver:
        record = acquire(driver, bad.schedule, bad.front_end, bursts=40)
    played = 40
    lost = record.flags[:, 0] == Flag.OVERRUN
    if name == "late":
        gone = lost.all(axis=1)
        assert np.array_equal(gone, lost.any(axis=1))
        played -= gone.sum()
        record = replace(
            record,
            **{n: getattr(record, n)[~gone] for n in ("iq", "flags", "device_time_ns")},
            pose=tuple(pose for pose, late in zip(record.pose, gone, strict=True) if not late),
        )
        lost = lost[~gone]
        assert 8 <= gone.sum() <= 32  # beyond 4 sigma of 20: one run in 1e4, of a fixed seed
    else:
        assert 8 <= lost.any(axis=1).sum() <= 32
    reference = acquire(clean, clean.schedule, clean.front_end, bursts=played)
    assert np.array_equal(record.iq[:, 0][~lost], reference.iq[:, 0][~lost])
    assert not record.iq[:, 0][lost].any()


def test_a_stall_is_waited_for_and_a_dropped_connection_is_an_error(scene) -> None:
    design = small()
    stalls = RadioFaults(stall=1.0, stall_s=0.3)
    with served(virtual(scene, design), faults=stalls) as port:
        with ZeroMqRadio("127.0.0.1", port) as driver:
            record = acquire(driver, *_setup(scene, design))
        assert not record.flags.any()
    with (
        served(virtual(scene, design), faults=replace(stalls, stall_s=4.0)) as port,
        ZeroMqRadio("127.0.0.1", port, timeout_s=1.0) as driver,
        pytest.raises(RadioError, match="burst: no answer within"),
    ):
        acquire(driver, *_setup(scene, design))
    with served(virtual(scene, design), faults=RadioFaults(drop=1.0)) as port:
        driver = ZeroMqRadio("127.0.0.1", port, timeout_s=1.0)
        with pytest.raises(RadioError, match="burst: no answer within"):
            acquire(driver, *_setup(scene, design))
        with pytest.raises(RadioError, match="open the radio first"):
            driver.now_ns()
        with ZeroMqRadio("127.0.0.1", port) as again:
            assert again.tune(design.ofdm.carrier_hz).carrier_hz == design.ofdm.carrier_hz
        driver.close()


def test_a_scene_slower_than_real_time_makes_sweeps_late_and_loses_nothing(scene, caplog) -> None:
    """0.3 s to compute a sweep of 0.12 s: the same counts, no step late, and it is said once."""
    design = load_radar("prototype")
    computed = RadarSweeps(scene, design, SEED, QUICK)

    def slow(number: int):
        time.sleep(0.3)
        return computed(number)

    radio = VirtualRadio(design, slow, clock=DeviceClock("real"))
    carriers = radio.schedule.carriers_hz[:3]
    unhurried = replace(radio.schedule, carriers_hz=carriers, step_period_s=0.1, lead_s=0.1)
    with served(radio) as port, open_radio(f"zmq://127.0.0.1:{port}") as driver:
        record = acquire(driver, unhurried, radio.front_end, bursts=5)
    assert not record.flags.any()
    for sweep in range(5):
        assert np.array_equal(record.iq[sweep], direct(scene, design, sweep).iq[0, :3])
    (told,) = caplog.messages
    assert "slower than real time: a sweep lasts 0.126 s" in told


def test_a_sweep_that_fails_is_one_line_and_may_be_asked_for_again(scene, caplog) -> None:
    """Here and at the client; the sweep comes once it can be computed."""
    design = small()
    computed, broken = RadarSweeps(scene, design, SEED, QUICK), [True]

    def fails(number: int):
        if number and broken[0]:
            raise ValueError("the engine\nis out of memory")
        return computed(number)

    radio = VirtualRadio(design, fails, clock=DeviceClock("fast"))
    sent = samples.burst(design.ofdm, radio.level)
    with served(radio) as port, ZeroMqRadio("127.0.0.1", port) as driver:
        driver.burst(sent, 0)
        for do in (lambda: driver.tune(design.ofdm.carrier_hz), lambda: driver.burst(sent, 10**9)):
            with pytest.raises(RadioError, match=r"sweep 1: the engine is out of memory$"):
                do()
        broken[0] = False
        driver.tune(design.ofdm.carrier_hz)
        assert driver.burst(sent, 10**9).there.all()
    assert len(caplog.messages) == 2


@pytest.mark.parametrize("rung", ["targets", "optics", "rough"])
def test_what_stands_is_traced_once(rung: str, monkeypatch) -> None:
    """At rest the records are those of single captures, though traced once, since rough surfaces
    belong to the scene; on a track every stop is traced.
    """
    traced: list[int] = []

    def counted(*arguments, **options):
        traced.append(1)
        return radar_echo(*arguments, **options)

    monkeypatch.setattr(twin.serve.sweeps, "radar_echo", counted)
    design, quick = small(), Fidelity(radar=rung, radar_tolerance=1.0, radar_scatterers=500)
    scene = load_scene("fig3b")
    at_rest = replace(scene, track=None)
    sweeps = RadarSweeps(at_rest, design, SEED, quick)
    for number in range(3):
        expected = radar_capture(at_rest, design, seed=SEED + number, fidelity=quick).record
        assert np.array_equal(sweeps(number).record.iq, expected.iq)
    assert len(traced) == 1
    on_track = RadarSweeps(scene, design, SEED, quick)
    assert len({on_track(number).record.iq.tobytes() for number in range(3)}) == 3
    assert len(traced) == 4


def test_prefetcher() -> None:
    """Items come in their order from other processes, which fail by one line, and can die."""
    prefetcher = Prefetcher(reciprocal)
    assert [prefetcher(0), prefetcher(1)] == [1 / 3, 1 / 2]
    for _ in range(2):
        with pytest.raises(InputError, match=r"^scene\.toml: wrong$"):
            prefetcher(2)
        with pytest.raises(EngineError, match=r"^ZeroDivisionError: division by zero$"):
            prefetcher(3)
    with pytest.raises(EngineError, match="has died"):
        Prefetcher(dies)(0)
    with pytest.raises(EngineError, match=r"has died: .*[Pp]ickl"):
        Prefetcher(lambda number: number)(0)


def test_processes_of_a_prefetcher_go_on_with_other_arguments() -> None:
    """What they compute for the earlier ones comes to nobody; what would not be read at once, or
    waits unread, is left to other processes.
    """
    prefetcher = Prefetcher(with_process, "slow")
    made = [prefetcher(number) for number in range(3)]
    assert [item[:2] for item in made] == [(0, "slow"), (1, "slow"), (2, "slow")]
    assert prefetcher.begin_again("one")
    assert prefetcher.begin_again("two")
    made += [prefetcher(number) for number in range(2)]
    assert [item[:2] for item in made[3:]] == [(0, "two"), (1, "two")]
    assert len({process for _, _, process in made}) <= min(4, os.cpu_count() or 1)
    assert not prefetcher.begin_again("long" * 10000)
    assert not all(prefetcher.begin_again(f"slow {number}") for number in range(9))
    prefetcher.close()


@pytest.mark.thorough
@pytest.mark.skipif(not hasattr(os, "SCHED_IDLE"), reason="Linux's priorities")
def test_processes_yield_the_core_once_the_device_runs() -> None:
    """One that begins later waits for its first items at full priority, before and after."""
    count = min(4, os.cpu_count() or 1)
    for begins_later in (False, True):
        prefetcher = Prefetcher(priority, begins_later=begins_later)
        if begins_later:
            assert [prefetcher(number) for number in range(count)] == count * [os.SCHED_OTHER]
            assert prefetcher.begin_again(1.0)
        found = [prefetcher(number) for number in range(2 * count)]
        assert found == count * [os.SCHED_OTHER] + count * [os.SCHED_IDLE]
        prefetcher.close()


def test_a_prefetcher_that_begins_later_computes_nothing_in_vain() -> None:
    prefetcher = Prefetcher(with_process, "first", begins_later=True)
    assert prefetcher(0)[:2] == (0, "first")
    assert not prefetcher.ready(min(4, os.cpu_count() or 1), 0.3)
    assert prefetcher.begin_again("again")
    assert [prefetcher(number)[:2] for number in range(9)] == [(k, "again") for k in range(9)]
    late = Prefetcher(with_process, "first", begins_later=True)
    assert [late(number)[:2] for number in range(9)] == [(k, "first") for k in range(9)]


def priority(number: int, begins_s: float = 0.0) -> int:
    return os.sched_getscheduler(0)


class SlowToSend:
    """What takes half a second until it is on its way to another process."""

    def __call__(self, number: int) -> int:
        return number

    def __getstate__(self) -> dict[str, object]:
        time.sleep(0.5)
        return {}


_PRINT_BLOCKED = """
from items_to_make import leaves_ctrl_c
from twin.serve.prefetcher import Prefetcher
if __name__ == "__main__":
    prefetcher = Prefetcher(leaves_ctrl_c)
    print([prefetcher(number) for number in range(2)])
"""


def test_ctrl_c_is_left_to_the_parent(tmp_path: Path) -> None:
    """In a process of its own, whose first child starts the tracker that lifts what is blocked."""
    (tmp_path / "run.py").write_text(_PRINT_BLOCKED)
    paths = os.pathsep.join([str(Path(__file__).parent), *filter(None, sys.path)])
    done = subprocess.run(
        [sys.executable, str(tmp_path / "run.py")],
        env={**os.environ, "PYTHONPATH": paths},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stdout == "[True, True]\n", done.stderr


def test_a_device_answers_while_its_processes_start() -> None:
    """To start them takes seconds on a busy machine; a driver waits for two."""
    since = time.monotonic()
    prefetcher = Prefetcher(SlowToSend())
    assert not prefetcher.ready(0, 0.0)
    assert time.monotonic() - since < 0.4
    prefetcher.close()


@pytest.mark.thorough
def test_ugv_captures_and_processes_a_radio(scene, tmp_path: Path) -> None:
    """By its URL alone: a record a sweep, bit for bit the twin's, with the radio's clock."""
    design = small()
    radio = virtual(scene, design, clock=DeviceClock("real"))
    setup, run, found = (tmp_path / name for name in ("radar.json", "run.mcap", "found.mcap"))
    write_setup(radio.schedule, radio.front_end, setup)
    with served(radio) as port:
        url = f"zmq://127.0.0.1:{port}"
        done = ugv("capture", url, "-o", run, "--radar-setup", setup, "--records", 3)
        assert done.returncode == 0, done.stderr
        live = ugv("process", url, "-o", found, "--radar-setup", setup, "--records", 2)
        assert live.returncode == 0, live.stderr
        # On a busy machine a burst may come too late: its record is told, and the next one taken.
        assert live.stdout.count("/radar/record") + live.stderr.count("not processed") == 2
        without = ugv("capture", url, "-o", tmp_path / "none.mcap")
    assert (without.returncode, without.stderr) == (
        2,
        f"ugv: error: {url}: a radio needs a setup\n",
    )
    assert not (tmp_path / "none.mcap").exists()
    taken = list(read_records(run))
    assert len(taken) == 3
    whole = [one for one in taken if not one.record.flags.any()]
    assert whole  # on a busy machine some of a burst may come too late, or a sweep be missed
    sweeps = (direct(scene, design, sweep).iq[0] for sweep in range(10))
    for received in whole:
        assert received.topic == "/radar/record"
        assert any(np.array_equal(received.record.iq[0], sweep) for sweep in sweeps)
        assert received.clock is not None
        begun_ns = received.clock.host_ns(int(received.record.device_time_ns[0, 0, 0]))
        assert 0 < received.host_ns - begun_ns < 5e9
    assert "ugv_msgs/msg/RadarRecord" in ugv("info", run).stdout


@pytest.mark.whole
def test_the_command(tmp_path: Path) -> None:
    """`twin serve` says where it listens, writes what a driver needs, and ends on ctrl-C."""
    design = tmp_path / "small.toml"
    values = {"n_subcarriers": 64, "subcarrier_spacing_hz": 312.5e3, "n_slots": 16}
    values |= {"slot_period_s": 3.6e-6, "repeats": 1, "prefix_s": 0.4e-6}
    lines = [f'{k} = {{ value = {v!r}, assumed = "short" }}' for k, v in values.items()]
    design.write_text("\n".join(['base = "hybrid-79"', 'name = "small"', "[waveform]", *lines]))
    setup = tmp_path / "setup.json"
    port = int(np.random.default_rng().integers(20000, 60000))
    command = [sys.executable, "-m", "twin", "serve", "fig3b", "--radar-at", f"tcp:{port}"]
    command += ["--radar", str(design), "--pace", "fast", "--radar-setup", str(setup)]
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, env=environment, **pipes) as process:
        line = process.stdout.readline()
        assert f"zmq://127.0.0.1:{port}" in line
        with open_radio(f"zmq://127.0.0.1:{port}") as driver:
            record = acquire(driver, *read_setup(setup))
        assert record.iq.any()
        assert not record.flags.any()
        options = ["--radar-setup", setup, "--records", 2]
        done = ugv("capture", f"zmq://127.0.0.1:{port}", "-o", tmp_path / "run.mcap", *options)
        assert done.returncode == 0, done.stderr
        captured = [received.record.iq for received in read_records(tmp_path / "run.mcap")]
        track = load_scene("fig3b")
        stops = track.track.poses(track.rig.pose)
        for sweep, iq in enumerate([record.iq, *captured]):
            expected = radar_capture(track, load_radar(design), seed=sweep, poses=[stops[sweep]])
            assert np.array_equal(iq, expected.record.iq)
        assert len(captured) == 2
        helpers = psutil.Process(process.pid).children(recursive=True)
        assert helpers
        process.send_signal(signal.SIGINT)
        assert process.wait(20) == 130
        assert not psutil.wait_procs(helpers, timeout=10)[1]
        computing, *ended = process.stderr.read().splitlines()
        assert computing.startswith("radar: computing the first sweep; its address is printed")
        assert ended == ["twin: interrupted, nothing half-written is left"]


def test_no_such_pace(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["serve", "fig3b", "--radar-at", "tcp:5555", "--pace", "slow"]
    monkeypatch.setattr(sys, "argv", ["twin", *arguments])
    with pytest.raises(SystemExit) as stopped:
        cli.main()
    assert stopped.value.code == 2
    assert capsys.readouterr().err == "twin: error: pace: 'slow', expected real or fast\n"


@pytest.mark.whole
def test_sweeps_traced_together_depend_on_their_number_alone(scene) -> None:
    """The first of three is that of a capture bit for bit; the others, which keep a part of it,
    are the same in whatever order they are asked for, and the next one begins anew.
    """
    design, fidelity = small(), Fidelity(radar="optics", radar_tolerance=1.0, radar_images=0)
    in_order = RadarSweeps(scene, design, SEED, fidelity, reuse=3)
    records = [in_order(number).record for number in range(4)]
    at_random = RadarSweeps(scene, design, SEED, fidelity, reuse=3)
    for number in (2, 3, 0, 1):
        assert np.array_equal(at_random(number).record.iq, records[number].iq)
    for number in (0, 3):
        world = scene.after(number * design.burst_s + design.middle_s)
        expected = radar_capture(world, design, seed=SEED + number, fidelity=fidelity).record
        assert np.array_equal(records[number].iq, expected.iq)
    with pytest.raises(InputError, match="reuse: 0 sweeps traced together, expected at least 1"):
        RadarSweeps(scene, design, SEED, fidelity, reuse=0)

"""The radio's driver and schedule, against closed forms and a cable in memory; no simulator."""

import json
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hardware.drivers.radio import (
    Fault,
    RadioDriver,
    RadioError,
    Reception,
    Schedule,
    Tuned,
    acquire,
    calibrate,
    carriers,
    open_radio,
    samples,
)
from hardware.drivers.radio.setup import read_setup, write_setup
from hardware.radar import OfdmWaveform, channel
from hardware.records import Flag, QuaternionPose, RadarFrontEnd
from hardware.sources import open_source

PROTOTYPE = OfdmWaveform(2.26e9, 64, 312.5e3, 16, 3.6e-6, 1, 0.4e-6)
CARRIERS = carriers(2.5e9, 20e6, 25)
SCHEDULE = Schedule(PROTOTYPE, CARRIERS, step_period_s=2e-3)
FRONT_END = RadarFrontEnd(root_watt_per_count=1e-9, transmit_power_w=0.01)


class Cable(RadioDriver):
    """Transmitter to receivers over a cable: gain and delay, a phase of its own at every tune."""

    device = "cable"

    def __init__(self, gain: float = 0.1, delay: int = 0, n_receivers: int = 1, tune_ns: int = 0):
        self.n_receivers, self.sample_rate_hz = n_receivers, PROTOTYPE.bandwidth_hz
        self.gain, self.delay, self.tune_ns = gain, delay, tune_ns
        self.clock_ns, self.tuned, self.bursts = 1_000_000, [], []
        self.spoil = {}
        self.rng = np.random.default_rng(1)

    def tune(self, carrier_hz: float) -> Tuned:
        self.tuned.append(carrier_hz)
        self.phase = np.exp(2j * np.pi * self.rng.random())
        self.clock_ns += self.tune_ns
        return Tuned(carrier_hz, self.clock_ns)

    def now_ns(self) -> int:
        return self.clock_ns

    def burst(self, sent, start_ns: int) -> Reception:
        assert start_ns >= self.clock_ns
        self.bursts.append(start_ns)
        self.clock_ns = start_ns + round(1e9 * len(sent) / self.sample_rate_hz)
        heard = np.zeros((self.n_receivers, len(sent)), dtype=np.complex64)
        heard[:, self.delay :] = sent[: len(sent) - self.delay] * self.gain * self.phase
        there = np.ones(len(sent), dtype=bool)
        faults, gap = self.spoil.get(len(self.bursts) - 1, (Fault(0), slice(0, 0)))
        there[gap] = False
        heard[:, gap] = 0
        return Reception(heard, there, start_ns, faults)

    def close(self) -> None:
        pass


def test_burst_is_prefix_repeats_and_silence() -> None:
    wave = replace(PROTOTYPE, repeats=3, prefix_s=5e-6, slot_period_s=16e-6, n_slots=2)
    sent = samples.burst(wave, 0.5).reshape(2, 320)
    one = samples.symbol(wave, 0.5)
    assert np.sqrt(np.mean(np.abs(one) ** 2)) == pytest.approx(0.5, rel=1e-6)
    assert np.array_equal(sent[0], sent[1])
    assert np.array_equal(sent[0, 100 : 100 + 192], np.tile(one, 3))
    assert np.array_equal(sent[0, :100], np.tile(one, 2)[-100:])
    assert not sent[0, 292:].any()


def test_spectrum_of_what_is_sent_is_what_was_meant() -> None:
    """Rounding to complex64 is all that differs: 2^-24 a sample, nothing more after the sum."""
    for n in (1, 2, 63, 64, 4096):
        wave = replace(PROTOTYPE, n_subcarriers=n)
        level = samples.highest_level(wave)
        found = samples.spectrum(samples.symbol(wave, level), level)
        assert np.abs(found - wave.sent()).max() < 4e-7
    flat = replace(PROTOTYPE, symbols="flat")
    assert samples.highest_level(flat) == 0.125
    assert np.abs(samples.symbol(flat, 0.125)).max() == 1.0
    with pytest.raises(ValueError, match=r"level: 0\.5 makes the symbol peak at 4 of full scale"):
        samples.symbol(flat, 0.5)


@given(data=st.data())
@settings(max_examples=60, deadline=None)
def test_counts_come_back_exactly(data: st.DataObject) -> None:
    """Counts sent as samples, each repeat alike, are those that are recorded, rails included."""
    repeats = data.draw(st.integers(1, 40))
    wave = OfdmWaveform(1e9, 4, 1e6, 3, 50e-6, repeats, 0.5e-6)
    count = st.integers(-32768, 32767)
    wanted = np.array(data.draw(st.lists(count, min_size=24, max_size=24)), dtype=np.int16)
    wanted = wanted.reshape(3, 1, 4, 2)
    sampled = (wanted / samples.FULL_SCALE_COUNTS) @ [1, 1j]
    heard = np.zeros((1, 3, 200), dtype=np.complex64)
    heard[..., 2 : 2 + 4 * repeats] = np.tile(sampled.transpose(1, 0, 2), repeats)
    reception = Reception(heard.reshape(1, -1), np.ones(600, dtype=bool), 0, Fault(0))
    iq, flags = samples.counts(reception, wave)
    assert np.array_equal(iq, wanted)
    rail = (np.abs(wanted.astype(int)) >= 32767).any(axis=(1, 2, 3))
    assert np.array_equal(flags == Flag.SATURATED, rail)


def test_repeats_are_averaged() -> None:
    wave = OfdmWaveform(1e9, 4, 1e6, 1, 8e-6, 2, 0.0)
    heard = np.zeros((1, 32), dtype=np.complex64)
    heard[0, :4], heard[0, 4:8] = 0.5, 0.25j
    iq, _ = samples.counts(Reception(heard, np.ones(32, dtype=bool), 0, Fault(0)), wave)
    assert np.array_equal(np.unique(iq.reshape(-1, 2), axis=0), [[8192, 4096]])


def test_grid_refuses_what_misses_it() -> None:
    with pytest.raises(ValueError, match="is no whole number of samples"):
        samples.SlotGrid.of(replace(PROTOTYPE, slot_period_s=3.61e-6))


def test_record_over_a_cable() -> None:
    """The channel of a cable is its gain and its delay, at every step and slot, and the record's
    clock is the schedule's.
    """
    radio = Cable(gain=0.25, delay=3, n_receivers=2)
    front_end = replace(FRONT_END, receivers_m=np.array([(0.0, 0.0, 0.0), (0.0, 0.1, 0.0)]))
    record = acquire(radio, SCHEDULE, front_end, bursts=2, pose=QuaternionPose(1, 2, 3))
    assert record.iq.shape == (2, 25, 16, 2, 64, 2)
    assert radio.tuned == [*CARRIERS, *CARRIERS]
    assert np.array_equal(record.carriers_hz, CARRIERS)
    assert not record.flags.any()
    starts = record.device_time_ns[..., 0]
    assert np.array_equal(starts.ravel(), radio.bursts)
    assert (np.diff(starts, axis=1) == 2_000_000).all()
    assert (np.diff(record.device_time_ns, axis=2) == 3600).all()
    assert record.pose == (QuaternionPose(1, 2, 3),) * 2
    f = PROTOTYPE.frequency_offsets_hz
    expected = 0.25 * 0.5 * 32767 * 1e-9 * np.exp(-2j * np.pi * f * 3 / 20e6)
    for step in range(25):
        found = channel(record, burst=1, step=step, receiver=1)
        turn = found[32, 0] / abs(found[32, 0]) * abs(expected[32]) / expected[32]
        # Rounding to counts: sqrt(1/6) counts a sample, here against 4096.
        assert np.abs(found / turn - expected[:, None]).max() < 6e-9


def test_faults_and_gaps_stand_in_the_record() -> None:
    """A lost sample costs its slot, a fault without a place the burst; all else is as without."""
    radio = Cable()
    clean = acquire(Cable(), SCHEDULE, FRONT_END)
    radio.spoil = {
        3: (Fault.OVERFLOW, slice(72 * 5 + 71, 72 * 7 + 4)),  # within 5, all of 6, prefix of 7
        4: (Fault.UNDERFLOW, slice(0, 0)),
        5: (Fault.LATE, slice(None)),
        6: (Fault.OUT_OF_SEQUENCE, slice(72 * 2, 72 * 2 + 8)),  # a prefix only
    }
    record = acquire(radio, SCHEDULE, FRONT_END)
    lost = np.zeros((25, 16), dtype=bool)
    lost[3, 5:7] = lost[4] = lost[5] = True
    assert np.array_equal(record.flags[0] == Flag.OVERRUN, lost)
    assert not record.iq[0][lost].any()
    assert np.array_equal(record.iq[0][~lost], clean.iq[0][~lost])
    assert np.array_equal(record.device_time_ns, clean.device_time_ns)


def test_steps_that_take_too_long_to_tune_are_late_not_shifted() -> None:
    radio = Cable(tune_ns=1_500_000)
    record = acquire(radio, SCHEDULE, FRONT_END)
    late = (record.flags[0] == Flag.OVERRUN).all(axis=1)
    assert not late[0]
    assert late[1:].any()
    assert (np.diff(record.device_time_ns[0, :, 0]) == 2_000_000).all()
    assert len(radio.bursts) == 25 - late.sum()


def test_calibration_burst_finds_gain_and_delay() -> None:
    """30 dB of cable and radio: the count is worth what left the port, less the cable."""
    radio = Cable(gain=0.02, delay=4)
    found = calibrate(radio, SCHEDULE, FRONT_END, attenuation_db=20.0, delay_s=1e-7)
    at_port = np.sqrt(0.01 * 10**-2)
    assert found.front_end.root_watt_per_count == pytest.approx(
        at_port / (0.02 * 0.5 * 32767), rel=1e-3
    )
    assert found.delay_s == pytest.approx(4 / 20e6 - 1e-7, abs=1e-11)
    assert np.abs(found.gain_db).max() < 0.01
    # The cable cuts the tail off the last symbol's slot: nothing else is left unexplained.
    assert found.coherence.min() > 0.999


@pytest.mark.parametrize(
    ("gain", "spoil", "says"),
    [
        (0.0, {}, "nothing came through the cable"),
        (3.0, {}, "400 slots of the calibration burst saturated"),
        (0.1, {0: (Fault.LATE, slice(None))}, "16 slots of the calibration burst lost"),
    ],
)
def test_calibration_refuses(gain: float, spoil: dict, says: str) -> None:
    radio = Cable(gain=gain)
    radio.spoil = spoil
    with pytest.raises(RadioError, match=says):
        calibrate(radio, SCHEDULE, FRONT_END, attenuation_db=20.0, delay_s=0.0)


def test_orders_of_carriers() -> None:
    up, down = (carriers(2.5e9, 20e6, 25, order) for order in ("ascending", "descending"))
    mixed = carriers(2.5e9, 20e6, 25, "shuffled", seed=1)
    assert up == down[::-1] == tuple(sorted(mixed)) != mixed
    assert up[0] == 2.26e9
    assert up[-1] == 2.74e9
    assert mixed == carriers(2.5e9, 20e6, 25, "shuffled", seed=1)


def test_what_does_not_fit_is_refused() -> None:
    with pytest.raises(ValueError, match="order: 'random' is none of ascending"):
        carriers(1e9, 1e6, 2, "random")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"step_period_s: 0\.001 s is shorter than burst"):
        replace(SCHEDULE, step_period_s=1e-3)
    with pytest.raises(ValueError, match="does not begin at the waveform's"):
        replace(SCHEDULE, carriers_hz=())
    with pytest.raises(ValueError, match="settling_s: nan"):
        replace(SCHEDULE, settling_s=float("nan"))
    radio = Cable()
    radio.sample_rate_hz = 1e6
    with pytest.raises(ValueError, match="samples/s, expected the waveform's"):
        acquire(radio, SCHEDULE, FRONT_END)
    with pytest.raises(ValueError, match="receivers_m: 1, the radio has 2"):
        acquire(Cable(n_receivers=2), SCHEDULE, FRONT_END)
    radio = Cable()
    radio.tune = lambda hz: Tuned(hz + 2e3, 0)
    with pytest.raises(RadioError, match="tuned to 2260002000 Hz, asked for 2260000000 Hz"):
        acquire(radio, SCHEDULE, FRONT_END)


@pytest.mark.parametrize(
    "url", ["", "uhd", "zmq://", "zmq://host", "zmq://h:99999", "tcp://h:1", "zmq://h:1/x"]
)
def test_url_that_is_no_radio(url: str) -> None:
    with pytest.raises(ValueError, match=r"expected uhd:ARGS or zmq://HOST:PORT"):
        open_radio(url)


def test_setup_survives_its_file(tmp_path) -> None:
    path = tmp_path / "setup.json"
    front_end = replace(FRONT_END, antenna_gain_dbi=6.0)
    louder = replace(SCHEDULE, level=0.25)
    write_setup(louder, front_end, path)
    schedule, found = read_setup(path)
    assert schedule == louder
    for name, value in vars(front_end).items():
        assert np.array_equal(getattr(found, name), value, equal_nan=True), name
    assert [p.name for p in tmp_path.iterdir()] == ["setup.json"]


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda c: c.update(version=2), "expected .'ugv-radio-setup', 1"),
        (lambda c: c.pop("schedule"), "'schedule' is missing"),
        (lambda c: c["schedule"].update(step_period_s="x"), "step_period_s: 'x' is not a number"),
        (lambda c: c["front_end"].update(colour=1), "unexpected keyword argument 'colour'"),
        (
            lambda c: c["schedule"]["waveform"].update(n_slots=0),
            "n_slots: 0, expected a whole number from 1 on",
        ),
    ],
)
def test_broken_setup_is_refused(tmp_path, change, says: str) -> None:
    path = tmp_path / "setup.json"
    write_setup(SCHEDULE, FRONT_END, path)
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))
    with pytest.raises(ValueError, match=says):
        read_setup(path)
    path.write_text("[]")
    with pytest.raises(ValueError, match=r"setup\.json"):
        read_setup(path)


def test_the_radio_needs_neither_the_cameras_framing_nor_its_line() -> None:
    """Where `cobs` and `pyserial` are not installed: radio, log and sources are there."""
    program = (
        "import sys; sys.modules.update(cobs=None, serial=None)\n"
        "import hardware.capture, hardware.sources, hardware.drivers.radio.opening\n"
        "from hardware.drivers import ClockModel\n"
        "from hardware.drivers.radio import acquire, open_radio\n"
        "try: from hardware.drivers import SpiCamera\n"
        "except ModuleNotFoundError as error: print(error.name)\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout == "cobs\n"


def test_a_radio_needs_a_setup() -> None:
    for url in ("uhd:type=b200", "zmq://127.0.0.1:5555"):
        with pytest.raises(ValueError, match="a radio needs a setup"):
            open_source(url)

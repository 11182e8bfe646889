"""Radios behind ZeroMQ, against peers in plain pyzmq written from RADIO.md alone."""

import json
import struct
import threading
import time
from contextlib import closing, contextmanager

import numpy as np
import pytest
import zmq

from hardware.drivers.radio import (
    Fault,
    RadioError,
    Schedule,
    acquire,
    open_radio,
)
from hardware.drivers.radio.stream import StreamRadio, parse_request
from hardware.drivers.radio.zeromq import ZeroMqRadio
from hardware.radar import OfdmWaveform
from hardware.records import RadarFrontEnd

WAVE = OfdmWaveform(2.5e9, 64, 312.5e3, 16, 3.6e-6, 1, 0.4e-6)
N = 16 * 72


class Peer:
    """A virtual radio by RADIO.md: an answer is made of each command by a function."""

    def __init__(self, answers) -> None:
        self.answers, self.commands = answers, []
        self.context = zmq.Context()
        self.socket = self.context.socket(zmq.ROUTER)
        self.port = self.socket.bind_to_random_port("tcp://127.0.0.1")
        self.running = True
        self.thread = threading.Thread(target=self.run)
        self.thread.start()

    def run(self) -> None:
        while self.running:
            if not self.socket.poll(20):
                continue
            sender, empty, text, *frames = self.socket.recv_multipart()
            assert empty == b""
            command = json.loads(text)
            self.commands.append(command)
            for answer, *out in self.answers(command, frames):
                text = answer if isinstance(answer, bytes) else json.dumps(answer).encode()
                self.socket.send_multipart([sender, b"", text, *out])

    def close(self) -> None:
        self.running = False
        self.thread.join()
        self.context.destroy(linger=0)


def well_behaved(command, frames):
    number = {"number": command["number"]}
    match command["do"]:
        case "open":
            told = {"device": "peer", "receivers": 1, "sample_rate_hz": 20e6, "patience_s": 0.3}
            yield {**number, **told}, *()
        case "tune":
            yield {**number, "carrier_hz": command["carrier_hz"], "time_ns": 5}, *()
        case "time":
            yield {**number, "time_ns": 7}, *()
        case "burst":
            told = {"start_ns": command["start_ns"], "faults": [], "gaps": []}
            heard = (0.5j * np.frombuffer(frames[0], "<c8")).astype("<c8")
            yield {**number, **told}, heard.tobytes()
        case "close":
            yield number, *()


@contextmanager
def opened(answers, **options):
    with closing(Peer(answers)) as peer, ZeroMqRadio("127.0.0.1", peer.port, **options) as radio:
        yield peer, radio


def misbehaving(**changes):
    """Well behaved, but a burst is answered by what ``burst(good answer, frames)`` yields."""

    def answers(command, frames):
        for answer, *out in well_behaved(command, frames):
            if command["do"] in changes:
                yield from changes[command["do"]](answer, *out)
            else:
                yield answer, *out

    return answers


def burst(radio, n: int = N):
    return radio.burst(np.full(n, 0.25, dtype=np.complex64), 1000)


def test_commands_and_samples_cross_the_wire() -> None:
    with opened(well_behaved) as (peer, radio):
        assert radio.device == f"peer at zmq://127.0.0.1:{peer.port}"
        assert radio.tune(2.5e9) == (2.5e9, 5)
        assert radio.now_ns() == 7
        heard = burst(radio)
        assert (heard.samples == np.complex64(0.125j)).all()
        assert heard.samples.shape == (1, N)
        assert heard.there.all()
        assert (heard.start_ns, heard.faults) == (1000, Fault(0))
        schedule = Schedule(WAVE, (2.5e9,), step_period_s=2e-3)
        record = acquire(radio, schedule, RadarFrontEnd(1e-9, 0.01))
        assert not record.flags.any()
    assert [c["do"] for c in peer.commands[:3]] == ["open", "tune", "time"]
    assert peer.commands[-1]["do"] == "close"


def test_a_url_opens_it() -> None:
    with (
        closing(Peer(well_behaved)) as peer,
        open_radio(f"zmq://127.0.0.1:{peer.port}") as radio,
    ):
        assert radio.sample_rate_hz == 20e6


def test_metadata_and_gaps_are_told() -> None:
    def spoilt(answer, samples):
        yield {**answer, "faults": ["overflow", "out_of_sequence"], "gaps": [[3, 9]]}, samples

    def late(answer, samples):
        yield {**answer, "faults": ["late"]}, *()

    with opened(misbehaving(burst=spoilt)) as (_, radio):
        heard = burst(radio)
        assert heard.faults == Fault.OVERFLOW | Fault.OUT_OF_SEQUENCE
        assert np.array_equal(np.flatnonzero(~heard.there), np.arange(3, 9))
    with opened(misbehaving(burst=late)) as (_, radio):
        heard = burst(radio)
        assert heard.faults == Fault.LATE
        assert not heard.there.any()


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda a, s: [(b"{", s)], "answer is no JSON"),
        (lambda a, s: [(b"[" * 60000, s)], "answer is no JSON"),
        (lambda a, s: [(b"[]", s)], "answer \\[\\]"),
        (lambda a, s: [(b" " * 70000, s)], "70000 bytes"),
        (lambda a, s: [({"number": a["number"], "error": "no"}, s)], "no"),
        (lambda a, s: [({**a, "start_ns": "now"}, s)], "start_ns: 'now' in the answer"),
        (lambda a, s: [({**a, "faults": ["fire"]}, s)], "faults: \\['fire'\\] in the answer"),
        (lambda a, s: [({**a, "faults": 3}, s)], "faults: 3 in the answer"),
        (lambda a, s: [({**a, "gaps": [["a", 1]]}, s)], "gaps: .* first < stop <= 1152"),
        (lambda a, s: [({**a, "gaps": [[10**30, 5]]}, s)], "gaps: .* first < stop <= 1152"),
        (lambda a, s: [({**a, "start_ns": 999}, s)], "start_ns: 999 in the answer, expected 1000"),
        (lambda a, s: [(a, s, s)], "2304 samples came back in 2 frames, expected 1 x 1152 in one"),
        (lambda a, s: [(a, s[:-4])], "9212 bytes, expected complex samples of 8"),
        (lambda a, s: [(a, s[:-8])], "1151 samples came back in 1 frames, expected 1 x 1152"),
        (lambda a, s: [(a, b"\xff" * len(s))], "a sample is not a number"),
        (lambda a, s: [({**a, "number": 1}, s)], "burst: no answer within"),
        (lambda a, s: [], "burst: no answer within"),
    ],
)
def test_bad_answers_are_refused(change, says: str) -> None:
    with (
        opened(misbehaving(burst=change), timeout_s=1.5) as (_, radio),
        pytest.raises(RadioError, match=says),
    ):
        burst(radio)


def deep(levels: int) -> list[object]:
    value: list[object] = []
    for _ in range(levels):
        value = [value]
    return value


NAN = float("nan")
NASTY = [
    None, True, False, -1, 0, 1, 3, 0.5, 1.5, -0.0, 1e308, -1e308, NAN, float("inf"), float("-inf"),
    2**31, 2**62 + 1, 2**63 - 1, 2**63, 2**64, -(2**63), 10**30, -(10**30), 10**400, -(10**400),
    1e15, 1e300, "", "x", "late", "1000", "a\nb", "\x1b[2J", [], [1], [[1]], [[5, 3]], [[-5, 3]],
    [[0, 1e3]], [[0, N + 1]], [[0, 10**30]], [[10**30, 5]], [[-(10**30), 10**30]], [[True, 5]],
    [[0, NAN]], [[0, 1, 2]], [{"0": 1}], ["late", 1], [["late"]], ["LATE"], {}, {"a": 1}, deep(400),
]  # fmt: skip


@pytest.mark.parametrize("do", ["open", "tune", "time", "burst"])
def test_each_field_of_an_answer_is_taken_as_it_must_be_or_refused(do: str) -> None:
    """Every field in turn with every value above, and left out: what the driver then says is within
    what a record can hold and what was asked for, or it is one line that names the field.
    """
    change: dict[str, object] = {}

    def spoilt(answer, *samples):
        spoilt = {**answer, **change}
        yield {name: value for name, value in spoilt.items() if value is not LEFT_OUT}, *samples

    with opened(misbehaving(**{do: spoilt})) as (peer, radio):

        def ask_open() -> object:
            with ZeroMqRadio("127.0.0.1", peer.port) as new:
                return new.n_receivers, new.sample_rate_hz, new.timeout_s, new.device

        ask = {
            "open": ask_open,
            "tune": lambda: radio.tune(2.5e9),
            "time": radio.now_ns,
            "burst": lambda: burst(radio),
        }[do]
        for field in FIELDS[do]:
            for value in (*NASTY, LEFT_OUT):
                change = {field: value}
                try:
                    said = ask()
                except RadioError as error:
                    line = str(error)
                    assert f" {field}: " in line
                    assert len(line) < 300
                    assert line.isprintable()
                else:
                    check(do, said)


LEFT_OUT = object()
FIELDS = {
    "open": ("receivers", "sample_rate_hz", "patience_s", "device"),
    "tune": ("carrier_hz", "time_ns"),
    "time": ("time_ns",),
    "burst": ("start_ns", "faults", "gaps"),
}


def check(do: str, said) -> None:
    """What a driver may say, whatever was answered."""
    if do == "open":
        receivers, rate_hz, patience_s, device = said
        assert 1 <= receivers <= 256
        assert 0 < rate_hz < float("inf")
        assert 0 < patience_s <= 3600
        assert device.isprintable()
    elif do == "burst":
        assert said.start_ns == 1000
        assert said.faults in (Fault(0), Fault.LATE)
        assert said.there.all()  # no gap above is one that a radio can mean
        assert (said.samples == np.complex64(0.125j)).all()
    else:
        carrier_hz, time_ns = said if do == "tune" else (1.0, said)
        assert 0 < carrier_hz < float("inf")
        assert isinstance(time_ns, int)
        assert 0 <= time_ns <= 2**62


def test_an_answer_that_was_given_up_is_not_taken_for_another() -> None:
    """After a silence the radio answers twice; the driver takes the answer of its own command."""
    kept = []

    def slow(answer, samples):
        kept.append((answer, samples))
        return []

    def after(answer):
        yield from kept
        yield answer, *()

    with opened(misbehaving(burst=slow, time=after), timeout_s=0.2) as (_, radio):
        with pytest.raises(RadioError, match="no answer"):
            burst(radio)
        assert radio.now_ns() == 7


def test_nobody_there() -> None:
    start = time.monotonic()
    with pytest.raises(RadioError, match=r"zmq://127\.0\.0\.1:9: open: no answer within 0\.2 s"):
        ZeroMqRadio("127.0.0.1", 9, timeout_s=0.2)
    assert time.monotonic() - start < 2


@pytest.mark.parametrize("style", ["gnuradio", "srsran"])
def test_plain_virtual_radio(style: str) -> None:
    """The peer asks for our samples and answers for its own, in blocks of its own size, the way
    GNU Radio's blocks (a 32-bit count) and srsRAN's (one byte) do.
    """
    context = zmq.Context()
    receive, transmit = context.socket(zmq.REP), context.socket(zmq.REQ)
    port = receive.bind_to_random_port("tcp://127.0.0.1")
    running = True

    def peer() -> None:
        waiting, asked = np.zeros(0, "<c8"), False
        while running:
            if not asked:
                transmit.send(struct.pack("<i", 500) if style == "gnuradio" else b"\xff")
                asked = True
            if transmit.poll(20):
                waiting = np.concatenate([waiting, np.frombuffer(transmit.recv(), "<c8")])
                asked = False
            if len(waiting) and receive.poll(20):
                asked_for = receive.recv()
                most = struct.unpack("<i", asked_for)[0]
                out, waiting = waiting[: min(most, 300)], waiting[min(most, 300) :]
                receive.send((0.5 * out).astype("<c8").tobytes())

    thread = threading.Thread(target=peer)
    with StreamRadio(
        "tcp://127.0.0.1:*",
        f"tcp://127.0.0.1:{port}",
        carrier_hz=2.5e9,
        sample_rate_hz=20e6,
    ) as radio:
        transmit.connect(radio.transmit)
        thread.start()
        sent = np.exp(1j * np.arange(N)).astype(np.complex64)
        for k in range(3):
            heard = radio.burst(sent, 0)
            assert np.array_equal(heard.samples[0], (0.5 * sent).astype(np.complex64))
            assert heard.start_ns == k * N * 50
        record = acquire(radio, Schedule(WAVE, (2.5e9,), 2e-3), RadarFrontEnd(1e-9, 0.01))
        assert not record.flags.any()
        with pytest.raises(RadioError, match="stands at 2500000000 Hz, asked for 2520000000 Hz"):
            radio.tune(2.52e9)
    running = False
    thread.join()
    context.destroy(linger=0)


def test_requests() -> None:
    assert parse_request(struct.pack("<i", 100)) == 100
    assert parse_request(struct.pack("<i", -1)) == 0
    assert (
        parse_request(b"\xff")
        == parse_request(b"")
        == parse_request(struct.pack("<i", 2**30))
        == 65536
    )


def test_plain_virtual_radio_that_is_silent() -> None:
    with (
        StreamRadio(
            "tcp://127.0.0.1:*",
            "tcp://127.0.0.1:9",
            carrier_hz=1e9,
            sample_rate_hz=1e6,
            timeout_s=0.1,
        ) as radio,
        pytest.raises(RadioError, match=r"no samples within 0\.1 s"),
    ):
        burst(radio)

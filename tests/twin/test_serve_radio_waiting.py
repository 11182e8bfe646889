"""The virtual radio while a sweep is computed: who waits keeps it, who has gone frees it."""

import json
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import pytest
import zmq
from virtual_radio import QUICK, SEED, direct, served, small

from hardware.drivers.radio import acquire, samples
from hardware.drivers.radio.zeromq import ZeroMqRadio
from twin.scene import load_scene
from twin.serve.clock import DeviceClock
from twin.serve.radio import VirtualRadio
from twin.serve.sweeps import RadarSweeps


@pytest.fixture(scope="module")
def scene():
    return load_scene("yard")


class _Client:
    """A client of its own, which does not wait for an answer where it does not want one."""

    def __init__(self, context: zmq.Context, port: int) -> None:
        self.socket = context.socket(zmq.DEALER)
        self.socket.connect(f"tcp://127.0.0.1:{port}")
        self._number = 0

    def send(self, do: str, *frames: bytes, **fields) -> None:
        self._number += 1
        message = json.dumps({"do": do, "number": self._number, **fields}).encode()
        self.socket.send_multipart([b"", message, *frames])

    def answer(self, do: str, *frames: bytes, **fields) -> dict:
        """The answer to a command within a second: a sweep here is never ready by itself."""
        self.send(do, *frames, **fields)
        while self.socket.poll(1000):
            answer = json.loads(self.socket.recv_multipart()[1])
            if answer["number"] == self._number:
                return answer
        raise AssertionError(f"{do}: no answer")


@dataclass
class _Waiting:
    """A client that waits for a sweep, another one, and the radio that both want."""

    one: _Client
    two: _Client
    radio: VirtualRadio
    port: int
    ready: threading.Event


@contextmanager
def waiting_for_a_sweep(scene) -> Iterator[_Waiting]:
    """The first sweep has been played, and the radio is tuned for the second, which is not computed
    before ``ready`` is set.
    """
    design, ready, asked = small(), threading.Event(), threading.Event()
    sweeps = RadarSweeps(scene, design, SEED, QUICK)

    def slow(number: int):
        if number:
            asked.set()
            ready.wait()
        return sweeps(number)

    radio, context = VirtualRadio(design, slow, clock=DeviceClock("fast")), zmq.Context()
    with served(radio) as port:
        one, two = _Client(context, port), _Client(context, port)
        sent = samples.burst(radio.waveform, radio.level).tobytes()
        one.answer("open", version=2)
        one.answer("tune", carrier_hz=radio.carriers_hz[0])
        assert one.answer("burst", sent, start_ns=10**6)["start_ns"] == 10**6
        one.send("tune", carrier_hz=radio.carriers_hz[0])
        assert asked.wait(10)
        try:
            yield _Waiting(one, two, radio, port, ready)
        finally:
            ready.set()
            context.destroy(linger=0)


def test_commands_are_answered_while_a_sweep_is_computed(scene) -> None:
    """Who waits for a sweep may still ask for the time; another is refused at once, and has the
    radio as soon as the first has closed, though the sweep is not there yet. Then the sweep is the
    second client's, to the bit.
    """
    with waiting_for_a_sweep(scene) as seen:
        assert seen.one.answer("time")["time_ns"] >= 10**6
        assert "busy" in seen.two.answer("open", version=2)["error"]
        assert "error" not in seen.one.answer("close")
        assert "error" not in seen.two.answer("open", version=2)
        assert "error" not in seen.two.answer("close")
        driver = ZeroMqRadio("127.0.0.1", seen.port)
        seen.ready.set()
        with driver:
            record = acquire(driver, seen.radio.schedule, seen.radio.front_end)
    assert np.array_equal(record.iq, direct(scene, small(), 1).iq)


def test_who_waits_for_a_sweep_has_the_radio_until_it_goes_away(scene, monkeypatch) -> None:
    """Silence while an answer is due is none; a client that is gone when its answer comes is."""
    monkeypatch.setattr("twin.serve.zeromq._LEASE_S", 0.3)
    with waiting_for_a_sweep(scene) as seen:
        time.sleep(0.5)
        assert "busy" in seen.two.answer("open", version=2)["error"]
        monkeypatch.setattr("twin.serve.zeromq._LEASE_S", 3600.0)
        seen.one.socket.close(linger=0)
        time.sleep(0.3)
        seen.ready.set()
        until = time.monotonic() + 10
        while "error" in seen.two.answer("open", version=2):
            assert time.monotonic() < until


def test_commands_that_are_sent_without_waiting_are_done_in_order(scene) -> None:
    """Up to 64 of them; more are refused, and a client that closes takes back what is not begun."""
    with waiting_for_a_sweep(scene) as seen:
        carrier_hz = seen.radio.carriers_hz[0]
        for _ in range(64):
            seen.one.send("tune", carrier_hz=carrier_hz)
        refused = seen.one.answer("tune", carrier_hz=carrier_hz)
        assert "64 commands are waiting" in refused["error"]
        seen.one.answer("close")
        seen.ready.set()
        with ZeroMqRadio("127.0.0.1", seen.port) as driver:
            assert driver.tune(carrier_hz).carrier_hz == carrier_hz
        answers = 0
        while seen.one.socket.poll(300):
            seen.one.socket.recv_multipart()
            answers += 1
        assert answers == 1  # of the command that was at work

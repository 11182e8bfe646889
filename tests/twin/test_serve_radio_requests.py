"""What is asked of a virtual radio: times, what it refuses, bytes from anyone, addresses."""

import json

import numpy as np
import pytest
import zmq
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from virtual_radio import served, small, virtual

from hardware.drivers.radio import Fault, RadioError, samples
from hardware.drivers.radio.zeromq import ZeroMqRadio
from twin.files import InputError
from twin.scene import load_scene
from twin.serve.clock import DeviceClock
from twin.serve.faults import RadioFaults, parse_faults
from twin.serve.serving import parse_address


@pytest.fixture(scope="module")
def scene():
    return load_scene("yard")


def test_device_time(scene) -> None:
    """Fast, the clock is where the last burst ended; real, it runs as the host's."""
    design = small()
    fast = virtual(scene, design)
    sent = samples.burst(design.ofdm, fast.level)
    assert fast.burst(sent, 5_000_000).faults == Fault(0)
    assert fast.now_ns() == 5_000_000 + 57_600
    assert fast.burst(sent, 5_000_000).faults == Fault.LATE
    real = virtual(scene, design, clock=DeviceClock("real"))
    start = real.now_ns() + 30_000_000
    assert real.burst(sent, start).start_ns == start
    assert real.now_ns() >= start + 57_600
    assert real.burst(sent, start).faults == Fault.LATE


@pytest.mark.parametrize(
    ("do", "says"),
    [
        (lambda r: r.tune(1e9), "1000000000 Hz is none of its 1 carriers"),
        (lambda r: r.tune(float("nan")), "is none of its 1 carriers"),
        (
            lambda r: r.burst(np.zeros(3, dtype=np.complex64), 0),
            "burst of 3 samples, expected",
        ),
        (lambda r: r.burst(np.zeros(1152, dtype=np.complex64), 10**15), "burst starts 1000000 s"),
    ],
)
def test_what_the_radio_cannot_do_is_refused(scene, do, says: str) -> None:
    radio = virtual(scene, small())
    with pytest.raises(RadioError, match=says):
        do(radio)
    with (
        served(radio) as port,
        ZeroMqRadio("127.0.0.1", port) as driver,
        pytest.raises(RadioError, match=says),
    ):
        do(driver)


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner),
    max_leaves=5,
)
commands = st.fixed_dictionaries(
    {"do": st.sampled_from(["open", "tune", "time", "burst", "close"]) | json_values},
    optional=dict.fromkeys(("number", "version", "carrier_hz", "start_ns"), json_values),
)
messages = st.lists(
    st.binary(max_size=64) | st.builds(lambda c: json.dumps(c).encode(), commands), max_size=4
)


@pytest.mark.thorough
def test_bytes_from_anyone(scene) -> None:
    """Whatever comes in, the radio answers with one line or not at all, and goes on serving."""
    context = zmq.Context()
    with served(virtual(scene, small())) as port:
        sockets = [context.socket(kind) for kind in (zmq.DEALER, zmq.DEALER, zmq.ROUTER)]
        for k, socket in enumerate(sockets):
            socket.connect(f"tcp://127.0.0.1:{port + k}")

        @given(frames=messages, framed=st.booleans(), which=st.sampled_from([0, 0, 0, 1]))
        @settings(max_examples=400, deadline=None, suppress_health_check=list(HealthCheck))
        def send(frames, framed: bool, which: int) -> None:
            sockets[which].send_multipart([b"", *frames] if framed or not frames else frames)
            while sockets[0].poll(0):
                _, *answer = sockets[0].recv_multipart()
                assert "number" in json.loads(answer[0])

        send()
        for socket in sockets:
            socket.close(linger=0)
        last = context.socket(zmq.DEALER)
        last.connect(f"tcp://127.0.0.1:{port}")
        last.send_multipart([b"", b'{"do": "time", "number": 9}'])
        assert last.poll(5000)
        assert json.loads(last.recv_multipart()[1])["number"] == 9
    context.destroy(linger=0)


def test_longer_than_a_burst_is_not_received(scene) -> None:
    radio = virtual(scene, small())
    context = zmq.Context()
    with served(radio) as port:
        flood = context.socket(zmq.DEALER)
        flood.connect(f"tcp://127.0.0.1:{port}")
        flood.send_multipart([b"", b'{"do": "open"}', bytes(8 * radio.n_samples + 2**16 + 1)])
        assert not flood.poll(300)
        context.destroy(linger=0)
        with ZeroMqRadio("127.0.0.1", port) as driver:
            assert driver.now_ns() == 0


@pytest.mark.parametrize(
    "text", ["", "tcp", "tcp:", "tcp:0", "tcp:70000", "udp:1.2.3.4:5", "tcp:host:1", "tcp:1.2:x"]
)
def test_addresses_that_are_none(text: str) -> None:
    """What is taken is named whole: the pseudo-terminal of a camera, both forms of TCP."""
    with pytest.raises(InputError, match=r"expected tcp:PORT \(.*\) or tcp:HOST:PORT, HOST an IP"):
        parse_address(text)
    with pytest.raises(InputError, match=f"--spi-at: '{text}', expected pty, tcp:PORT "):
        parse_address(text, "--spi-at", "pty")


def test_addresses() -> None:
    assert parse_address("tcp:5555").host == "127.0.0.1"
    assert parse_address("tcp:5555").loopback
    assert not parse_address("tcp:0.0.0.0:5555").loopback
    assert parse_address("tcp:[::1]:5555").loopback


def test_faults_that_are_none() -> None:
    assert parse_faults(["overflow=0.1", "out-of-sequence=1"], RadioFaults) == RadioFaults(
        overflow=0.1, out_of_sequence=1.0
    )
    for text, says in (
        ("fire=1", "fault 'fire': expected drop, late"),
        ("late", "fault late: '', expected a number"),
        ("late=2", "fault late: 2.0, expected 0 to 1"),
        ("late=nan", "fault late: nan, expected 0 to 1"),
    ):
        with pytest.raises(InputError, match=says):
            parse_faults([text], RadioFaults)

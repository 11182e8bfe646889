"""The model of a device's clock: offset and drift, the error that it states, and jumps."""

import numpy as np
import pytest
from scipy.optimize import linprog

from hardware.drivers.clock import ClockFilter, ClockModel


def exchanges(
    clock: ClockFilter, n: int, drift: float, jitter_ns: float, rng: np.random.Generator
) -> int:
    """Host and device 5 s apart, ways of 20 us and more that are not alike; last host time."""
    host = 1_700_000_000_000_000_000
    for _ in range(n):
        host += 1_000_000_000
        there, back = 20_000 + rng.exponential(jitter_ns, 2)
        device = 5_000_000_000 + (host - 1_700_000_000_000_000_000) * drift + host
        received = round(device + there)
        clock.add(host, received, received + 1000, round(host + there + back + 1000))
    return host


@pytest.mark.parametrize("drift", [0.0, 50e-6, -200e-6])
def test_clock_finds_offset_and_drift(drift: float) -> None:
    clock = ClockFilter()
    last = exchanges(clock, 60, drift, 30_000, np.random.default_rng(1))
    model = clock.model
    assert model is not None
    assert model.drift == pytest.approx(drift, abs=2e-6)
    since = last - 1_700_000_000_000_000_000
    true_device = last + 5_000_000_000 + round(since * drift)
    assert abs(model.device_ns(last) - true_device) < 60_000
    assert model.host_ns(model.device_ns(last)) == pytest.approx(last, abs=2)
    assert 20_000 <= model.error_ns < 60_000


@pytest.mark.parametrize("jump_s", [-5.0, 0.1, 3600.0])
def test_clock_that_was_set_is_told_and_found_anew(
    jump_s: float, caplog: pytest.LogCaptureFixture
) -> None:
    """A device starts again, or the host's clock is set: older exchanges say nothing any more."""
    clock, host, jump = ClockFilter("camera"), 1_700_000_000_000_000_000, 0
    for second in range(40):
        jump = round(jump_s * 1e9) if second >= 30 else 0
        received = second * 1_000_050_000 + jump + 20_000  # drift of 50e-6
        sent = host + second * 1_000_000_000
        clock.add(sent, received, received, sent + 40_000)
    model = clock.model
    assert model is not None
    assert model.drift == pytest.approx(50e-6, abs=1e-7)
    assert abs(model.host_ns(39 * 1_000_050_000 + jump) - (host + 39 * 1_000_000_000)) < 100
    (warning,) = (record.message for record in caplog.records)
    assert f"camera: its clock jumped by {jump_s:.6g} s" in warning


def test_a_clock_that_stands_still_before_a_run_is_in_the_stated_error(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """That of a fast virtual device: 0 in 8 exchanges of 0.7 ms, which is told as an error of that
    and not as a clock that was set. In a run it gains 3 s in 0.25 s, which is told once.
    """
    clock, sent = ClockFilter("camera"), 1_700_000_000_000_000_000
    for _ in range(8):
        clock.add(sent, 0, 0, sent + 300_000)
        sent += 700_000
    assert clock.model is not None
    assert abs(clock.model.host_ns(0) - (sent - 550_000)) <= clock.model.error_ns < 3e6
    assert not caplog.records
    for received in (3_000_000_000, 6_000_000_000, 9_000_000_000):
        clock.add(sent, received, received, sent + 300_000)
        sent += 250_000_000
    (warning,) = (record.message for record in caplog.records)
    assert "camera: its clock jumped by" in warning


@pytest.mark.parametrize("jitter_ns", [0.0, 1e5, 2e6, 2e7])
@pytest.mark.parametrize("drift", [0.0, 1e-4, -5e-3, 9.9e-3])
def test_the_stated_error_of_a_clock_holds(drift: float, jitter_ns: float) -> None:
    """Lines whose one way is late at random, exchanges four times a second: at no time between the
    first exchange and the next one is a clock of even drift off by more.
    """
    rng, clock = np.random.default_rng(5), ClockFilter(ahead_s=0.3)
    start = 1_700_000_000_000_000_000
    sent_ns = np.concatenate([np.arange(8) * 10**6, np.arange(1, 100) * 250_000_000])
    for n, sent in enumerate(sent_ns.tolist()):
        there, back = 50_000, 50_000 + round(rng.exponential(jitter_ns) if jitter_ns else 0)
        received = round((sent + there) * (1 + drift))
        clock.add(start + sent, received, received, start + sent + there + back)
        model = clock.model
        assert model is not None
        first = int(sent_ns[max(0, n - 63)])
        for time in rng.integers(first + there, sent + 300_000_000, 20).tolist():
            found = model.host_ns(round(time * (1 + drift))) - start
            assert abs(found - time) * (1 + model.drift) <= model.error_ns + 3
    assert model.error_ns < 100_000 + jitter_ns


def test_the_error_of_a_clock_is_that_of_all_lines_through_its_exchanges() -> None:
    """Against a linear program, for exchanges of one second."""
    rng, clock, start = np.random.default_rng(6), ClockFilter(ahead_s=0.5), 1_700_000_000 * 10**9
    low, high, times = [], [], np.sort(rng.integers(0, 10**9, 12))
    for sent in times.tolist():
        there, back = rng.integers(10_000, 500_000, 2).tolist()
        received = round((sent + there) * 1.0002) + 777
        clock.add(start + sent, received, received, start + sent + there + back)
        middle = sent + (there + back) // 2
        offset = (received - sent - (sent + there + back) + received) / 2
        half = 1.01 * (there + back) / 2  # it drifts by up to 1 % within the exchange
        low.append((middle, offset - half))
        high.append((middle, offset + half))
    model = clock.model
    assert model is not None
    ends = [int(times[0]), max(t for t, _ in low) + 500_000_000]
    lines = np.array([[1.0, t] for t, _ in high] + [[-1.0, -t] for t, _ in low])
    limits = np.array([o for _, o in high] + [-o for _, o in low])
    halves = []
    for end in ends:
        least, most = (
            linprog([sign, sign * end], lines, limits, bounds=[(None, None), (-0.01, 0.01)]).fun
            for sign in (1.0, -1.0)
        )
        halves.append((-most - least) / 2)
        middle = model.device_ns(start + end) - (start + end) + start
        assert middle == pytest.approx((least - most) / 2, abs=5)
    alone = [
        (most - least) / 2 + abs(model.device_ns(start + t) - t - (most + least) / 2)
        for (t, least), (_, most) in zip(low[-4:], high[-4:], strict=True)
    ]
    assert model.error_ns == pytest.approx(max(*halves, min(alone)), abs=5)


@pytest.mark.parametrize("step_ns", [1_000_000, -3_000_000, 5_000_000])
def test_a_small_step_of_a_clock_is_told(step_ns: int, caplog: pytest.LogCaptureFixture) -> None:
    """Of a clock known to 50 us: told, and stated as an error until it is known again."""
    clock, start = ClockFilter("camera", ahead_s=0.3), 1_700_000_000 * 10**9
    for n in range(60):
        sent = n * 250_000_000
        received = sent + 50_000 + (step_ns if n >= 30 else 0)
        clock.add(start + sent, received, received, start + sent + 100_000)
        model = clock.model
        assert model is not None
        off = abs(model.host_ns(received) - start - sent - 50_000)
        assert off <= model.error_ns
        if n == 32:
            assert model.error_ns > abs(step_ns)
    assert model.error_ns < 100_000
    assert len(caplog.records) == 1


def test_clock_that_does_not_count_gives_the_time_of_its_latest_exchange(
    caplog: pytest.LogCaptureFixture,
) -> None:
    clock, host = ClockFilter(), 1_700_000_000_000_000_000
    for n in range(100):
        clock.add(host + n * 10**9, 7, 7, host + n * 10**9 + 200_000)
    model = clock.model
    assert model is not None
    assert model.host_ns(7) == host + 99 * 10**9 + 100_000
    assert len(caplog.records) == 1


def test_clock_refuses_time_that_runs_back() -> None:
    clock = ClockFilter()
    assert clock.model is None
    for times in ((10, 5, 4, 20), (10, 5, 6, 9), (0, 0, 100, 50)):
        with pytest.raises(ValueError, match="run back"):
            clock.add(*times)


@pytest.mark.parametrize(("step_ns", "trip_ns"), [(300_000, 260_000), (200_000, 100_000)])
def test_a_step_within_the_round_trip_is_no_sudden_certainty(step_ns: int, trip_ns: int) -> None:
    """It is not seen; what one exchange alone says is the least that is stated."""
    rng, clock, start = np.random.default_rng(7), ClockFilter(ahead_s=0.3), 1_700_000_000 * 10**9
    for n in range(80):
        sent = n * 250_000_000
        there = round(trip_ns * rng.uniform(0.3, 0.7))
        received = sent + there + (step_ns if n >= 40 else 0)
        clock.add(start + sent, received, received, start + sent + trip_ns)
        model = clock.model
        assert model is not None
        off = abs(model.host_ns(received) - start - sent - there)
        assert off <= 2.5 * model.error_ns
        assert model.error_ns > 0.49 * trip_ns


def test_a_device_that_answers_late_by_a_fast_clock_is_no_fault() -> None:
    """It holds a request for 95 ms, which by its own clock are 0.5 ms more than the trip."""
    clock, start, drift = ClockFilter(ahead_s=0.3), 1_700_000_000 * 10**9, 5e-3
    for n in range(40):
        sent = n * 250_000_000
        received, replied = (round((sent + t) * (1 + drift)) for t in (50_000, 95_050_000))
        clock.add(start + sent, received, replied, start + sent + 95_100_000)
        model = clock.model
        assert model is not None
        for t in range(sent, sent + 300_000_000, 10_000_000):
            off = model.host_ns(round(t * (1 + drift))) - start - t
            assert abs(off) <= model.error_ns


@pytest.mark.parametrize("drift", [0.0, 3e-5, -3e-5])
def test_times_far_from_the_reference_are_whole_nanoseconds(drift: float) -> None:
    """Of a clock that counts from 1970: floats had rounded them to 256 ns."""
    clock = ClockModel(1_799_999_990_000_000_000, -1_800_000_000_000_000_000, drift, 0.0)
    for device_ns in (1_014_400, 4_043_201):
        assert clock.device_ns(clock.host_ns(device_ns)) == pytest.approx(device_ns, abs=1)
    assert ClockModel(0, clock.offset_ns, 0.0, 0.0).host_ns(1_014_400) - 18 * 10**17 == 1_014_400

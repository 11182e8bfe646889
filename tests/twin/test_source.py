"""`ugv capture twin:SCENE`: the records of the twin, without a protocol in between."""

import threading
import time
from contextlib import closing
from itertools import islice

import numpy as np
import pytest
from virtual_camera import SETTINGS

import twin
from hardware import PatternSet
from hardware.drivers import SpiSettings
from hardware.sources import SourceError, open_source
from twin.fidelity import Fidelity
from twin.files import InputError
from twin.radar import load_radar, radar_capture
from twin.serve.source import records

QUICK = Fidelity(radar="targets", samples=4, max_depth=1)
SYSTEM = """
base = "workable"
name = "small"

[emitter]
rows = 16
columns = 16

[acquisition]
n_patterns = 256
"""


@pytest.fixture(scope="module")
def system(tmp_path_factory):
    path = tmp_path_factory.mktemp("systems") / "small.toml"
    path.write_text(SYSTEM)
    return path


def test_the_first_record_is_that_of_a_capture(system) -> None:
    """Bit for bit; the next ones follow without a pause, with noise of their own."""
    with closing(records(f"twin:yard?system={system}&seed=3&pace=fast", fidelity=QUICK)) as source:
        received = list(islice(source, 3))
    expected = twin.capture(
        twin.load_scene("yard"), twin.load_system(system), seed=3, fidelity=QUICK
    ).record
    first, second, third = (one.record for one in received)
    assert np.array_equal(first.counts, expected.counts)
    assert first.device == expected.device
    assert not np.array_equal(first.counts, second.counts)
    numbers = np.concatenate([record.sequence for record in (first, second, third)])
    assert np.array_equal(numbers, np.arange(len(numbers)))
    period_ns = np.diff(np.concatenate([r.device_time_ns for r in (first, second, third)]))
    assert np.ptp(period_ns) <= 1  # rounded to nanoseconds
    for one in received:  # the log's clock is the device's
        assert one.topic == "/spi/record"
        assert one.clock.host_ns(int(one.record.device_time_ns[-1])) == one.host_ns


def test_it_comes_at_its_own_pace_until_it_is_ended(system) -> None:
    over = threading.Event()
    with closing(records(f"twin:yard?system={system}", over=over, fidelity=QUICK)) as source:
        begun = time.monotonic()
        first = next(source)
        measured_s = 1e-9 * int(first.record.device_time_ns[-1])
        assert time.monotonic() - begun >= measured_s
        over.set()
        assert list(source) == []


def test_settings_configure_the_camera(system) -> None:
    wanted = SpiSettings(PatternSet(16, 16, 8, "natural", "plain"), 80e-6)
    with closing(records(f"twin:yard?system={system}&pace=fast", wanted, fidelity=QUICK)) as source:
        record = next(source).record
    assert record.patterns == wanted.patterns
    assert record.integration_time_s == 80e-6
    with pytest.raises(InputError, match=r"settings: rows, columns: the emitter has 64 x 64 cells"):
        records("twin:yard", SETTINGS)


@pytest.mark.thorough
def test_both_sensors_in_the_order_of_time(system) -> None:
    """Radar sweeps are those of a capture, each later by the sweeps before it."""
    url = f"twin:yard?system={system}&radar=prototype&seed=5&pace=fast"
    with closing(records(url, fidelity=QUICK)) as source:
        received = list(islice(source, 4))
    begins = [int(one.record.device_time_ns.flat[0]) for one in received]
    assert begins == sorted(begins)
    cameras, sweeps = (
        [one.record for one in received if one.topic == f"/{sensor}/record"]
        for sensor in ("spi", "radar")
    )
    assert cameras
    assert sweeps
    radar = load_radar("prototype")
    world = twin.load_scene("yard").after(radar.middle_s)
    expected = radar_capture(world, radar, seed=5, fidelity=QUICK).record
    assert np.array_equal(sweeps[0].iq, expected.iq)
    for number, record in enumerate(sweeps):
        assert record.device_time_ns.flat[0] == round(1e9 * number * radar.burst_s)


@pytest.mark.parametrize(
    ("query", "says"),
    [
        ("colour=red", "option 'colour' is none of system, radar, seed, pace"),
        ("seed", "'seed', expected OPTION=VALUE"),
        ("seed=-1", "seed: '-1', expected a whole number"),
        ("pace=slow", "pace: 'slow', expected real or fast"),
        ("system=none", "neither a system nor a radar"),
        ("system=no-such", "no-such"),
    ],
)
def test_what_is_wrong_in_a_url_is_told_before_anything_is_computed(query: str, says: str) -> None:
    with pytest.raises(InputError, match=says):
        records(f"twin:yard?{query}")


def test_a_url_without_a_scene_says_what_is_missing() -> None:
    with pytest.raises(InputError, match="twin:: expected a scene, twin:SCENE"):
        open_source("twin:")
    with pytest.raises(SourceError, match="no installed package offers nope:"):
        open_source("nope:")

"""Many echoes as fewer: the channel stays the same, at every antenna and time."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.constants import speed_of_light

from twin.radar import RadarDesign, load_radar
from twin.radar.synthesis import Contributions, direct_sum
from twin.radar.synthesis.joined import Resolution, joined

COUNT = 60_000


def echoes(radar: RadarDesign, seed: int) -> Contributions:
    """From two objects, 20 cm deep and half a degree wide, that move at up to 0.1 m/s."""
    rng = np.random.default_rng(seed)
    delay_s = 2 / speed_of_light * (10 + 0.2 * rng.random(COUNT))
    amplitude = np.exp(2j * np.pi * rng.random(COUNT)) * rng.random(COUNT)
    ways = rng.normal(0, 0.003, (2, COUNT, 3)) + [1, 0.2, 0]
    ways /= np.linalg.norm(ways, axis=2)[..., None]
    rate, faster = 3e-10 * rng.random(COUNT), 1e-8 * rng.random(COUNT)
    found = Contributions(amplitude, delay_s, rate, faster, *ways)
    return replace(found, object=rng.integers(2, size=COUNT).astype(np.uint32))


@pytest.mark.parametrize("at_once", [COUNT, COUNT // 7])
@pytest.mark.parametrize("name", ["hybrid-79", "hybrid-79-mimo", "prototype"])
def test_the_channel_is_the_same(name: str, at_once: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of each object, all over the band and the burst, at the elements farthest from the middle: to
    6 % of what independent echoes are together.
    """
    monkeypatch.setattr("twin.radar.synthesis.joined._AT_ONCE", at_once)
    radar = load_radar(name)
    burst, carrier_hz, gain = radar.burst, radar.ofdm.carrier_hz, radar.antenna.gain
    every = echoes(radar, 1)
    fewer = joined(every, Resolution.of(radar), gain, COUNT // 2)
    assert len(fewer) < 0.7 * COUNT
    half_hz = radar.total_bandwidth_hz - radar.ofdm.bandwidth_hz / 2
    frequencies_hz = np.linspace(-half_hz, half_hz, 9)
    times_s = np.linspace(-0.5, 0.5, 3) * radar.burst_s
    for number in (0, 1):
        channels = []
        for found in (every, fewer):
            own = found.take(found.object == number)
            received = np.sqrt(gain(own.departure) * gain(own.arrival))
            longer_m = own.departure @ burst.transmitters_m[-1]
            longer_m += own.arrival @ burst.receivers_m[-1]
            turned = np.exp(2j * np.pi * carrier_hz / speed_of_light * longer_m)
            own = replace(own, amplitude=own.amplitude * received * turned)
            channels.append(direct_sum(own, frequencies_hz, times_s, carrier_hz))
        due, got = channels
        level = np.linalg.norm((every.amplitude * gain(every.departure))[every.object == number])
        assert np.sqrt(np.mean(np.abs(got - due) ** 2)) < 0.06 * level


def test_few_echoes_stay_as_they_are() -> None:
    radar = load_radar("hybrid-79")
    few = echoes(radar, 2).take(slice(0, 100))
    assert joined(few, Resolution.of(radar), radar.antenna.gain, 100) is few


def test_what_no_antenna_receives_is_nothing() -> None:
    """Echoes from behind: not infinite where the antenna's gain is zero."""
    radar = load_radar("hybrid-79")
    behind = echoes(radar, 3)
    behind = replace(behind, departure=-behind.departure, arrival=-behind.arrival)
    fewer = joined(behind, Resolution.of(radar), radar.antenna.gain, 100)
    assert len(fewer) < COUNT
    assert not fewer.amplitude.any()

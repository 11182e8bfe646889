"""Phases of single slots, as static echoes show them, where what moves alone is looked for."""

from dataclasses import replace

import numpy as np
import pytest

from hardware.radar.process import process
from hardware.radar.settings import Processing
from tests.hardware.radar_cubes import Echo, cube
from tests.hardware.test_radar_slot_phases import WAVE, turned


def _bursts(n_slots: int, phase_rad: float, *others: Echo):
    """Records of a static echo of 60 dB, and others, whose slots are turned by phases."""
    rng = np.random.default_rng(n_slots)
    wave = replace(WAVE, n_slots=n_slots)
    static = Echo((20.0, 0, 0))
    for seed in range(5):
        record = cube(wave, [static, *others], noise_w=1e-15 * 64 * n_slots, seed=seed)
        yield turned(record, phase_rad * rng.normal(size=n_slots))


@pytest.mark.parametrize("phase_rad", [0.1, 0.5])
@pytest.mark.parametrize("n_slots", [16, 64])
def test_what_is_static_does_not_move_by_phases_of_slots(n_slots: int, phase_rad: float) -> None:
    """Each burst had up to 11 movers of up to 29 dB; a true one of 50 dB elsewhere is there."""
    more, told = 0, 0
    wave = replace(WAVE, n_slots=n_slots)
    rate = 0.3 * 2 * wave.max_velocity_m_per_s
    mover = Echo((24.0, 0, 0), 1e-10, (rate, 0, 0))
    for record in _bursts(n_slots, phase_rad, mover):
        frame = process(record, how=Processing(moving_only=True, fastest_m_per_s=rate))
        told += any("phases differ from slot to slot" in text for text in frame.warnings)
        off = [one.range_rate_m_per_s - rate for one in frame.detections]
        assert np.abs(off).min() < wave.velocity_cell_m_per_s
        more += len(off) - 1
    assert told >= 4
    assert more <= 2


def test_phases_are_measured_beside_what_they_do_not_make() -> None:
    """Of half a radian: the highest of what they spread passed for echoes that explain a part of
    the phases, and peaks were left.
    """
    detections = [len(process(record).detections) for record in _bursts(64, 0.5)]
    assert sum(detections) == len(detections)


@pytest.mark.parametrize("n_slots", [16, 64])
def test_what_phases_spread_of_an_echo_is_not_split_off(n_slots: int) -> None:
    """Phases of 0.1 rad: an echo had two to three false targets of up to 33 dB. A second one 10 dB
    below and a cell of rate away is split off.
    """
    wave = replace(WAVE, n_slots=n_slots)
    second = Echo((20.0, 0, 0), 1e-10, (1.2 * wave.velocity_cell_m_per_s, 0, 0), phase_rad=1.0)
    for others, expected in (([], 1), ([second], 2)):
        counts = [
            len(process(record, how=Processing(resolve=True)).detections)
            for record in _bursts(n_slots, 0.1, *others)
        ]
        assert counts.count(expected) >= len(counts) - 1

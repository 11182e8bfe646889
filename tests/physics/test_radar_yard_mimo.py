"""The yard before the array of three transmitters in turns, oscillator, leakage and converter as
they are: the vehicle finds what is there.
"""

import pytest

from twin import load_radar, load_scene, radar_capture
from twin.radar.evaluation import evaluate_radar


@pytest.mark.whole
def test_the_moving_car_has_its_own_rate() -> None:
    """1.44 m/s; the turns fold at 8.1, and one span more was given before."""
    radar = load_radar("hybrid-79-mimo")
    evaluation = evaluate_radar(radar, radar_capture(load_scene("yard"), radar, seed=1))
    near_car = [d for d in evaluation.detections if 8.0 < d.range_m < 8.6]
    movers = [d for d in near_car if abs(d.range_rate_m_per_s) > 0.5]
    assert movers
    for one in movers:
        assert one.range_rate_m_per_s == pytest.approx(1.438, abs=0.1)
        assert one.range_rate_alternatives_m_per_s == ()
    # Nothing in the yard is faster; a false alarm may be, and then its rate is left open.
    fast = [d for d in evaluation.detections if abs(d.range_rate_m_per_s) > 6]
    assert len(fast) <= 1
    assert all(d.range_rate_alternatives_m_per_s for d in fast)

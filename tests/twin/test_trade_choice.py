"""Which level of a speed/accuracy trade is taken."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin.fidelity import Fidelity
from twin.trade import (
    Cost,
    LevelMeasurement,
    cheapest,
    front,
    most_accurate,
)


def level(seconds: float, over_noise: float, name: str = "", own: bool = True) -> LevelMeasurement:
    cost = Cost(seconds, seconds, seconds, 3, 0.0)
    return LevelMeasurement(
        "light", name, Fidelity() if own else None, cost, 100 * over_noise, "e-", over_noise
    )


def test_the_most_accurate_level_within_a_time_is_taken() -> None:
    levels = [level(1, 0.4, "rough"), level(2, 0.1, "fine"), level(9, 0.01, "finest")]
    choice = most_accurate(levels, 2)
    assert choice.within
    assert choice.measurement.name == "fine"
    late = most_accurate(levels, 0.5)
    assert not late.within
    assert late.measurement.name == "rough"
    assert "no level takes 0.5 s or less; the cheapest takes 1 s" in late.reason
    with pytest.raises(ValueError, match="no level"):
        most_accurate([level(1, 0.0, own=False)], 1)


def test_the_cheapest_level_below_the_tolerance_is_taken() -> None:
    levels = [level(3, 0.01, "fine"), level(1, 0.9, "rough"), level(2, 0.1, "fair")]
    choice = cheapest(levels, 0.2)
    assert (choice.measurement.name, choice.within) == ("fair", True)
    assert "rough, has 0.9" in choice.reason
    assert "fine takes 1.5 times as long" in choice.reason
    assert cheapest(levels, 0.1).measurement.name == "fine"  # below, not at
    assert cheapest(levels, 5).measurement.name == "rough"


def test_of_levels_equally_fast_the_most_accurate_is_taken() -> None:
    """Quartiles of 1.0 to 1.2 s and 1.1 to 1.3 s overlap; those from 1.25 s on stand apart."""
    good = level(1.1, 0.1, "first")
    levels = [
        replace(good, cost=replace(good.cost, low_s=1.0, high_s=1.2)),
        replace(level(1.2, 0.05, "second"), cost=Cost(1.2, 1.1, 1.3, 3, 0.0)),
        replace(level(1.3, 0.01, "third"), cost=Cost(1.3, 1.25, 1.4, 3, 0.0)),
    ]
    choice = cheapest(levels, 0.2)
    assert choice.measurement.name == "second"
    assert "as fast as first within the spread" in choice.reason


def test_where_none_is_good_enough_the_most_accurate_is_taken_and_said_so() -> None:
    levels = [level(1, 0.9), level(2, 0.4, "best"), level(3, 0.6), level(0.5, np.nan)]
    choice = cheapest(levels, 0.2)
    assert (choice.measurement.name, choice.within) == ("best", False)
    assert "no level is below 0.2" in choice.reason
    assert cheapest([level(9, 0.0, own=False), *levels], 0.2).measurement.name == "best"
    with pytest.raises(ValueError, match="no level"):
        cheapest([level(1, 0.0, own=False)], 0.2)


@given(
    st.lists(st.tuples(st.floats(1e-6, 1e3), st.floats(0, 1e3)), min_size=1, max_size=20),
    st.floats(1e-6, 1e3),
)
def test_no_cheaper_level_would_do_and_none_on_the_front_is_beaten(pairs, tolerance) -> None:
    levels = [level(*pair) for pair in pairs]
    choice = cheapest(levels, tolerance)
    assert choice.within == (choice.measurement.over_noise < tolerance)
    if choice.within:
        cheaper = [m for m in levels if m.cost.seconds < choice.measurement.cost.seconds]
        assert not any(m.over_noise < tolerance for m in cheaper)
    else:
        assert choice.measurement.over_noise == min(m.over_noise for m in levels)
    best = front(levels)
    for m in levels:
        beaten = [
            b for b in best if b.cost.seconds <= m.cost.seconds and b.over_noise <= m.over_noise
        ]
        assert beaten  # by itself, when it is on the front
    times, errors = zip(*((m.cost.seconds, m.over_noise) for m in best), strict=True)
    assert list(times) == sorted(times)
    assert list(errors) == sorted(set(errors), reverse=True)

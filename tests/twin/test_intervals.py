"""Intervals of figures: what they hold, how they propagate, how they are printed."""

import json
import math

import numpy as np
import pytest

from twin.accuracy import Figure, Interval, propagated


def test_an_interval_of_statistical_error_holds_95_of_100_draws() -> None:
    """Normal draws about a true value of 3: of 4000 between 94 and 96 % (three deviations of the
    binomial distribution).
    """
    drawn = np.random.default_rng(1).normal(3.0, 0.2, 4000)
    assert np.mean([Interval(x, 0.2).holds(3.0) for x in drawn]) == pytest.approx(0.95, abs=0.01)


def test_systematic_error_widens_an_interval_as_it_is() -> None:
    assert Interval(10.0, 0.5, 2.0).half_width == pytest.approx(1.96 * 0.5 + 2)
    assert Interval(10.0, 0.0, math.inf).holds(-1e9)
    assert Interval(math.inf).holds(math.inf)
    assert not Interval(math.inf).holds(1.0)
    assert Interval(math.nan).holds(math.nan)
    assert not Interval(1.0, 1.0).holds(math.nan)


def test_propagation_is_that_of_draws() -> None:
    """A product of two independent figures over a third, against 200000 draws: within 2 %."""
    a, b, c = Interval(4.0, 0.05), Interval(2.0, 0.03), Interval(5.0, 0.02)
    rng = np.random.default_rng(2)
    x, y, z = (rng.normal(f.value, f.standard_error, 200_000) for f in (a, b, c))
    ratio = propagated(lambda p, q, r: p * q / r, a, b, c)
    assert ratio.value == pytest.approx(8 / 5)
    assert ratio.standard_error == pytest.approx(float(np.std(x * y / z)), rel=0.02)


def test_systematic_errors_propagate_without_squares() -> None:
    total = propagated(
        lambda p, q: p - q, Interval(1.0, systematic=0.1), Interval(1.0, 0.3, systematic=0.2)
    )
    assert total.systematic == pytest.approx(0.3)
    assert total.standard_error == pytest.approx(0.3)


def test_two_figures_agree_where_their_errors_explain_the_difference() -> None:
    assert Interval(1.0, 0.1).agrees(Interval(1.27, 0.1))
    assert not Interval(1.0, 0.1).agrees(Interval(1.29, 0.1))
    assert Interval(1.0, 0.0, 0.2).agrees(Interval(1.3, 0.0, 0.11))
    assert not Interval(1.0).agrees(Interval(1.0 + 1e-9))


@pytest.mark.parametrize(
    ("interval", "printed"),
    [
        (Interval(27.3123, 0.05), "27.312 ± 0.098"),
        (Interval(27.3123, 0.3), "27.31 ± 0.59"),
        (Interval(0.017, 0.0002), "0.01700 ± 0.00039"),
        (Interval(2.5e6, 1e4), "2.500e6 ± 2.0e4"),
        (Interval(5.0), "5"),
        (Interval(math.nan), "nan"),
        (Interval(5.0, 0.1, math.inf), "5, error not bounded"),
    ],
)
def test_a_figure_is_printed_to_the_digits_that_it_has(interval: Interval, printed: str) -> None:
    assert str(interval) == printed


def test_a_figure_is_valid_json_whatever_its_value() -> None:
    figure = Figure(("workable", "lmmse"), "PSNR", "dB", Interval(math.inf, 0.1, math.nan))
    entry = json.loads(json.dumps(figure.entry(), allow_nan=False))
    assert entry == {
        "of": ["workable", "lmmse"],
        "name": "PSNR",
        "unit": "dB",
        "value": None,
        "standard_error": 0.1,
        "systematic": None,
        "noise": 0.0,
    }

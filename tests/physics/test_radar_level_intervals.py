"""Levels of detections: what of a body's error lies in their cell, and bounds with one end."""

import csv
import json
import math

import numpy as np
import pytest

from tests.physics.radar_worlds import RADAR, ball, ground, trihedral, world
from twin.accuracy import Figure, Interval
from twin.fidelity import DEFAULT, Tolerance
from twin.radar import radar_capture
from twin.radar.evaluation import RadarEvaluation, evaluate_radar, write_detections
from twin.radar.intervals import level_interval
from twin.radar.propagation.facets.errors_by_range import ErrorsByRange
from twin.radar.propagation.solvers import trace
from twin.scene import Scene

SENT_W = RADAR.front_end.transmit_power_w.value


def strong_before_weak() -> Scene:
    """A trihedral before a floor, and two balls far behind it, 40 dB weaker."""
    return world(
        trihedral("corner", (8, 1, 0), rcs_m2=100.0),
        ball("ball", (13, -1.5, 0), radius=0.2, level=3),
        ball("far ball", (17, 2.5, 0), radius=0.2, level=3),
        ground(-0.7, "concrete"),
    )


def test_a_level_has_both_ends_while_the_echo_is_above_its_error() -> None:
    """The echo is 1 of amplitude, and another of r in any phase may be missing: 1 - r to 1 + r.
    From r = 1 on nothing may be left of it, but it is at most 20 lg(1 + r) dB stronger.
    """
    for statistical, systematic in ((0.0, 0.3), (0.4, 0.5), (0.2, 0.9), (3.0, 0.0)):
        level = level_interval(-90.0, statistical, systematic)
        r = statistical + systematic
        assert level.high >= -90 + 20 * math.log10(1 + r) - 1e-9
        if r < 1:
            assert level.low == pytest.approx(-90 + 20 * math.log10(1 - r))
            assert level.systematic_above is None
        else:
            assert level.low == -math.inf
            assert level.high == pytest.approx(-90 + 20 * math.log10(1 + r))
    without_bound = level_interval(-90.0, 0.1, math.inf)
    assert (without_bound.low, without_bound.high) == (-math.inf, math.inf)


def test_an_upper_end_alone_is_an_interval() -> None:
    """It holds all that is weaker, agrees with all that reaches below its end, and says so."""
    level = Interval(-98.2, 0.5, math.inf, 0.0, 2.0)
    assert level.holds(-200.0)
    assert not level.holds(-95.1)
    assert level.high == pytest.approx(-98.2 + 2.0 + 1.96 * 0.5)
    assert level.agrees(Interval(-120.0))
    assert Interval(-120.0).agrees(level)
    assert not level.agrees(Interval(-90.0))
    assert Interval(-90.0, systematic=8.0).agrees(level)
    assert level.text("dBm") == "-98.2, at most -95.2 dBm"
    entry = json.loads(json.dumps(Figure(("radar",), "level", "dBm", level).entry()))
    assert (entry["systematic"], entry["systematic_above"]) == (None, 2.0)
    assert "systematic_above" not in Figure(("radar",), "level", "dBm", Interval(1.0)).entry()


def test_errors_by_range_add_up() -> None:
    """Whatever is added and taken apart, squared errors of every body stay."""
    rng = np.random.default_rng(3)
    body, length_m, square = rng.integers(0, 3, 500), 20 * rng.random(500), rng.random(500)
    errors = ErrorsByRange.none(0.1).plus(body[:200], length_m[:200], square[:200])
    errors = errors.plus(body[200:], length_m[200:], square[200:])
    due = np.bincount(body, square)
    np.testing.assert_allclose(np.bincount(errors.body, errors.square), due)
    assert np.abs(errors.length_m % 0.1 - 0.05).max() < 1e-9
    some = errors.of(np.array([True, False, True])).times(2.0)
    np.testing.assert_allclose(np.bincount(some.body, some.square), 4 * due * [1, 0, 1])
    moved = errors.renumbered(np.array([[0, 2], [1, 0]]), np.array([0.5, 1.0, 0.25]))
    np.testing.assert_allclose(np.bincount(moved.body, moved.square), [due[2] / 4, due[0] / 2])


def test_the_errors_of_a_profile_are_those_of_its_body() -> None:
    """All that is accepted of a body is somewhere: three times the root of the sum of squares, with
    the least of any echo and bounds of what was left out, is what is stated of the body.
    """
    found = trace(strong_before_weak(), RADAR, fidelity=DEFAULT)
    assert len(found.bodies) == 3
    for body in found.bodies:
        profile = body.profile
        assert profile is not None
        statistical = 3e-3 + 3 * math.sqrt(profile.square.sum()) / body.level_amplitude
        assert body.accepted_error == pytest.approx(statistical, rel=1e-3)
        # Cells are half a resolution cell: their powers are about that of the band.
        assert 0.3 < math.sqrt(profile.power.sum()) / body.amplitude < 3


@pytest.fixture(scope="module")
def evaluations() -> tuple[RadarEvaluation, RadarEvaluation]:
    """By the default tolerance, and by one of a tenth; the same noise."""
    by_default, finely = (
        evaluate_radar(RADAR, radar_capture(strong_before_weak(), RADAR, fidelity=tolerance))
        for tolerance in (Tolerance(), Tolerance(0.02))
    )
    return by_default, finely


@pytest.mark.thorough
def test_levels_hold_those_of_a_finer_trace(
    evaluations: tuple[RadarEvaluation, RadarEvaluation],
) -> None:
    """Of every detection 20 dB above the noise, and within what the model alone is off by, but for
    what noise and rounding of the converter in between leave different, 0.1 dB, and its standard
    error, which holds what echoes beside it move it by: some lie in the side lobes of stronger
    ones, on four cells of range.
    """
    found, fine = evaluations
    cell = found.waveform.range_cell_m
    assert len(found.detections) > 20
    for detection, interval in zip(found.detections, found.intervals, strict=True):
        if detection.snr_db < 20:
            continue
        truths = [
            10 * math.log10(each.power_w * 1e3)
            for each in fine.detections
            if abs(each.range_m - detection.range_m) < 4 * cell
        ]
        level = interval.level_dbm.of_model
        more = 0.1 + 3 * 10 / math.log(10) * detection.power_error_w / detection.power_w
        assert any(level.low - more <= truth <= level.high + more for truth in truths)


def test_a_weak_body_far_from_a_strong_one_has_its_own_error(
    evaluations: tuple[RadarEvaluation, RadarEvaluation],
) -> None:
    """A strong body's whole error is above the echo of a weak one, 5 m away; what of it lies in the
    weak one's cell is not.
    """
    found, _ = evaluations
    bodies = {body.name: body for body in found.capture.propagation.bodies}
    corner = bodies["corner"]
    near = [
        (detection, interval.level_dbm.of_model)
        for detection, interval in zip(found.detections, found.intervals, strict=True)
        if abs(detection.range_m - 12.8) < 0.2
    ]
    assert near
    for detection, level in near:
        whole = math.sqrt(SENT_W) * corner.estimated_error * corner.level_amplitude
        assert whole > 0.1 * math.sqrt(detection.power_w)
        assert level.value - level.low < 1.0


def test_the_columns_of_detections_have_the_upper_end(
    evaluations: tuple[RadarEvaluation, RadarEvaluation], tmp_path
) -> None:
    found, _ = evaluations
    write_detections(found, tmp_path / "detections.csv")
    with (tmp_path / "detections.csv").open() as file:
        rows = list(csv.DictReader(file))
    for row, interval in zip(rows, found.intervals, strict=True):
        has_lower_end = math.isfinite(interval.level_dbm.low)
        assert (row["model_level_dbm_systematic_above"] == "") == has_lower_end

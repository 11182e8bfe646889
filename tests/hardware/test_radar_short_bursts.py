"""Rates of bursts of few slots, beside what is static and of targets that are split."""

from dataclasses import replace

import numpy as np
import pytest
from radar_cubes import WIDE, Echo, cube
from ugv_command import ugv

from hardware.errors import InputError
from hardware.radar.process import Frame, frames, process
from hardware.radar.settings import Processing
from hardware.records import Flag, RadarRecord, write_radar_record

_NOISE_W = 3e-11  # beside echoes of 1e-9 W in 256 samples a slot
_TRIALS = 12


def _record(n_slots: int, echoes: list[Echo], seed: int) -> RadarRecord:
    return cube(replace(WIDE, n_slots=n_slots), echoes, noise_w=_NOISE_W, seed=seed)


def _point(range_m: float, cells: float, n_slots: int, rng: np.random.Generator) -> Echo:
    """Of a rate of so many cells."""
    rate = cells * replace(WIDE, n_slots=n_slots).velocity_cell_m_per_s
    return Echo((range_m, 0, 0), 1e-9, (rate, 0, 0), phase_rad=rng.uniform(0, 2 * np.pi))


def _pulls(frame: Frame, cells: list[float]) -> list[float]:
    """Errors of the rates over their standard errors, of the nearest true one each."""
    wave, pulls = frame.waveform, []
    for one in frame.detections:
        off = one.range_rate_m_per_s / wave.velocity_cell_m_per_s - np.array(cells)
        off -= wave.n_slots * np.rint(off / wave.n_slots)
        error = one.range_rate_error_m_per_s / wave.velocity_cell_m_per_s
        pulls.append(float(np.abs(off).min() / error))
    return pulls


@pytest.mark.quick(3)
@pytest.mark.parametrize("resolve", [False, True])
@pytest.mark.parametrize("n_slots", [3, 4, 6, 8, 16])
def test_errors_of_rates_hold_what_is_taken_with_the_static(n_slots: int, resolve: bool) -> None:
    """A target of any rate beyond 0.6 cells from rest, and walls of 30 and 40 dB more: one
    detection each time, off by 0.4 to 1.6 of its standard errors rms and 4.5 at most. The mean over
    slots moved rates by up to 9 m/s, 5 to 90 standard errors rms, and left echoes at rest.
    """
    rng = np.random.default_rng(n_slots)
    walls = [Echo((9.3, 0, 0), 1e-7), Echo((12.0, 0, 0), 1e-6)]
    how = Processing(moving_only=True, resolve=resolve, fastest_m_per_s=5.0)
    pulls = []
    for seed in range(_TRIALS):
        cells = rng.uniform(0.6, n_slots / 2) * rng.choice([-1, 1])
        frame = process(_record(n_slots, [_point(9.0, cells, n_slots, rng), *walls], seed), 0, how)
        assert len(frame.detections) == 1
        pulls += _pulls(frame, [cells])
    assert 0.4 < np.sqrt(np.mean(np.square(pulls))) < 1.6
    assert max(pulls) < 4.5


@pytest.mark.quick(2)
@pytest.mark.parametrize("apart", [(0.0, 0.7), (1.5, 0.0)])
@pytest.mark.parametrize("n_slots", [3, 4, 6])
def test_targets_of_few_slots_are_split(n_slots: int, apart: tuple[float, float]) -> None:
    """Two alike, cells of range or of rate apart: the search went around the rates that slots can
    tell and found up to five, off by 5 m/s and 4 to 12 standard errors rms.
    """
    rng, how = np.random.default_rng(n_slots), Processing(resolve=True, fastest_m_per_s=5.0)
    pulls, counts = [], []
    for seed in range(_TRIALS):
        first = rng.uniform(-n_slots / 2, n_slots / 2 - apart[1])
        cells = [first, first + apart[1]]
        ranges_m = (9.0, 9.0 + apart[0] * WIDE.range_cell_m)
        points = [
            _point(at_m, rate, n_slots, rng) for at_m, rate in zip(ranges_m, cells, strict=True)
        ]
        frame = process(_record(n_slots, points, seed), 0, how)
        counts.append(len(frame.detections))
        pulls += _pulls(frame, cells)
    assert counts.count(2) >= _TRIALS - 1
    assert np.sqrt(np.mean(np.square(pulls))) < 1.6


@pytest.mark.parametrize("moving_only", [False, True])
@pytest.mark.parametrize("n_slots", [4, 8])
def test_rates_of_targets_that_are_split_are_within_the_fastest(
    n_slots: int, moving_only: bool
) -> None:
    """Two of one range cell, at rates near either end of those that slots tell: half of the rates
    were off by what folds to the same, beyond the fastest, with no alternative.
    """
    rng, wave = np.random.default_rng(n_slots), replace(WIDE, n_slots=n_slots)
    cells = [0.45 * n_slots, -0.33 * n_slots]
    fastest = wave.max_velocity_m_per_s
    how = Processing(resolve=True, moving_only=moving_only, fastest_m_per_s=fastest)
    for seed in range(6):
        points = [_point(9.0, cells[0], n_slots, rng), _point(9.015, cells[1], n_slots, rng)]
        detections = process(_record(n_slots, points, seed), 0, how).detections
        assert len(detections) == 2
        for one in detections:
            off = np.array(cells) * wave.velocity_cell_m_per_s - one.range_rate_m_per_s
            assert abs(off).min() < 5 * one.range_rate_error_m_per_s


def test_two_that_move_are_not_lost_where_their_sum_is_at_rest() -> None:
    """At either sign of a rate their sum peaks there for some phases: of 40 bursts 14 had none."""
    rng = np.random.default_rng(0)
    for seed in range(12):
        points = [_point(9.0, -1.26, 4, rng), _point(8.99, 1.26, 4, rng)]
        record = _record(4, [*points, Echo((9.3, 0, 0), 3e-8)], seed)
        assert process(record, 0, Processing(moving_only=True)).detections
        split = process(record, 0, Processing(moving_only=True, resolve=True))
        assert len(split.detections) == 2
        assert max(_pulls(split, [-1.26, 1.26])) < 5


def test_two_that_move_are_told_where_one_would_be_at_rest() -> None:
    """The one echo that fits their sum best is at rest for many phases, and was left out: such a
    burst of 4 slots had no detection.
    """
    rng, cells = np.random.default_rng(0), [-0.8, 1.12]
    for seed in range(10):
        record = _record(4, [_point(9.0, rate, 4, rng) for rate in cells], seed)
        assert process(record, 0, Processing(moving_only=True, fastest_m_per_s=5.0)).detections
        how = Processing(moving_only=True, resolve=True, fastest_m_per_s=5.0)
        frame = process(record, 0, how)
        assert len(frame.detections) == 2
        assert max(_pulls(frame, cells)) < 5


@pytest.mark.parametrize("n_slots", [6, 8])
def test_a_slow_target_is_not_told_beside_another_that_it_moves(n_slots: int) -> None:
    """It is fitted with the other one, and told of neither by itself nor in that one's rate."""
    rng, pulls = np.random.default_rng(0), []
    how = Processing(moving_only=True, resolve=True, fastest_m_per_s=5.0)
    for seed in range(10):
        points = [_point(9.0, 2.0, n_slots, rng), _point(9.01, 0.3, n_slots, rng)]
        frame = process(_record(n_slots, points, seed), 0, how)
        assert len(frame.detections) == 1
        pulls += _pulls(frame, [2.0])
    assert max(pulls) < 5


def test_targets_that_are_split_migrate_as_others_do() -> None:
    """Two of one range, one of them beyond the unambiguous rate, three cells of range a burst and
    span: both at their own rates, where the errors hold them, and no other is left open.
    """
    rng = np.random.default_rng(0)
    span = 2 * WIDE.max_velocity_m_per_s
    how = Processing(resolve=True, fastest_m_per_s=1.5 * span)
    for seed in range(4):
        points = [_point(9.0, 5.0, 64, rng), _point(9.0, 6.2 + 64, 64, rng)]
        frame = process(_record(64, points, seed), 0, how)
        assert len(frame.detections) == 2
        for cells in (5.0, 70.2):
            at = cells * WIDE.velocity_cell_m_per_s
            nearest = min(frame.detections, key=lambda d: abs(d.range_rate_m_per_s - at))
            assert abs(nearest.range_rate_m_per_s - at) < 5 * nearest.range_rate_error_m_per_s
        assert not any(d.range_rate_alternatives_m_per_s for d in frame.detections)


def test_a_slow_target_beside_another_is_not_split() -> None:
    """At 0.1 cells, where its mean takes nearly all of it: what is left spreads over rates and was
    taken for three targets, 20 standard errors away.
    """
    rng, cells = np.random.default_rng(0), [0.1, 0.8]
    points = [_point(9.0, 0.1, 8, rng), _point(9.0 + 1.5 * WIDE.range_cell_m, 0.8, 8, rng)]
    how = Processing(moving_only=True, resolve=True, fastest_m_per_s=5.0)
    for seed in range(6):
        frame = process(_record(8, points, seed), 0, how)
        assert 1 <= len(frame.detections) <= 2
        assert max(_pulls(frame, cells)) < 5


def test_two_slots_tell_no_rate_beside_what_is_static(tmp_path) -> None:
    """Their difference is the same for all rates but for its size; rates were half the ambiguity,
    with errors a hundredth of that.
    """
    rng = np.random.default_rng(0)
    short = _record(2, [_point(9.0, 0.3, 2, rng)], 0)
    told = "burst 0: 2 slots of a transmitter, expected 3 or more"
    with pytest.raises(InputError, match=told):
        process(short, 0, Processing(moving_only=True))
    with pytest.raises(InputError, match=told):
        next(frames(short, Processing(moving_only=True)))
    assert any("2 slots of a transmitter tell one" in text for text in _warnings(short))
    write_radar_record(short, tmp_path / "short.h5")
    for command in (("detect",), ("spectrogram", "--at", "9 m")):
        done = ugv(*command, tmp_path / "short.h5", "--moving-only")
        assert done.returncode == 2
        assert done.stderr.startswith(f"ugv: error: {tmp_path / 'short.h5'}: {told}")


def _warnings(record: RadarRecord) -> tuple[str, ...]:
    return process(record, 0, Processing(resolve=True)).warnings


def test_a_burst_cut_to_two_slots_is_left_out_of_what_moves() -> None:
    pose = np.tile([0, 0, 0, 1, 0, 0, 0.0], (2, 1))
    record = cube(WIDE, [Echo((9.0, 0, 0), 1e-9, (2.0, 0, 0))], noise_w=_NOISE_W, pose=pose)
    record.flags[0, 0, 2:] = Flag.LOST
    [frame] = frames(record, Processing(moving_only=True))
    assert frame.burst == 1
    assert (
        "1 of 2 bursts left out (0), the first since: burst 0, step 0, slot 2" in frame.warnings[0]
    )
    assert "2 slots of a transmitter, expected 3" in frame.warnings[0]

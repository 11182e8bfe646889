"""Several targets closer than three cells, split by `Processing.resolve`."""

from dataclasses import replace

import numpy as np
import pytest

from hardware import Processing, process
from tests.hardware.radar_cubes import WIDE, Echo, cube

NARROW = replace(WIDE, n_subcarriers=128, n_slots=32)


def _record(cells: list[tuple[float, float]], snr_db: float, seed: int):
    """Equal echoes at cells of range and rate, of this SNR, and their ranges and rates."""
    noise_w = 1e-10
    power_w = 10 ** (snr_db / 10) * noise_w / (NARROW.n_subcarriers * NARROW.n_slots)
    ranges = [4.0 + at * NARROW.range_cell_m for at, _ in cells]
    rates = [3.0 + at * NARROW.velocity_cell_m_per_s for _, at in cells]
    phases = np.random.default_rng(seed).uniform(-np.pi, np.pi, len(cells))
    echoes = [
        Echo((r, 0, 0), power_w, (v, 0, 0), float(phase))
        for r, v, phase in zip(ranges, rates, phases, strict=True)
    ]
    return cube(NARROW, echoes, noise_w=noise_w, seed=seed), ranges, rates, power_w


@pytest.mark.parametrize(
    "cells",
    [
        [(0, 0.34), (2.90, -0.53), (5.14, -0.79), (7.46, 1.30)],
        [(0, 0), (2.5, 0), (5.0, 0)],
        [(0, 0.5), (2.48, 1.85), (4.87, 2.08), (6.53, 2.81)],
    ],
)
def test_targets_hidden_by_the_window_are_neither_split_nor_lost(cells) -> None:
    """At 50 dB, 4 seeds: as many targets as there are, and each of the three figures within 5 of
    its stated errors. Each detection split alone made ghosts between two detections, and errors of
    up to 300 stated ones.
    """
    off = []
    for seed in range(4):
        record, ranges, rates, power_w = _record(cells, 50.0, seed)
        found = process(record, 0, Processing(resolve=True)).detections
        found = sorted(found, key=lambda d: d.range_m)
        assert len(found) == len(cells)
        off += [
            [
                (d.range_m - r) / d.range_error_m,
                (d.range_rate_m_per_s - v) / d.range_rate_error_m_per_s,
                (d.power_w - power_w) / d.power_error_w,
            ]
            for d, r, v in zip(found, ranges, rates, strict=True)
        ]
    assert np.abs(off).max() < 5
    assert 0.6 < np.sqrt(np.mean(np.square(off))) < 1.4


def test_a_group_that_hides_a_target_does_not_make_another_elsewhere() -> None:
    """Pairs of 2 cells, 30 cells apart and 55 dB: side lobes of what one pair hides are no target
    of the other, which is split first.
    """
    cells = [(0.0, 0.0), (2.0, 0.4), (30.0, 0.7), (32.0, 0.2)]
    for seed in range(3):
        record, ranges, _, _ = _record(cells, 55.0, seed)
        found = process(record, 0, Processing(resolve=True)).detections
        np.testing.assert_allclose(sorted(d.range_m for d in found), ranges, atol=2e-3)


def test_bodies_that_are_no_points_neither_vanish_nor_grow() -> None:
    """A body of 60 points in three cells at 75 dB, and two targets that the window shows beside it:
    no part is stronger than the whole, which would be two that cancel; every part shows with a
    window; and neither target is lost.
    """
    random = np.random.default_rng(5)
    inside = random.uniform(-1.5, 1.5, (60, 2))
    noise_w = 1e-10
    cell_w = noise_w / (NARROW.n_subcarriers * NARROW.n_slots)
    powers_w = [10**7.5 / 60 * cell_w] * 60 + [10**3.5 * cell_w] * 2
    cells = [*inside, (9.0, 3.0), (-11.0, -5.0)]
    echoes = [
        Echo(
            (8.0 + at * NARROW.range_cell_m, 0, 0),
            power_w,
            (3.0 + rate * NARROW.velocity_cell_m_per_s, 0, 0),
            float(random.uniform(-np.pi, np.pi)),
        )
        for (at, rate), power_w in zip(cells, powers_w, strict=True)
    ]
    record = cube(NARROW, echoes, noise_w=noise_w, seed=5)
    whole = process(record).detections
    found = process(record, 0, Processing(resolve=True)).detections
    assert max(d.power_w for d in found) < 2 * max(d.power_w for d in whole)
    cell = np.array([NARROW.range_cell_m, NARROW.velocity_cell_m_per_s])
    places = np.array([(d.range_m, d.range_rate_m_per_s) for d in found]) / cell
    shown = np.array([(d.range_m, d.range_rate_m_per_s) for d in whole]) / cell
    targets = np.array([(one.place_m[0], one.velocity_m_per_s[0]) for one in echoes[-2:]]) / cell
    assert _apart(targets, places).max() < 0.3
    assert _apart(places, shown).max() < 5


def _apart(places, others):
    """Cells from each place (n, 2) to the nearest of the others."""
    return np.abs(places[:, None] - others).max(axis=-1).min(axis=1)

"""A board that crosses before a wall whose stripes are two cells wide: detail that the coarsest
measurements do not tell, which a box larger than the board would move with it.
"""

from dataclasses import replace

import numpy as np
import pytest
from spi_records import record_of

from hardware import PatternSet, PlaneMotion, SpiRecord, reconstruct
from hardware.patterns import hadamard_rows
from hardware.reconstruction.measurements import measurements
from hardware.reconstruction.motion import sightings
from hardware.reconstruction.motion.evidence import ALL_ROWS, SEARCHED_ROWS, Evidence
from hardware.reconstruction.motion.timing import exposure_times_s, middle_ns, timed_rows

N, FIELD, FRAME_S = 32, np.radians(20.0), 0.82
PATTERNS = PatternSet(N, N, N * N, "interleaved")
WALL_M, STRIPES_M, ALONG = 9.9, 0.2218, 2.7427
BOARD_M, WIDTH_M, HEIGHT_M, BEGIN_M, SPEED_M_PER_S = 5.954, 0.683, 0.776, 0.151, -0.5865


def stripes(y: np.ndarray, z: np.ndarray) -> np.ndarray:
    waves = (y * np.cos(ALONG) + z * np.sin(ALONG)) / STRIPES_M
    return 0.45 + 0.35 * np.sign(np.sin(2 * np.pi * waves + 4.953))


def bricks(y: np.ndarray, z: np.ndarray) -> np.ndarray:
    row = np.floor(z / 0.2576 + 0.854)
    along = y / 0.181 + 0.731 + 0.5 * (row % 2)
    hashed = np.sin(12.9898 * row + 78.233 * np.floor(along) + 8.537) * 43758.5453
    joint = ((z / 0.2576 + 0.854) % 1 < 0.1) | (along % 1 < 0.1)
    return np.where(joint, 0.7, 0.25 + 0.35 * (hashed % 1))


def light(time_s: float) -> np.ndarray:
    """Of each cell from 4 x 4 rays, at a time after the frame's middle."""
    part = np.tan(FIELD / 2) * (1 - (2 * np.arange(4 * N) + 1) / (4 * N))
    left, up = np.meshgrid(part, part)
    across = BOARD_M * left - BEGIN_M - SPEED_M_PER_S * time_s
    high = BOARD_M * up
    inside = (np.abs(across) < WIDTH_M / 2) & (np.abs(high) < HEIGHT_M / 2)
    wall = stripes(WALL_M * left, WALL_M * up) / WALL_M**2
    lit = np.where(inside, bricks(across, high) / BOARD_M**2, wall)
    return np.asarray(lit.reshape(N, 4, N, 4).mean(axis=(1, 3)))


TRUTH = light(0.0)
SCALE = 4000 / TRUTH.mean()


def frame() -> SpiRecord:
    rows, signs = PATTERNS.exposures
    since = (np.arange(len(rows)) + 0.5) * FRAME_S / len(rows)
    electrons = [
        light(t - FRAME_S / 2)
        .ravel()[hadamard_rows(rows[k : k + 1], N * N)[0] * signs[k] > 0]
        .sum()
        for k, t in enumerate(since)
    ]
    noise = np.random.default_rng(70).normal(0, 800, len(rows))
    record = record_of((SCALE * np.array(electrons) + 5e6 + noise)[:, None], PATTERNS)
    times = np.rint(1e9 * (since - since[0])).astype(np.int64)
    return replace(record, device_time_ns=times, integration_time_s=FRAME_S / len(rows))


#: Edges of the board, and with 5 cells of wall around it: top, left, bottom, right.
TIGHT, LARGE = (9.5, 8.0, 21.5, 18.5), (5.0, 3.0, 26.0, 24.0)
PLANE = PlaneMotion(BOARD_M, (0.0, SPEED_M_PER_S, 0.0), (FIELD, FIELD))


def decibels(image: np.ndarray) -> float:
    truth = SCALE * TRUTH
    return float(-10 * np.log10(np.mean((image - truth) ** 2) / truth.max() ** 2))


def evidence(record: SpiRecord, most_rows: int) -> Evidence:
    times = exposure_times_s(record, middle_ns(record))
    timed = timed_rows(PATTERNS, record.electrons, times, pairs_apart=False)
    return Evidence.of(PATTERNS, timed, measurements(record).noise_variance, most_rows)


@pytest.mark.thorough
def test_a_box_that_all_measurements_refute_is_not_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    """The coarsest measurements are likelier by the large box than by rest (+55); its image is
    3.0 dB worse than that of rest, and all measurements tell (-373).
    """
    monkeypatch.setattr(sightings, "_ROUNDS", ())  # a search that does not get any nearer
    record = frame()
    large = sightings.Sighting(LARGE, PLANE, 0.15)
    coarse, whole = (evidence(record, rows) for rows in (SEARCHED_ROWS, ALL_ROWS))
    still = decibels(reconstruct(record).image[0])
    taken = sightings.supported_motion(coarse, (N, N), (), (large,))
    worse = decibels(reconstruct(record, motion=taken.motion).image[0])
    print(f"coarse {taken.evidence:+.0f}: {still:.2f} -> {worse:.2f} dB")
    assert taken.motion is not None
    assert worse < still - 2.0
    assert sightings.supported_motion(coarse, (N, N), (), (large,), whole).motion is None


@pytest.mark.thorough
def test_the_board_itself_is_not_refuted() -> None:
    record = frame()
    tight = sightings.Sighting(TIGHT, PLANE, 0.15)
    coarse, whole = (evidence(record, rows) for rows in (SEARCHED_ROWS, ALL_ROWS))
    found = sightings.supported_motion(coarse, (N, N), (), (tight,), whole)
    still, moved = (decibels(reconstruct(record, motion=m).image[0]) for m in (None, found.motion))
    print(f"{found.evidence:+.0f}: {still:.2f} -> {moved:.2f} dB")
    assert moved > still + 3.0

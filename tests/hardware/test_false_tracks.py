"""Frames at rest, of made scenes, with tracks of what is not there."""

from collections.abc import Callable

import numpy as np
import pytest
from spi_records import record_of

from hardware import PatternSet
from hardware.drivers.clock import ClockModel
from hardware.motion_of_tracks import MotionOfTracks
from hardware.patterns import hadamard_rows
from hardware.radar.tracking import TargetTrack
from hardware.recording import Received
from hardware.recording.mounting import Mounting
from hardware.records import QuaternionPose, SpiRecord

N, FIELD, FRAME_S = 16, np.radians(20.0), 0.8
PATTERNS = PatternSet(N, N, N * N, "interleaved")
MOUNTING = Mounting({"spi": QuaternionPose(), "radar": QuaternionPose()}, {"spi": (FIELD, FIELD)})


def discs(rng: np.random.Generator) -> np.ndarray:
    """Sixty of them, one over another."""
    across, high = np.meshgrid(*[(np.arange(4 * N) + 0.5) / (4 * N)] * 2)
    found = np.full(across.shape, 0.4)
    for (x, y), radius, light in zip(
        rng.random((60, 2)), rng.uniform(0.02, 0.2, 60), rng.uniform(0.05, 0.9, 60), strict=True
    ):
        found[(across - x) ** 2 + (high - y) ** 2 < radius**2] = light
    return found


def stripes(rng: np.random.Generator) -> np.ndarray:
    across, high = np.meshgrid(*[np.arange(4 * N) / 4] * 2)
    turn, period = rng.uniform(0, np.pi), rng.uniform(2, 6)
    waves = (across * np.cos(turn) + high * np.sin(turn)) / period
    return 0.45 + 0.35 * np.sign(np.sin(2 * np.pi * waves))


def points(rng: np.random.Generator) -> np.ndarray:
    found = np.full((4 * N, 4 * N), 0.03)
    for down, along in rng.integers(0, 4 * N - 4, (6, 2)):
        found[down : down + 4, along : along + 4] = 0.9
    return found


def frame(picture: np.ndarray, noise: float, rng: np.random.Generator) -> SpiRecord:
    """Of noise per cell, over its mean."""
    cells = picture.reshape(N, 4, N, 4).mean(axis=(1, 3)).ravel()
    cells *= 4000 / cells.mean()
    rows, signs = PATTERNS.exposures
    light = (hadamard_rows(rows, N * N) * signs[:, None] > 0) @ cells
    light += rng.normal(0, noise * 4000 * np.sqrt(N * N / 2), len(rows)) + 5e6
    record = record_of(light[:, None], PATTERNS)
    record.device_time_ns[:] = np.arange(len(rows)) * round(1e9 * FRAME_S / len(rows))
    return record


def false_tracks(count: int, rng: np.random.Generator) -> list[TargetTrack]:
    """In the field and a little beside it, 3 to 12 m away, 0.2 to 4 m/s in any direction."""
    found = []
    for k in range(count):
        distance, azimuth = rng.uniform(3, 12), rng.uniform(-0.2, 0.2)
        speed, turn = np.exp(rng.uniform(np.log(0.2), np.log(4.0))), rng.uniform(0, 2 * np.pi)
        state = [distance, distance * azimuth, speed * np.cos(turn), speed * np.sin(turn)]
        error = rng.uniform(0.05, 0.5)
        sure = np.diag([4e-4, 4e-4, error**2, error**2])
        found.append(TargetTrack(k, np.array(state), sure, 8, 0))
    return found


@pytest.mark.slow
@pytest.mark.parametrize("made", [discs, stripes, points])
@pytest.mark.parametrize("noise", [0.003, 0.05])
def test_what_rests_stays_as_it_is_whatever_a_radar_says(
    made: Callable[[np.random.Generator], np.ndarray], noise: float
) -> None:
    """Pictures, tracks and noise of their own by seed; the image is changed in none of them."""
    gains = []
    for seed, count in enumerate((1, 1, 2, 4, 12)):
        rng = np.random.default_rng([seed, 11])
        record, tracks = frame(made(rng), noise, rng), false_tracks(count, rng)
        motion = MotionOfTracks(MOUNTING)
        for t in (0.3, 0.7):
            motion.burst("/radar", round(1e9 * t), QuaternionPose(), tracks)
        received = Received("/spi/record", record, 10**9, ClockModel(0, 0, 0.0, 0.0))
        found, told = motion.supported(received, "/spi")
        assert found.motion is None, told
        gains.append(found.evidence)
    print(f"{made.__name__}, noise {noise}: largest gain of log-likelihood {max(gains):.1f}")

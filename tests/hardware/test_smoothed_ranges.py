"""Distances from smoothed images: their errors where neighbours stand at other distances."""

from dataclasses import replace

import numpy as np
import pytest
from spi_records import record_of

from hardware import PatternSet, SpiRecord
from hardware.reconstruction import range_image
from hardware.reconstruction.shutter_images import ShutterErrors
from hardware.records import Shutter
from hardware.waveform import C_M_PER_S

SIDE = 32
LIGHT_E = 1e5  # of a cell, mean of all phases
PULSE_S = 10e-9
PHASES = {
    "one frequency": [(20e6, p) for p in np.pi / 2 * np.arange(4)],
    "two frequencies": [(f, p) for f in (20e6, 15e6) for p in np.pi / 2 * np.arange(4)],
    "16 phases": [(20e6, p) for p in np.pi / 8 * np.arange(16)],
}
_down, _along = np.mgrid[:SIDE, :SIDE]
_radius = np.hypot(_along - SIDE / 2, _down - SIDE / 2.2) / (SIDE / 3)
#: Distance of each cell, m.
WORLDS = {
    "fence of one cell": np.where(_along % 2, 3.0, 3.4),
    "fence of three cells": np.where(_along // 3 % 2, 3.0, 3.4),
    "few posts": np.where(_along % 8, 3.0, 2.0),
    "step": np.where(_along < SIDE / 2.3, 3.0, 4.0),
    "slant": 2 + 4 * (_along + 0.3 * _down) / (1.3 * SIDE),
    "sphere": np.where(_radius < 1, 4 - np.sqrt(np.clip(1 - _radius**2, 0, 1)), 5.0),
}


def phase_images(distance_m: np.ndarray, phases: list[tuple[float, float]]) -> list[np.ndarray]:
    turn = 4 * np.pi * distance_m.ravel() / C_M_PER_S
    return [LIGHT_E * (1 + np.cos(f * turn - phase)) for f, phase in phases]


def gate_images(distance_m: np.ndarray, gates: list[Shutter]) -> list[np.ndarray]:
    begins = 2 * distance_m.ravel() / C_M_PER_S
    return [
        LIGHT_E * np.clip(1 - np.abs(begins - gate.gate_delay_s) / PULSE_S, 0, None)
        for gate in gates  # as long as the pulse
    ]


def noisy_record(images: list[np.ndarray], shutters: list[Shutter], snr: float) -> SpiRecord:
    """All patterns; ``snr`` of a cell of `LIGHT_E` in one shutter's plain inverse."""
    patterns = PatternSet(SIDE, SIDE, SIDE * SIDE)
    electrons = np.stack([patterns.signal(image) for image in images], axis=1)
    noise = np.random.default_rng(1).normal(size=electrons.shape)
    electrons += 5e8 + LIGHT_E / snr * np.sqrt(SIDE * SIDE / 2) * noise
    one = record_of(electrons[:, 0], patterns)
    n = electrons.size
    return replace(
        one,
        counts=np.rint(electrons).astype(np.int32).reshape(n, 1),
        device_time_ns=np.arange(n),
        sequence=np.arange(n, dtype=np.uint32),
        flags=np.zeros(n, np.uint8),
        shutters=tuple(shutters),
        pulse_width_s=PULSE_S if shutters[0].gated else 0.0,
    )


def share_within(record: SpiRecord, distance_m: np.ndarray, most_m: float) -> tuple[float, float]:
    """Share of cells within 1.96 errors, of those on the right period; rms error over stated."""
    found = range_image(record)
    off = np.abs(found.distance_m[0] - distance_m)
    right = off < most_m
    assert right.mean() > 0.95
    ratio = off[right] / found.standard_error_m[0][right]
    return float(np.mean(ratio < 1.96)), float(np.sqrt(np.mean(ratio**2)))


@pytest.mark.parametrize("snr", [5, 20, 100])
@pytest.mark.parametrize("kind", PHASES)
def test_errors_of_distances_by_phase_hold_what_smoothing_takes(kind: str, snr: float) -> None:
    """Smoothing draws the phases of neighbours together, in all shutters and frequencies alike: 93
    to 100 % of the cells, which is 2 to 98 % where the shutters' errors count as independent (a
    fence of one cell, 16 phases: 3.6 stated errors off).
    """
    shutters = [Shutter(*one) for one in PHASES[kind]]
    for name, distance in WORLDS.items():
        record = noisy_record(phase_images(distance, PHASES[kind]), shutters, snr)
        within, rms = share_within(record, distance, C_M_PER_S / 4 / 20e6)
        assert within > 0.93, name
        assert 0.7 < rms < 1.15, name


@pytest.mark.parametrize("snr", [5, 20, 100])
def test_errors_of_distances_by_gates_hold_what_smoothing_takes(snr: float) -> None:
    """What smoothing takes of one gate it gives the next: 93 to 100 %, in place of 88 to 99 %."""
    gates = [Shutter(gate_delay_s=k * PULSE_S, gate_width_s=PULSE_S) for k in range(1, 5)]
    for name in ("fence of one cell", "fence of three cells", "step", "sphere"):
        distance = WORLDS[name]
        within, _ = share_within(
            noisy_record(gate_images(distance, gates), gates, snr), distance, 2
        )
        assert within > 0.93, name


def test_smoothing_all_shutters_together_is_more_accurate() -> None:
    """16 phases of a fence hold two pictures, not 16: each by itself is 0.094 m off, rms."""
    distance, shutters = WORLDS["fence of one cell"], [Shutter(*one) for one in PHASES["16 phases"]]
    record = noisy_record(phase_images(distance, PHASES["16 phases"]), shutters, 20)
    off = range_image(record).distance_m[0] - distance
    assert np.sqrt(np.mean(off**2)) < 0.06


def test_independent_errors_add_by_their_squares() -> None:
    errors = np.array([3.0, 4.0])[:, None, None, None]
    tied = ShutterErrors.independent(errors)
    assert np.linalg.norm(tied.of_sum(np.ones((2, 1)))) == pytest.approx(5.0)
    np.testing.assert_allclose(tied.of_shutters[:, 0], [3.0, 4.0])


def test_a_single_pattern_tells_no_error_and_no_confidence() -> None:
    """Its noise is unknown: no warning of NumPy's, and nothing is claimed."""
    patterns, phases = PatternSet(4, 4, 1), PHASES["two frequencies"]
    light = [patterns.signal(image) for image in phase_images(np.full((4, 4), 3.0), phases)]
    record = record_of(np.stack(light, axis=1).ravel()[:2], patterns)
    n = 2 * len(phases)
    record = replace(
        record,
        counts=np.rint(np.stack(light, axis=1)).astype(np.int32).reshape(n, 1),
        device_time_ns=np.arange(n),
        sequence=np.arange(n, dtype=np.uint32),
        flags=np.zeros(n, np.uint8),
        shutters=tuple(Shutter(*one) for one in phases),
    )
    found = range_image(record)
    assert np.isinf(found.standard_error_m).all()
    assert not found.confidence.any()

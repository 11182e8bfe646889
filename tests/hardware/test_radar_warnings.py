"""What processing a record cannot do, and says."""

from dataclasses import replace

import numpy as np
import pytest
from radar_cubes import HALF, WIDE, Echo, cube

from hardware import Cfar, Processing, process

SMALL = replace(WIDE, n_subcarriers=13, n_slots=13)


def test_a_map_that_guard_cells_cover_is_warned_of() -> None:
    """13 cells hold one cell and 6 to each side; with a guard of 3 the echo is detected."""
    record = cube(SMALL, [Echo((0.3, 0, 0))], noise_w=1e-12)
    frame = process(record)
    assert not frame.detections
    (told,) = frame.warnings
    assert "nothing can be detected on a map of 13 x 13 cells" in told
    smaller = process(record, 0, Processing(cfar=Cfar(1e-4, guard=(3, 3))))
    assert len(smaller.detections) == 1
    assert not any("guard" in warning for warning in smaller.warnings)


@pytest.mark.parametrize("shape", [(8, 16), (16, 8), (20, 4), (24, 4)])
@pytest.mark.parametrize("snr_db", [28, 32, 36])
def test_one_echo_on_a_small_map_is_detected(shape: tuple[int, int], snr_db: float) -> None:
    """The window's threshold is 28 to 36 dB over the noise, of few training cells; without it the
    strongest is no side lobe. Weaker ones beside it are lost, which a warning tells.
    """
    wave = replace(WIDE, n_subcarriers=shape[0], n_slots=shape[1])
    noise_w = 1e-9 * shape[0] * shape[1] / 10 ** (snr_db / 10)
    for seed in range(4):
        record = cube(
            wave, [Echo((5.3 * wave.range_cell_m, 0, 0))], noise_w=noise_w, counts=2000, seed=seed
        )
        frame = process(record)
        assert len(frame.detections) == 1
        assert any("weaker echoes beside it" in told for told in frame.warnings)


def test_a_map_whose_training_cells_one_echo_does_not_fill_has_no_warning() -> None:
    wave = replace(WIDE, n_subcarriers=64, n_slots=16)
    frame = process(cube(wave, [Echo((3.0, 0, 0))], noise_w=1e-8))
    assert frame.detections
    assert not any("training cells" in told for told in frame.warnings)


def test_flags_of_unknown_meaning_are_warned_of() -> None:
    record = cube(SMALL, [Echo((0.3, 0, 0))])
    flags = record.flags.copy()
    flags[0, 0, [2, 5]] = 16
    (told, *_) = process(replace(record, flags=flags)).warnings
    assert "flags of 2 slots hold bits of unknown meaning (16), which are ignored" in told


@pytest.mark.parametrize("off_m", [0.0, 0.4])
def test_ranges_are_those_from_the_middle_of_the_phase_centres(off_m: float) -> None:
    """Receivers 0.4 m to the left: the middle is 0.2 m to the left, and an echo on the left nearer
    to it, by 111 mm.
    """
    receivers = np.array([[0, i * HALF + off_m, 0] for i in range(-2, 3)])
    place = np.array([6.0, 4.0, 0.0])
    record = cube(WIDE, [Echo(tuple(place))], receivers_m=receivers, noise_w=1e-12)
    (found,) = process(record).detections
    ways = np.linalg.norm(place - receivers, axis=1) + np.linalg.norm(place)
    assert found.range_m == pytest.approx(ways.mean() / 2, abs=4 * found.range_error_m + 2e-5)
    middle = np.array([0, off_m / 2, 0])
    assert found.range_m == pytest.approx(np.linalg.norm(place - middle), abs=5e-3)


@pytest.mark.parametrize(("counts", "is_told"), [(0.2, True), (0.4, True), (0.7, False)])
def test_noise_of_less_than_half_a_count_is_told(counts: float, is_told: bool) -> None:
    """Of 0.2 counts an echo of 30 dB is 10 dB too weak by rounding, of 0.35 counts 0.6 dB."""
    record = cube(WIDE, [])
    noise = np.random.default_rng(0).normal(0, counts, record.iq.shape)
    frame = process(replace(record, iq=np.rint(noise).astype(np.int16)))
    assert any("less than half a count" in told for told in frame.warnings) == is_told

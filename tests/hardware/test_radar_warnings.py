"""What processing a record cannot do, and says."""

from dataclasses import replace

import numpy as np
import pytest
from radar_cubes import HALF, WIDE, Echo, cube

from hardware import Cfar, Processing, process
from hardware.calibration import CalibrationTarget, RadarCalibration

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


@pytest.mark.parametrize(
    ("noise", "echo", "is_told"),
    [
        (0.2, 0.0, True),
        (0.35, 0.0, True),
        (0.6, 0.0, False),
        (0.05, 0.7, True),
        (0.1, 3.5, True),
        (0.6, 3.5, False),
        (0.1, 20.0, False),
    ],
)
def test_levels_that_are_left_to_rounding_are_told(
    noise: float, echo: float, is_told: bool
) -> None:
    """Of 0.2 counts of noise an echo of 30 dB is 10 dB too weak by rounding; one of 0.7 counts in
    noise of 0.02 to 0.2 0.6 to 1.7 dB too strong, one of 3.5 up to 0.4 dB off.
    """
    record = cube(WIDE, [Echo((5.0, 0, 0))], counts=8000)
    rng = np.random.default_rng(0)
    iq = echo / 8000 * record.iq + rng.normal(0, noise, record.iq.shape)
    frame = process(replace(record, iq=np.rint(iq).astype(np.int16)))
    assert any("left to rounding" in told for told in frame.warnings) == is_told


def test_a_calibration_of_several_records_names_each() -> None:
    """The first had no number, so that its warnings passed for those of all."""
    record = cube(WIDE, [Echo((9.0, 0, 0))], noise_w=1e-12)
    frame = replace(process(record), warnings=("told",))
    target, bursts = CalibrationTarget(9.0, 1.0), [(1, record, frame), (2, record, frame)]
    several = RadarCalibration.of(bursts, target).warnings
    assert several[:2] == ("record 1: told", "record 2: told")
    assert RadarCalibration.of(bursts[:1], target).warnings[0] == "told"

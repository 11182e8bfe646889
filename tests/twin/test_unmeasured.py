"""Cells that the patterns do not measure: no value, from the record to scores and messages."""

from pathlib import Path

import numpy as np
import pytest

from hardware import PatternSet, reconstruct
from hardware.patterns import fwht
from hardware.processing import process
from hardware.recording import Log, Received, read_messages
from twin.camera.acquisition import Capture, capture
from twin.camera.evaluation import evaluate
from twin.camera.light import render
from twin.camera.score import score
from twin.fidelity import Fidelity
from twin.regression.metrics import CAMERA_METRICS
from twin.regression.runs import run_camera, true_cells
from twin.scene import load_scene
from twin.system import System, load_system


def taken(mode: str, scene: str = "table1") -> Capture:
    content = load_system("workable").model_dump()
    content["acquisition"]["mode"] = mode
    system = System.model_validate(content)
    return capture(load_scene(scene), system, seed=1, fidelity=Fidelity(samples=4, max_depth=1))


@pytest.mark.parametrize("mode", ["s-matrix", "plain"])
def test_the_cell_that_is_never_lit_has_no_signal_to_noise(mode: str) -> None:
    """On ee37b06 an SNR as good as its neighbours', and a value of 0 with a small error."""
    found = taken(mode)
    assert found.cells_e[0, 0] > 0
    assert found.snr[0, 0] == 0
    assert (found.snr[0, 1:] > 0).all()
    image = reconstruct(found.record)
    assert image.standard_error is not None
    assert np.isnan(image.image[0, 0, 0])
    assert np.isnan(image.standard_error[0, 0, 0])
    assert np.isfinite(image.picture).sum() == image.picture.size - 1


def test_scores_are_over_the_cells_that_are_measured() -> None:
    """Whatever the image says of the others; NaN anywhere else is no number."""
    truth = 1.0 + np.arange(256.0).reshape(16, 16)
    known = truth.copy()
    known[0, 0] = np.nan
    image = truth + 2.0
    assert score(known, image).psnr_db == pytest.approx(10 * np.log10(256**2 / 4))
    for value in (np.nan, 1e9):
        image[0, 0] = value
        assert score(known, image) == score(known, truth + 2.0)
    image[3, 3] = np.nan
    assert np.isnan(score(known, image).psnr_db)


def test_the_score_of_an_s_matrix_is_that_of_its_image() -> None:
    """By hand over 4095 cells; on ee37b06 the one never lit counts as wrong by all of it."""
    found = taken("s-matrix")
    image = reconstruct(found.record, "zero-fill")
    off = (image.picture - found.cells_e).ravel()[1:]
    psnr = 10 * np.log10(found.cells_e.ravel()[1:].max() ** 2 / np.mean(off**2))
    evaluated = evaluate(load_system("workable"), found, [image])
    assert evaluated.scores[0].psnr_db == pytest.approx(psnr)


def test_the_message_holds_no_number(tmp_path: Path) -> None:
    """32FC1 with NaN, as ROS marks what is not known (REP 118), and a warning beside it."""
    found = taken("s-matrix")
    path = tmp_path / "log.mcap"
    with Log(path) as log:
        received = Received("/spi/record", found.record, 1_000, None)
        outcome = process(received, log)
    (message,) = [one for one in read_messages(path) if one.topic == "/spi/image"]
    pixels = np.frombuffer(message.message.data[-4 * 4096 :], "<f4")
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(pixels)), [0])
    assert "nan" not in outcome.lines[0]
    assert outcome.warnings[-1].startswith("1 of 4096 cells have no value")


def test_the_regression_metrics_leave_the_cell_out() -> None:
    content = load_system("workable").model_dump()
    content["acquisition"]["mode"] = "s-matrix"
    system, scene = System.model_validate(content), load_scene("table1")
    fast = Fidelity(samples=4, max_depth=1)
    light = render(scene, system, fidelity=fast, seed=np.random.SeedSequence(0))
    assert np.isnan(true_cells(scene, system, light)[0]).sum() == 1
    outcome = run_camera(scene, system, light, "zero-fill", range(2), CAMERA_METRICS)
    for metric in CAMERA_METRICS:
        assert np.isfinite(outcome.figures[metric.name]).all()


@pytest.mark.parametrize("count", [64, 24])
def test_noise_of_references_adds_up_in_cells_that_patterns_agree_on(count: int) -> None:
    """Exposures of white noise alone, 4000 draws, through the inverse transform: the standard
    deviation of each of 64 cells is known to 1.1 %, held to 5 of that.
    """
    from hardware.reconstruction.measurements import measured_values
    from twin.detector import NoiseBudget

    patterns = PatternSet(8, 8, count, mode="reference")
    budget = NoiseBudget(0.0, 0.0, 0.0, {"read noise": 3.0})
    electrons = np.random.default_rng(0).normal(0, 3.0, (patterns.n_exposures, 4000))
    coefficients = np.zeros((64, 4000))
    coefficients[patterns.indices] = measured_values(electrons, patterns)
    found = (fwht(coefficients) / 64).std(axis=1)
    expected = budget.cells_noise_e(patterns)
    np.testing.assert_allclose(found, expected, rtol=0.055)
    assert expected[0] == pytest.approx(budget.pixel_noise_e(patterns) * np.sqrt(1 + count / 2))

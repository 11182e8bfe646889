"""The interval of the median SNR: it holds, and is no wider than what the cells can be off by."""

import numpy as np
import pytest

from tests.twin.test_interval_coverage import captured, small
from twin.camera.intervals import _share_seen, snr_interval
from twin.fidelity import Fidelity
from twin.scene import load_scene


@pytest.mark.parametrize("spread", [0.0, 0.5, 3.0])
@pytest.mark.parametrize("overstated", [1.0, 10.0])
def test_errors_are_as_large_as_neighbours_let_them_be(overstated: float, spread: float) -> None:
    """Never taken smaller than they are, whatever the true SNRs differ by; of equal cells with
    errors that are stated ten times too large a tenth is left.
    """
    rng = np.random.default_rng(5)
    shape, error = (48, 48), 0.1
    true = 2.0 + spread * rng.random(shape)
    snr = true + error * rng.standard_normal(shape)
    stated = np.full(shape, overstated * error)
    share = _share_seen(snr, stated, np.ones(shape, dtype=bool))
    assert share * overstated > 0.9
    if not spread:
        assert share * overstated < 1.15
    assert share <= 1


def test_few_cells_tell_nothing() -> None:
    snr = np.full((4, 4), 2.0)
    assert _share_seen(snr, 0.1 * snr, np.ones((4, 4), dtype=bool)) == 1.0


def test_the_median_of_table1_is_known_to_a_percent() -> None:
    """Renders of several seeds move it by 0.1 %, and each interval holds that of light of far more
    paths; stated errors of single cells, 0.2 of their noise, would shift it by 3 %.
    """
    scene, shape = load_scene("table1"), {"emitter.rows": 32, "emitter.columns": 32}
    system = small("workable", **shape, **{"acquisition.n_patterns": 1024})
    truth = snr_interval(captured(scene, system, Fidelity(samples=1024), 1000), "median")
    coarse = Fidelity(samples=16, light_tolerance=0.2)
    for seed in range(6):
        median = snr_interval(captured(scene, system, coarse, seed), "median").of_model
        assert median.holds(truth.value)
        assert median.half_width < 0.01 * median.value

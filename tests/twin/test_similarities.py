"""SSIM of several pairs at once is that of each by itself."""

import numpy as np
import pytest

from twin.camera.score import similarities, similarity


@pytest.mark.parametrize("shape", [(64, 64), (16, 256), (7, 9), (5, 30), (4, 3), (2, 8)])
def test_pairs_stacked_score_as_each_alone(shape: tuple[int, int]) -> None:
    """Of peaks 1e12 times apart, with cells that are not known, and of one pair alone."""
    rng = np.random.default_rng(6)
    truths = [scale * rng.random(shape) for scale in (1.0, 1e6, 1e-6)]
    truths[1][0, :2] = np.nan
    images = [truth + 0.2 * np.nanmax(truth) * rng.normal(size=shape) for truth in truths]
    alone = [similarity(*pair) for pair in zip(truths, images, strict=True)]
    np.testing.assert_allclose(similarities(truths, images), alone, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(similarities(truths[:1], images[:1]), alone[:1], rtol=1e-9)
    assert np.isnan(alone).all() == (min(shape) < 3)


def test_an_image_without_light_has_no_score_and_no_warning() -> None:
    """Of a void record: nothing over nothing. Warnings are errors here."""
    dark = np.zeros((16, 16))
    assert np.isnan(similarity(dark, dark))

"""What the vehicle's own software reaches on the yard, held against its baselines.

A failure means: worse by more than the metric's tolerance, at 1 % false alarms per test. The seeds
are fixed, so a test that passes goes on passing until something changes.
"""

from pathlib import Path

import pytest

HERE = Path(__file__).parent


@pytest.mark.quick(1)
@pytest.mark.parametrize("method", ["zero-fill", "lmmse"])
def test_full_set_of_patterns(twin_regression, method: str) -> None:
    twin_regression.camera("yard", HERE / "yard-32x32.toml", method=method)


@pytest.mark.quick(1)
@pytest.mark.parametrize("method", ["zero-fill", "lmmse"])
def test_an_eighth_of_the_patterns(twin_regression, method: str) -> None:
    twin_regression.camera("yard", HERE / "yard-32x32-128.toml", method=method, seeds=24)


@pytest.mark.thorough
def test_radar_detections(twin_regression) -> None:
    twin_regression.radar("yard", HERE / "yard-radar.toml", seeds=8)

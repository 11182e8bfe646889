"""Where paths of a moving frame go."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from twin.optics.path_drawing import Drawing, Part
from twin.optics.paths import TracingQuality


@pytest.mark.parametrize("is_smooth", [False, True])
def test_a_cell_gets_paths_by_what_those_around_it_found(is_smooth: bool) -> None:
    """Two sets of paths that miss the same agree: were their difference to decide, such a cell
    would be left as it is, and light be too bright where dark things are missed (2.5e-4 in the
    first exposure of `crossing`).
    """
    grid = SimpleNamespace(rows=8, columns=8, size=64)
    tracer: Any = SimpleNamespace(start=grid, seed=1, quality=TracingQuality())
    drawing = Drawing(lambda times: tracer, Part(lambda *_: None, 1.7, is_smooth), 0)
    cells, samples = np.arange(64), np.full(64, 4)
    sums = np.random.default_rng(1).normal(40.0, 1.0, (64, 2))
    agreeing = sums.copy()
    agreeing[27] = sums[27].mean()

    def variances(sums: Any) -> Any:
        light = (sums / 4).mean(axis=1)[None]
        return drawing._variance(light, cells, np.zeros(64, np.int64), samples, sums)

    (_, planned), (stated, agreed) = variances(sums), variances(agreeing)
    assert agreed[27] == pytest.approx(planned[27], rel=1e-12)
    assert agreed[28] < planned[28]
    assert stated[27] > 0

"""Which edges count for a cell, against the same by sorting."""

import numpy as np

from hardware.compiled import kernel
from twin.radar.propagation.diffraction import shadow_bounds


def test_nearest_edges_are_those_of_sorted_ones() -> None:
    """Of all, of the other side of that one, and the same across it, of those that paths face."""
    rng = np.random.default_rng(4)
    root_q, faces = rng.exponential(size=(200, 12)), rng.random((200, 12)) < 0.6
    root_q[rng.random(root_q.shape) < 0.3] = np.inf
    lit = rng.normal(size=(12, 3))
    lit /= np.linalg.norm(lit, axis=1)[:, None]
    cosine, opposite = lit @ lit.T, -0.5

    def least(row: np.ndarray, of: np.ndarray) -> tuple[int, float]:
        among = np.where(of, row, np.inf)
        return int(among.argmin()), float(among.min())

    search = kernel(shadow_bounds._of_cell, shadow_bounds._cosine)
    for i, row in enumerate(root_q):
        edges, roots = np.zeros(4, dtype=np.int64), np.full(4, np.inf)
        search(row, faces[i], lit, opposite, edges, roots)
        of = np.ones(12, dtype=bool)
        for k in (0, 2):
            nearest, root = least(row, of)
            due = [root, least(row, of & (cosine[nearest] < opposite))[1]]
            np.testing.assert_array_equal(roots[k : k + 2], due)
            assert not np.isfinite(root) or edges[k] == nearest
            of = faces[i] & (np.abs(cosine[edges[0]]) <= shadow_bounds._ALONG)

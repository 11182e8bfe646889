"""Light of a frame at instants, linear in between, and what of it each exposure collects."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.camera.chain import Chain
from twin.camera.exposures import Exposures
from twin.camera.illumination import mean_signal

Array = NDArray[np.float64]

#: Instants whose signals are computed at once.
_AT_ONCE = 32
#: Shortest interval between instants, over an exposure's integration.
_FINEST = 1 / 8


def finest_s(chain: Chain) -> float:
    """Shortest interval between instants."""
    return _FINEST * chain.system.acquisition.integration_time_s.value


@dataclass(frozen=True, eq=False)
class LightAtInstants:
    """Powers of cells at instants, (n, n_shutters, n_detectors, n_cells), and of the sun at its own
    ones, (m, n_detectors), of a scanner (m, n_patterns, 1, n_detectors), W. ``paths_error_w``: what
    paths of the cells' light err by at the worst instant, (n_detectors, n_cells); None: as in the
    frame's middle.
    """

    times_s: Array
    cells_w: Array
    sun_times_s: Array
    sun_w: Array
    motion_error: float
    path_error: float = 0.0
    paths_error_w: Array | None = None

    @property
    def sun_scatter_w(self) -> float:
        """Root mean square of what the sun's light at each instant is off its neighbours' by, as
        independent errors of all of them; kinks in time count as well.
        """
        if len(self.sun_times_s) < 3 or self.sun_w.ndim != 2:
            return 0.0
        before, at, after = (self.sun_times_s[i : len(self.sun_times_s) - 2 + i] for i in range(3))
        share = ((at - before) / (after - before))[:, None]
        between = (1 - share) * self.sun_w[:-2] + share * self.sun_w[2:]
        off2 = np.square(self.sun_w[1:-1] - between) / (1 + share**2 + (1 - share) ** 2)
        return float(np.sqrt(off2.mean(axis=0).max()))

    @property
    def n_instants(self) -> int:
        """At which light of the emitter, or of the sun, was rendered."""
        return len(np.union1d(self.times_s, self.sun_times_s))

    def exposed(self, chain: Chain, exposures: Exposures) -> tuple[Array, Array]:
        """Mean signal and sunlight of every exposure, (n_exposures, n_shutters, n_detectors)."""
        n_shutters, n_detectors = len(chain.shutters), chain.system.n_detectors
        shape = (-1, n_shutters, n_detectors)
        weights = exposures.means(self.times_s).tocsc()
        signal = np.zeros((len(exposures.starts_s), n_detectors))
        for first in range(0, len(self.times_s), _AT_ONCE):
            some = slice(first, first + _AT_ONCE)
            # Instants beside each other, like detectors.
            cells = np.moveaxis(self.cells_w[some], 0, 1).reshape(
                n_shutters, -1, self.cells_w.shape[-1]
            )
            each = mean_signal(chain.system, cells).reshape(len(signal), -1, n_detectors)
            part = weights[:, some].tocoo()
            np.add.at(signal, part.row, part.data[:, None] * each[part.row, part.col])
        means = exposures.means(self.sun_times_s)
        if self.sun_w.ndim == 2:
            sun = means @ self.sun_w
        else:
            each = np.broadcast_to(self.sun_w, (len(self.sun_w), *signal.reshape(shape).shape))
            sun = np.einsum("km,mkd->kd", means.toarray(), each.reshape(len(each), *signal.shape))
        return signal.reshape(shape), sun.reshape(shape)

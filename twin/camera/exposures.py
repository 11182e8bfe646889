"""When each exposure of a frame is taken, and what it has of light that changes meanwhile."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from twin.system import System

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Exposures:
    """All exposures of a frame in turn, of every pattern with every shutter.

    ``starts_s``: of their integration, (n,), from the start of the frame, after the dead time that
    each pattern's period begins with; ``integration_s`` long each. ``period_s``: from one to the
    next, of which there are ``n_periods``: all gates of a waveform share one.
    """

    starts_s: Array
    integration_s: float
    period_s: float
    n_periods: int

    @classmethod
    def of(cls, system: System) -> "Exposures":
        """Of a system."""
        acquisition = system.acquisition
        period, time = acquisition.pattern_period_s.value, acquisition.integration_time_s.value
        gates = system.n_exposures // system.patterns.n_exposures if system.gates_at_once else 1
        n_periods = system.n_exposures // gates
        number = np.repeat(np.arange(n_periods, dtype=np.float64), gates)
        starts: Array = number * period + (period - time)
        return cls(starts, time, period, n_periods)

    @property
    def duration_s(self) -> float:
        """Of the frame."""
        return self.n_periods * self.period_s

    @property
    def middles_s(self) -> Array:
        """Of their integration, (n,)."""
        return self.starts_s + self.integration_s / 2

    def means(self, times_s: Array) -> csr_array:
        """Weights (n, n_times) of values at instants, ascending, in each exposure's mean of what is
        linear in between: of all of them that lie within its integration, so that it is blurred.
        """
        starts, ends = self.starts_s, self.starts_s + self.integration_s
        first, last = (np.searchsorted(times_s, t, side="right") for t in (starts, ends))
        first, last = (np.clip(x, 1, len(times_s) - 1) for x in (first, last))
        rows: list[Ints] = []
        columns: list[Ints] = []
        weights: list[Array] = []
        within = np.flatnonzero(first == last)
        _put(rows, columns, weights, within, times_s, first[within], self.middles_s[within], 1.0)
        # Pieces of those that go on over an instant.
        for row in np.flatnonzero(first != last).tolist():
            inside = times_s[first[row] : last[row]]
            edges = np.concatenate([[starts[row]], inside, [ends[row]]])
            middles, share = (edges[1:] + edges[:-1]) / 2, np.diff(edges) / self.integration_s
            after = np.arange(first[row], last[row] + 1)
            _put(rows, columns, weights, np.full(len(after), row), times_s, after, middles, share)
        shape = (len(starts), len(times_s))
        flat = (np.concatenate(x) for x in (weights, rows, columns))
        value, row_of, column_of = flat
        return csr_array((value, (row_of, column_of)), shape=shape)


def _put(
    rows: list[Ints],
    columns: list[Ints],
    weights: list[Array],
    row: Ints,
    times: Array,
    after: Ints,
    at: Array,
    weight: Array | float,
) -> None:
    """Weights of the instants before and after times ``at``, added to the lists."""
    share = (at - times[after - 1]) / (times[after] - times[after - 1])
    rows += [row, row]
    columns += [after - 1, after]
    weights += [weight * (1 - share), weight * share]

"""Images of a camera between its whole sets of patterns: a new one after every few exposures."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from hardware.errors import InputError
from hardware.patterns import PatternSet
from hardware.reconstruction import measurements
from hardware.reconstruction.motion import Motion
from hardware.reconstruction.stream import SlidingWindow
from hardware.records import SpiRecord

Array = NDArray[np.float64]


class SlidingImages:
    """A `SlidingWindow` for each detector of each camera.

    Parameters
    ----------
    every
        Patterns from one image to the next.
    motion
        How the image moves, where it is known: the windows' prediction.

    Raises InputError for a number below 1.
    """

    def __init__(self, every: int, motion: Motion | None = None) -> None:
        if every < 1:
            raise InputError(f"every: {every}, expected at least 1 pattern")
        self.every, self.motion = every, motion
        self._cameras: dict[str, tuple[int, list[SlidingWindow]]] = {}  # with the last time, ns

    def update(self, sensor: str, record: SpiRecord) -> Iterator[tuple[int, Array]]:
        """Take in a record: device time, ns, and image (n_images, rows, columns), electrons, after
        every so many patterns that arrived, and after the last.

        Cells that the patterns do not measure are NaN. The windows begin anew with other patterns,
        and where the sensor's clock runs back. The level of the image is 0 until the pattern that
        lights all cells has come. Raises InputError for patterns of a user's own, which this cannot
        do.
        """
        received, patterns = record.received, record.patterns
        if not (isinstance(patterns, PatternSet) and isinstance(received.patterns, PatternSet)):
            raise InputError(
                "patterns: images between whole sets need rows of the Hadamard matrix, these are a "
                "user's own"
            )
        measured = measurements(received)
        times_ns = _ends_ns(received)
        last_ns, windows = self._cameras.get(sensor, (times_ns[0], []))
        if not windows or windows[0].patterns != patterns or times_ns[0] < last_ns:
            windows = [
                SlidingWindow(patterns, float(s), self.motion) for s in measured.noise_variance
            ]
        self._cameras[sensor] = int(times_ns[-1]), windows
        for window, variance in zip(windows, measured.noise_variance, strict=True):
            window.noise_variance = float(variance)
        places = np.flatnonzero(np.isin(patterns.indices, received.patterns.indices))
        for start in range(0, len(places), self.every):
            part = slice(start, start + self.every)
            time_ns = int(times_ns[part][-1])
            images = [
                window.push(places[part], values, 1e-9 * time_ns)
                for window, values in zip(windows, measured.values[part].T, strict=True)
            ]
            cells = np.where(patterns.unmeasured_cells, np.nan, np.stack(images))
            yield time_ns, cells.reshape(-1, patterns.rows, patterns.columns)


def _ends_ns(record: SpiRecord) -> NDArray[np.int64]:
    """Device time at the last exposure of each pattern, (count,)."""
    patterns = record.patterns
    head = patterns.n_exposures - patterns.count * (2 if patterns.mode == "differential" else 1)
    times = record.device_time_ns.reshape(patterns.n_exposures, -1)[head:]
    return np.asarray(times.reshape(patterns.count, -1)[:, -1])

"""Images of a camera between its whole sets of patterns: a new one after every few exposures."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.errors import InputError
from hardware.patterns import PatternSet
from hardware.reconstruction import measurements
from hardware.reconstruction.motion import Motion, Search
from hardware.reconstruction.motion.compensated import motion_found
from hardware.reconstruction.negative_light import negative_light
from hardware.reconstruction.stream import SlidingWindow
from hardware.records import SpiRecord

Array = NDArray[np.float64]

#: Modes each of whose values is of one time.
_OF_ONE_TIME = ("differential", "complementary")


@dataclass(frozen=True, eq=False)
class ImagesBetween:
    """Images of a record, made as they are asked for: device time, ns, and image (n_images, rows,
    columns), electrons, of each.

    ``motion``: by which they are predicted, None: values age; ``warnings``: why none was found, and
    what contradicts the values.
    """

    images: Iterator[tuple[int, Array]]
    motion: Motion | None
    warnings: tuple[str, ...] = ()


class SlidingImages:
    """A `SlidingWindow` for each detector of each camera.

    Parameters
    ----------
    every
        Patterns from one image to the next.
    motion
        How the image moves, the same at all times: the windows' prediction. A `Search`: the shift
        that each record's measurements tell, of all its images and detectors; where they tell none,
        values age. Only of modes ``differential`` and ``complementary``, whose values are each of
        one time; in others, whose values hold the mean of a set, they age.

    Raises InputError for a number that is not whole and from 1 on, and for another kind of motion.
    """

    def __init__(self, every: int, motion: Motion | Search | None = None) -> None:
        if isinstance(every, bool) or not isinstance(every, int) or every < 1:
            raise InputError(f"every: {every!r:.60}, expected a whole number of patterns from 1 on")
        if motion is not None and not isinstance(motion, Motion | Search):
            raise InputError(f"motion: {motion!r:.60}, expected a motion, Search() or None")
        self.every, self.motion = every, motion
        self._cameras: dict[str, tuple[int, list[SlidingWindow]]] = {}  # with the last time, ns

    def update(self, sensor: str, record: SpiRecord) -> ImagesBetween:
        """Take in a record: an image after every so many patterns that arrived, and after the last.

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
        motion, warnings = self.motion, tuple[str, ...]()
        if motion is not None and patterns.mode not in _OF_ONE_TIME:
            still = (
                f"motion: does not predict images between whole sets of mode {patterns.mode}, "
                f"expected {' or '.join(_OF_ONE_TIME)}: older values age"
            )
            motion, warnings = None, (still,)
        elif isinstance(motion, Search):
            motion, warnings = motion_found(record, received, measured.noise_variance, motion)
        times_ns = _ends_ns(received)
        last_ns, windows = self._cameras.get(sensor, (times_ns[0], []))
        if not windows or windows[0].patterns != patterns or times_ns[0] < last_ns:
            windows = [SlidingWindow(patterns, float(s)) for s in measured.noise_variance]
        self._cameras[sensor] = int(times_ns[-1]), windows
        for window, variance in zip(windows, measured.noise_variance, strict=True):
            window.noise_variance = float(variance)
            window.goes_on(motion, 1e-9 * int(times_ns[0]))
        places = np.flatnonzero(np.isin(patterns.indices, received.patterns.indices))
        images = self._images(windows, places, measured.values, times_ns)
        told = (*warnings, *negative_light(received, measured))
        return ImagesBetween(images, motion, told)

    def _images(
        self,
        windows: list[SlidingWindow],
        places: NDArray[np.intp],
        values: Array,
        times_ns: NDArray[np.int64],
    ) -> Iterator[tuple[int, Array]]:
        patterns = windows[0].patterns
        for start in range(0, len(places), self.every):
            part = slice(start, start + self.every)
            time_ns = int(times_ns[part][-1])
            images = [
                window.push(places[part], of_one, np.asarray(1e-9 * times_ns[part]))
                for window, of_one in zip(windows, values[part].T, strict=True)
            ]
            cells = np.where(patterns.unmeasured_cells, np.nan, np.stack(images))
            yield time_ns, cells.reshape(-1, patterns.rows, patterns.columns)


def _ends_ns(record: SpiRecord) -> NDArray[np.int64]:
    """Device time at the last exposure of each pattern, (count,)."""
    patterns = record.patterns
    head = patterns.n_exposures - patterns.count * (2 if patterns.mode == "differential" else 1)
    times = record.device_time_ns.reshape(patterns.n_exposures, -1)[head:]
    return np.asarray(times.reshape(patterns.count, -1)[:, -1])

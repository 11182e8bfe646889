"""Objects with motions of their own before a background: boxes that hide what is behind them.

What a box shows at the reference time, and what it hides then, are different unknowns: the grid
holds the background, and beside it each object, apart from each other by a gap. With known boxes
the measurements are linear in all of them, whatever is covered and uncovered within the frame.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.errors import InputError
from hardware.reconstruction.motion.model import Motion, Translation

Array = NDArray[np.float64]

#: Cells between the background and an object on the grid: the prior ties what is beside each other.
_GAP = 4


@dataclass(frozen=True)
class MovingBox:
    """A box of the image at the reference time, all of which moves alike.

    Parameters
    ----------
    top, left, bottom, right
        Its edges in cells, the first cell from -0.5 to 0.5. It may reach beyond the image.
    motion
        How it moves.

    Light of the background within the box is taken as moving with it: the tighter, the better.
    """

    top: float
    left: float
    bottom: float
    right: float
    motion: Translation

    def __post_init__(self) -> None:
        edges = (self.top, self.left, self.bottom, self.right)
        if not np.isfinite(edges).all() or self.top >= self.bottom or self.left >= self.right:
            raise InputError(
                f"motion: box: top, left, bottom, right {edges}, expected finite numbers, top "
                "above bottom and left of right"
            )

    def holds(self, places: Array) -> NDArray[np.bool_]:
        """Which places ``(n, 2)`` of the reference time lie in it."""
        low, high = np.array([self.top, self.left]), np.array([self.bottom, self.right])
        return np.asarray(((places >= low) & (places < high)).all(axis=1))


@dataclass(frozen=True)
class Layers(Motion):
    """A background and boxes in front of it, the first in front of those that follow."""

    background: Motion
    objects: tuple[MovingBox, ...]

    def sources(self, time_s: float, places: Array, shape: tuple[int, int]) -> Array:
        """See `Motion.sources`; a box hides what is behind it."""
        found = self.background.sources(time_s, places, shape)
        for one in reversed(self.objects):
            within = one.motion.sources(time_s, places, shape)
            inside = one.holds(within)
            found[inside] = within[inside]
        return found

    @property
    def parts(self) -> tuple[Motion, ...]:
        """See `Motion.parts`."""
        return (self.background, *(one.motion for one in self.objects))

    def on_grid(self, times_s: Array, places: Array, shape: tuple[int, int]) -> list[Array]:
        """Sources as `sources` has them at each time, objects moved to places of their own below
        all of the background that is seen; and last those at the reference time.
        """
        times = [*times_s.tolist(), 0.0]
        found = [self.background.sources(t, places, shape) for t in times]
        bottom = np.ceil(max(one[:, 0].max() for one in found)) + 1
        for box in reversed(self.objects):
            first = np.array([bottom + _GAP - box.top, -box.left])
            bottom += _GAP + np.ceil(box.bottom - box.top)
            for t, sources in zip(times, found, strict=True):
                within = box.motion.sources(t, places, shape)
                inside = box.holds(within)
                sources[inside] = within[inside] + first
        return found

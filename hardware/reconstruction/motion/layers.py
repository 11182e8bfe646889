"""Objects with motions of their own before a background: boxes that hide what is behind them.

What a box shows at the reference time, and what it hides then, are different unknowns: the grid
holds the background, and beside it each object, apart from each other by a gap. With known boxes
the measurements are linear in all of them, whatever is covered and uncovered within the frame.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.errors import InputError
from hardware.reconstruction.motion.approach import PlaneMotion
from hardware.reconstruction.motion.grid import Grid
from hardware.reconstruction.motion.model import Motion, Translation, all_finite

Array = NDArray[np.float64]

#: Cells between the background and an object on the grid: the prior ties what is beside each other.
_GAP = 4
#: Parts of an unknown that an edge may lie off its border.
_ROUNDED = 1e-6


@dataclass(frozen=True)
class MovingBox:
    """A box of the image at the reference time, all of which moves alike.

    Parameters
    ----------
    top, left, bottom, right
        Its edges in cells, the first cell from -0.5 to 0.5. It may reach beyond the image.
    motion
        How it moves.

    Edges are rounded to the unknowns' size, half a cell unless ``Compensation.oversampling`` says
    otherwise; standard errors leave that out, and a warning says so where it happens within the
    image at the reference time. Light of the background within the box is taken as moving with
    it: the tighter, the better.
    """

    top: float
    left: float
    bottom: float
    right: float
    motion: Translation | PlaneMotion

    def __post_init__(self) -> None:
        edges = (self.top, self.left, self.bottom, self.right)
        if not isinstance(self.motion, Translation | PlaneMotion):
            raise InputError(
                f"motion: box: moves by {type(self.motion).__name__}, expected a Shift, a "
                "ShiftTrack or a PlaneMotion"
            )
        if not all_finite(edges) or self.top >= self.bottom or self.left >= self.right:
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

    def __post_init__(self) -> None:
        if not isinstance(self.background, Motion) or isinstance(self.background, Layers):
            raise InputError(
                f"motion: background: {type(self.background).__name__}, expected a motion without "
                "layers"
            )
        kinds = {type(one).__name__ for one in self.objects} - {MovingBox.__name__}
        if kinds:
            raise InputError(f"motion: objects: {min(kinds)}, expected each a MovingBox")

    def sources(self, time_s: float, places: Array, shape: tuple[int, int]) -> Array:
        """See `Motion.sources`; a box hides what is behind it."""
        found = self.background.sources(time_s, places, shape)
        for one in reversed(self.objects):
            within = one.motion.sources(time_s, places, shape)
            inside = one.holds(within)
            found[inside] = within[inside]
        return found

    def brightness(self, time_s: float, places: Array, shape: tuple[int, int]) -> Array:
        """See `Motion.brightness`."""
        found = self.background.brightness(time_s, places, shape)
        for one in reversed(self.objects):
            inside = one.holds(one.motion.sources(time_s, places, shape))
            found[inside] = one.motion.brightness(time_s, places[inside], shape)
        return found

    @property
    def parts(self) -> tuple[Motion, ...]:
        """See `Motion.parts`."""
        return (self.background, *(one.motion for one in self.objects))

    def is_rounded(self, oversampling: int, grid: Grid) -> bool:
        """Whether an edge within the image at the reference time lies within an unknown."""
        for box in self.objects:
            low, high = np.array([box.top, box.left]), np.array([box.bottom, box.right])
            end = np.array([grid.rows, grid.columns]) - 0.5
            if (high <= -0.5).any() or (low >= end).any():
                continue
            for edge in (low, high):
                at = (edge + 0.5) * oversampling
                if ((edge > -0.5) & (edge < end) & (np.abs(at - np.rint(at)) > _ROUNDED)).any():
                    return True
        return False

    def on_grid(self, times_s: Array, places: Array, shape: tuple[int, int]) -> list[Array]:
        """Sources as `sources` has them at each time, objects moved to places of their own below
        all of the background that is seen; and last those at the reference time.
        """
        times = [*times_s.tolist(), 0.0]
        found = [self.background.sources(t, places, shape) for t in times]
        bottom = np.ceil(max(one[:, 0].max() for one in found)) + 1
        for box in reversed(self.objects):
            within = [box.motion.sources(t, places, shape) for t in times]
            inside = [box.holds(one) for one in within]
            seen = np.concatenate([one[of] for one, of in zip(within, inside, strict=True)])
            if seen.size == 0:
                continue
            # Of a box that reaches far beyond the image, what is seen of it within the frame.
            top, left = np.maximum([box.top, box.left], np.floor(seen.min(axis=0)) - 1)
            end = min(box.bottom, np.ceil(seen[:, 0].max()) + 1)
            first = np.array([bottom + _GAP - top, -left])
            bottom += _GAP + np.ceil(end - top)
            for sources, one, of in zip(found, within, inside, strict=True):
                sources[of] = one[of] + first
        return found

"""Objects with motions of their own before a background: boxes that hide what is behind them.

What a box shows at the reference time, and what it hides then, are different unknowns: the grid
holds the background, and beside it each object, apart from each other by a gap. With known boxes
the measurements are linear in all of them, whatever is covered and uncovered within the frame.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hardware.errors import InputError
from hardware.reconstruction.motion.approach import PlaneMotion
from hardware.reconstruction.motion.model import Motion, Translation, all_finite

Array = NDArray[np.float64]

#: Cells between the background and an object on the grid: the prior ties what is beside each other.
_GAP = 4
#: Share or width, in cells, of a part that counts as none.
_SLIVER = 1e-9


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

    def on_grid(
        self, times_s: Array, places: Array, size_cells: float, shape: tuple[int, int]
    ) -> list["Seen"]:
        """What square parts of cells about ``places`` show at each time; and last at the reference
        time. Objects are moved to places of their own below all of the background that is seen.
        """
        times = [*times_s.tolist(), 0.0]
        found = [[Seen.all_of(self.background, t, places, shape)] for t in times]
        bottom = np.ceil(max(layers[0].sources[:, 0].max() for layers in found)) + 1
        for box in reversed(self.objects):
            found = [
                _before(layers, box, t, places, size_cells, shape)
                for layers, t in zip(found, times, strict=True)
            ]
            seen = np.concatenate([layers[-1].sources for layers in found])
            if seen.size == 0:
                continue
            # Of a box that reaches far beyond the image, what is seen of it within the frame.
            top, left = np.maximum([box.top, box.left], np.floor(seen.min(axis=0)) - 1)
            end = min(box.bottom, np.ceil(seen[:, 0].max()) + 1)
            first = np.array([bottom + _GAP - top, -left])
            bottom += _GAP + np.ceil(end - top)
            for layers in found:
                layers[-1] = replace(layers[-1], sources=layers[-1].sources + first)
        return [Seen.together(layers) for layers in found]


@dataclass(frozen=True, eq=False)
class Seen:
    """What parts of cells show at a time: for each of n entries the index of the ``part`` (n,),
    where it stood at the reference time, ``sources`` (n, 2), and its ``light`` (n,) over that of
    the same place then, times the share of the part in which it is seen.
    """

    part: NDArray[np.intp]
    sources: Array
    light: Array

    @classmethod
    def all_of(cls, motion: Motion, time_s: float, places: Array, shape: tuple[int, int]) -> "Seen":
        """Of one motion, in all of each part."""
        sources = motion.sources(time_s, places, shape)
        return cls(np.arange(len(places)), sources, motion.brightness(time_s, places, shape))

    @classmethod
    def together(cls, layers: "list[Seen]") -> "Seen":
        """All entries that have light."""
        part, sources, light = (
            np.concatenate([getattr(one, name) for one in layers])
            for name in ("part", "sources", "light")
        )
        lit = light > 0
        return cls(part[lit], sources[lit], light[lit])


def _before(
    layers: list[Seen],
    box: MovingBox,
    time_s: float,
    places: Array,
    size_cells: float,
    shape: tuple[int, int],
) -> list[Seen]:
    """Layers with a box before them, which comes last; they keep what it leaves of each part.

    By the areas of both shares, each at its middle, so that an edge that moves by a fraction of a
    part changes measurements by as much. Where two boxes end in one part, the shares are taken as
    independent; of a camera that rolls, edges within a part are taken as along its sides.
    """
    half = size_cells / 2
    one, other = (box.motion.sources(time_s, places + side, shape) for side in (-half, half))
    extent = np.maximum(other - one, _SLIVER)  # of the part, at the reference time
    low = np.maximum(one, [box.top, box.left])
    within = np.maximum(np.minimum(other, [box.bottom, box.right]) - low, 0.0)
    share = np.minimum((within / extent).prod(axis=1), 1.0)
    middle = low + within / 2
    off = ((middle - one) / extent - 0.5) * size_cells  # from the part's middle
    off_left = -off * np.where(share < 1, share / np.maximum(1 - share, _SLIVER), 0.0)[:, None]
    behind = [
        Seen(
            layer.part,
            layer.sources + off_left[layer.part],
            layer.light * (1 - share[layer.part]),
        )
        for layer in layers
    ]
    part = np.flatnonzero(share > 0)
    light = share[part] * box.motion.brightness(time_s, places[part], shape)
    return [*behind, Seen(part, middle[part], light)]

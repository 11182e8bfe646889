"""Culling: paths that do not exist, or carry too little power, are not traced.

A path leads from the radar, directly or by its image in large surfaces, to the box of an object.
Two things are known before any ray is sent:

- Over an image there is a path only to what stands beyond the last mirror, as seen from the image,
  and within the window that the mirror's patch is; or beside it, where waves over the border of an
  only mirror count.
- A box that subtends a solid angle Omega, where the antenna's gain is at most G, receives at most
  the share G Omega / (4 pi) of the sent power, and scatters no more. By reciprocity the same share
  holds for reception. So an echo with a forward path of share p and a return path of share q has at
  most the amplitude sqrt(p q) relative to the sent wave, whatever happens in between (Cauchy and
  Schwarz; the scene is passive). The shares of all paths add up to 1 at most. So all echoes that
  begin or end with paths of shares p_1, p_2 ... have together at most the amplitude
  2 sqrt(p_1 + p_2 + ...), and paths are left out while that stays below a limit.

The bound holds for any number of bounces, any shape and any phase. It takes neither occlusion nor
the direction of reflection into account. Echoes from beyond the unambiguous range are kept: a
strong one is received, at a wrong range.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from twin.radar.device.antenna import Antenna
from twin.radar.device.design import RadarDesign
from twin.radar.propagation.scene.images import Image, in_plane
from twin.radar.propagation.scene.mesh_scene import Flats
from twin.scene.boxes import distances_m

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Amplitude of all echoes that are left out together, over the noise of a cell of the map.
OF_NOISE = 0.1
_GRAZING = 0.1  # least cosine of incidence by which what is beside a mirror is looked for
_ROUNDED = 1e-9  # of the coordinates: tolerance for their rounding
#: For each corner of a box, which of both ends along x, y, z it has.
_CORNERS = np.array([[i & 1, i >> 1 & 1, i >> 2 & 1] for i in range(8)])
_STEP_DEG = 0.25  # between samples of the antenna's pattern off its axis; around it four times that
_AT_ONCE = 2**17  # paths to boxes whose corners are tested together, 60 MB


@dataclass(frozen=True, eq=False)
class Beam:
    """An antenna's largest gain at an angle off its axis and all larger ones, (n,), in equal
    steps.
    """

    gain: Array

    def most(self, off_rad: Array) -> Array:
        """Bound of the gain at angles off the axis and all larger ones."""
        step = np.floor(np.degrees(off_rad) / _STEP_DEG).astype(np.int64)
        bound: Array = self.gain[np.clip(step, 0, len(self.gain) - 1)]
        return bound


def beam_of(antenna: Antenna) -> Beam:
    """The bound of an antenna's gain, sampled every quarter of a degree off the axis."""
    off = np.radians(np.arange(0, 180 + _STEP_DEG / 2, _STEP_DEG))[:, None]
    around = np.radians(np.arange(0, 360, 4 * _STEP_DEG))
    x = np.cos(off) + 0 * around
    directions = np.stack([x, np.sin(off) * np.cos(around), np.sin(off) * np.sin(around)], axis=-1)
    highest = antenna.gain(directions).max(axis=1)
    return Beam(np.maximum.accumulate(highest[::-1])[::-1])


def noise_amplitude(radar: RadarDesign) -> float:
    """Rms noise of a cell of the processed burst, relative to the sent wave as echoes are."""
    burst = radar.burst
    samples = burst.waveform.n_subcarriers * burst.waveform.n_slots
    samples *= len(burst.carriers_hz) * len(burst.receivers_m)
    sent = radar.front_end.transmit_power_w.value
    return float(np.sqrt(radar.sample_noise_w / samples / sent))


@dataclass(frozen=True, eq=False)
class ImageAntennas:
    """The antenna and its mirror images, from which paths begin, one row each.

    ``place`` (n, 3); ``axis`` (n, 3), the mirrored antenna's; ``gain`` (n,), its bound towards the
    first patch; ``last`` (n,), number of the last mirror's patch, through which the image is seen,
    -1 for none; ``more_m`` (n,), by how much longer paths over that patch's border may be.
    """

    place: Array
    axis: Array
    gain: Array
    last: NDArray[np.int64]
    more_m: Array

    def take(self, which: slice) -> "ImageAntennas":
        """Only some of them."""
        return ImageAntennas(*(getattr(self, f.name)[which] for f in fields(ImageAntennas)))


def image_antennas_of(
    images: Sequence[Image], flats: Flats, axis: Array, beam: Beam, more_m: float = 0.0
) -> ImageAntennas:
    """Of the radar, whose antenna looks along ``axis``, and of its images; paths over the border of
    an only mirror may be longer by ``more_m``.
    """
    mirrored = np.tile(axis, (len(images), 1))
    gain = np.full(len(images), beam.gain[0])
    last = np.array([i.patches[-1] if i.patches else -1 for i in images], dtype=np.int64)
    for row, image in enumerate(images):
        for patch in image.patches:
            normal = flats.normal[patch]
            mirrored[row] -= 2 * (mirrored[row] @ normal) * normal
        if image.patches:
            box = flats.box[image.patches[0]][None]
            gain[row] = most_gain(beam, image.places[:1], axis[None], box)[0, 0]
    places = np.array([image.place for image in images])
    longer_m = np.array([more_m if len(i.patches) == 1 else 0.0 for i in images])
    return ImageAntennas(places, mirrored, gain, last, longer_m)


def shares(
    antennas: ImageAntennas, boxes: Array, flats: Flats, beam: Beam, area_m2: Array | None = None
) -> Array:
    """Bound of the share of the sent power that meets boxes (m, 2, 3) from every antenna, (n, m).

    ``area_m2`` (m,): largest projected area of what is in each box; default: that of the box.
    """
    size = boxes[:, 1] - boxes[:, 0]
    if area_m2 is None:
        sides = size[:, [0, 1, 2]] * size[:, [1, 2, 0]]
        area_m2 = np.linalg.norm(sides, axis=1)  # largest projected area of a box
    share = np.zeros((len(antennas.place), len(boxes)))
    rows = max(_AT_ONCE // max(len(boxes), 1), 1)
    for first in range(0, len(share), rows):
        part = slice(first, first + rows)
        some = antennas.take(part)
        gain = np.minimum(most_gain(beam, some.place, some.axis, boxes), some.gain[:, None])
        distance = np.stack([distances_m(boxes, place) for place in some.place])
        with np.errstate(divide="ignore", invalid="ignore"):
            angle = np.where(distance > 0, area_m2 / distance**2, 4 * np.pi)
        share[part] = gain * np.minimum(angle, 4 * np.pi) / (4 * np.pi)
        share[part] *= _in_sight(some, boxes, flats)
    return share


@dataclass(frozen=True, eq=False)
class Worth:
    """Which paths to boxes are traced, (n, m), and the bound of the amplitude of all other echoes
    relative to the sent wave, before losses.
    """

    is_traced: Mask
    left_out: float


def worth_tracing(share: Array, limit: float) -> Worth:
    """Paths that are traced: the faintest are left out while their echoes stay below a limit.

    Parameters
    ----------
    share : (n, m)
        Of the sent power, as `shares` has it.
    limit
        Of the amplitude of all echoes that are left out, before losses.
    """
    order = np.argsort(share, axis=None)
    below = np.cumsum(share.ravel()[order])
    whole = min(1.0, float(below[-1])) if len(below) else 0.0
    lost = 2 * np.sqrt(whole * below)
    count = int(np.searchsorted(lost, limit, side="right"))
    # Paths without power are left out whatever the limit.
    count = max(count, int(np.count_nonzero(share == 0)))
    worth = np.ones(share.size, dtype=bool)
    worth[order[:count]] = False
    return Worth(worth.reshape(share.shape), float(lost[count - 1]) if count else 0.0)


def most_gain(beam: Beam, places: Array, axes: Array, boxes: Array) -> Array:
    """Bound of the gain from each place, with the antenna along its axis, towards each box."""
    middle = boxes.mean(axis=1)
    radius = np.linalg.norm(boxes[:, 1] - boxes[:, 0], axis=1) / 2
    towards = middle - places[:, None]
    distance = np.maximum(np.linalg.norm(towards, axis=2), 1e-300)
    cosine = np.einsum("nmi,ni->nm", towards, axes) / distance
    half = np.where(distance > radius, np.arcsin(np.minimum(radius / distance, 1.0)), np.pi)
    return beam.most(np.maximum(np.arccos(np.clip(cosine, -1, 1)) - half, 0.0))


def _in_sight(antennas: ImageAntennas, boxes: Array, flats: Flats) -> Mask:
    """Whether a part of each box is beyond the last mirror and seen through that mirror's patch."""
    seen = np.ones((len(antennas.place), len(boxes)), dtype=bool)
    over = np.flatnonzero(antennas.last >= 0)
    if not len(over) or not len(boxes):
        return seen
    patch = antennas.last[over]
    away, point = flats.normal[patch], flats.point[patch]
    height = np.einsum("ni,ni->n", point - antennas.place[over], away)
    away, height = away * np.where(height < 0, -1, 1)[:, None], np.abs(height)
    corners = boxes[:, _CORNERS, np.arange(3)]
    # Distance of every corner beyond the mirror's plane, (n, m, 8).
    beyond = np.einsum("mci,ni->nmc", corners - boxes[:1, :1], away)
    beyond -= np.einsum("ni,ni->n", point - boxes[0, 0], away)[:, None, None]
    scale = _ROUNDED * (np.abs(corners).max() + np.abs(antennas.place).max())
    seen[over] = (beyond > scale).any(axis=2)
    straddles = (beyond < 0).any(axis=2)
    farthest_m = np.linalg.norm(corners - antennas.place[over][:, None, None], axis=3).max(axis=2)
    more_m, cosine = antennas.more_m[over, None], height[:, None] / np.maximum(farthest_m, 1e-300)
    # Where a mirror is met obliquely a zone on it is longer.
    beside = np.sqrt(more_m * (2 * farthest_m + more_m)) / 2 / np.maximum(cosine, _GRAZING)
    beside += scale
    shrink = height[:, None, None] / np.maximum(height[:, None, None] + beyond, 1e-300)
    for axis in in_plane(away):
        here = np.einsum("ni,ni->n", antennas.place[over], axis)[:, None, None]
        there = np.einsum("mci,ni->nmc", corners, axis)
        # A corner beyond the mirror is seen through its plane at this coordinate; where the plane
        # cuts a box, the cut is no wider than the box.
        at = np.where(beyond >= 0, here + (there - here) * shrink, there)
        low = np.where(straddles, np.minimum(at, there).min(axis=2), at.min(axis=2))
        high = np.where(straddles, np.maximum(at, there).max(axis=2), at.max(axis=2))
        window = flats.extent(patch, axis)
        seen[over] &= (high >= window[:, :1] - beside) & (low <= window[:, 1:] + beside)
    return seen

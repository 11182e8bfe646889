"""Scattering of a mesh as a table over directions, filled where it is asked.

The phase of S refers to the middle of the mesh, of extent D. A part of it at r answers exp(j k r .
(u_i + u_s)), so over either direction S is band-limited to D / (2 lambda) cycles per radian, and
monostatic lobes are lambda / (2 D) wide. Nodes lie lambda / (2 D n) apart on the six faces of a
cube, equal in angle; between 2 x 2 of them for each direction S is linear. A part at the rim loses
at most (pi / (2 n))^2 / 4 of its amplitude: 15, 3.9 and 1.0 % at n = 2, 4 and 8. Measured on a
plate around its mirror's direction, rms over the peak: 2.5, 0.7 and 0.2 %.

Pairs of nodes are evaluated by physical optics when a look-up first meets them, and kept. At n = 4
a sphere of directions would have, at 79 and 2.5 GHz: for a car 9e8 and 9e5 nodes, for a person 2e8
and 2e5, for a trihedral of 0.2 m 8e6 and 9e3. One way out and back needs 10 pairs, which on one
core take 2.5 and 0.84 s, 1.5 and 0.45 s, 0.35 and 0.05 s; a look-up among known ones takes 4 us.
`benchmarks.radar_tables` prints these. So a table pays for what is small against sqrt(lambda R) and
seen again and again from within some lobes; for a car or a person at 79 GHz, whose far field begins
at kilometres, mirrored rays are the way.

A table knows plane waves alone, so it holds from 2 D^2 / lambda on, and answers from one range.
"""

import hashlib
import io
import os
import zipfile
from contextlib import suppress
from dataclasses import astuple, replace
from pathlib import Path

import numpy as np
from cachetools import LRUCache
from numpy.typing import NDArray
from scipy.constants import speed_of_light

from hardware.files import whole_file
from twin.digest import source_digest
from twin.errors import InputError
from twin.geometry import Geometry
from twin.radar.cross_section.bistatic import scattering_dyadics
from twin.radar.cross_section.optics import Quality, thinning
from twin.radar.scattering.target import MeshTarget

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Nodes = NDArray[np.int64]

#: Of a table: far below the error of interpolation.
QUALITY = Quality(tolerance=0.02, max_rays=200_000)

_MOST_NODES = 3_000_000_000  # beyond, pairs of them have no number of 64 bits
_MOST_PAIRS = 2**19  # 150 MB; then a table starts anew
_RADAR = Path(__file__).parents[1]
_SHIFT = 1 / 16  # of c / D: the second frequency, at which no part turns by more than 23 deg
_tables: "LRUCache[str, Table]" = LRUCache(64)


def table_of(
    target: MeshTarget, carrier_hz: float, nodes: int, quality: Quality = QUALITY
) -> "Table":
    """The table of a mesh, the same for the same triangles, surfaces, carrier and quality.

    The folder named by the environment variable ``TWIN_TABLES`` keeps tables from one process to
    the next; without it they live as long as the process.
    """
    key = _key(target, carrier_hz, nodes, quality)
    held = _tables.get(key)
    if held is None:
        folder = os.environ.get("TWIN_TABLES")
        file = Path(folder) / f"{key}.npz" if folder else None
        held = _tables[key] = Table(target, carrier_hz, nodes, quality, file)
    return held


class Table:
    """Dyadics of a mesh at two frequencies, by pairs of directions.

    Parameters
    ----------
    target
        Around the middle of its own box; other places are moved there.
    carrier_hz, nodes, quality
        ``nodes`` per lobe lambda / (2 D).
    file
        To begin with, and to write what is new to; an unreadable one is as none.

    Raises InputError where a sphere would have more than 3e9 nodes.
    """

    def __init__(
        self,
        target: MeshTarget,
        carrier_hz: float,
        nodes: int,
        quality: Quality = QUALITY,
        file: Path | None = None,
    ) -> None:
        center, radius = target.geometry.sphere
        self.extent_m = 2 * radius
        wavelength = speed_of_light / carrier_hz
        centered = Geometry(target.geometry.vertices_m - center, target.geometry.faces)
        self._target = replace(target, geometry=centered)
        self.far_m = 2 * self.extent_m**2 / wavelength
        self.quality = quality
        self.undersampling = thinning(self._target, carrier_hz, quality)
        self._shift_hz = _SHIFT * speed_of_light / self.extent_m
        self._frequencies = np.array([carrier_hz, carrier_hz + self._shift_hz])
        step = wavelength / (2 * self.extent_m * nodes)
        self._side = int(np.ceil(np.pi / 2 / step))  # cells along a face of the cube
        if self.nodes > _MOST_NODES:
            raise InputError(
                f"{self.extent_m / wavelength:.4g} wavelengths at {nodes} nodes per lobe are "
                f"{self.nodes:.2g} directions, expected at most {_MOST_NODES:.0e}"
            )
        self._file = file
        self._keys, self._values = _read(file)

    @property
    def filled(self) -> int:
        """Pairs of directions evaluated so far."""
        return len(self._keys)

    @property
    def nodes(self) -> int:
        """Directions on the whole sphere."""
        return 6 * (self._side + 1) ** 2

    def dyadics(self, source: Array, receiver: Array) -> Complex:
        """As `scattering_dyadics` gives them, between the nodes around, at both frequencies.

        ``source``, ``receiver`` (n, 3): unit vectors from the target; returns (n, 2, 3, 3).
        """
        a, share_a = self._around(source)
        b, share_b = self._around(receiver)
        one, other = a[:, :, None], b[:, None, :]
        # Within a cell a way and its reverse are one and the same; farther apart physical optics
        # knows only the truth's reciprocity, not its own.
        turned = (a == b).all(axis=1)[:, None, None] & (one > other)
        one, other = np.where(turned, other, one), np.where(turned, one, other)
        keys = one * self.nodes + other
        self._fill(np.unique(keys))
        values = self._values[np.searchsorted(self._keys, keys)]
        values = np.where(turned[..., None, None, None], values.swapaxes(-1, -2), values)
        return np.einsum("na,nb,nabfxy->nfxy", share_a, share_b, values)

    def answers(
        self, source: Array, receiver: Array, sent: Complex, received: Complex
    ) -> tuple[Complex, Array]:
        """S in metres at the carrier, sigma = 4 pi |S|^2, and the delay that the echo has beyond
        that of the target's middle.

        The delay is S's own, -d(phase)/d(omega): that of a lone scattering centre, of several
        their mean by strength; where they cancel each other it is kept within the target.

        Parameters
        ----------
        source, receiver, sent, received : (n, 3)
            Directions from the target, and the fields of transmitter and receiver there.
        """
        s, above = np.einsum("nx,nfxy,ny->fn", received, self.dyadics(source, receiver), sent)
        delay = -np.angle(above * s.conj()) / (2 * np.pi * self._shift_hz)
        most = self.extent_m / speed_of_light
        return s, np.clip(delay, -most, most)

    def _around(self, direction: Array) -> tuple[Nodes, Array]:
        """Numbers and shares of the four nodes around directions, both (n, 4)."""
        axis = np.argmax(np.abs(direction), axis=1)
        rows = np.arange(len(direction))
        along = direction[rows, axis]
        sides = [direction[rows, (axis + i) % 3] / np.abs(along) for i in (1, 2)]
        at = [(np.arctan(side) / (np.pi / 2) + 0.5) * self._side for side in sides]
        low = [np.clip(x.astype(np.int64), 0, self._side - 1) for x in at]
        share = [x - below for x, below in zip(at, low, strict=True)]
        edge = self._side + 1
        first = ((2 * axis + (along < 0)) * edge + low[0]) * edge + low[1]
        nodes = first[:, None] + np.array([0, 1, edge, edge + 1])
        (p, q), ones = share, np.ones_like(share[0])
        return nodes, np.stack([(ones - p) * (1 - q), (1 - p) * q, p * (1 - q), p * q], axis=1)

    def _direction(self, nodes: Nodes) -> Array:
        """Unit vectors (n, 3) of nodes by number."""
        edge = self._side + 1
        face, i, j = nodes // edge**2, nodes // edge % edge, nodes % edge
        axis, rows = face // 2, np.arange(len(nodes))
        on_cube = np.empty((len(nodes), 3))
        on_cube[rows, axis] = 1.0 - 2.0 * (face % 2)
        for step, k in ((1, i), (2, j)):
            on_cube[rows, (axis + step) % 3] = np.tan((k / self._side - 0.5) * (np.pi / 2))
        unit: Array = on_cube / np.linalg.norm(on_cube, axis=1, keepdims=True)
        return unit

    def _fill(self, wanted: Nodes) -> None:
        """Evaluate the pairs that are not there yet; keys (n,) in order."""
        if len(self._keys) > _MOST_PAIRS:
            self._keys, self._values = _read(None)
        at = np.searchsorted(self._keys, wanted)
        new = wanted[np.append(self._keys, -1)[at] != wanted]
        if not len(new):
            return
        source, receiver = (self._direction(part) for part in (new // self.nodes, new % self.nodes))
        frequencies = self._frequencies
        values = scattering_dyadics(self._target, source, receiver, frequencies, self.quality)
        keys = np.concatenate([self._keys, new])
        order = np.argsort(keys)
        self._keys = keys[order]
        self._values = np.concatenate([self._values, values])[order]
        if self._file is not None:
            _write(self._file, self._keys, self._values)


def _key(target: MeshTarget, carrier_hz: float, nodes: int, quality: Quality) -> str:
    """Digest of all that a table depends on, the source of the packages that fill it included."""
    # To 0.1 um: where the object stands leaves rounding errors in its shape.
    shape = np.round(target.geometry.vertices_m - target.geometry.sphere[0], 7) + 0.0
    digest = hashlib.sha256(shape.tobytes() + np.asarray(target.geometry.faces, np.int64).tobytes())
    if target.surface_of_face is not None:
        digest.update(np.asarray(target.surface_of_face, np.int64).tobytes())
    code = source_digest(
        *(_RADAR / room for room in ("cross_section", "propagation", "scattering"))
    )
    digest.update(repr((target.surfaces, carrier_hz, nodes, astuple(quality), code)).encode())
    return digest.hexdigest()


def _read(file: Path | None) -> tuple[Nodes, Complex]:
    if file is not None and file.is_file():
        # What can't be read is no table: it is made anew.
        with suppress(OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
            held = np.load(io.BytesIO(file.read_bytes()), allow_pickle=False)
            return held["keys"], held["values"]
    return np.zeros(0, dtype=np.int64), np.zeros((0, 2, 3, 3), dtype=np.complex128)


def _write(file: Path, keys: Nodes, values: Complex) -> None:
    """Whole or not at all; of two processes the last one's pairs stay."""
    file.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(file) as partial, partial.open("wb") as opened:
        np.savez(opened, keys=keys, values=values)

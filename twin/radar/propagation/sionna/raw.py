"""Paths as Sionna RT's solvers give them, out of their padded arrays."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

TARGET = 16  # Sionna's interaction type of a scattering point


@dataclass(frozen=True)
class RawPath:
    """One path: kind, object and triangle of each interaction, vertices (n, 3), amplitude."""

    kinds: tuple[int, ...]
    objects: tuple[int, ...]
    primitives: tuple[int, ...]
    vertices: Array
    amplitude: complex

    @staticmethod
    def unpack(solved: Any) -> "list[RawPath]":
        """Every valid one of a solver's answer."""
        real, imaginary = (np.array(part).ravel() for part in solved.a)
        n = real.size
        if n == 0:
            return []
        kinds, objects, primitives = (
            np.array(x).reshape(-1, n)
            for x in (solved.interactions, solved.objects, solved.primitives)
        )
        vertices = np.array(solved.vertices, dtype=np.float64).reshape(len(kinds), n, 3)
        valid = np.array(solved.valid).ravel()
        raw_paths = []
        for i in np.flatnonzero(valid):
            used = int(np.count_nonzero(kinds[:, i]))
            raw_paths.append(
                RawPath(
                    kinds=tuple(int(k) for k in kinds[:used, i]),
                    objects=tuple(int(o) for o in objects[:used, i]),
                    primitives=tuple(int(p) for p in primitives[:used, i]),
                    vertices=vertices[:used, i],
                    amplitude=complex(real[i], imaginary[i]),
                )
            )
        return raw_paths

"""Bounds of the light that fixed knobs leave out of a cell, as shares of its light."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from twin.scene import SceneObject
from twin.scene.texture import Texture

Array = NDArray[np.float64]

_STEP = 2.0**-24  # half a step of float32, relative
#: Steps that intersection and normal together are off at most: 4.2 were measured.
_STEPS = 8.0
#: Of the extent of vertices, by which they may lie beside a plane.
_FLAT = 1e-6


def typical_reflectance(objects: Iterable[SceneObject], albedo: Array) -> float:
    """By which light decreases from bounce to bounce: the mean of what is seen, or of all surfaces
    by their area where that is more; light may come by bright walls beside the field.
    """
    areas_m2, weighted = 0.0, 0.0
    for item in objects:
        area_m2, of = float(item.geometry.areas_m2.sum()), item.reflectance
        areas_m2 += area_m2
        weighted += area_m2 * float(of.image.mean() if isinstance(of, Texture) else of)
    seen = albedo[albedo > 0]
    of_all = weighted / areas_m2 if areas_m2 else 0.0
    return min(max(float(seen.mean()) if seen.size else 0.0, of_all), 1.0)


def bounces_share(reflectance: float, max_depth: float, indirect_share: float | None) -> float:
    """Light of bounces beyond ``max_depth``, as a share of the computed light; infinite where
    nothing absorbs light.

    Bounces are assumed to decrease as powers of a reflectance r, see `typical_reflectance`, which
    is exact in a closed room of one colour: r^d / (1 - r^d) of the light is then missing, or of the
    indirect light, where its share is known, r^(d-1) / (1 - r^(d-1)). Elsewhere it is an estimate.
    """
    if max_depth == np.inf or not reflectance:
        return 0.0
    share = _rest(reflectance**max_depth)
    if max_depth > 1 and indirect_share is not None:
        lost = _rest(reflectance ** (max_depth - 1))
        share = min(share, indirect_share * lost if indirect_share else 0.0)
    return share


def _rest(factor: float) -> float:
    return factor / (1 - factor) if factor < 1 else np.inf


def rounding_share(cosines: Array) -> Array:
    """What float32 rays are off at most, of the light of a cell with this cosine of incidence."""
    return np.divide(_STEPS * _STEP, cosines, out=np.zeros_like(cosines), where=cosines > 0)


def lie_in_a_plane(vertices_m: Iterable[Array]) -> bool:
    """Whether vertices (n, 3) of all objects lie in one plane: light on it bounces once."""
    together = np.concatenate([np.zeros((0, 3)), *vertices_m])
    if len(together) < 4:
        return True
    away = together - together.mean(axis=0)
    squares = np.linalg.eigvalsh(away.T @ away)
    return bool(squares[0] <= _FLAT**2 * squares[-1])

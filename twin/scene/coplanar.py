"""Objects of unlike surfaces in one plane, of which sensors see either one or the other."""

from collections.abc import Sequence

import numpy as np

from twin.geometry.coplanar import Facets, shared_by_two
from twin.geometry.near_boxes import near_pairs
from twin.scene.objects import Array, SceneObject
from twin.scene.texture import Texture

_RESOLVED = 1e-6  # of the distance: float32 rays meet either of two surfaces that are closer
_MOST_NAMED = 4  # pairs


def coplanar(objects: Sequence[SceneObject], place_m: Array) -> list[str]:
    """Warning for pairs of objects that show a place unlike surfaces in one plane."""
    pairs = [
        (i, j)
        for i, j in _near(objects)
        if _unlike(objects[i], objects[j]) and _share(objects[i], objects[j], place_m)
    ]
    if not pairs:
        return []
    named = [f"{_told(objects[i])} and {_told(objects[j])}" for i, j in pairs[:_MOST_NAMED]]
    more = f", and {len(pairs) - _MOST_NAMED} more pairs" if len(pairs) > _MOST_NAMED else ""
    return [
        f"in one plane, to within {_RESOLVED:g} of the distance: {'; '.join(named)}{more}: where "
        "they overlap the camera sees one of the two, which one rounding decides, the radar the "
        "one in front or else the second; move one by a tenth of a millimetre"
    ]


def _near(objects: Sequence[SceneObject]) -> list[tuple[int, int]]:
    if len(objects) < 2:
        return []
    boxes = [(item.vertices_m.min(axis=0), item.vertices_m.max(axis=0)) for item in objects]
    pairs: list[tuple[int, int]] = sorted(map(tuple, near_pairs(np.array(boxes))[0].tolist()))
    return pairs


def _unlike(one: SceneObject, other: SceneObject) -> bool:
    if isinstance(one.reflectance, Texture) or isinstance(other.reflectance, Texture):
        return one.material != other.material or one.reflectance is not other.reflectance
    return (one.material, one.reflectance) != (other.material, other.reflectance)


def _share(one: SceneObject, other: SceneObject, place_m: Array) -> bool:
    """Whether faces of both that are seen from a place share part of a plane."""
    facets = [_within_box_of(*pair, place_m) for pair in ((one, other), (other, one))]
    if not all(map(len, facets)):
        return False
    reach = max(float(np.linalg.norm(f.corners_m - place_m, axis=2).max()) for f in facets)
    shared = shared_by_two(facets[0], facets[1], _RESOLVED * reach)
    # Only now what takes long: which sides of the meshes are inside closed bodies.
    rows = [np.unique(shared.one), np.unique(shared.other)]
    seen = [
        f.take(some).known(item.geometry).seen_from(place_m)
        for f, some, item in zip(facets, rows, (one, other), strict=True)
        if len(some)
    ]
    return len(seen) == 2 and len(shared_by_two(seen[0], seen[1], _RESOLVED * reach).one) > 0


def _within_box_of(one: SceneObject, other: SceneObject, place_m: Array) -> Facets:
    low, high = other.vertices_m.min(axis=0), other.vertices_m.max(axis=0)
    margin = _RESOLVED * float(np.abs(other.vertices_m - place_m).max())
    return Facets.inside(one.geometry, one.vertices_m, np.array([low - margin, high + margin]))


def _told(item: SceneObject) -> str:
    value = item.reflectance
    told = "textured" if isinstance(value, Texture) else f"reflectance {value:g}"
    return f"{item.name} ({item.material}, {told})"

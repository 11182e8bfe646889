"""Which echoes of an earlier frame are still valid after objects have moved.

A path is reused as a whole: from the radar to its first facet, on to the facets that this one
lights, and back. It is valid if none of its segments may cross a box around an object that changed,
at its earlier or its present place. The segments are bounded by pyramids: between the radar, or an
image of it, and the first facet; those into which ray tubes are reflected; and those to the
receiver. The images, and the facets reachable from them, must also be the same. All other paths are
traced anew, with the errors that the level of every body now allows.

What the earlier frame left out, or did not divide further, was small relative to the levels then.
Of bodies whose levels have fallen since, so that the accepted error is now beyond the tolerance,
`scattered_by` traces everything anew.

Nothing is reused if the rig or its radar has moved; the tolerance or the number of bounces differs;
objects were added, removed, renamed, reordered or given other facets; a mirror, or a wall that the
radar sees through, has changed, or an object has become a mirror or is none any more; or the
objects that changed need more than `MOST_BOXES` boxes; or hardly anything would be reused.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from twin.radar.propagation.facets.crossing import as_mirrored, crossed, oriented
from twin.radar.propagation.facets.currents import plane_of
from twin.radar.propagation.facets.earlier import (
    Footprints,
    Setting,
    Sums,
    TracedEchoes,
    TracedFrame,
)
from twin.radar.propagation.facets.errors_by_range import ErrorsByRange
from twin.radar.propagation.facets.front_facets import lit_facets, portions
from twin.radar.propagation.facets.reflections import Bounds
from twin.radar.propagation.facets.scatterers import Scatterers
from twin.radar.propagation.one_way.motion import RigidMotions
from twin.radar.propagation.one_way.path import TracingContext, image_place
from twin.radar.propagation.prepared_scene import PreparedScene
from twin.radar.propagation.scene.images import Image
from twin.radar.propagation.scene.scattering_models import ScatteringModel
from twin.radar.synthesis import Contributions
from twin.scene import SceneObject
from twin.scene.boxes import boxes_of
from twin.transfer import aligned

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Indices = NDArray[np.integer]

MOST_BOXES = 24
_MOST_COMPARED = 512
#: Of an earlier frame's contributions: of fewer, finding the others takes as long as finding all.
_WORTH_KEEPING = 0.03
_FEW = 20_000  # contributions, up to which all that is valid is reused
_MOVABLE = (ScatteringModel.OPTICS, ScatteringModel.OBSTACLE)


@dataclass(frozen=True, eq=False)
class Valid:
    """Valid contributions and echoes of an earlier frame, and per body the accepted error, by range
    too, and the level that it is relative to.

    To be traced anew, by image and facet (n_images, n_facets): ``paths`` between them, and ray
    ``tubes`` that begin there. ``spacing_m`` as in `TracedEchoes`; ``left_out`` of the present
    bodies, of reflections that were not computed. ``without`` some of the present bodies,
    (n_bodies,): what is valid if everything of them is traced anew.
    """

    contributions: Contributions
    sums: Sums
    error: Array
    by_range: ErrorsByRange
    level: Array
    paths: Mask
    tubes: Mask
    spacing_m: tuple[float, float]
    left_out: Bounds | None
    without: Callable[[Mask], "Valid | None"]


def still_valid(
    context: TracingContext,
    scatterers: Scatterers,
    earlier: TracedFrame,
    now: Setting,
    prepared: PreparedScene,
    again: Mask | None = None,
) -> Valid | None:
    """What is still valid; None if nothing can be. ``again``: present bodies, (n_bodies,), of which
    everything is traced anew.
    """
    before, echoes = earlier.setting, earlier.echoes
    if before is None or echoes is None or not echoes.sums:
        return None  # nothing scattered
    changed = _changed(before, now)
    if changed is None:
        return None
    numbers = np.flatnonzero(changed)
    sides = [boxes_of([side.items[i] for i in numbers]) for side in (before, now)]
    boxes = _united(np.concatenate(sides) - prepared.anchor_m)
    if len(boxes) > MOST_BOXES:
        return None
    image = _numbers_of(before.images, now.images)
    if again is None:
        again = np.zeros(int(now.body.max(initial=0)) + 1, dtype=bool)
    changed |= (now.body >= 0) & again[now.body]
    differs = _differs(before, now, image)
    paths, tubes = differs | changed[now.owner], np.zeros_like(differs)
    if changed.any():
        mirrored_boxes = as_mirrored(oriented(boxes), now.images, prepared.flats)
        _cross(context, scatterers, now, mirrored_boxes, paths, tubes)
        tubes |= paths
        face_changed = differs.any(axis=0) | changed[now.owner]
        for footprints in echoes.footprints:
            is_crossed = _crossing(context, footprints, mirrored_boxes, face_changed, image)
            source, first = image[footprints.source[is_crossed]], footprints.first[is_crossed]
            tubes[source[source >= 0], first[source >= 0]] = True
    else:
        tubes |= paths

    def holding(part: Contributions | Sums, is_direct: bool) -> Any:
        source, receiver = image[part.source], image[part.receiver]
        anew = tubes[source, part.first]
        if is_direct:
            anew = paths[source, part.first] | paths[receiver, part.first]
        rows = np.flatnonzero((source >= 0) & (receiver >= 0) & ~anew)
        ends = source[rows].astype(np.uint32), receiver[rows].astype(np.uint32)
        return replace(part.take(rows), source=ends[0], receiver=ends[1])

    sums = Sums.concatenate(list(map(holding, echoes.sums, echoes.is_direct)))
    is_direct = now.reachable & scatterers.counts & (before.body[before.owner] >= 0)
    direct_paths = np.nonzero(is_direct & ~paths)[1], np.nonzero(is_direct)[1]
    error, by_range, level, left_out = _of_bodies(before, echoes, now, changed, direct_paths, sums)
    contributions = list(map(holding, echoes.contributions, echoes.is_direct))
    total = sum(map(len, echoes.contributions))
    if total > _FEW and sum(map(len, contributions)) < _WORTH_KEEPING * total:
        return None
    return Valid(
        contributions=Contributions.concatenate(contributions),
        sums=sums,
        error=error,
        by_range=by_range,
        level=level,
        paths=paths,
        tubes=tubes,
        spacing_m=echoes.spacing_m,
        left_out=left_out,
        without=lambda more: still_valid(context, scatterers, earlier, now, prepared, again | more),
    )


def _changed(before: Setting, now: Setting) -> Mask | None:
    """Which objects have moved or changed; None if anything else has, so that nothing is valid."""
    fixed = len(before.fixed) == len(now.fixed) and all(
        map(np.array_equal, before.fixed, now.fixed)
    )
    if not fixed or not np.array_equal(before.owner, now.owner):
        return None
    if [item.name for item in before.items] != [item.name for item in now.items]:
        return None
    pairs, row = np.unique(
        np.stack([before.surface, now.surface], axis=1), axis=0, return_inverse=True
    )
    same = np.array([np.array_equal(before.table[i], now.table[j]) for i, j in pairs], dtype=bool)
    same = same[row.reshape(-1)]
    for i, (one, other) in enumerate(zip(before.items, now.items, strict=True)):
        same[i] &= before.roles[i] is now.roles[i] and _alike(one, other)
    for i in np.flatnonzero(~same).tolist():
        if before.roles[i] not in _MOVABLE or now.roles[i] not in _MOVABLE:
            return None
    return ~same


def _alike(one: SceneObject, other: SceneObject) -> bool:
    if one is other:
        return True
    if one.thickness_m != other.thickness_m or not _move_alike(one, other):
        return False
    if one.geometry is other.geometry and one.pose is other.pose:
        return True
    return np.array_equal(one.geometry.faces, other.geometry.faces) and np.array_equal(
        one.vertices_m, other.vertices_m
    )


def _move_alike(one: SceneObject, other: SceneObject) -> bool:
    motions = RigidMotions.of([one, other], one.middle_m)
    pairs = (values for name, values in vars(motions).items() if name != "anchor_m")
    return all(np.array_equal(*pair) for pair in pairs)


def _united(boxes: Array) -> Array:
    """Boxes (n, 2, 3), overlapping ones united."""
    while 1 < len(boxes) <= _MOST_COMPARED:
        low, high = boxes[:, 0], boxes[:, 1]
        overlap = ((low[:, None] <= high) & (low <= high[:, None])).all(axis=2)
        count, group = connected_components(coo_array(overlap), directed=False)
        if count == len(boxes):
            break
        boxes = np.array(
            [[low[group == k].min(axis=0), high[group == k].max(axis=0)] for k in range(count)]
        )
    return boxes


def _numbers_of(before: Sequence[Image], now: Sequence[Image]) -> NDArray[np.intp]:
    """Present numbers of the earlier frame's images, by their mirrors; -1 for images that are
    gone.
    """
    number = {image.patches: k for k, image in enumerate(now)}
    return np.array([number.get(image.patches, -1) for image in before], dtype=np.intp)


def _differs(before: Setting, now: Setting, image: NDArray[np.intp]) -> Mask:
    """Pairs of image and facet that were not reachable and are now, or the reverse, or on whose
    other side the image is now, (n_images, n_facets).
    """
    is_changed, old = now.reachable.copy(), np.flatnonzero(image >= 0)
    new = image[old]
    is_changed[new] = before.reachable[old] != now.reachable[new]
    is_changed[new] |= before.outward[old] != now.outward[new]
    return is_changed


def _cross(
    context: TracingContext,
    scatterers: Scatterers,
    now: Setting,
    mirrored_boxes: Array,
    paths: Mask,
    tubes: Mask,
) -> None:
    """Mark pairs of image and facet in ``paths`` if the path between them may cross a box, and in
    ``tubes`` if the rays that the facet reflects may.
    """
    images, faces = np.nonzero(now.reachable & scatterers.counts & ~paths)
    for some in portions(np.arange(len(faces))):
        image, face = images[some], faces[some]
        lit = lit_facets(context, scatterers, face, image, image)
        tip = image_place(context, lit.source)
        paths[image, face] = _on_the_way(context, tip, lit.corners, mirrored_boxes, lit.source)
        tip, none = _behind(context, tip, lit.face), context.mi.UInt32(0)
        tubes[image, face] = crossed(
            context.mi, tip, lit.corners, mirrored_boxes[:1, 0], none, beyond=True
        )


def _on_the_way(
    context: TracingContext, tip: Any, corners: Any, mirrored_boxes: Array, image: Any
) -> Mask:
    """Whether paths from images to triangles may cross a box, (n,)."""
    is_crossed = np.zeros(dr.width(corners[0]), dtype=bool)
    for level in range(mirrored_boxes.shape[1]):
        is_crossed |= crossed(
            context.mi, tip, corners, mirrored_boxes[:, level], image, beyond=False
        )
    return is_crossed


def _behind(context: TracingContext, origin: Any, face: Any) -> Any:
    """Mirror images of points in the planes of facets."""
    point, normal = plane_of(context, face)
    return origin - 2 * dr.dot(origin - point, normal) * normal


def _crossing(
    context: TracingContext,
    footprints: Footprints,
    mirrored_boxes: Array,
    face_changed: Mask,
    image: NDArray[np.intp],
) -> Mask:
    """Footprints whose reflected tubes, or return paths, may cross a box, or whose facet
    changed.
    """
    mi = context.mi
    is_invalid = face_changed[np.array(footprints.face)]
    on = np.flatnonzero(footprints.goes_on & ~is_invalid)
    row, receiver = footprints.row, image[footprints.receiver]
    to_receiver = np.flatnonzero((receiver >= 0) & ~is_invalid[row])
    for rows, receiver_of in ((on, None), (row[to_receiver], receiver[to_receiver])):
        for some in portions(np.arange(len(rows))):
            index = mi.UInt32(aligned(rows[some].astype(np.uint32)))
            corners = tuple(dr.gather(mi.Vector3d, c, index) for c in footprints.corners)
            if receiver_of is None:
                origin = dr.gather(mi.Vector3d, footprints.origin, index)
                tip = _behind(context, origin, dr.gather(mi.UInt32, footprints.face, index))
                first = mi.UInt32(0)
                hit = crossed(mi, tip, corners, mirrored_boxes[:1, 0], first, beyond=True)
            else:
                number = mi.UInt32(aligned(receiver_of[some].astype(np.uint32)))
                hit = _on_the_way(
                    context, image_place(context, number), corners, mirrored_boxes, number
                )
            is_invalid[rows[some][hit]] = True
    return is_invalid


def _of_bodies(
    before: Setting,
    echoes: TracedEchoes,
    now: Setting,
    changed: Mask,
    direct_paths: tuple[Indices, Indices],
    valid_sums: Sums,
) -> tuple[Array, ErrorsByRange, Array, Bounds | None]:
    """Accepted errors of the valid echoes of the present bodies, the same by range, the highest
    level that they are relative to, and what was left out of them.

    Of a body's squared error that share counts which is valid of its direct paths, of its
    triangles, or of their power, whichever is largest; a body whose echo was left out has direct
    paths only. ``direct_paths``: facets of the valid ones, and of all.
    """
    whose, count = before.body[before.owner], len(echoes.error)
    whole = Sums.concatenate(echoes.sums)

    def share(valid: Indices, every: Indices, weights: tuple[Any, Any] = (None, None)) -> Array:
        kept, total = (
            np.bincount(whose[faces], weight, count)
            for faces, weight in zip((valid, every), weights, strict=True)
        )
        part: Array = kept / np.maximum(total, 1e-300)
        return part

    powers = np.abs(valid_sums.echo) ** 2, np.abs(whole.echo) ** 2
    most = np.maximum(
        share(*direct_paths),
        np.maximum(share(valid_sums.face, whole.face), share(valid_sums.face, whole.face, powers)),
    )
    same = ~changed & (now.body >= 0)
    pairs = np.unique(np.stack([now.body[same], before.body[same]], axis=1), axis=0)
    error, level = (np.zeros(int(now.body.max(initial=-1)) + 1) for _ in range(2))
    np.add.at(error, pairs[:, 0], (most * echoes.error**2)[pairs[:, 1]])
    np.maximum.at(level, pairs[:, 0], echoes.level[pairs[:, 1]])
    choice = echoes.choice
    left_out = None if choice is None else choice.left_out.of(pairs, len(error))
    return np.sqrt(error), echoes.by_range.renumbered(pairs, most), level, left_out

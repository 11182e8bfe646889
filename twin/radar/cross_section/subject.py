"""A mesh as the scene's solver takes it, and what of it can stand before what."""

from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from twin.geometry import Geometry, Shape
from twin.radar.cross_section.aspects import Aspects
from twin.radar.propagation.scene.mesh_scene import MeshScene
from twin.radar.propagation.scene.overlaps import divided_at, own_covers, tolerances_m
from twin.radar.scattering.target import MeshTarget
from twin.scene import SceneObject

Array = NDArray[np.float64]

_ROUNDED = 1e-6  # of the mesh's size: what stands no farther before a facet lies in its plane
_MOST_COMPARED = 2**27  # facets times corners of the hull, a second
_NEAR = 0.1  # of the distance of a mesh's middle: nearer parts have no projection


@dataclass(frozen=True, eq=False)
class Subject:
    """A mesh as the scene's solver takes it, the same from all sides.

    ``surface`` numbers that of every object of the ``world``; ``is_open`` (2, n_facets): nothing
    of the mesh stands before a facet, on the side of its normal and on the other.
    """

    world: MeshScene
    anchor_m: Array
    shape: Shape
    surface: NDArray[np.uint32]
    is_open: NDArray[np.bool_]

    @property
    def is_convex(self) -> bool:
        """Whether nothing is hidden, and nothing lit by anything else."""
        return bool(self.is_open.any(axis=0).all()) and bool(
            (self.is_open.all(axis=0) | (self.shape.outward != 0)).all()
        )


_subjects: WeakKeyDictionary[MeshTarget, Subject] = WeakKeyDictionary()


def subject_of(target: MeshTarget) -> Subject:
    """Found once for a mesh."""
    if target not in _subjects:
        _subjects[target] = _subject(target)
    return _subjects[target]


def _subject(target: MeshTarget) -> Subject:
    center, radius = target.geometry.sphere
    # Beside the mesh: rays start off a surface by a share of the distance from the anchor.
    anchor = center - radius
    kind = target.surface_of_face
    kinds = np.zeros(len(target.geometry), dtype=np.intp) if kind is None else np.asarray(kind)
    used = np.unique(kinds)
    whole = target.geometry
    if len(used) > 1:  # in the order of the world's facets
        order = np.argsort(kinds, kind="stable")
        whole, kinds = Geometry(whole.vertices_m, whole.faces[order]), kinds[order]
    tolerance = float(tolerances_m(np.array(float(np.linalg.norm(np.full(3, 2 * radius))))))
    if covers := own_covers(whole, tolerance, None):
        whole, part_of = divided_at(whole, covers)
        kinds = kinds[part_of]
    parts = [whole]
    if len(used) > 1:
        parts = [Geometry(whole.vertices_m, whole.faces[kinds == number]) for number in used]
    items = [SceneObject("target", part, "", 0.0) for part in parts]
    world = MeshScene(items)
    world.place(items, anchor)
    shape = whole.shape
    return Subject(
        world, anchor, shape, used.astype(np.uint32), _open(world, shape, _ROUNDED * radius)
    )


def _open(world: MeshScene, shape: Shape, rounded_m: float) -> NDArray[np.bool_]:
    if shape.is_convex:
        return np.stack([shape.outward > 0, shape.outward < 0])
    point, normal = world.plane_table[:, :3], world.plane_table[:, 3:]
    corners = world.vertices[shape.hull]
    if len(normal) * len(corners) > _MOST_COMPARED:
        return np.zeros((2, len(normal)), dtype=bool)
    level = np.sum(point * normal, axis=1)
    is_open = np.empty((2, len(normal)), dtype=bool)
    for rows in np.array_split(np.arange(len(normal)), len(normal) * len(corners) // 2**22 + 1):
        height = normal[rows] @ corners.T - level[rows, None]
        is_open[0, rows] = height.max(axis=1) <= rounded_m
        is_open[1, rows] = height.min(axis=1) >= -rounded_m
    return is_open


def is_seen_once(target: MeshTarget, aspects: Aspects) -> bool:
    """Whether no facet lights another: of convex meshes seen from outside."""
    subject = subject_of(target)
    return subject.is_convex and not are_within(subject, aspects).any()


def are_within(subject: Subject, aspects: Aspects) -> NDArray[np.bool_]:
    """Whether transmitter or receiver stands within the mesh's box, (n,)."""
    low, high = subject.world.vertices.min(axis=0), subject.world.vertices.max(axis=0)
    is_within = np.zeros(len(aspects), dtype=bool)
    for direction in (aspects.source, aspects.receiver):
        reach = np.minimum(aspects.distance_m, 1e30)[:, None]
        place = direction * reach - subject.anchor_m
        is_within |= ((low <= place) & (place <= high)).all(axis=1)
    return is_within


def bare(subject: Subject, place_m: Array) -> NDArray[np.bool_]:
    """Facets no other one of which stands before them as seen from places, (n, n_facets).

    Two triangles in a central projection are apart if a line along an edge of either parts them.
    """
    place = place_m - subject.anchor_m
    middle = subject.world.vertices.mean(axis=0)
    size = float(np.ptp(subject.world.vertices, axis=0).max())
    towards = place - middle
    length = np.linalg.norm(towards, axis=1)
    axis = towards / length[:, None]
    across = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis), axis=1)])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    sides = np.stack([across, np.cross(axis, across)], axis=1)
    corners = subject.world.vertices[subject.world.faces] - middle
    depth = length[:, None, None] - np.einsum("ni,fci->nfc", axis, corners)
    flat = np.einsum("nai,fci->nfca", sides, corners)
    flat *= (length[:, None, None] / np.maximum(depth, 1e-9 * size))[..., None]
    edge = np.roll(flat, -1, axis=2) - flat
    normal = np.stack([-edge[..., 1], edge[..., 0]], axis=-1)
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-300)
    at = np.einsum("nfea,ngca->nfgec", normal, flat)
    own = np.einsum("nffec->nfec", at)[:, :, None]
    apart = (at.min(axis=4) >= own.max(axis=4) - _ROUNDED * size) | (
        at.max(axis=4) <= own.min(axis=4) + _ROUNDED * size
    )
    is_apart = apart.any(axis=3)
    is_apart |= is_apart.swapaxes(1, 2)
    point, across_face = subject.world.plane_table[:, :3], subject.world.plane_table[:, 3:]
    level = np.sum(point * across_face, axis=1)
    height = np.einsum("fi,gci->fgc", across_face, subject.world.vertices[subject.world.faces])
    height -= level[:, None, None]
    side = np.sign(place @ across_face.T - level)
    stands = (height.max(axis=2) > _ROUNDED * size) & (side > 0)[:, :, None]
    stands |= (height.min(axis=2) < -_ROUNDED * size) & (side < 0)[:, :, None]
    is_near = (depth <= _NEAR * length[:, None, None]).any(axis=(1, 2))
    is_bare: NDArray[np.bool_] = ~(stands & ~is_apart).any(axis=2) & ~is_near[:, None]
    return is_bare

"""What a frame stores for later ones: its setting, its echoes, and the footprints of its ray
tubes.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from twin.errors import InputError
from twin.radar.device.design import RadarDesign
from twin.radar.propagation.facets.error_budget import Leaves
from twin.radar.propagation.facets.errors_by_range import ErrorsByRange
from twin.radar.propagation.facets.reflections import ReflectionChoice
from twin.radar.propagation.facets.scatterers import Scatterers
from twin.radar.propagation.facets.triangles import origin_of
from twin.radar.propagation.facets.tubes import Tubes
from twin.radar.propagation.one_way.path import TracingContext
from twin.radar.propagation.prepared_scene import PreparedScene
from twin.radar.propagation.scene.images import Image
from twin.radar.propagation.scene.scattering_models import ScatteringModel
from twin.radar.scattering.surface import TABLE_STEPS
from twin.radar.synthesis import Contributions
from twin.scene import SceneObject
from twin.toml import Entry

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Indices = NDArray[np.integer]


@dataclass(frozen=True, eq=False)
class Setting:
    """Everything on which a frame's echoes depend, for comparison with later frames.

    Per object ``items``, ``roles``, ``surface`` (rows of coefficients in ``table``) and ``body``;
    per facet ``owner``, its object; ``reachable`` and ``outward`` as of `Scatterers`; the numbers
    in ``fixed`` are where the radar stands, what mirrors and what lets through.
    """

    items: tuple[SceneObject, ...]
    roles: tuple[ScatteringModel, ...]
    surface: Indices
    table: Array
    body: Indices
    owner: Indices
    images: tuple[Image, ...]
    reachable: Mask
    outward: NDArray[np.int8]
    fixed: tuple[NDArray[Any], ...]


def setting_of(
    prepared: PreparedScene,
    scatterers: Scatterers,
    body: Indices,
    parameters: Sequence[float],
) -> Setting:
    """Setting of a prepared scene; ``parameters``: further numbers on which a frame depends."""
    flats, walls = prepared.flats, prepared.context.walls
    through = () if walls is None else (np.array(walls.thickness), np.array(walls.table))
    half_time = scatterers.half_time_s
    return Setting(
        items=prepared.originals,
        roles=prepared.roles,
        surface=prepared.surface_of_object,
        table=np.array(prepared.context.table).reshape(-1, 4 * (TABLE_STEPS + 1)),
        body=body,
        owner=prepared.world.object_of_face,
        images=prepared.images,
        reachable=scatterers.reachable,
        outward=scatterers.outward,
        fixed=(
            np.array(
                [*parameters, half_time, prepared.wavelength_m, len(prepared.world.face_ranges)]
            ),
            prepared.anchor_m,
            prepared.place,
            *vars(prepared.radar_motion).values(),
            prepared.axes,
            flats.object,
            flats.point,
            flats.normal,
            flats.box,
            *through,
            *_divided(prepared),
        ),
    )


def _divided(prepared: PreparedScene) -> Iterator[NDArray[Any]]:
    """Which objects' faces are divided, and where: facets have other numbers where that changes."""
    for number, (item, original) in enumerate(zip(prepared.items, prepared.originals, strict=True)):
        if item.geometry is not original.geometry:
            yield np.array([number])
            yield item.geometry.vertices_m
            yield item.geometry.shape.is_double


@dataclass(frozen=True, eq=False)
class Footprints:
    """Triangles that ray tubes light.

    On the device: ``origin`` of the wave, ``corners``, ``face``. On the host: the ``first`` facet
    of each tube, the image that is its ``source``, and whether it ``goes_on`` to be reflected; in
    pairs the ``row`` of a footprint and a ``receiver`` of its echo.
    """

    origin: Any
    corners: tuple[Any, Any, Any]
    face: Any
    first: Indices
    source: Indices
    goes_on: Mask
    row: Indices
    receiver: Indices

    @staticmethod
    def of(
        context: TracingContext, tubes: Tubes, goes_on: Mask, row: Indices, receiver: Indices
    ) -> "Footprints":
        """Footprints of tubes, without the waves that light them."""
        lit = tubes.triangles
        origin = origin_of(context, lit)
        dr.eval(origin)
        source = np.array(lit.source).astype(np.int32)
        pairs = row.astype(np.int32), receiver.astype(np.int32)
        return Footprints(origin, lit.corners, lit.face, lit.first, source, goes_on, *pairs)


@dataclass(frozen=True, eq=False)
class Sums:
    """Echoes of triangles at the carrier without the phase of the path, (n,), with the path's
    length, the facet on which each lies, the ``first`` facet of its path, and the images at both
    ends.
    """

    echo: NDArray[np.complex128]
    length_m: Array
    face: Indices
    first: Indices
    source: Indices
    receiver: Indices

    @staticmethod
    def of(leaves: Leaves) -> "Sums":
        """Echoes of leaves."""
        lit = leaves.triangles
        return Sums(
            leaves.weight * leaves.echoes.total,
            leaves.echoes.length_m,
            np.array(lit.face),
            lit.first,
            np.array(lit.source),
            np.array(lit.receiver),
        )

    @staticmethod
    def concatenate(parts: "Sequence[Sums]") -> "Sums":
        """One after the other."""
        names = [f.name for f in fields(Sums)]
        return Sums(*(np.concatenate([getattr(p, name) for p in parts]) for name in names))

    def take(self, which: Indices) -> "Sums":
        """Only some of them, by index."""
        return Sums(*(getattr(self, f.name)[which] for f in fields(Sums)))


@dataclass(frozen=True, eq=False)
class TracedEchoes:
    """Echoes of all bodies.

    contributions
        In parts, those of an earlier frame first.
    sums, is_direct
        Of each part but these; whether it is lit from images rather than by ray tubes.
    error, by_range, level
        Accepted error of every body, where along the range it is, and the level that it is relative
        to.
    footprints
        Of ray tubes.
    spacing_m
        Sizes of parts of facets: of those lit from images, and of roots of ray tubes.
    n_reused
        Number of contributions from an earlier frame.
    choice
        Of reflections that are computed of every body; None where these are given.
    """

    contributions: tuple[Contributions, ...]
    sums: tuple[Sums, ...]
    is_direct: tuple[bool, ...]
    error: Array
    by_range: ErrorsByRange
    level: Array
    footprints: tuple[Footprints, ...]
    spacing_m: tuple[float, float]
    n_reused: int = 0
    choice: ReflectionChoice | None = None


@dataclass(frozen=True, eq=False)
class TracedFrame:
    """A traced frame, of which later ones may reuse a part: some 500 bytes for each of its
    contributions and ray tubes.

    ``radar`` and ``solver`` (as in ``Fidelity.radar``) are those by which it was traced;
    ``setting`` and ``echoes`` are None where nothing scattered.
    """

    radar: RadarDesign
    solver: str
    setting: Setting | None = None
    echoes: TracedEchoes | None = None

    def check(self, radar: RadarDesign, solver: str) -> None:
        """Raises InputError where that is no frame of this radar, or of this solver."""
        if self.solver != solver:
            raise InputError(
                f"earlier: traced with fidelity.radar = {self.solver!r}, expected {solver!r}"
            )
        for name in sorted({*RadarDesign.model_fields} - {*Entry.model_fields}):
            if getattr(self.radar, name) != getattr(radar, name):
                raise InputError(
                    f"earlier: {name} of radar {self.radar.name!r}, with which it was traced, is "
                    f"not that of {radar.name!r}: expected a frame of the same design"
                )

"""Echoes of objects by a table of their far-field scattering matrix: between declared
cross-sections and rays at every pose in cost and accuracy.

Sionna RT finds the paths to the centre of each object and back. The reflections on these paths and
the object's echo are computed here, complex and in float64. Sionna's own `ScatteringModel`, with a
cross-section and a cross-polarisation matrix, would be float32, looked up inside a compiled loop,
and without the place within the object from which the echo comes.

An object counts as one point, seen or hidden as a whole, and alone: objects that touch it neither
shadow it nor reflect to it. The table is bistatic: forward and return path may come from different
directions. The monostatic matrix at the bisector (Kell, Proc. IEEE 53, 1965) would not do: for a
trihedral of 40 wavelengths, with 3.8 deg between the direct path and the one over the ground, it is
20 dB too strong.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.constants import speed_of_light

from twin.files import InputError
from twin.geometry import Geometry
from twin.radar.cross_section.table import Table, table_of
from twin.radar.device.design import RadarDesign
from twin.radar.propagation.scene.materials import surface_of
from twin.radar.scattering.surface import LayeredSurface
from twin.radar.scattering.target import MeshTarget
from twin.scene import Scene, SceneObject, Target

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True, eq=False)
class Tabulated:
    """An object with its table; ``point`` represents it in the search for paths: at its centre,
    with a cross-section of 1 m^2.
    """

    point: Target
    table: Table
    assumed: str | None


@dataclass(frozen=True, eq=False)
class SpecularPath:
    """A path from the radar over planes to a point.

    ``back`` (3,) and ``length_m``: unit vector and distance from the point to the radar's image;
    ``field`` (3,): incident field at the point of a wave sent with amplitude 1, without spreading
    and phase, after so many ``reflections``.
    """

    reflections: int
    back: Array
    length_m: float
    field: Complex


def tabulated(scene: Scene, item: SceneObject, radar: RadarDesign, nodes: int) -> Tabulated:
    """The table of an object, from the cache or new.

    Raises InputError where the material has no data at the carrier, or the object is too large.
    """
    carrier = radar.ofdm.carrier_hz
    surface, assumed = surface_of(item, scene, carrier)
    place = f"objects.{item.name}"
    placed = Geometry(item.vertices_m, item.geometry.faces)
    body = MeshTarget(placed.without_empty_faces(place), (surface,))
    x, y, z = body.geometry.sphere[0].tolist()
    try:
        table = table_of(body, carrier, nodes)
    except InputError as error:
        raise InputError(f"{place}: radar = 'table': {error}") from error
    point = Target(item.name, (x, y, z), item.velocity_m_per_s, 1.0, "its table", item.name)
    return Tabulated(point, table, assumed)


def specular_path(
    point: Array,
    planes: Sequence[tuple[Array, Array]],
    surfaces: Sequence[LayeredSurface],
    axes: Array,
    carrier_hz: float,
) -> SpecularPath:
    """The path from the radar, in the origin, over planes (a point and the unit normal each) in
    their order.

    ``axes`` (3, 3) are the antenna's: forward, left, up. It is polarised along up, in Ludwig's
    third definition.
    """
    image = np.zeros(3)
    for start, normal in planes:
        image = image - 2 * ((image - start) @ normal) * normal
    from_image = point - image
    length = float(np.linalg.norm(from_image))
    arriving = from_image / length
    direction = arriving
    for _, normal in reversed(planes):
        direction = direction - 2 * (direction @ normal) * normal
    forward, _, up = axes
    ahead = max(1 + float(direction @ forward), 1e-9)
    field = up - (up @ direction) / ahead * (direction + forward) + 0j
    for (_, normal), surface in zip(planes, surfaces, strict=True):
        field = _reflected(field, direction, normal, surface, carrier_hz)
        direction = direction - 2 * (direction @ normal) * normal
    return SpecularPath(len(planes), -arriving, length, field)


def answers(
    thing: Tabulated, path_pairs: Sequence[tuple[SpecularPath, SpecularPath]], wavelength_m: float
) -> tuple[Complex, Array]:
    """Amplitudes (n,) without the antenna's gains, and delays (n,) beyond that of the centre, for
    pairs of a forward and a return path.
    """
    # Physical optics is not reciprocal. As in the solver of facets, a path and its reverse both
    # have the echo of the one that comes in by the simpler path.
    there, back = zip(
        *(sorted(pair, key=lambda path: (path.reflections, path.length_m)) for pair in path_pairs),
        strict=True,
    )
    s, delay = thing.table.answers(
        *(np.array([path.back for path in paths]) for paths in (there, back)),
        *(np.array([path.field for path in paths]) for paths in (there, back)),
    )
    spread = np.array([a.length_m * b.length_m for a, b in path_pairs])
    # The delay's phase at the carrier is taken out: with it the amplitude has the phase of S.
    turn = np.exp(2j * np.pi * speed_of_light / wavelength_m * delay)
    amplitude: Complex = wavelength_m / (4 * np.pi * spread) * s * turn
    return amplitude, delay


def warning(thing: Tabulated, distance_m: float) -> str | None:
    """Warning about an object nearer than its far field begins."""
    table = thing.table
    if distance_m >= table.far_m:
        return None
    bend = np.pi / 4 * table.far_m / distance_m
    return (
        f"{thing.point.name} answers from a table of its far field, which begins at "
        f"2 D^2 / lambda = {table.far_m:.3g} m: {distance_m:.3g} m away phases at its rim are off "
        f"by {bend:.2g} rad there and back (the radar model optics has no such limit)"
    )


def assumptions(thing: Tabulated, material: str, radar: RadarDesign) -> list[str]:
    """What a table takes for granted."""
    name, table = thing.point.name, thing.table
    lines = [f"{name} answers from a table of physical optics, alone and from one point"]
    if table.extent_m > radar.range_cell_m:
        lines[0] += f": it measures {table.extent_m / radar.range_cell_m:.3g} range cells"
    if table.undersampling > 1:
        lines.append(
            f"rays of the table of {name} {table.undersampling:.2g} times wider apart than asked "
            "for: what its parts light of each other fades"
        )
    if thing.assumed:
        lines.append(f"radio properties of {material}: {thing.assumed}")
    return lines


def _reflected(
    field: Complex, direction: Array, normal: Array, surface: LayeredSurface, carrier_hz: float
) -> Complex:
    """A conductor's mirror image times TM, and what TE differs from it across the plane of
    incidence, as in the kernel of physical optics.
    """
    cosine = np.array([abs(direction @ normal)])
    te, tm = (complex(value[0]) for value in surface.reflection(cosine, carrier_hz))
    across = np.cross(direction, normal)
    part = across * ((across @ field) / max(float(across @ across), 1e-30))
    reflected: Complex = tm * (2 * (normal @ field) * normal - field) + (te + tm) * part
    return reflected

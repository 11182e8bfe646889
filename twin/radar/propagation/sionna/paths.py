"""Paths between the radar and the scene, traced by Sionna RT and refined in float64.

`PathSolver` finds mirror images in large surfaces, `RCSSolver` the paths to every target and back.
Sionna computes in float32, where 80 GHz times the delay of 150 m is off by 1.4 degrees per last
digit: so from its paths only the sequence of surfaces and the amplitude are taken, and lengths are
measured anew on the scene's own planes in float64.

Higher rungs leave Sionna aside: `twin.radar.propagation.physical_optics_solver`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hardware.waveform import C_M_PER_S
from twin.geometry import planes
from twin.radar.device.design import RadarDesign
from twin.radar.propagation.one_way.motion import (
    PointMotion,
    RigidMotions,
    lengthening,
    target_motion,
    turning,
)
from twin.radar.propagation.result import Heard, PathName, Propagation, by_delay
from twin.radar.propagation.scene.materials import surface_of
from twin.radar.propagation.sionna.raw import TARGET, RawPath
from twin.radar.propagation.sionna.world import RadioWorld
from twin.radar.propagation.tabulated import (
    SpecularPath,
    Tabulated,
    answers,
    specular_path,
)
from twin.radar.synthesis import Contributions
from twin.radar.synthesis.contributions import OWN_IMAGE, POINT
from twin.scene import Scene, SceneObject, Target

Array = NDArray[np.float64]


def sionna_paths(
    scene: Scene, radar: RadarDesign, *, max_depth: int = 3, table_nodes: int = 4, seed: int = 0
) -> Propagation:
    """Images in surfaces, and paths to declared targets and to those of tables.

    Parameters
    ----------
    scene, radar
        The scene, and the radar in it.
    max_depth
        Interactions of one path at most, the target's included.
    table_nodes
        As in `Fidelity.radar_table_nodes`.
    seed
        Of the rays that look for surfaces.

    Raises InputError where a reflecting surface's material has no data at the carrier.
    """
    world = RadioWorld(scene, radar, table_nodes)
    refinement = _Refinement(world)
    mirrors = refinement.environment(max_depth, seed)
    points, dense = refinement.targets(max_depth, seed)
    loss = 10 ** (-radar.front_end.losses_db.value / 20)
    names, paths = by_delay(
        [p.name for p in (*mirrors, *points)], _received((*mirrors, *points), loss)
    )
    dense = [p for p in dense if p.echo.amplitude[0]]
    echoes = _received(dense, loss)
    return Propagation(
        Contributions.concatenate([paths, echoes]),
        names,
        roles=tuple(world.roles),
        assumptions=tuple(dict.fromkeys(world.assumptions)),
        heard=_heard([p.name for p in dense], echoes, radar.ofdm.carrier_hz),
        warnings=tuple(world.warnings),
    )


@dataclass(frozen=True, eq=False)
class _Refined:
    """A path with its contribution, one row, before the front end's losses."""

    name: PathName
    echo: Contributions


def _received(paths: Sequence[_Refined], loss: float) -> Contributions:
    echoes = Contributions.concatenate([path.echo for path in paths])
    return replace(echoes, amplitude=echoes.amplitude * loss)


def _heard(
    names: Sequence[PathName], echoes: Contributions, carrier_hz: float
) -> tuple[Heard, ...]:
    """Echoes summed up per object that answers from a table."""
    turns = np.exp(-2j * np.pi * (carrier_hz * echoes.delay_s % 1.0))
    waves: dict[str, list[complex]] = {}
    for name, wave in zip(names, (echoes.amplitude * turns).tolist(), strict=True):
        waves.setdefault(str(name.target), []).append(wave)
    return tuple(Heard(name, len(w), float(abs(sum(w)) ** 2)) for name, w in waves.items())


class _Refinement:
    """Paths of Sionna's scene measured anew on the scene's own planes."""

    def __init__(self, world: RadioWorld) -> None:
        self.world = world

    def environment(self, max_depth: int, seed: int) -> list[_Refined]:
        """Mirror images of the radar in large surfaces."""
        raw_paths = self.world.surface_paths(max_depth, seed)
        return [path for raw in raw_paths if (path := self._refined(raw))]

    def targets(self, max_depth: int, seed: int) -> tuple[list[_Refined], list[_Refined]]:
        """Ways to every target and back, directly and over surfaces: to declared ones, and to
        those that answer from tables.
        """
        points: list[_Refined] = []
        paths_of_tables: list[list[tuple[RawPath, _Refined]]] = [[] for _ in self.world.tables]
        for raw in self.world.target_paths(max_depth, seed):
            path = self._refined(raw)
            if path is None:
                continue
            number = raw.objects[raw.kinds.index(TARGET)] - self.world.n_declared
            if number < 0:
                points.append(path)
            else:
                paths_of_tables[number].append((raw, path))
        pairs = zip(self.world.tables, paths_of_tables, strict=True)
        return points, [
            echo
            for thing, paths_of_target in pairs
            if paths_of_target
            for echo in self._tabulated(thing, paths_of_target)
        ]

    def _tabulated(self, thing: Tabulated, paths: list[tuple[RawPath, _Refined]]) -> list[_Refined]:
        """Paths to one target with the echo by its table, in place of that of 1 m^2."""
        path_pairs = []
        for raw, _ in paths:
            at = raw.kinds.index(TARGET)
            there = zip(raw.objects[:at], raw.primitives[:at], strict=True)
            back = zip(raw.objects[:at:-1], raw.primitives[:at:-1], strict=True)
            path_pairs.append(
                (self._specular_path(thing, list(there)), self._specular_path(thing, list(back)))
            )
        wavelength = self.world.radar.ofdm.wavelength_m
        amplitude, delay = answers(thing, path_pairs, wavelength)
        return [
            _Refined(
                path.name,
                replace(
                    path.echo,
                    amplitude=np.array([complex(amplitude[i] * self._gain(path.echo))]),
                    delay_s=path.echo.delay_s + delay[i],
                ),
            )
            for i, (_, path) in enumerate(paths)
        ]

    def _specular_path(self, thing: Tabulated, reflections: list[tuple[int, int]]) -> SpecularPath:
        """The path from the radar to a target over triangles of surfaces, by object and number."""
        world = self.world
        carrier = world.radar.ofdm.carrier_hz
        items = [world.meshes_met[number] for number, _ in reflections]
        planes = [self._plane(item, n) for item, (_, n) in zip(items, reflections, strict=True)]
        # Nothing goes through surfaces on this rung: they have no thickness.
        surfaces = [
            surface_of(replace(item, thickness_m=None), world.scene, carrier)[0] for item in items
        ]
        point = np.asarray(thing.point.position_m) - world.origin
        return specular_path(point, planes, surfaces, world.axes, carrier)

    def _gain(self, echo: Contributions) -> float:
        """Of the antenna's amplitude, there and back."""
        directions = np.concatenate([echo.departure, echo.arrival])
        return float(np.sqrt(np.prod(self.world.radar.antenna.gain(directions))))

    def _refined(self, raw: RawPath) -> _Refined | None:
        """The same path with its length in float64; None for one over an obstacle."""
        world = self.world
        # Sionna counts sensing targets by themselves. Both kinds have a name and a velocity.
        interactions: list[SceneObject | Target] = [
            world.targets_met[i] if kind == TARGET else world.meshes_met[i]
            for i, kind in zip(raw.objects, raw.kinds, strict=True)
        ]
        if any(isinstance(m, SceneObject) and m.name not in world.surfaces for m in interactions):
            return None
        planes = [
            (*self._plane(m, primitive), RigidMotions.of([m], world.origin), 0)
            if isinstance(m, SceneObject)
            else None
            for m, primitive in zip(interactions, raw.primitives, strict=True)
        ]
        vertices = raw.vertices.copy()
        at = next((i for i, m in enumerate(interactions) if isinstance(m, Target)), None)
        if at is None:
            place, moving = np.zeros(3), world.motion
            sections = [planes]
        else:
            place = np.asarray(world.targets_met[raw.objects[at]].position_m) - world.origin
            moving = target_motion(world.scene, world.targets_met[raw.objects[at]])
            vertices[at] = place
            sections = [planes[:at], planes[:at:-1]]
        motions = [_path_motion(place, moving, world.motion, p) for p in sections]
        # Length with its first and second derivative, of both paths together.
        length, rate, acceleration = np.sum([lengths for lengths, _ in motions], axis=0)
        turns = [_mirrored_back(turn, p) for (_, turn), p in zip(motions, sections, strict=True)]
        # A path without a target ends at the radar's own image.
        turns = [*turns, -motions[0][1]][:2]
        ends = self._direction(vertices[0]), self._direction(vertices[-1])
        is_own_image = at is None and len(planes) == 1
        spin = self._in_antenna(world.motion.spin_rad_per_s)
        name = PathName(
            tuple(m.name for m in interactions), None if at is None else interactions[at].name
        )
        echo = Contributions(
            amplitude=np.array([complex(raw.amplitude)]),
            delay_s=np.array([length / C_M_PER_S]),
            delay_rate=np.array([rate / C_M_PER_S]),
            delay_acceleration_per_s=np.array([acceleration / C_M_PER_S]),
            departure=ends[0],
            arrival=ends[1],
            departure_per_s=self._in_antenna(turns[0]) - np.cross(spin, ends[0]),
            arrival_per_s=self._in_antenna(turns[1]) - np.cross(spin, ends[1]),
            wavefront=np.full(1, OWN_IMAGE if is_own_image else POINT, dtype=np.uint32),
        )
        amplitude = np.array([complex(raw.amplitude * self._gain(echo))])
        return _Refined(name, replace(echo, amplitude=amplitude))

    def _direction(self, towards: Array) -> Array:
        """Unit vector in the antenna's frame, (1, 3)."""
        return self._in_antenna(towards / np.linalg.norm(towards))

    def _in_antenna(self, vector: Array) -> Array:
        turned: Array = (self.world.axes @ vector).reshape(1, 3)
        return turned

    def _plane(self, item: SceneObject, primitive: int) -> tuple[Array, Array]:
        """A point and the unit normal of a triangle, relative to the radar, in float64."""
        corners = item.vertices_m[item.geometry.faces[primitive]] - self.world.origin
        (plane,) = planes(corners, np.array([[0, 1, 2]]))
        return plane[:3], plane[3:]


def _path_motion(
    place: Array, moving: PointMotion, radar: PointMotion, planes: "list[Any]"
) -> tuple[tuple[float, float, float], Array]:
    """Of the path from the radar, in the origin, over planes that move (a point, the unit
    normal, motions and the number of its own among them), the first one first, to a point that
    moves: its length with the first and second derivative in time, and the derivative of its
    direction at the point, as the axes see it that the planes mirror.
    """
    image, motion = np.zeros(3), replace(radar, spin_rad_per_s=np.zeros(3))
    for start, normal, motions, number in planes:
        motion = motion.mirrored(image, start, normal, motions, number)
        image = image - 2 * ((image - start) @ normal) * normal
    length = float(np.linalg.norm(place - image))
    towards, velocity = (place - image) / length, moving.velocity_m_per_s - motion.velocity_m_per_s
    faster = moving.acceleration_m_per_s2 - motion.acceleration_m_per_s2
    rate, acceleration = lengthening(velocity, towards, length, faster)
    turn = turning(velocity, towards, length) - np.cross(motion.spin_rad_per_s, towards)
    return (length, float(rate), float(acceleration)), turn


def _mirrored_back(direction: Array, planes: "list[Any]") -> Array:
    """A direction at the end of a path over planes, mirrored back to the radar."""
    for _, normal, *_ in reversed(planes):
        direction = direction - 2 * (direction @ normal) * normal
    return direction

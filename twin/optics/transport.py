"""Light transport from emitter to detector, rendered once for all patterns.

*Dual* form (Helmholtz reciprocity): paths start at the emitter, one stratum of one cell each, and
every vertex connects to the detector's pupil. What a cell sends to the pupil per radiant intensity
is one pixel; a pattern's signal is then the sum of its lit pixels, exact in float64.

The same path tracer, started at the detector and connected to the sun, gives the background; and
started at a camera, the picture. Contributions are added up per path in float64, in a fixed order:
the same seed gives the same bits.
"""

from dataclasses import dataclass
from typing import Any, Literal

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from twin.engine import mitsuba
from twin.optics.radiometry import Outline

Array = NDArray[np.float64]

_RAYS_AT_ONCE = 2**22


@dataclass(frozen=True, eq=False)
class Pinhole:
    """A device small against all distances, with a flat field.

    ``origin_m`` (3,) relative to the rig; ``axes`` (3, 3) with the rows forward, left, up;
    ``tan_half_field`` of the square's half width or the disc's radius.
    """

    origin_m: Array
    axes: Array
    tan_half_field: float
    outline: Outline = "square"


@dataclass(frozen=True, eq=False)
class SunLight:
    """Directional light; radiances come out per unit irradiance on the plane normal to it."""

    direction: Array


@dataclass(frozen=True, eq=False)
class DeviceLight:
    """A pinhole as light: of radiant intensity 1 (``emitter``), or a pupil of area 1 seen by
    reciprocity (``pupil``, which adds the cosine of its flat surface).
    """

    pinhole: Pinhole
    kind: Literal["emitter", "pupil"]


@dataclass(frozen=True)
class Quality:
    """Knobs of the path tracer, each with the error it bounds.

    samples
        Paths per cell, a square number, stratified: noise of a cell. Against a sensor's own noise
        16 is rarely visible.
    max_depth
        Bounces: 1 is direct light; each further one adds light of up to the reflectance's next
        power. What is cut off is lost.
    """

    samples: int = 64
    max_depth: int = 4

    def __post_init__(self) -> None:
        side = round(self.samples**0.5)
        if self.samples < 1 or side * side != self.samples:
            raise ValueError(f"samples: {self.samples} is not a square number")
        if self.max_depth < 1:
            raise ValueError(f"max_depth: {self.max_depth} is less than 1")


@dataclass(frozen=True, eq=False)
class Gathered:
    """What a grid of cells gathers: mean over each cell, (rows, columns), with standard error."""

    direct: Array
    indirect: Array
    standard_error: Array

    @property
    def total(self) -> Array:
        """Direct and indirect light together."""
        return self.direct + self.indirect


def transport(
    scene: Any,
    emitter: Pinhole,
    detector: Pinhole,
    shape: tuple[int, int],
    *,
    quality: Quality,
    seed: int,
) -> Gathered:
    """Irradiance on the detector's pupil per radiant intensity of each cell, in 1/m^2.

    The power that cell i puts on the detector is I tau A_pupil times the value of its pixel, with
    the radiant intensity I that the cell has inside its solid angle. Cosines of surface and pupil,
    shadowing and the outline of the detector's field are in it. Row 0 is the top, column 0 left.
    """
    light = DeviceLight(detector, "pupil")
    return gather(scene, emitter, shape, light, cos_power=3, quality=quality, seed=seed)


def sunlight(
    scene: Any,
    detector: Pinhole,
    direction: Array,
    *,
    shape: tuple[int, int] = (32, 32),
    quality: Quality,
    seed: int,
) -> Gathered:
    """Irradiance on the detector's pupil per irradiance of the sun, by part of its field.

    The sum of the parts is the background; times E_sun tau A_pupil it is a power.
    """
    light = SunLight(direction)
    return gather(scene, detector, shape, light, cos_power=4, quality=quality, seed=seed)


def gather(
    scene: Any,
    camera: Pinhole,
    shape: tuple[int, int],
    light: SunLight | DeviceLight,
    *,
    cos_power: int,
    quality: Quality,
    seed: int,
) -> Gathered:
    """Light that each cell of a camera's field receives.

    With ``cos_power`` 0 the mean radiance of the cell; with k > 0 its integral over the cell's
    area on the plane at distance 1, weighted by cos^k (3: solid angle; 4: solid angle and a flat
    pupil).
    """
    rows, columns = shape
    per_block = max(1, _RAYS_AT_ONCE // (columns * quality.samples))
    blocks = [
        _block(scene, camera, shape, (top, min(top + per_block, rows)), light, quality, seed)
        for top in range(0, rows, per_block)
    ]
    cos, direct, indirect = (np.concatenate(parts) for parts in zip(*blocks, strict=True))
    weight = np.ones_like(cos)
    if cos_power:
        weight = cos**cos_power * (2 * camera.tan_half_field) ** 2 / (rows * columns)
    direct, indirect = weight * direct, weight * indirect
    return Gathered(
        direct=direct.mean(axis=-1),
        indirect=indirect.mean(axis=-1),
        standard_error=(direct + indirect).std(axis=-1) / np.sqrt(quality.samples),
    )


def _block(
    scene: Any,
    camera: Pinhole,
    shape: tuple[int, int],
    block: tuple[int, int],
    light: SunLight | DeviceLight,
    quality: Quality,
    seed: int,
) -> tuple[Array, Array, Array]:
    """Cosine, direct and indirect light of every path: three (rows, columns, samples) arrays."""
    mi = mitsuba()
    n_rows = block[1] - block[0]
    n_rays = n_rows * shape[1] * quality.samples
    # Scalars are made opaque, or each new value would compile a new kernel.
    stream = dr.opaque(
        mi.UInt64, int(np.random.SeedSequence([seed, block[0]]).generate_state(1)[0])
    )
    rng = mi.PCG32(size=n_rays, initstate=stream)
    ray, cos = primary_rays(camera, shape, block, quality.samples, rng)
    direct, indirect = _trace(
        mi, scene, ray, rng, connector(light), dr.opaque(mi.UInt32, quality.max_depth)
    )
    if camera.outline == "disc":
        seen = inside(camera, ray.d)
        direct, indirect = (dr.select(seen, x, 0) for x in (direct, indirect))
    dr.eval(cos, direct, indirect)
    full = (n_rows, shape[1], quality.samples)
    arrays = (np.array(x, dtype=np.float64).reshape(full) for x in (cos, direct, indirect))
    first, second, third = arrays
    return first, second, third


def primary_rays(
    camera: Pinhole, shape: tuple[int, int], block: tuple[int, int], samples: int, rng: Any
) -> tuple[Any, Any]:
    """Stratified rays through the cells of rows ``block``, and their cosine to the axis.

    With ``rng`` None every ray goes through the middle of its stratum.
    """
    mi = mitsuba()
    wide, high = (dr.opaque(mi.UInt32, n) for n in strata(samples, shape[0] / shape[1]))
    columns = dr.opaque(mi.UInt32, shape[1])
    index = dr.arange(mi.UInt32, (block[1] - block[0]) * shape[1] * samples)
    stratum, cell = index % (wide * high), index // (wide * high)
    row, column = cell // columns + dr.opaque(mi.UInt32, block[0]), cell % columns
    jitter_x, jitter_y = (0.5, 0.5) if rng is None else (rng.next_float32(), rng.next_float32())
    x = mi.Float(column) + (mi.Float(stratum % wide) + jitter_x) / mi.Float(wide)
    y = mi.Float(row) + (mi.Float(stratum // wide) + jitter_y) / mi.Float(high)
    t = dr.opaque(mi.Float, camera.tan_half_field)
    left = t * (1 - 2 * x / dr.opaque(mi.Float, shape[1]))
    up = t * (1 - 2 * y / dr.opaque(mi.Float, shape[0]))
    cos = dr.rsqrt(1 + left * left + up * up)
    forward_axis, left_axis, up_axis = _vectors(camera.axes)
    direction = (forward_axis + left * left_axis + up * up_axis) * cos
    return mi.Ray3f(_point(camera.origin_m), direction), cos


def strata(samples: int, aspect: float) -> tuple[int, int]:
    """Strata across and up in a cell of ``aspect`` width over height: factors of ``samples`` whose
    strata come nearest to squares.
    """
    factors = [n for n in range(1, samples + 1) if samples % n == 0]
    across = min(factors, key=lambda n: abs(np.log(n * n / samples / aspect)))
    return across, samples // across


class _SunConnector:
    def __init__(self, light: SunLight) -> None:
        (self.direction,) = _vectors(light.direction[None])

    def __call__(self, mi: Any, interaction: Any) -> tuple[Any, Any, Any]:
        """Direction to the light, the ray that must be free, and the light's weight."""
        return self.direction, interaction.spawn_ray(self.direction), mi.Float(1)


class _DeviceConnector:
    def __init__(self, light: DeviceLight) -> None:
        self.pinhole = light.pinhole
        self.is_pupil = light.kind == "pupil"
        self.origin = _point(light.pinhole.origin_m)
        (self.forward, *_) = _vectors(light.pinhole.axes)

    def __call__(self, mi: Any, interaction: Any) -> tuple[Any, Any, Any]:
        """Direction to the device, the ray that must be free, and 1/r^2 (x pupil cosine)."""
        towards = self.origin - interaction.p
        distance2 = dr.squared_norm(towards)
        direction = towards * dr.rsqrt(distance2)
        weight = dr.rcp(distance2)
        if self.is_pupil:
            weight *= dr.maximum(dr.dot(-direction, self.forward), 0)
        weight = dr.select(inside(self.pinhole, -direction), weight, 0)
        return direction, interaction.spawn_ray_to(self.origin), weight


def connector(light: SunLight | DeviceLight) -> Any:
    """What a path asks at each vertex: direction to the light, shadow ray, weight."""
    return _SunConnector(light) if isinstance(light, SunLight) else _DeviceConnector(light)


@dr.syntax
def _trace(mi: Any, scene: Any, ray: Any, rng: Any, connect: Any, max_depth: Any) -> Any:
    """Path tracing with next-event estimation to one light; (direct, indirect) per path."""
    context = mi.BSDFContext()
    throughput, direct, indirect = mi.Float(1), mi.Float(0), mi.Float(0)
    depth = mi.UInt32(0)
    active = mi.Bool(True)
    while active:
        interaction = scene.ray_intersect(ray, active)
        active &= interaction.is_valid()
        surface = interaction.bsdf(ray)
        direction, shadow_ray, weight = connect(mi, interaction)
        reflected = surface.eval(context, interaction, interaction.to_local(direction), active)[0]
        lit = active & (reflected * weight > 0)
        lit &= ~scene.ray_test(shadow_ray, lit)
        added = dr.select(lit, throughput * reflected * weight, 0)
        direct += dr.select(depth == 0, added, 0)
        indirect += dr.select(depth == 0, 0, added)
        depth += 1
        active &= depth < max_depth
        point = mi.Point2f(rng.next_float32(), rng.next_float32())
        sampled, value = surface.sample(context, interaction, rng.next_float32(), point, active)
        throughput *= value[0]
        active &= throughput > 0
        ray = interaction.spawn_ray(interaction.to_world(sampled.wo))
    return direct, indirect


def inside(pinhole: Pinhole, direction: Any) -> Any:
    """Whether a direction away from a pinhole is inside its field."""
    ahead = dr.dot(direction, _vectors(pinhole.axes)[0]) > 0
    left, up = field_coordinates(pinhole, direction)
    if pinhole.outline == "square":
        return ahead & (dr.abs(left) <= 1) & (dr.abs(up) <= 1)
    return ahead & (left * left + up * up <= 1)


def field_coordinates(pinhole: Pinhole, direction: Any) -> tuple[Any, Any]:
    """Where a direction meets the plane at distance 1: left and up, +/- 1 at the field's edges."""
    mi = mitsuba()
    forward, left, up = (dr.dot(direction, axis) for axis in _vectors(pinhole.axes))
    scale = dr.rcp(dr.opaque(mi.Float, pinhole.tan_half_field) * forward)
    return left * scale, up * scale


def _point(values: Array) -> Any:
    mi = mitsuba()
    return mi.Point3f(*(dr.opaque(mi.Float, float(v)) for v in values))


def _vectors(rows: Array) -> list[Any]:
    mi = mitsuba()
    return [mi.Vector3f(*(dr.opaque(mi.Float, float(v)) for v in row)) for row in rows]

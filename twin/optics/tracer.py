"""The light tracer: paths from the cells of a device, connected to a light at each surface.

All results are sums over the bounces of these paths: over all of them (`transport`), by cell of the
other device (`matrix`), by object (`by_object`), or each with its length (`time_of_flight`).
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import drjit as dr

from twin.engine import mitsuba
from twin.optics.devices import CellGrid, RayWeighting, per_distance2, sample_rays
from twin.optics.paths import Light, Place, TracingQuality, albedo, bounce, random_numbers
from twin.optics.ray_sets import Rays, RowRays
from twin.optics.scattering import Medium
from twin.optics.steps import PathSteps
from twin.optics.weather import Air

#: Paths traced in one kernel, which bounds memory.
RAYS_AT_ONCE = 2**22
#: How likely a path that ends by chance goes on at most, up to a number of bounces. After these it
#: goes on as likely as light is reflected, where the light of ever fewer paths would else grow.
_LIKELIEST, _LIKELIEST_BOUNCES, _LEAST_LIKELY = 0.98, 100, 1e-6
#: First and last row, the last one excluded.
Block = tuple[int, int]


class Bounce(NamedTuple):
    """Light of one bounce of every path of some rows, (n_cells x n_samples,) each, cell by cell.

    ``value``: light that reaches the surface directly from the source and is reflected to the
    path's cell, with the weight of `sample_rays`; its mean over a cell's paths is that cell's
    light. ``length``: of the whole path, m, 0 where there is no light; where the air scatters, the
    mean over the two ways back, weighted by their light. ``places``: the point of the source's own
    field, as in `Connection`. ``shape``: the object hit.
    """

    value: Any
    length: Any
    places: tuple[Place, ...]
    shape: Any


class Indirect(NamedTuple):
    """Light of all further bounces of each path, with the weight of `sample_rays`, and the rays to
    surfaces that it took, (n_paths,) each.
    """

    value: Any
    rays: Any


@dataclass(frozen=True, eq=False)
class Tracer:
    """Paths from the cells of ``start`` to a light; all random numbers follow from ``seed``.

    ``instants``: of a scene that moves, as many for each cell, one after another; each path has one
    of those of its cell, at random. None: rays say themselves of which instant they are.
    """

    scene: Any
    start: CellGrid
    weighting: RayWeighting
    light: Light
    air: Air | None
    quality: TracingQuality
    seed: int
    instants: int | None = None

    @property
    def scatters(self) -> bool:
        """Whether scatterings in the air are followed."""
        return self._medium is not None and self._medium.scatters

    @property
    def largest_weight(self) -> float:
        """Bound of the mean weight of a cell's paths, as `sample_rays` gives them."""
        device = self.start.device
        if device.pitch_m is not None and self.weighting == "emitter":
            return 2 * math.pi / (device.lobe_exponent + 1) / self.start.size
        brightest = max(device.edge_illumination, 1.0) ** 2
        return brightest * (2 * device.tan_half_field) ** 2 / self.start.size

    def blocks(self, samples: int) -> Iterator[Block]:
        """Rows whose paths fit into memory together, with ``samples`` of each cell."""
        per_block = max(1, RAYS_AT_ONCE // (self.start.columns * samples))
        for top in range(0, self.start.rows, per_block):
            yield top, min(top + per_block, self.start.rows)

    def bounces(self, block: Block, weight: float = 1.0) -> Iterator[Bounce]:
        """Bounces of all paths of a block of rows, one after another, times ``weight``.

        Each bounce is one kernel, which runs when the caller evaluates its result.
        """
        mi, steps = mitsuba(), self._steps
        rng, ray, throughput, active = self._rays(RowRays(*block, self.quality.samples))
        throughput, path_length = throughput * weight, mi.Float(0)
        for depth in range(self.quality.max_depth):
            first = depth == 0
            hit, ray, active, step_length = steps.next_surface(ray, rng, active, first=first)
            path_length = path_length + step_length
            if first and self.weighting == "pupil" and self.start.device.disc_radius_m:
                # Paths from a point of the pupil: the share of a point that the whole pupil has.
                distance2 = dr.square(step_length)
                throughput *= distance2 * per_distance2(self.start.device, distance2)
            value, link = steps.light_at(hit, ray, rng, active, coherent=first)
            length = path_length + link.length
            value = value * throughput * steps.unabsorbed(length)
            length = dr.select(value > 0, length + link.detour, 0)
            light = Bounce(value, length, link.places, hit.shape)
            # After the last one too, unless it is the only one: one kernel less to compile.
            if self.quality.max_depth > 1:
                throughput = throughput * albedo(hit, active)
                active = active & (throughput > 0)
                ray = bounce(hit, ray, rng, steps.clearance)
                dr.schedule(throughput, ray, active, path_length, rng)
            yield light
            dr.eval()

    def direct(self, rays: Rays) -> Bounce:
        """The first bounce alone, of light that is not scattered on the way to it."""
        steps = self._steps
        rng, ray, weight, active = self._rays(rays)
        hit, ray, active, step_length = steps.next_surface_straight(ray, active)
        value, link = steps.light_at(hit, ray, rng, active, coherent=True)
        length = step_length + link.length
        value *= steps.unabsorbed(length)
        value *= steps.unscattered(step_length)
        length = length + link.detour
        return Bounce(_per_path(weight * value, rng), length, link.places, hit.shape)

    def scattered(self, rays: Rays) -> Bounce:
        """The first bounce alone, of light that the air scatters on the way to it."""
        steps = self._steps
        rng, ray, weight, active = self._rays(rays, 2)
        (hit, ray, active, step_length), share = steps.next_surface_scattered(ray, rng, active)
        value, link = steps.light_at(hit, ray, rng, active, coherent=False)
        length = step_length + link.length
        value = value * share * steps.unabsorbed(length)
        length = length + link.detour
        return Bounce(_per_path(weight * value, rng), length, link.places, hit.shape)

    def indirect(self, rays: Rays) -> Any:
        """Sum of all further bounces, in one kernel whatever their number."""
        rng, ray, weight, active = self._rays(rays, 1)
        max_depth = dr.opaque(mitsuba().UInt32, self.quality.max_depth)
        light, _ = _further(self._steps, ray, rng, active, max_depth, False)
        return _per_path(weight * light, rng)

    def all_indirect(self, rays: Rays) -> Indirect:
        """The same up to `TracingQuality.most_bounces`: from the third surface on a path ends by
        chance, as likely as light is absorbed there, so that the mean is that of all bounces.
        """
        mi = mitsuba()
        rng, ray, weight, active = self._rays(rays, 1)
        most = dr.opaque(mi.UInt32, self.quality.most_bounces)
        light, traced = _further(self._steps, ray, rng, active, most, True)
        return Indirect(_per_path(weight * light, rng), traced + dr.zeros(mi.UInt32, dr.width(rng)))

    def _rays(self, rays: Rays, *key: int) -> tuple[Any, Any, Any, Any]:
        """Generator of random numbers, rays, their weights, and whether they belong to a cell."""
        count, streams = rays.count(self.start.columns), rays.streams()
        rng = random_numbers(count, self.seed, *key, *rays.key, streams=streams)
        ray, weight, active = sample_rays(self.start, rays, rng, self.weighting)
        if (instants := rays.instants()) is not None:
            ray.time = instants
        elif self.instants is not None:
            mi = mitsuba()
            number = dr.opaque(mi.UInt32, self.instants)
            one = mi.UInt32(rng.next_float32() * mi.Float(number))
            cell = rays.cells(self.start.columns)
            ray.time = mi.Float(cell * number + dr.minimum(one, number - 1))
        return rng, ray, weight, active

    @cached_property
    def _steps(self) -> PathSteps:
        return PathSteps(self.scene, self.light, self._medium)

    @cached_property
    def _medium(self) -> Medium | None:
        return Medium(self.air, self.quality.air_orders) if self.air else None


@dr.syntax
def _further(
    steps: PathSteps, ray: Any, rng: Any, active: Any, max_depth: Any, by_chance: bool
) -> tuple[Any, Any]:
    """Path tracing with next-event estimation from the second surface on, and the number of rays to
    surfaces; ``by_chance``: paths end where the light would be absorbed.
    """
    mi = mitsuba()
    hit, ray, active, length = steps.next_surface(ray, rng, active, first=True)
    throughput, total = albedo(hit, active), mi.Float(0)
    ray = bounce(hit, ray, rng, steps.clearance)
    depth = mi.UInt32(1)
    active &= throughput > 0
    while active & (depth < max_depth):
        hit, ray, active, step_length = steps.next_surface(ray, rng, active, first=False)
        length += step_length
        value, link = steps.light_at(hit, ray, rng, active, coherent=False)
        total += throughput * (value * steps.unabsorbed(length + link.length))
        if dr.hint(by_chance, mode="scalar"):
            likeliest = dr.select(depth < _LIKELIEST_BOUNCES, _LIKELIEST, 1.0)
            survives = dr.minimum(albedo(hit, active), likeliest)
            throughput *= albedo(hit, active) / dr.maximum(survives, _LEAST_LIKELY)
            active &= rng.next_float32() < survives
        else:
            throughput *= albedo(hit, active)
        active &= throughput > 0
        ray = bounce(hit, ray, rng, steps.clearance)
        depth += 1
    return total, depth


def _per_path(value: Any, rng: Any) -> Any:
    """One value for every path, also where ``value`` is a single number."""
    return value + dr.zeros(mitsuba().Float, dr.width(rng))

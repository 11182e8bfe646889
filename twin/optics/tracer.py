"""The light tracer: paths from the cells of a device, connected to a light at each surface.

What is computed of light are sums over its bounces: over all of them (`transport`), by cell of the
other device (`matrix`), by object (`by_object`), or each kept with its length (`time_of_flight`).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import drjit as dr

from twin.engine import mitsuba
from twin.optics.devices import Grid, Role, started_rays
from twin.optics.paths import Light, Place, Quality, albedo, bounce, random_numbers
from twin.optics.scattering import Medium
from twin.optics.steps import PathSteps
from twin.optics.weather import Air

#: Paths traced in one kernel, which bounds memory.
RAYS_AT_ONCE = 2**22
#: First and last row, the last one excluded.
Block = tuple[int, int]


class Bounce(NamedTuple):
    """Light of one bounce of every path of some rows, (n_cells x n_samples,) each, cell by cell.

    ``value``: what the surface has straight from the light and sends back to the path's cell,
    weighted as the cell's role says (`started_rays`); its mean over a cell's paths is that cell's
    light. ``length``: of the whole way, m, 0 where there is no light. ``places``: where it arrives
    in the light's own field, as in `Connection`. ``shape``: the object that was met.
    """

    value: Any
    length: Any
    places: tuple[Place, ...]
    shape: Any


@dataclass(frozen=True, eq=False)
class Tracer:
    """Paths from the cells of ``start`` to a light; all draws follow from ``seed``."""

    scene: Any
    start: Grid
    role: Role
    light: Light
    air: Air | None
    quality: Quality
    seed: int

    @property
    def scatters(self) -> bool:
        """Whether scatterings in the air are followed."""
        return self._steps.scatters

    def blocks(self, samples: int) -> Iterator[Block]:
        """Rows whose paths fit into memory together, with ``samples`` of each cell."""
        per_block = max(1, RAYS_AT_ONCE // (self.start.columns * samples))
        for top in range(0, self.start.rows, per_block):
            yield top, min(top + per_block, self.start.rows)

    def bounces(self, block: Block, weight: float = 1.0) -> Iterator[Bounce]:
        """Bounce after bounce of all paths of some rows, times ``weight``.

        Each bounce is one kernel: it runs when the caller evaluates what it makes of it.
        """
        mi, steps = mitsuba(), self._steps
        rng, ray, throughput, active = self._rays(block, self.quality.samples)
        throughput, travelled = throughput * weight, mi.Float(0)
        for depth in range(self.quality.max_depth):
            first = depth == 0
            hit, ray, active, way = steps.next_surface(ray, rng, active, first=first)
            travelled = travelled + way
            value, link = steps.light_at(hit, ray, rng, active, coherent=first)
            length = dr.select(value > 0, travelled + link.length, 0)
            light = Bounce(
                value * throughput * steps.unabsorbed(length), length, link.places, hit.shape
            )
            # After the last one too, unless it is the only one: one kernel less to compile.
            if self.quality.max_depth > 1:
                throughput = throughput * albedo(hit, active)
                active = active & (throughput > 0)
                ray = bounce(hit, ray, rng)
                dr.schedule(throughput, ray, active, travelled, rng)
            yield light
            dr.eval()

    def direct(self, block: Block) -> Bounce:
        """The first bounce alone, of light that reaches it straight."""
        steps = self._steps
        rng, ray, weight, active = self._rays(block, self.quality.samples)
        hit, ray, active, way = steps.next_surface_straight(ray, active)
        value, link = steps.light_at(hit, ray, rng, active, coherent=True)
        length = way + link.length
        value *= steps.unabsorbed(length)
        value *= steps.unscattered(way)
        return Bounce(_of_all(weight * value, rng), length, link.places, hit.shape)

    def scattered(self, block: Block) -> Bounce:
        """The first bounce alone, of light that the air scatters before it."""
        steps = self._steps
        rng, ray, weight, active = self._rays(block, self.quality.samples, 2)
        (hit, ray, active, way), share = steps.next_surface_scattered(ray, rng, active)
        value, link = steps.light_at(hit, ray, rng, active, coherent=False)
        length = way + link.length
        value = value * share * steps.unabsorbed(length)
        return Bounce(_of_all(weight * value, rng), length, link.places, hit.shape)

    def indirect(self, block: Block) -> Any:
        """Values of all further bounces together, in one kernel whatever their number."""
        rng, ray, weight, active = self._rays(block, self.quality.further_samples, 1)
        max_depth = dr.opaque(mitsuba().UInt32, self.quality.max_depth)
        return _of_all(weight * _further(self._steps, ray, rng, active, max_depth), rng)

    def _rays(self, block: Block, samples: int, *key: int) -> tuple[Any, Any, Any, Any]:
        """Generator of random numbers, rays, their weights, and whether they belong to a cell."""
        n_rays = (block[1] - block[0]) * self.start.columns * samples
        rng = random_numbers(n_rays, self.seed, *key, block[0])
        return rng, *started_rays(self.start, block, samples, rng, self.role)

    @cached_property
    def _steps(self) -> PathSteps:
        medium = Medium(self.air, self.quality.air_orders) if self.air else None
        return PathSteps(self.scene, self.light, medium)


@dr.syntax
def _further(steps: PathSteps, ray: Any, rng: Any, active: Any, max_depth: Any) -> Any:
    """Path tracing with next-event estimation from the second surface on."""
    mi = mitsuba()
    hit, ray, active, length = steps.next_surface(ray, rng, active, first=True)
    throughput, total = albedo(hit, active), mi.Float(0)
    ray = bounce(hit, ray, rng)
    depth = mi.UInt32(1)
    active &= throughput > 0
    while active & (depth < max_depth):
        hit, ray, active, way = steps.next_surface(ray, rng, active, first=False)
        length += way
        value, link = steps.light_at(hit, ray, rng, active, coherent=False)
        total += throughput * (value * steps.unabsorbed(length + link.length))
        throughput *= albedo(hit, active)
        active &= throughput > 0
        ray = bounce(hit, ray, rng)
        depth += 1
    return total


def _of_all(value: Any, rng: Any) -> Any:
    """The value of every path, where it may be one for all."""
    return value + dr.zeros(mitsuba().Float, dr.width(rng))

"""What motion changes counts by: whether a frame needs more than one instant, and how many."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, minimum_filter

from hardware.formatting import number
from twin.camera.chain import Chain
from twin.camera.equal_paths import sun_shape
from twin.camera.exposure_noise import exposure_noise_w, lit_share
from twin.camera.exposures import Exposures
from twin.camera.looks import Looks
from twin.camera.model_error import side_by_side
from twin.camera.motion import Seen, WorldInMotion
from twin.camera.mounting import devices
from twin.camera.rendered import RenderedLight
from twin.camera.shadows import Shadows, shadows
from twin.digest import digest
from twin.optics.devices import Device
from twin.scene import Scene
from twin.system import System
from twin.warned import CaptureWarning

Array = NDArray[np.float64]

#: Cells that what is seen passes at most from one first instant to the next, where it matters.
_STEP_CELLS = 2.0
_MOST_FIRST = 512


@dataclass(frozen=True, eq=False)
class CountChange:
    """What motion changes counts by, an estimate from above.

    A cell that something passes changes by the contrast of the cells as far around it as things
    move, or by the share of a cell that they move, and by what its light differs by between the
    times looked at; such changes add up over the lit cells of an exposure as independent ones, and
    so do those of the parts of the sun's light. What comes nearer grows brighter in all cells at
    once, and so change all cells or parts together that something covers, or shades.

    Parameters
    ----------
    images, suns : (n, rows, columns) array
        Light of the cells, and of the parts of the sun's light, W: at one instant of the frame, and
        then at those looked at.
    step_s
        From one of these to the next.
    changed : (rows, columns) array
        Cells that may change.
    unseen : (n_cells,) array
        Light that cells may have of bodies that pass them between the times looked at, W.
    seen
        How fast.
    shadows
        Of the bodies that may keep the sun off what is seen.
    cells_per_tangent
        Cells over the plane at distance 1.
    lit_share
        Of cells that are lit in an exposure.
    noise_w
        Of an exposure.
    """

    images: Array
    suns: Array
    step_s: float
    changed: NDArray[np.bool_]
    unseen: Array
    seen: Seen
    shadows: Shadows
    cells_per_tangent: float
    lit_share: float
    noise_w: float

    def within(self, seconds: float) -> float:
        """Over as long a time, over an exposure's noise."""
        return math.hypot(self.of_light(seconds), self.of_sun(seconds))

    def of_light(self, seconds: float) -> float:
        """The same of the emitter's light alone."""
        passed = self.cells_passed(seconds)
        looks = self.images[1:] * self.changed
        cells = np.maximum(_contrast(self.images, passed), self._between(looks, seconds, passed))
        nearer = self.images[0].ravel() * np.minimum(self.seen.brightening_per_s * seconds, 1)
        together = max(
            float(nearer.sum()), float(self._between(looks.sum(axis=(1, 2)), seconds, passed))
        )
        share = math.sqrt(self.lit_share)
        independent = math.hypot(
            *(share * np.linalg.norm(x) for x in (cells[self.changed], self.unseen))
        )
        return math.hypot(independent, self.lit_share * together) / self.noise_w

    def of_sun(self, seconds: float) -> float:
        """The same of the sun's light alone."""
        passed = self.cells_passed(seconds, self.shadows.fastest_per_s)
        passed *= self.suns.shape[1] / self.images.shape[1]
        parts = np.maximum(
            _contrast(self.suns, passed), self._between(self.suns[1:], seconds, passed)
        )
        together = float(self._between(self.suns[1:].sum(axis=(1, 2)), seconds, passed))
        brightest, whole = self.suns.max(axis=0), float(self.suns.sum(axis=(1, 2)).max())
        shaded = min(self.shadows.area * brightest.size * float(brightest.max()), whole)
        together = max(together, min(passed, 1.0) * shaded)
        return math.hypot(float(np.linalg.norm(parts)), together) / self.noise_w

    @property
    def sun_range(self) -> float:
        """Of the parts of the sun's light between the times looked at, norm, over the noise."""
        return float(np.linalg.norm(np.ptp(self.suns, axis=0)) / self.noise_w)

    def _between(self, looks: Array, seconds: float, passed: float) -> Array:
        """What light at the times looked at differs by from one to another as far apart."""
        step = np.abs(np.diff(looks, axis=0)).max(axis=0)
        change = np.minimum(step * seconds / self.step_s, np.ptp(looks, axis=0))
        return np.asarray(min(passed, 1.0) * change)

    def cells_passed(self, seconds: float, beside_per_s: float = 0.0) -> float:
        """Cells that what is seen passes in a time, at most; or what else goes that fast."""
        return max(self.seen.fastest_per_s, beside_per_s) * seconds * self.cells_per_tangent

    def first_instants(
        self, duration_s: float, tolerance: float, change: Callable[[float], float]
    ) -> Array:
        """Instants, ascending, from the start to the end, so close that in between counts change by
        less than a tolerance, or what is seen passes no more than some cells; ``change``: of a
        time, one of the methods.
        """
        shadows = self.shadows.fastest_per_s if change == self.of_sun else 0.0
        passed = self.cells_passed(duration_s, shadows)
        enough = math.ceil(min(passed / _STEP_CELLS, _MOST_FIRST))
        n = 1
        while n < enough and change(duration_s / n) > tolerance:
            n *= 2
        return np.linspace(0, duration_s, max(min(n, enough), 1) + 1)


@dataclass(frozen=True, eq=False)
class _View:
    """From where a frame is lit and seen: equal where all of it is, as sensors of a study often
    are.
    """

    emitter: Device
    detector: Device
    shape: tuple[int, int]
    sun_shape: tuple[int, int]

    @staticmethod
    def of(scene: Scene, system: System) -> "_View":
        emitter, detector, _ = devices(scene, system)
        return _View(emitter, detector, system.image_shape, sun_shape(system))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _View) and self._content == other._content

    def __hash__(self) -> int:
        return hash(self._content)

    @cached_property
    def _content(self) -> str:
        return digest(self.emitter, self.detector, self.shape, self.sun_shape)


@dataclass(frozen=True, eq=False)
class _Passing:
    """What a view has of a world in motion: how fast, cells, (rows, columns), that change, light at
    some times, and shadows.
    """

    seen: Seen
    changed: NDArray[np.bool_]
    looks: Looks
    shadows: Shadows

    @staticmethod
    def of(world: WorldInMotion, view: _View) -> "_Passing":
        changes = world.changes(world.looks_s, view.emitter, view.detector, view.shape)
        changed = np.asarray(np.logical_or.reduce(changes, axis=0)).reshape(view.shape)
        seen = world.seen(view.emitter, view.shape)
        looks = Looks.of(world, view.emitter, view.detector, view.shape, view.sun_shape)
        return _Passing(seen, changed, looks, shadows(world, view.detector, seen.nearest_m))


@lru_cache(maxsize=8)
def _passing(scene: Scene, duration_s: float, view: _View) -> _Passing | None:
    """During a frame, once for all sensors of one view; None where nothing moves."""
    world = WorldInMotion(scene, duration_s)
    return None if world.is_at_rest else _Passing.of(world, view)


def count_change(world: WorldInMotion, chain: Chain, rendered: RenderedLight) -> CountChange:
    """What a world in motion changes counts by; ``rendered``: light at one instant of the frame."""
    view = _View.of(world.scene, chain.system)
    return _count_change(_Passing.of(world, view), view.emitter, chain, rendered)


def _count_change(
    passing: _Passing, emitter: Device, chain: Chain, rendered: RenderedLight
) -> CountChange:
    system, seen = chain.system, passing.seen
    watt = float(chain.watts_of(rendered).max() * chain.largest_share)
    largest = (2 * emitter.tan_half_field) ** 2 / passing.changed.size * watt
    image = side_by_side(chain.powers(rendered).cells_w.sum(axis=0), system)
    weight = chain.sun_weight(rendered)
    return CountChange(
        np.concatenate([image[None], watt * passing.looks.light]),
        weight * np.concatenate([rendered.sun[None], passing.looks.sun]),
        passing.looks.step_s,
        passing.changed,
        largest * seen.unseen_per_m2,
        seen,
        passing.shadows,
        max(system.image_shape) / (2 * emitter.tan_half_field),
        lit_share(chain),
        exposure_noise_w(chain, rendered),
    )


def frozen_error(
    scene: Scene, chain: Chain, rendered: RenderedLight
) -> tuple[float, tuple[CaptureWarning, ...]]:
    """What motion during a frame that is taken as still may change counts by, over their noise, and
    a warning of it; 0 and none where it is not more than their noise. Only to the end of
    trajectories that end before the frame.
    """
    if scene.at_rest and not scene.rig.moves:
        return 0.0, ()
    duration = min(Exposures.of(chain.system).duration_s, scene.span_s[1])
    if duration <= 0:
        return 0.0, ()
    view = _View.of(scene, chain.system)
    passing = _passing(scene, duration, view)
    if passing is None:
        return 0.0, ()
    change = _count_change(passing, view.emitter, chain, rendered)
    over = change.within(duration)
    if not over > 1:
        return 0.0, ()
    text = (
        f"the scene moves by up to {number(change.cells_passed(duration), 2)} cells in a frame, "
        f"which is taken as still: errors of counts up to some {number(over, 2)} times their "
        "noise; fidelity.motion_tolerance models the motion"
    )
    return over, (CaptureWarning("tolerance", text),)


def _contrast(images: Array, passed: float) -> Array:
    """Of each cell, what it may change by at most in one of the images, (n, rows, columns), where
    things pass so many cells.
    """
    side = 2 * min(math.ceil(passed), max(images.shape[1:])) + 1
    size = (1, side, side)
    contrast = maximum_filter(images, size) - minimum_filter(images, size)
    return np.asarray(min(passed, 1.0) * contrast.max(axis=0))

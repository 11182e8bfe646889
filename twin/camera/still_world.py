"""Light of frames of a world in which nothing moves, or nothing but the sun."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.camera.light import render
from twin.camera.rendered import RenderedLight
from twin.camera.sun_in_frame import middle_of_frame_s
from twin.fidelity import Fidelity
from twin.scene import Scene, Sun
from twin.system import System

Array = NDArray[np.float64]

#: Between suns so many seconds apart, 0.1 degrees, the light of one that moves is linear.
_STEP_S = 24.0


class StillWorld:
    """Light of a camera's frames at any time: rendered once, or at steps of a sun that moves.

    Paths are drawn from ``seed`` alone, the same ones at all times. Between two steps the sun's
    light is linear; when it has set nothing is rendered anew.
    """

    def __init__(
        self, scene: Scene, system: System, fidelity: Fidelity, seed: np.random.SeedSequence
    ) -> None:
        self._scene, self._system, self._fidelity, self._seed = scene, system, fidelity, seed
        self._middle_s = middle_of_frame_s(system)
        self._held: dict[Sun, RenderedLight] = {}

    def at(self, begin_s: float) -> tuple[Scene, RenderedLight]:
        """The scene in the middle of the frame that begins at a time, and its light."""
        if not self._scene.sun.moves:
            return self._scene, self._under(self._scene.sun)
        step, sun = math.floor(begin_s / _STEP_S), self._sun(begin_s)
        share = begin_s / _STEP_S - step
        ends = {self._sun(_STEP_S * step): 1 - share, self._sun(_STEP_S * (step + 1)): share}
        lit = {end: part for end, part in ends.items() if part and not end.has_set}
        if sun.has_set or not lit:
            lit = {_dark(sun): 1.0}
        self._held = {end: light for end, light in self._held.items() if end in lit}
        parts, lights = np.array(list(lit.values())), [self._under(end) for end in lit]
        return replace(self._scene, sun=sun), _mean(lights, parts / parts.sum())

    def _sun(self, begin_s: float) -> Sun:
        """Of the middle of the frame that begins at a time."""
        return self._scene.sun.after(begin_s + self._middle_s)

    def _under(self, sun: Sun) -> RenderedLight:
        """Light under a sun."""
        if sun not in self._held:
            # Without the children that a render before spawned.
            seed = np.random.SeedSequence(self._seed.entropy, spawn_key=self._seed.spawn_key)
            then = replace(self._scene, sun=sun)
            self._held[sun] = render(then, self._system, fidelity=self._fidelity, seed=seed)
        return self._held[sun]


def _dark(sun: Sun) -> Sun:
    """The same one for all of the night."""
    return replace(sun, azimuth_deg=0.0, elevation_deg=-90.0, illuminance_lx=0.0)


def _mean(lights: Sequence[RenderedLight], parts: Array) -> RenderedLight:
    """Between the sun's light in some renders by the same paths, whose errors go along."""
    if len(lights) == 1:
        return lights[0]

    def between(name: str) -> Any:
        return sum(p * getattr(light, name) for p, light in zip(parts, lights, strict=True))

    names = "sun", "sun_error", "sun_left_out"
    return replace(lights[0], **{name: between(name) for name in names})

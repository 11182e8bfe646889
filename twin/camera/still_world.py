"""Light of a world in which nothing moves, or nothing but the sun."""

from dataclasses import replace

import numpy as np

from twin.camera.light import render
from twin.camera.rendered import RenderedLight
from twin.fidelity import Fidelity
from twin.scene import Scene
from twin.system import System

#: A sun that moves is followed in steps of so many seconds, in which it turns by 0.1 degrees: its
#: direction is off by half as much, a fifth of the radius of its disc, which is a point here.
_SUN_STEP_S = 24.0


class StillWorld:
    """Light of a camera at any time: rendered once, or anew as the sun's direction changes; the
    sun's illuminance is that of each time.

    Paths are drawn from ``seed`` alone, the same ones at all times.
    """

    def __init__(
        self, scene: Scene, system: System, fidelity: Fidelity, seed: np.random.SeedSequence
    ) -> None:
        self._scene, self._system, self._fidelity, self._seed = scene, system, fidelity, seed
        self._step: int | None = None
        self._rendered: RenderedLight | None = None

    def at(self, seconds: float) -> tuple[Scene, RenderedLight]:
        """The scene at a time, and its light."""
        step = round(seconds / _SUN_STEP_S) if self._scene.sun.moves else 0
        if self._rendered is None or step != self._step:
            # Without the children that a render before spawned.
            seed = np.random.SeedSequence(self._seed.entropy, spawn_key=self._seed.spawn_key)
            then = self._under(step * _SUN_STEP_S)
            self._rendered = render(then, self._system, fidelity=self._fidelity, seed=seed)
            self._step = step
        return self._under(seconds), self._rendered

    def _under(self, seconds: float) -> Scene:
        """The scene under the sun of a time."""
        sun = self._scene.sun
        return replace(self._scene, sun=sun.after(seconds)) if sun.moves else self._scene

"""Light of frames of a world in which nothing moves, or nothing but the sun."""

import math
from dataclasses import replace
from typing import Any

import numpy as np

from twin.camera.chain import Chain
from twin.camera.exposure_noise import exposure_noise_w
from twin.camera.light import render
from twin.camera.rendered import RenderedLight
from twin.camera.sun_in_frame import middle_of_frame_s
from twin.fidelity import Fidelity
from twin.scene import Scene, Sun
from twin.system import System

#: Steps of a sun that moves, 0.1 degrees, and how often they are halved where its light bends.
_STEP_S, _MOST_HALVINGS = 24.0, 6
#: Of an exposure's noise, by which the light of one that moves may be off where no tolerance of
#: motion is given.
_TOLERANCE = 0.1


class StillWorld:
    """Light of a camera's frames at any time: rendered once, or at steps of a sun that moves.

    Paths are drawn from ``seed`` alone, the same ones at all times. Between two steps the sun's
    light is linear, to `motion_tolerance` of an exposure's noise: as it was found in the middle
    between them. When the sun has set nothing is rendered anew.
    """

    def __init__(
        self, scene: Scene, system: System, fidelity: Fidelity, seed: np.random.SeedSequence
    ) -> None:
        self._scene, self._system, self._fidelity, self._seed = scene, system, fidelity, seed
        self._middle_s = middle_of_frame_s(system)
        #: By the begin of the frame; None: at night, or of a sun that stands still.
        self._held: dict[float | None, RenderedLight] = {}
        #: Of the step that they are of, intervals in which light is not linear.
        self._step_s, self._bent = math.nan, dict[tuple[float, float], bool]()

    def at(self, begin_s: float) -> tuple[Scene, RenderedLight]:
        """The scene in the middle of the frame that begins at a time, and its light."""
        if not self._scene.sun.moves:
            return self._scene, self._light(None, self._scene.sun)
        then = replace(self._scene, sun=self._sun(begin_s))
        if then.sun.has_set:
            return then, self._light(None, _dark(then.sun))
        first_s, last_s = self._interval(begin_s)
        share = (begin_s - first_s) / (last_s - first_s)
        if share == 0:
            return then, self._lit(first_s)
        return then, _between(self._lit(first_s), self._lit(last_s), share)

    def _interval(self, begin_s: float) -> tuple[float, float]:
        """Times around a frame's begin between which the sun's light is linear."""
        first_s = math.floor(begin_s / _STEP_S) * _STEP_S
        last_s = first_s + _STEP_S
        if self._step_s != first_s:
            self._step_s = first_s
            self._held = {at: self._held[at] for at in (first_s, last_s) if at in self._held}
            self._bent = {}
        for _ in range(_MOST_HALVINGS):
            if begin_s == first_s:
                break
            middle_s = (first_s + last_s) / 2
            bends = self._bends(first_s, middle_s, last_s)
            first_s, last_s = (first_s, middle_s) if begin_s < middle_s else (middle_s, last_s)
            if not bends:
                break
        return first_s, last_s

    def _bends(self, first_s: float, middle_s: float, last_s: float) -> bool:
        """Whether the sun's light is too far from linear between two times."""
        key = first_s, last_s
        if key not in self._bent:
            lights = [self._lit(at) for at in (first_s, middle_s, last_s)]
            brighter = max(map(self._sun, key), key=lambda sun: sun.elevation_deg)
            chain = Chain.of(self._system, brighter)
            first, middle, last = (chain.powers(light) for light in lights)
            further = middle.sun_w - (first.sun_w + last.sun_w) / 2
            # Without what their paths differ by.
            off2 = float((further**2 - 1.5 * middle.sun_error_w**2).max())
            tolerance = self._fidelity.motion_tolerance or _TOLERANCE
            self._bent[key] = off2 > (tolerance * exposure_noise_w(chain, lights[1])) ** 2
        return self._bent[key]

    def _sun(self, begin_s: float) -> Sun:
        """Of the middle of the frame that begins at a time."""
        return self._scene.sun.after(begin_s + self._middle_s)

    def _lit(self, begin_s: float) -> RenderedLight:
        """Light of the frame that begins at a time, under the sun of the horizon too."""
        sun = self._sun(begin_s)
        if sun.has_set:
            sun = Sun(sun.azimuth_deg, sun.elevation_deg, sun.illuminance_lx)
        return self._light(begin_s, sun)

    def _light(self, key: float | None, sun: Sun) -> RenderedLight:
        if key not in self._held:
            # Without the children that a render before spawned.
            seed = np.random.SeedSequence(self._seed.entropy, spawn_key=self._seed.spawn_key)
            then = replace(self._scene, sun=sun)
            self._held[key] = render(then, self._system, fidelity=self._fidelity, seed=seed)
        return self._held[key]


def _dark(sun: Sun) -> Sun:
    """The same one for all of the night."""
    return replace(sun, azimuth_deg=0.0, elevation_deg=-90.0, illuminance_lx=0.0)


def _between(one: RenderedLight, other: RenderedLight, share: float) -> RenderedLight:
    """With the sun's light between that of two renders by the same paths, whose errors go along."""

    def mean(name: str) -> Any:
        return (1 - share) * getattr(one, name) + share * getattr(other, name)

    return replace(one, **{name: mean(name) for name in ("sun", "sun_error", "sun_left_out")})

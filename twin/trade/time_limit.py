"""The smallest tolerance whose frames a time allows on this machine, or else coarser knobs."""

import math
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from hardware.formatting import number, si
from hardware.units import quantity
from twin.camera import capture
from twin.camera.render_warnings import is_out_of_paths
from twin.errors import InputError
from twin.fidelity import DEFAULT, PRESETS, Fidelity, Tolerance
from twin.fidelity.knobs import is_number
from twin.fidelity.light import LightFidelity
from twin.fidelity.radar import RadarFidelity
from twin.radar import RadarDesign, load_radar, radar_capture
from twin.scene import Scene, load_scene
from twin.scene.mitsuba import mitsuba_scene
from twin.system import System, load_system

#: A frame, to its warnings.
_Frame = Callable[[Fidelity], Iterable[str]]
#: Tolerances that are tried, each half of the one before.
_SHARES = tuple(2.0 / 2**step for step in range(10))
#: Of a frame's time from one tolerance to its half at least, before two have been measured.
_LEAST_GROWTH = 1.1
#: Of what a frame may take, what one may measure: frames scatter.
_OF_LIMIT = 0.8


@dataclass(frozen=True)
class TimedShare:
    """What a sensor's frame takes at most at a tolerance, a share of the sensor's noise; or, where
    none is large enough, by coarser knobs, which have a name and promise no share: infinity.
    """

    noise_share: float
    frame_s: float
    coarser: str = ""

    def __str__(self) -> str:
        level = self.coarser or f"{number(self.noise_share)} of the noise"
        return f"{level}, {si(self.frame_s, 's')} a frame"


@dataclass(frozen=True)
class TimedFidelity:
    """Knobs with what they were chosen by; None for a sensor that there is not."""

    fidelity: Fidelity
    camera: TimedShare | None
    radar: TimedShare | None

    def __str__(self) -> str:
        told = {"camera": self.camera, "radar": self.radar}
        return "; ".join(f"{name}: {share}" for name, share in told.items() if share)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What coarser knobs than any tolerance's leave out without a bound of its own."""
        told = []
        if self.camera and self.fidelity.max_depth == 1 and not self.fidelity.has_light_tolerance:
            told.append("camera: light of more than one bounce is left out")
        if self.radar and self.radar.coarser:
            left_out = {
                "targets": "bodies, clutter, shadows and mirror images are",
                "paths": "bodies' surfaces, edges and clutter are",
            }.get(str(self.fidelity.radar), "further reflections, edges and clutter are")
            told.append(f"radar: {left_out} left out, and errors of its figures are not bounded")
        return tuple(told)


def fidelity_within(
    scene: str | Path | Scene,
    frame_s: float | str,
    *,
    system: str | Path | System | None = "workable",
    radar: str | Path | RadarDesign | None = "hybrid-79",
    seed: int = 0,
    fixed: Mapping[str, Any] | None = None,
) -> TimedFidelity:
    """The smallest tolerance at which a frame takes no longer than ``frame_s`` on this machine,
    a number or text with a unit, for the camera and the radar each; from 2 of the sensor's noise
    down to 0.004, or to what the limit of paths reaches. What else the radar models, such as its
    bounces, is as by default.

    Where even the largest takes longer, coarser knobs are tried: nothing moves within the camera's
    frame, then that with `draft`; of the radar `draft`, then `paths`, then `targets` alone. Their
    error is told by each result, and what they leave out is warned of there.

    ``fixed``: knobs by name that have these values whatever else is chosen; frames are timed with
    them.

    A frame is all from the scene to the counts, once kernels are compiled and the scene is loaded.
    It is measured, so what is chosen differs between machines and may differ between runs; results
    depend on what was chosen alone. Choosing takes some times ``frame_s``.

    Raises InputError where a frame takes longer by the coarsest knobs.
    """
    limit_s = _seconds(frame_s)
    if system is None and radar is None:
        raise InputError("system, radar: both are none, expected at least one of them")
    if not isinstance(seed, int) or seed < 0:
        raise InputError(f"seed: {seed!r:.60}: expected a whole number from 0")
    world = scene if isinstance(scene, Scene) else load_scene(scene)
    camera = echoes = None
    always = dict(fixed or {})
    knobs = DEFAULT
    if system is not None:
        sensor, rendered = load_system(system), mitsuba_scene(world)

        def image(fidelity: Fidelity) -> Iterable[str]:
            given = fidelity.with_(always)
            return capture(world, sensor, seed=seed, fidelity=given, mesh_scene=rendered).warnings

        camera = _best("camera", image, limit_s, always)
        if camera.coarser:
            knobs = _with(knobs, _coarser("camera", always)[camera.coarser], LightFidelity)
        else:
            knobs = _of_light(knobs, camera.noise_share)
    if radar is not None:
        design = load_radar(radar)

        def burst(fidelity: Fidelity) -> Iterable[str]:
            given = fidelity.with_(always)
            return radar_capture(world, design, seed=seed, fidelity=given).warnings

        echoes = _best("radar", burst, limit_s, always)
        if echoes.coarser:
            knobs = _with(knobs, _coarser("radar", always)[echoes.coarser], RadarFidelity)
        else:
            knobs = replace(knobs, radar_tolerance=echoes.noise_share / 2)
    return TimedFidelity(knobs.with_(always), camera, echoes)


def _of_light(knobs: Fidelity, share: float) -> Fidelity:
    """The knobs with light to a share of the sensor's noise."""
    asked = Tolerance(share).knobs()
    return replace(
        knobs, light_tolerance=asked.light_tolerance, motion_tolerance=asked.motion_tolerance
    )


def _seconds(frame_s: float | str) -> float:
    value = quantity(frame_s, "s", bare=True) if isinstance(frame_s, str) else frame_s
    if not is_number(value) or not 0 < value < math.inf:
        raise InputError(f"within: {value!r:.60}: expected a finite time above 0 s")
    return float(value)


def _with(knobs: Fidelity, other: Fidelity, sensor: type) -> Fidelity:
    """The knobs with another's of one sensor."""
    return replace(knobs, **{field.name: getattr(other, field.name) for field in fields(sensor)})


def _best(
    sensor: str,
    frame: _Frame,
    limit_s: float,
    fixed: Mapping[str, Any] | None = None,
) -> TimedShare:
    """The finest tolerance within the limit, or the first of the coarser knobs that is."""
    largest = finest(frame, limit_s)
    if largest.frame_s <= limit_s:
        return largest
    for name, fidelity in _coarser(sensor, fixed or {}).items():
        frame(fidelity)  # compiles
        took_s, _ = _timed(frame, fidelity)
        if took_s <= limit_s:
            return TimedShare(math.inf, took_s, name)
    raise InputError(
        f"within: {limit_s:g} s: a frame of the {sensor} takes {took_s:.2g} s by the coarsest "
        f"knobs, {name}, and {largest.frame_s:.2g} s at the largest tolerance, "
        f"{largest.noise_share:g} of the noise"
    )


def _timed(frame: _Frame, fidelity: Fidelity) -> tuple[float, bool]:
    """What a frame may take, from one, and whether its paths suffice."""
    start = time.perf_counter()
    warnings = frame(fidelity)
    return (time.perf_counter() - start) / _OF_LIMIT, not is_out_of_paths(warnings)


def finest(frame: _Frame, limit_s: float) -> TimedShare:
    """The last of the tolerances that stays within the limit, and that the limit of paths reaches,
    as far as the next ones are worth trying: a frame takes the longer, the smaller the tolerance.
    The largest, where none does.
    """

    def timed(share: float) -> tuple[TimedShare, bool]:
        knobs = replace(_of_light(DEFAULT, share), radar_tolerance=share / 2)
        took_s, reached = _timed(frame, knobs)
        return TimedShare(share, took_s), reached

    timed(_SHARES[0])  # compiles
    best, _ = timed(_SHARES[0])
    growth = _LEAST_GROWTH
    for share in _SHARES[1:]:
        if best.frame_s * growth > limit_s:
            break
        tried, reached = timed(share)
        if tried.frame_s > limit_s or not reached:
            break
        growth = max(tried.frame_s / best.frame_s, _LEAST_GROWTH)
        best = tried
    return best


_STILL = " with nothing that moves within a frame"


def _coarser(sensor: str, fixed: Mapping[str, Any]) -> dict[str, Fidelity]:
    """By name, from the best on: what takes less time than the largest tolerance, without what
    would need another value of a knob that is fixed.
    """
    draft = PRESETS["draft"]
    if sensor == "radar":
        found = {"`draft`": draft}
        if "radar" not in fixed:
            found["`draft` with `paths`"] = replace(draft, radar="paths")
            found["declared targets alone"] = replace(draft, radar="targets")
        return found
    if "motion_tolerance" in fixed:
        return {"`draft`": draft}
    largest = _of_light(DEFAULT, _SHARES[0])
    return {
        f"{_SHARES[0]:g} of the noise{_STILL}": replace(largest, motion_tolerance=None),
        f"`draft`{_STILL}": replace(draft, motion_tolerance=None),
    }

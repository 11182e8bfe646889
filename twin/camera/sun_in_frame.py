"""The sun of a frame, which stands still in it: where it is in the middle."""

from dataclasses import replace

from hardware.formatting import number
from twin.camera.exposures import Exposures
from twin.scene import Scene, Sun
from twin.scene.sun import TURN_DEG_PER_S
from twin.system import System
from twin.warned import CaptureWarning

#: Turn of the sun in a frame, and change of its brightness, above which a warning is given.
_TURN_DEG, _CHANGE = 0.1, 0.01


def middle_of_frame_s(system: System) -> float:
    """From a frame's begin."""
    return Exposures.of(system).duration_s / 2


def sun_of_frame(scene: Scene, system: System) -> Scene:
    """The scene at a frame's begin, under the sun of the frame's middle."""
    if not scene.sun.moves:
        return scene
    return replace(scene, sun=scene.sun.after(middle_of_frame_s(system)))


def sun_warnings(scene: Scene, system: System) -> tuple[CaptureWarning, ...]:
    """Of a frame in which the sun does not stand still; ``scene``: under the sun of its middle."""
    if not scene.sun.moves:
        return ()
    half_s = middle_of_frame_s(system)
    turn_deg = 2 * half_s * TURN_DEG_PER_S
    levels = [_brightness(scene.sun.after(s), system) for s in (-half_s, 0.0, half_s)]
    change = (max(levels) - min(levels)) / max(max(levels), 1e-300)
    if not max(levels) or (turn_deg <= _TURN_DEG and change <= _CHANGE):
        return ()
    changes = f" and changes its brightness by {number(100 * change, 2)} %" if change else ""
    text = (
        f"the sun turns by {number(turn_deg, 2)} deg in a frame{changes}; all exposures have that "
        "of the middle"
    )
    return (CaptureWarning("model", text),)


def _brightness(sun: Sun, system: System) -> float:
    """Of the system's sky until the sun sets, or of the scene's sun."""
    if sun.has_set:
        return 0.0
    if system.sky is None:
        return sun.illuminance_lx
    given = system.sky.illuminance_lx
    return 1.0 if given is None or given.value else 0.0

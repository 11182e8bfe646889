"""Shadows of the sun that bodies may throw on what a camera sees during a frame, unseen
themselves.
"""

import math
from dataclasses import dataclass

import numpy as np

from twin.camera.motion import WorldInMotion
from twin.camera.swept import covers
from twin.optics.devices import Device

#: Cells, to a side, of the grid in which it is asked where shadows may fall.
_SIDE = 8


@dataclass(frozen=True)
class Shadows:
    """``fastest_per_s``: largest speed of a body that moves and may shade what is seen, over the
    distance of the nearest surface. ``area``: share of the field, 1 at most, that the largest of
    those may shade there whose shadow may pass between two of the times looked at.
    """

    fastest_per_s: float
    area: float


def shadows(world: WorldInMotion, camera: Device, nearest_m: float) -> Shadows:
    """Of all bodies that move while the sun may throw their shadow into a camera's field."""
    times = world.looks_s
    moves, towards = world.moves(times), world.sun_directions(times)
    fastest, area = 0.0, 0.0
    if not math.isfinite(nearest_m):
        return Shadows(fastest, area)
    farthest = max(
        float(np.linalg.norm(b.placed(moves), axis=-1).max(initial=0.0)) for b in world.bodies
    )
    for body in world.bodies:
        places = body.placed(moves)
        if (places == places[0]).all():
            continue
        behind = places - 2 * farthest * towards[:, None]
        around = np.concatenate([places, behind]).reshape(-1, 3)
        if not covers(around, 0.0, camera, camera, (_SIDE, _SIDE)).any():
            continue
        step_m = float(np.linalg.norm(np.diff(places, axis=0), axis=-1).max())
        fastest = max(fastest, step_m / float(times[1]) / nearest_m)
        if step_m <= body.radius_m:
            continue
        shaded = math.pi * (body.radius_m / nearest_m) ** 2
        area = max(area, min(shaded / (2 * camera.tan_half_field) ** 2, 1.0))
    return Shadows(fastest, area)

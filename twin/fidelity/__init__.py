"""How closely the twin follows physics: every knob in one object, each with the error it bounds.

The knobs are of two kinds, those of light and those of the radar; a `Fidelity` is both. Each knob
says beside its default what values it takes and which of two is the stricter. A `Tolerance` is the
error that a user grants, from which the knobs follow.
"""

from twin.fidelity.knobs import REPLACED
from twin.fidelity.light import LightFidelity, Noise, Start
from twin.fidelity.presets import PRESETS, Fidelity
from twin.fidelity.radar import RadarFidelity, RadarModel, own_solver
from twin.fidelity.tolerance import (
    DEFAULT,
    DEFAULT_SHARE,
    Accuracy,
    Tolerance,
    knobs_of,
    knobs_of_sensors,
)

__all__ = [
    "DEFAULT",
    "DEFAULT_SHARE",
    "PRESETS",
    "REPLACED",
    "Accuracy",
    "Fidelity",
    "LightFidelity",
    "Noise",
    "RadarFidelity",
    "RadarModel",
    "Start",
    "Tolerance",
    "knobs_of",
    "knobs_of_sensors",
    "own_solver",
]

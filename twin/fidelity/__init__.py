"""How closely the twin follows physics: every knob in one object, each with the error it bounds.

The knobs are of two kinds, those of light and those of the radar; a `Fidelity` is both. Each knob
says beside its default what values it takes and which of two is the stricter.
"""

from twin.fidelity.knobs import REPLACED
from twin.fidelity.light import LightFidelity, Noise, Start
from twin.fidelity.presets import PRESETS, Fidelity, preset
from twin.fidelity.radar import RadarFidelity, RadarModel, own_solver

__all__ = [
    "PRESETS",
    "REPLACED",
    "Fidelity",
    "LightFidelity",
    "Noise",
    "RadarFidelity",
    "RadarModel",
    "Start",
    "own_solver",
    "preset",
]

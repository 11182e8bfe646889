"""Names of the parameters by which a study says its accuracy, and which of them go together."""

from collections.abc import Iterable

from twin.errors import InputError

#: What the name of a knob begins with.
KNOB = "fidelity."
TOLERANCE, PRESET = f"{KNOB}tolerance", f"{KNOB}preset"
#: Numbers of paths, which a tolerance chooses itself unless that of light is named too.
_OF_LIGHT = f"{KNOB}light_tolerance"
_CHOSEN = (f"{KNOB}samples", f"{KNOB}indirect_samples")


def check_accuracy(parameters: Iterable[str]) -> None:
    """Raise InputError for parameters of which one leaves the other without effect."""
    given = set(parameters)
    if {TOLERANCE, PRESET} <= given:
        raise InputError(f"{TOLERANCE}, {PRESET}: expected one of them")
    for name in () if _OF_LIGHT in given else _CHOSEN:
        if {TOLERANCE, name} <= given:
            raise InputError(f"{name}: has no effect beside {TOLERANCE}, by which paths are added")


def names_accuracy(parameters: Iterable[str]) -> bool:
    """Whether any parameter is a tolerance, a preset or a knob."""
    return any(name.startswith(KNOB) for name in parameters)

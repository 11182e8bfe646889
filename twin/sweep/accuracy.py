"""At which accuracy a study computes its points: what it says itself, and what it is asked for."""

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from twin.errors import InputError
from twin.fidelity import DEFAULT_SHARE, Accuracy, Fidelity, LightFidelity, Tolerance
from twin.fidelity.knobs import NONE
from twin.sweep.accuracy_names import KNOB, PRESET, TOLERANCE
from twin.sweep.names import needs_radar
from twin.sweep.study import Study

_UNSET = "(not set)"
#: Knobs that a tolerance leaves to bounds, and those that a study may switch off.
_BY_BOUNDS = ("radar_bounces", "radar_images", "radar_edges", "radar_shadowed")
_OPTIONAL = (f"{KNOB}motion_tolerance", f"{KNOB}light_tolerance")


def with_accuracy(study: Study, accuracy: Accuracy) -> Study:
    """The same study at a tolerance, a preset, or knobs, in place of the preset or tolerance that
    it sets; knobs that it sets or varies stay.

    Raises InputError where the study varies its preset or tolerance, or a knob without effect then.

    >>> study = Study(name="lens", metrics=["psnr_db"], grid={"system.optics.f_number": [1, 2]})
    >>> with_accuracy(study, 0.1).set
    {'fidelity.tolerance': 0.1}
    """
    varied = [n for n in (TOLERANCE, PRESET) if n in study.parameters and n not in study.set]
    if varied:
        raise InputError(
            f"{study.label}: varies {varied[0]}, expected no other tolerance or fidelity beside it"
        )
    own = {n: value for n, value in study.set.items() if n not in (TOLERANCE, PRESET)}
    return study.with_set({**_said(accuracy, has_radar=needs_radar(study.metrics)), **own})


def named_in(study: Study) -> list[str]:
    """Knobs that a study sets, which stay whatever accuracy is asked for.

    >>> named_in(Study(name="n", metrics=["psnr_db"], set={"fidelity.noise": "none"}))
    ['noise']
    """
    named = study.set.keys() - {TOLERANCE, PRESET}
    return sorted(name.removeprefix(KNOB) for name in named if name.startswith(KNOB))


def _said(accuracy: Accuracy, *, has_radar: bool) -> dict[str, Any]:
    """As parameters of a study; without knobs of the radar where there is none."""
    if isinstance(accuracy, str):
        return {PRESET: accuracy}
    if isinstance(accuracy, float | int):
        return {TOLERANCE: float(accuracy)}
    if isinstance(accuracy, Tolerance):
        plain = accuracy == Tolerance(accuracy.noise_share)
        return {TOLERANCE: accuracy.noise_share if plain else str(accuracy)}
    named: dict[str, Any]
    base, named = Fidelity(), {PRESET: "standard"}
    knobs = [f.name for f in fields(accuracy if has_radar else LightFidelity)]
    share, said = accuracy.light_tolerance, accuracy.said()
    by_bounds = any(said[n] is None for n in knobs if n in _BY_BOUNDS)
    if share is not None or by_bounds:
        share = DEFAULT_SHARE if share is None else share
        base, named = Tolerance(share).knobs(), {TOLERANCE: share}
    usual = base.said()
    changed = {f"{KNOB}{n}": said[n] for n in knobs if said[n] != usual[n]}
    changed |= {n: NONE for n in _OPTIONAL if changed.get(n, NONE) is None}
    if none := [n for n, value in changed.items() if value is None]:
        raise InputError(f"{none[0]}: by bounds, which a study says by {TOLERANCE} alone")
    return {**named, **changed}


def accuracy_of(study: Mapping[str, Any]) -> dict[str, Any]:
    """What a study, as it is stored, sets of its accuracy."""
    return {name: value for name, value in study["set"].items() if name.startswith(KNOB)}


def other_accuracy(old: Mapping[str, Any], new: Mapping[str, Any]) -> str:
    """How two studies, as they are stored, differ where it is in the accuracy alone, else ""."""
    one, other = accuracy_of(old), accuracy_of(new)
    rest = [
        {**study, "set": {n: v for n, v in study["set"].items() if not n.startswith(KNOB)}}
        for study in (old, new)
    ]
    if one == other or rest[0] != rest[1]:
        return ""
    names = sorted(n for n in one.keys() | other.keys() if one.get(n) != other.get(n))
    said = (f"{n} = {one.get(n, _UNSET)}, not {other.get(n, _UNSET)}" for n in names)
    return "; ".join(said)

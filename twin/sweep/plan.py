"""What the points in a sweep's folder are of: ``study.json``, read and compared."""

from pathlib import Path
from typing import Any

from pydantic import ValidationError

from hardware.files import read_json
from hardware.formatting import setting_text
from twin.fidelity import PRESETS, Fidelity, Tolerance
from twin.fidelity.knobs import NONE
from twin.files import InputError
from twin.sweep.accuracy import accuracy_of, other_accuracy
from twin.sweep.accuracy_names import KNOB, PRESET, TOLERANCE
from twin.sweep.checksums import unsealed
from twin.sweep.study import Study
from twin.toml import describe

#: Of two studies, that are told.
_MOST_DIFFERENCES = 4
_UNSET = "(not set)"
_NO_PLAN = (
    "it says what the points of this folder are of; put back a copy, or begin the sweep anew in "
    "another folder (--out)"
)


def check_same(out: Path, old: dict[str, Any], new: dict[str, Any]) -> None:
    """Raise InputError where a folder's points are of something else."""
    if differs := other_accuracy(old["study"], new["study"]):
        raise InputError(
            f"{out}: holds results of {differs}; expected the same, or another folder (--out)"
        )
    if different := _differences("", old["study"], new["study"]):
        shown = "; ".join(different[:_MOST_DIFFERENCES])
        if len(different) > _MOST_DIFFERENCES:
            shown += f" and {len(different) - _MOST_DIFFERENCES} more"
        raise InputError(
            f"{out}: holds results of another study: {shown}; "
            "expected the same, or another folder (--out)"
        )
    for kind, what in (("versions", "other versions of"), ("inputs", "other content of")):
        names = old[kind].keys() | new[kind].keys()
        if other := sorted(n for n in names if old[kind].get(n) != new[kind].get(n)):
            raise InputError(
                f"{out}: holds results of {what} {', '.join(other)}; expected the same, or "
                "another folder (--out)"
            )


def _differences(name: str, old: Any, new: Any) -> list[str]:
    """What differs between two studies as they are stored, by dotted name: the old, the new."""
    if old == new:
        return []
    if isinstance(old, dict) and isinstance(new, dict):
        return [
            text
            for key in dict.fromkeys((*old, *new))
            for text in _differences(f"{name}.{key}".lstrip("."), old.get(key), new.get(key))
        ]
    was, now = (_UNSET if value is None else setting_text("", value) for value in (old, new))
    return [f"{name} = {was}, not {now}" if was != now else f"{name}: other values"]


def read_plan(out: Path) -> dict[str, Any]:
    """What a folder's ``study.json`` says. Raises InputError."""
    path = out / "study.json"
    if not path.is_file() and not (out / "points").is_dir():
        raise InputError(f"{out}: holds no sweep")
    try:
        plan: dict[str, Any] = read_json(path)
        unsealed(plan, needs_seal=False)
        missing = {"study", "folder", "versions", "inputs", "labels", "chunk"} - plan.keys()
    except FileNotFoundError as error:
        raise InputError(f"{path}: is missing: {_NO_PLAN}") from error
    except (OSError, ValueError, AttributeError) as error:
        told = str(error).removeprefix(f"{path}: ")
        raise InputError(f"{path}: is damaged ({told}): {_NO_PLAN}") from error
    if missing:
        raise InputError(f"{path}: lacks {', '.join(sorted(missing))}: of an older version")
    return plan


def stored_study(out: Path) -> Study:
    """The study that a folder's sweep is of. Raises InputError for a folder without one."""
    return study_of(out, read_plan(out))


def stored_inputs(out: Path) -> dict[str, str]:
    """Digests of the inputs of a folder's sweep, by kind and name."""
    found: dict[str, str] = read_plan(out)["inputs"]
    return found


def study_of(out: Path, plan: dict[str, Any]) -> Study:
    """The study that a plan of the folder ``out`` is of. Raises InputError."""
    try:
        return Study.model_validate({**plan["study"], "folder": plan["folder"]})
    except ValidationError as error:
        told = describe(error, Study, plan["study"])
        raise InputError(f"{out / 'study.json'}: study: {told}") from error


def stored_accuracy(out: Path) -> Fidelity | None:
    """Knobs that a folder's sweep sets, by a tolerance or a preset and by themselves; None where
    there is no such sweep.
    """
    said = accuracy_of(read_plan(out)["study"]) if (out / "study.json").is_file() else {}
    if TOLERANCE in said:
        knobs = Tolerance.of(str(said[TOLERANCE])).knobs()
    elif said.get(PRESET) in PRESETS:
        knobs = PRESETS[said[PRESET]]
    else:
        return None
    own = said.keys() - {TOLERANCE, PRESET}
    named = {name.removeprefix(KNOB): said[name] for name in own}
    if named.get("motion_tolerance") == NONE:
        named["motion_tolerance"] = None
    return knobs.with_(named)

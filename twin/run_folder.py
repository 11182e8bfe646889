"""Folders that commands write: of one run, whole; a run's is named after what is not default."""

import json
import os
import platform
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, fields
from importlib.metadata import version
from pathlib import Path
from typing import Any

from hardware.files import read_json
from hardware.formatting import json_text
from twin import __version__
from twin.fidelity import DEFAULT, PRESETS, Fidelity
from twin.files import InputError, whole_folder
from twin.scene import Pose, Track

INDEX = "run.json"
_FORMAT = "ugv-twin-{}"
#: Files of each run.
_ALWAYS = {INDEX, "report.html", "summary.json"}
#: What a run is without being told; everything else stands in its folder's name.
_DEFAULTS = {"radar": "hybrid-79", "compare": "paper", "seed": 0}


@contextmanager
def figures_folder(out: Path, what: str, *others: str) -> Iterator[Path]:
    """A folder for ``WHAT.json``, the figures of a command, and other files; whole or not at all.

    The JSON file lists them all. Raises as `check_figures`, before any work.
    """
    check_figures(out, what, *others)
    with whole_folder(out) as partial:
        yield partial
        path = partial / f"{what}.json"
        head = {"format": _FORMAT.format(what), "files": [path.name, *others]}
        path.write_text(json_text({**head, **read_json(path)}), encoding="utf-8")


def check_figures(out: Path, what: str, *others: str) -> None:
    """Raise InputError for files of these names that no earlier command of the kind wrote."""
    _check_own(Path(out), {f"{what}.json", *others}, what)


@contextmanager
def run_folder(out: Path, settings: Mapping[str, Any]) -> Iterator[Path]:
    """A folder to write a run in; it appears in ``out`` whole or not at all.

    ``run.json`` is written beside the run's files and lists them with the settings. Files of the
    run before, as its list has them, are removed; what a user keeps there stays. Raises InputError
    when ``out`` can't be written, and for files of the run's names that no such list has: before
    any work for those that each run writes.
    """
    _check_own(Path(out), _ALWAYS)
    with whole_folder(out) as partial:
        yield partial
        written = sorted(path.name for path in partial.iterdir())
        index = {
            "format": _FORMAT.format("run"),
            "version": __version__,
            **settings,
            "files": written,
        }
        (partial / INDEX).write_text(json.dumps(index, indent=1) + "\n", encoding="utf-8")
        _check_own(Path(out), {*written, INDEX})
        stale = _listed(Path(out) / INDEX) - {*written, INDEX}
    for name in stale:
        # The run is written: what cannot be removed stays.
        with suppress(OSError, ValueError):
            (Path(out) / name).unlink(missing_ok=True)


def settings_of(
    scene: str,
    systems: Sequence[str],
    radar: str | None,
    seed: int,
    pose: Pose | None,
    track: Track | None,
    fidelity: Fidelity,
    *,
    method: str | None = None,
    detection: str | None = None,
    command: str | None = None,
) -> dict[str, Any]:
    """What a run is made of, ready for JSON; pose and track where they are not the scene's own, a
    reconstruction beside the bundled ones and a user's own detection by name and digest. With them
    the command as it was typed, None from Python, and the versions of what computes.
    """
    return {
        "scene": scene,
        "system": systems[0] if systems else None,
        "compare": systems[1] if len(systems) > 1 else None,
        "radar": radar,
        "seed": seed,
        "pose": _pose(pose) if pose else None,
        "track": asdict(track) if track else None,
        "fidelity": fidelity.said(),
        "method": method,
        "detection": detection,
        "command": command,
        "versions": versions(),
    }


def versions() -> dict[str, str]:
    """Of this software and of the libraries that compute."""
    names = ("mitsuba", "drjit", "sionna-rt", "finufft", "numpy", "scipy")
    return {
        "ugv-twin": __version__,
        **{name: version(name) for name in names},
        "Python": platform.python_version(),
    }


def default_folder(settings: Mapping[str, Any]) -> Path:
    """``runs/SCENE-SYSTEM``, or ``runs/SCENE-RADAR`` of a radar alone, and whatever else is not the
    default: two runs that differ by their settings never share a folder.
    """
    system, radar = settings["system"], settings["radar"]
    words = [settings["scene"], system or radar]
    if system:
        other = "workable" if system == _DEFAULTS["compare"] else _DEFAULTS["compare"]
        words += unless(settings["compare"], other, "beside_{}", "alone")
        words += unless(radar, _DEFAULTS["radar"], "{}", "no-radar")
    words += unless(settings["seed"], _DEFAULTS["seed"], "seed_{}")
    words += unless(settings["pose"], None, "pose_{}")
    if track := settings["track"]:
        numbers = [*track["step_m"], track["count"], track["interval_s"]]
        words.append("track_" + ",".join(_number(n) for n in numbers if n is not None))
    words += unless(settings["method"], None, "{}") + unless(settings["detection"], None, "{}")
    return named_folder(*words, *knob_words(settings["fidelity"]))


def named_folder(*words: str) -> Path:
    """A folder of ``runs`` whose name says these words."""
    return Path("runs") / "-".join(words).replace(" ", "_").replace(os.sep, "_")


def unless(value: Any, default: Any, word: str, without: str = "") -> list[str]:
    """What a folder's name says of a setting: nothing where it is the default."""
    if value == default:
        return []
    return [word.format(value) if value is not None else without]


def knob_words(knobs: Mapping[str, Any]) -> list[str]:
    """Knobs that differ from the default; or the preset that is nearer, and
    those that differ from it.
    """
    known = {"": DEFAULT, **PRESETS}
    differing = {
        name: [f.name for f in fields(usual) if getattr(usual, f.name) != knobs[f.name]]
        for name, usual in known.items()
    }
    nearest = min(differing, key=lambda name: len(differing[name]))
    words = [nearest] if nearest else []
    return words + [f"{knob}_{knobs[knob]}" for knob in differing[nearest]]


def _pose(pose: Pose) -> str:
    """As it is typed, without angles that are zero."""
    angles = [pose.yaw_deg, pose.pitch_deg, pose.roll_deg]
    while angles and angles[-1] == 0:
        angles.pop()
    return ",".join(_number(n) for n in (*pose.position_m, *angles))


def _number(value: float) -> str:
    return f"{value:.12g}"


def _check_own(out: Path, names: set[str], what: str = "run") -> None:
    """Raise InputError where files of these names are not of an earlier run, or what it is."""
    index = out / f"{what}.json"
    listed = _listed(index, what)
    own = {*listed, index.name} if listed else set()
    if others := sorted(name for name in names - own if (out / name).is_file()):
        raise InputError(
            f"{out}: holds {', '.join(others)}, of no earlier {what}, which this one would "
            "overwrite; expected another folder"
        )


def _listed(index: Path, what: str = "run") -> set[str]:
    """Files of the run that wrote a list; none where there is no list that can be read."""
    try:
        content = read_json(index)
        if content["format"] != _FORMAT.format(what):
            return set()
        names: set[str] = set(content["files"])
        return {name for name in names if Path(name).name == name}
    except (OSError, ValueError, KeyError, TypeError):
        return set()

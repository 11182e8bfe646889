"""What figures are of: views of a scene, seeds, and all that must be the same as in a baseline."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from twin.digest import digest, parts
from twin.fidelity import Fidelity, LightFidelity, RadarFidelity
from twin.files import InputError
from twin.radar import RadarDesign
from twin.regression.metrics import Metric
from twin.scene import Pose, Scene, load_scene
from twin.system import System

#: Values of scene and design in a setup: they are told where a digest differs, and not compared.
_PARTS = "values"


def views_of(scene: str | Path | Scene, poses: Sequence[Pose]) -> list[Scene]:
    """The scene from every pose, or as it is."""
    if isinstance(scene, Scene):
        return [scene.at(pose) for pose in poses] or [scene]
    return [load_scene(scene, pose) for pose in poses] or [load_scene(scene)]


def seeds_of(n_seeds: int, n_views: int) -> range:
    """Seeds from 0 on. Raises InputError where they are too few for a scatter in each view."""
    if n_seeds < 2 * n_views:
        of = f" of each of {n_views} poses" if n_views > 1 else ""
        raise InputError(f"seeds: {n_seeds}: expected at least 2{of}, a test needs their scatter")
    return range(n_seeds)


def setup_of(
    kind: str,
    scene: Scene,
    poses: Sequence[Pose],
    design: System | RadarDesign,
    fidelity: LightFidelity | RadarFidelity,
    n_seeds: int,
    metrics: Sequence[Metric],
) -> dict[str, Any]:
    """What must not differ, in words where there are some; content by the start of its digest."""
    truths: dict[str, Any] = {"poses": [str(pose) for pose in poses]} if poses else {}
    if kind == "camera" and not poses:
        truths = {"truths": ["as rendered", "mirrored"]}
    return truths | {
        "kind": kind,
        "scene": said_as(scene.name, scene),
        "design": said_as(design.name, design),
        _PARTS: {"scene": parts(scene), "design": parts(design)},
        "fidelity": fidelity.said(),
        "seeds": n_seeds,
        "metrics": [metric.name for metric in metrics],
    }


def said_as(name: str, content: Scene | System | RadarDesign) -> str:
    """What a setup says of a scene or a design, if it had this name."""
    named = replace(content, name=name) if isinstance(content, Scene) else _copy(content, name)
    return f"{name} {digest(named)[:12]}"


def _copy(design: System | RadarDesign, name: str) -> System | RadarDesign:
    return design.model_copy(update={"name": name})


def n_views_of(setup: dict[str, Any]) -> int:
    """Number of views that a setup has."""
    return len(setup.get("poses", [""]))


def differences(
    before: dict[str, Any],
    now: dict[str, Any],
    contents: Mapping[str, Scene | System | RadarDesign],
) -> list[str]:
    """Entries of a baseline's setup and of today's that are not the same, one line each; of entries
    with names of their own, such as knobs, those that differ.

    ``contents``: the scene and the design of today. The same ones by another name, as of a copied
    folder, do not differ. Of others the values that differ are told, by baselines that hold them.

    A knob newer than the baseline stood then where `Fidelity` has it, even if another value is the
    default now; one that is gone is a change of the twin, which its figures are to judge. Baselines
    of earlier versions have the knobs of the other sensor too.
    """
    knobs, defaults = before.get("fidelity", {}), Fidelity().said()
    before = {
        **before,
        "fidelity": {name: knobs.get(name, defaults[name]) for name in now["fidelity"]},
    }

    known, today = before.pop(_PARTS, {}), now[_PARTS]
    now = {name: value for name, value in now.items() if name != _PARTS}
    for name, content in contents.items():
        if (said := before.get(name)) == said_as(str(said).rpartition(" ")[0], content):
            now[name] = said

    def line(name: str) -> str:
        one, other = before.get(name), now.get(name)
        if known.get(name, today.get(name)) != today.get(name):
            one, other = known[name], today[name]
        if isinstance(one, dict) and isinstance(other, dict):
            apart = [key for key in {**one, **other} if one.get(key) != other.get(key)]
            one, other = ({key: part.get(key) for key in apart} for part in (one, other))
        return f"{name}: {one!r} in the baseline, {other!r} now"

    return [line(name) for name in sorted({*before, *now}) if before.get(name) != now.get(name)]

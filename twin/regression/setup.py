"""What figures are of: views of a scene, seeds, and all that must be the same as in a baseline."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from twin.digest import digest
from twin.fidelity import Fidelity, LightFidelity, RadarFidelity
from twin.files import InputError
from twin.radar import RadarDesign
from twin.regression.metrics import Metric
from twin.scene import Pose, Scene, load_scene
from twin.system import System


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
        "scene": f"{scene.name} {digest(scene)[:12]}",
        "design": f"{design.name} {digest(design)[:12]}",
        "fidelity": fidelity.said(),
        "seeds": n_seeds,
        "metrics": [metric.name for metric in metrics],
    }


def n_views_of(setup: dict[str, Any]) -> int:
    """Number of views that a setup has."""
    return len(setup.get("poses", [""]))


def differences(before: dict[str, Any], now: dict[str, Any]) -> list[str]:
    """Entries of a baseline's setup and of today's that are not the same, one line each; of entries
    with names of their own, such as knobs, those that differ.

    A knob newer than the baseline stood then where `Fidelity` has it, even if another value is the
    default now; one that is gone is a change of the twin, which its figures are to judge. Baselines
    of earlier versions have the knobs of the other sensor too.
    """
    knobs, defaults = before.get("fidelity", {}), Fidelity().said()
    before = {
        **before,
        "fidelity": {name: knobs.get(name, defaults[name]) for name in now["fidelity"]},
    }

    def line(name: str) -> str:
        one, other = before.get(name), now.get(name)
        if isinstance(one, dict) and isinstance(other, dict):
            apart = [key for key in {**one, **other} if one.get(key) != other.get(key)]
            one, other = ({key: part.get(key) for key in apart} for part in (one, other))
        return f"{name}: {one!r} in the baseline, {other!r} now"

    return [line(name) for name in sorted({*before, *now}) if before.get(name) != now.get(name)]

"""Warnings of a run, each with whom it is of: page and summary repeat what the command prints."""

from collections.abc import Sequence

from twin.camera.evaluation import Evaluation
from twin.radar.evaluation import RadarEvaluation
from twin.scene import Scene


def warnings_of(
    scene: Scene, evaluations: Sequence[Evaluation], radar: RadarEvaluation | None
) -> list[tuple[str, str]]:
    """Name of the scene or sensor, and the warning."""
    named = [(scene.name, scene.warnings), *((e.system.name, e.warnings) for e in evaluations)]
    if radar:
        named.append((radar.radar.name, radar.warnings))
    return [(name, warning) for name, warnings in named for warning in warnings]

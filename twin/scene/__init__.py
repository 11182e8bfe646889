"""One scene for every engine: read once, validated, in float64, in metres, z up.

A scene is a Mitsuba 3 XML file with meshes, and optionally ``scene.toml`` beside it for what XML
has no place for. Nothing reaches a renderer before it was validated here: on a bad index the
renderer crashes, and on other faults it silently returns wrong light.
"""

from twin.scene.load import load_scene
from twin.scene.model import Scene
from twin.scene.objects import SceneObject, Target
from twin.scene.rig import Pose, Rig, Track, parse_pose, parse_track
from twin.scene.sun import Sun

__all__ = [
    "Pose",
    "Rig",
    "Scene",
    "SceneObject",
    "Sun",
    "Target",
    "Track",
    "load_scene",
    "parse_pose",
    "parse_track",
]

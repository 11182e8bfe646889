"""Triangle meshes: what they are by themselves, wherever they stand and whatever they are for."""

from twin.geometry.edges import EdgeTable, connected, doubles, edge_table
from twin.geometry.faces import planes
from twin.geometry.geometry import Geometry
from twin.geometry.mitsuba_meshes import are_too_large, divided, mitsuba_mesh, scene_of_shapes
from twin.geometry.shape import Shape, shapes_of

__all__ = [
    "EdgeTable",
    "Geometry",
    "Shape",
    "are_too_large",
    "connected",
    "divided",
    "doubles",
    "edge_table",
    "mitsuba_mesh",
    "planes",
    "scene_of_shapes",
    "shapes_of",
]

"""The bundled yard with nothing in it moving: a frame of it is what is rendered, once."""

from dataclasses import replace
from functools import lru_cache

from twin.scene import Scene, load_scene


@lru_cache(maxsize=1)
def still_yard() -> Scene:
    """`scenes/yard` whose car stands."""
    scene, rest = load_scene("yard"), (0.0, 0.0, 0.0)
    return replace(
        scene,
        objects=tuple(replace(item, velocity_m_per_s=rest) for item in scene.objects),
        targets=tuple(replace(item, velocity_m_per_s=rest) for item in scene.targets),
    )

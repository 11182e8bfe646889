"""The digital twin: what the sensors of the vehicle would send, from a scene and a system.

`run` does the whole job. The same in steps, six lines from a scene to a scored image:

    import hardware, twin

    scene = twin.load_scene("yard")
    system = twin.load_system("workable")
    capture = twin.capture(scene, system, seed=1)
    image = hardware.reconstruct(capture.record, "lmmse")
    print(twin.evaluate(system, capture, [image]))
"""

from importlib import import_module
from typing import Any

__version__ = "0.1.0"

# Names are looked up when first used: `twin --help` must not wait for a renderer.
_HOMES = {
    "Capture": "twin.camera.acquisition",
    "InputError": "twin.files",
    "Scene": "twin.scene",
    "System": "twin.system",
    "capture": "twin.camera.acquisition",
    "evaluate": "twin.camera.evaluation",
    "load_scene": "twin.scene",
    "load_system": "twin.system",
    "load_radar": "twin.radar",
    "radar_capture": "twin.radar",
    "run": "twin.job",
}
__all__ = [*_HOMES]


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module 'twin' has no attribute {name!r}")


def __dir__() -> list[str]:
    return [*globals(), *_HOMES]

"""Pages of the public names, as the stub files beside the packages list them."""

import re
from pathlib import Path

_INTRODUCTIONS = {
    "twin": """# Python: `twin`

All names that `import twin` gives; nothing is loaded before it is used. Whatever takes a name of a
scene, system or radar takes a file or an object too.

```python
import hardware, twin

scene, system = twin.load_scene("yard"), twin.load_system("workable")
capture = twin.capture(scene, system, seed=1)
image = hardware.reconstruct(capture.record, "lmmse")
print(twin.evaluate(system, capture, [image]))

record = twin.radar_capture(scene, twin.load_radar("hybrid-79"), seed=1).record
print(hardware.process(record).detections)
```
""",
    "hardware": """# Python: `hardware`

All names that `import hardware` gives: the vehicle's software, which knows nothing of the twin.

```python
import hardware

record = hardware.read_record("record.h5")
image = hardware.reconstruct(record, "lmmse").image  # (images, rows, columns), electrons

for frame in [hardware.process(hardware.read_radar_record("radar.h5"))]:
    for detection in frame.detections:
        print(detection.range_m, detection.range_error_m)
```
""",
}


def api_page(package: str, stub: Path) -> str:
    """One package: its names by the room that defines them."""
    rooms: dict[str, list[str]] = {}
    for module, name in re.findall(r"^from ([\w.]+) import (\w+) as \2$", stub.read_text(), re.M):
        rooms.setdefault(".".join(module.split(".")[:2]), []).append(name)
    text = _INTRODUCTIONS[package]
    for room, names in rooms.items():
        text += f"\n## From `{room}`\n\n```{{eval-rst}}\n"
        text += "\n".join(_directive(package, name) for name in names) + "```\n"
    return text


def _directive(package: str, name: str) -> str:
    import importlib
    import inspect

    thing = getattr(importlib.import_module(package), name)
    if inspect.isclass(thing):
        if thing.__module__.split(".")[0] != package:
            return f".. py:class:: {package}.{name}\n\n   The same as ``hardware.{name}``.\n"
        return f".. autoclass:: {package}.{name}\n   :members:\n"
    if callable(thing):
        return f".. autofunction:: {package}.{name}\n"
    keys = ", ".join(f"``{key}``" for key in thing)
    return f".. py:data:: {package}.{name}\n\n   By name: {keys}.\n"

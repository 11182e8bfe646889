"""Whole jobs at the extremes: every text that comes out holds numbers, never NaN or infinity."""

import re
import tempfile
from pathlib import Path

import numpy as np

from tests.extremes.case import Case, Found
from tests.extremes.worlds import Triangles, asked, camera, scene, square
from twin.fidelity import Fidelity
from twin.job import run
from twin.system import System

_WRONG = re.compile(r"(?<![\w.])-?(nan|inf|infinity)(?!\w)", re.IGNORECASE)


def _job(*shapes: Triangles, system: System | None = None, **options: object) -> Found:
    """Words in the report, the tables and the record's figures that are no numbers."""
    with (
        scene(*shapes, radio="concrete", **options) as world,
        tempfile.TemporaryDirectory() as folder,
    ):  # type: ignore[arg-type]
        out = Path(folder) / "out"
        result = run(
            world.path,
            system or camera(),
            compare=None,
            radar="hybrid-79-slow",
            fidelity=asked(Fidelity(4, 2)),
            out=out,
        )
        wrong = 0
        for path in out.iterdir():
            if path.suffix in (".html", ".csv", ".json"):
                # Pictures are data in base 64; scripts speak of infinity by its name.
                text = re.sub(r"data:[\w/+;,=-]*", "", path.read_text())
                text = re.sub(r"(?s)<script>.*?</script>", "", text)
                wrong += len(_WRONG.findall(text))
        warnings = (*result.scene.warnings, *result.evaluations[0].capture.warnings)
    return Found(float(wrong), 0.0, warnings=warnings)


def _room() -> Triangles:
    import trimesh

    box = trimesh.creation.box((6.0, 6.0, 6.0))
    return np.array(box.vertices), np.array(box.faces)


def cases() -> list[Case]:
    """All of this room."""
    words = "no NaN, no infinity in any file"
    wall = square((5.0, 0, 0), 10.0)
    return [
        Case("report", "empty scene", words, lambda: _job(), says="the scene has no shapes"),
        Case("report", "closed room", words, lambda: _job(_room()), says="stands inside",
             slow=True),
        Case("report", "reflectance 0", words, lambda: _job(wall, reflectance=0.0),
             says="no light", slow=True),
        Case("report", "picture of one row", words,
             lambda: _job(wall, system=camera(emitter__rows=1, acquisition__n_patterns=16)),
             slow=True),
        Case("report", "1 ns", words,
             lambda: _job(wall, system=camera(acquisition__integration_time_s=1e-9)), slow=True),
        Case("report", "no sun, no light of the emitter", words,
             lambda: _job(wall, sun_lx=0.0, system=camera(emitter__radiant_intensity_w_per_sr=0.0)),
             says="or it emits none", slow=True),
    ]  # fmt: skip

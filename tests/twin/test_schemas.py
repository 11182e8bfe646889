"""JSON Schemas of the files that users write: bundled files pass, wrong ones do not, and every
field says what it means.
"""

import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from hardware.drivers.settings import read_settings
from twin.errors import InputError
from twin.schemas import KINDS, file_schema

ROOT = Path(__file__).parents[2]
BUNDLED = {
    "system": sorted((ROOT / "twin" / "catalog" / "systems").glob("*.toml")),
    "radar": sorted((ROOT / "twin" / "catalog" / "radars").glob("*.toml")),
    "part": sorted((ROOT / "twin" / "catalog" / "parts").glob("*.toml")),
    "scene": sorted((ROOT / "scenes").glob("*/scene.toml")),
    "materials": [ROOT / "scenes" / "materials.toml"],
}
STUDY = """
scene = "yard"
metrics = ["psnr_db"]
[set]
"fidelity.max_depth" = 1
[grid]
"system.detector.width_m" = ["150 um", 1e-3]
[sample]
method = "sobol"
n = 8
[sample.ranges]
"system.optics.f_number" = { low = 0.8, high = 2.0 }
"""
CAMERA = """
integration_time_s = "315 us"
shutters = [[10e6, 0, 0, 0], [10e6, 1.5708, 0, 0]]
pose = [0, 0, 1.2, 1, 0, 0, 0]
[patterns]
rows = 16
columns = 16
count = 256
"""


def is_valid(kind: str, content: Any) -> bool:
    return jsonschema.Draft202012Validator(file_schema(kind)).is_valid(content)


@pytest.mark.parametrize("kind", BUNDLED)
def test_bundled_files_are_valid(kind: str) -> None:
    """As they stand, with ``base`` and ``part`` and without what these give."""
    assert BUNDLED[kind]
    validator = jsonschema.Draft202012Validator(file_schema(kind))
    for path in BUNDLED[kind]:
        faults = list(validator.iter_errors(tomllib.loads(path.read_text())))
        assert not faults, (path.name, faults[0].message)


@pytest.mark.parametrize(
    ("kind", "text"),
    [
        ("system", 'base = "paper"\n[optics]\nf_numbr = 1.0'),
        ("system", 'base = "paper"\n[optics]\nf_number = "wide"'),
        ("system", 'base = "paper"\n[acquisition]\npart = "fga015"'),
        ("part", 'base = "fga015"\n[detector]\npart = "fga015"'),
        ("radar", 'base = "hybrid-79"\n[waveform]\nsymbols = "chirp"'),
        ("scene", "[rig]\nposition_m = [0, 0]"),
        ("materials", "[tar.optical]\nreflectance = 1.5"),
        ("study", "scene = 'yard'"),
        ("study", STUDY.replace("sobol", "random")),
        ("camera", CAMERA.replace("315 us", "315 us") + 'mode = "both"'),
        ("camera", "integration_time_s = 1e-3"),
    ],
)
def test_wrong_files_are_not(kind: str, text: str) -> None:
    assert not is_valid(kind, tomllib.loads(text))


def test_studies_and_camera_settings_are_valid(tmp_path: Path) -> None:
    assert is_valid("study", tomllib.loads(STUDY))
    assert is_valid("camera", tomllib.loads(CAMERA))
    (tmp_path / "camera.toml").write_text(CAMERA)
    assert len(read_settings(tmp_path / "camera.toml").shutters) == 2


def sections(schema: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Every table of a schema, by its place."""
    for place, part in [("", schema), *schema.get("$defs", {}).items()]:
        for n, form in enumerate([part, *part.get("anyOf", [])]):
            if "properties" in form:
                yield f"{place}/{n}" if n else place, form
    for name, entry in schema.get("properties", {}).items():
        for form in entry.get("anyOf", []):
            if "properties" in form:
                yield name, form


@pytest.mark.parametrize("kind", KINDS)
def test_every_field_says_what_it_means(kind: str) -> None:
    schema = file_schema(kind)
    jsonschema.Draft202012Validator.check_schema(schema)
    definitions = schema.get("$defs", {}).items()
    described = {
        f"#/$defs/{n}": entry["description"] for n, entry in definitions if "description" in entry
    }
    said = {
        f"{place}.{name}": entry.get("description", described.get(entry.get("$ref"), ""))
        for place, section in sections(schema)
        for name, entry in section["properties"].items()
    }
    assert len(said) > 5
    # Not the unit alone, which is added to the text.
    assert [
        n for n, text in said.items() if not re.search(r"\w{2}", text.split("A number")[0])
    ] == []


def test_an_unknown_kind_is_told() -> None:
    with pytest.raises(InputError, match="schema: 'rig': expected system, radar, part"):
        file_schema("rig")

"""The regression plugin's truth: rendered once, kept under what it depends on."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from yard_32x32 import SYSTEM

from twin.digest import digest
from twin.kept_results import KeptResults
from twin.regression.truth import Truths
from twin.scene import load_scene
from twin.system import load_system


def test_truth_is_rendered_once_and_kept(yard, tmp_path: Path, monkeypatch) -> None:
    scene, system, _ = yard
    first = Truths(KeptResults(tmp_path)).light(scene, system)
    monkeypatch.setattr("twin.regression.truth.render", None)
    again = Truths(KeptResults(tmp_path)).light(scene, system)
    np.testing.assert_array_equal(first.light.cells, again.light.cells)
    np.testing.assert_array_equal(first.truth.depth_m, again.truth.depth_m)
    with pytest.raises(TypeError):  # another system is rendered anew
        Truths(KeptResults(tmp_path)).light(scene, load_system("workable"))


def test_a_digest_tells_what_is_rendered_from_what_is_said(yard, tmp_path: Path) -> None:
    scene, system, _ = yard
    whole = digest(scene, system)
    assert whole == digest(load_scene("yard"), load_system(SYSTEM))
    item = scene.objects[0].moved([1e-6, 1e-6, 1e-6])
    assert digest(replace(scene, objects=(item, *scene.objects[1:])), system) != whole
    assert digest(replace(scene, description="x", warnings=("y",)), system) == whole
    said = (tmp_path / "said.toml", f'base = "{SYSTEM}"\nname = "{system.name}"\n[optics]\n')
    f_number = system.optics.f_number.value
    said[0].write_text(said[1] + f'f_number = {{ value = {f_number}, source = "elsewhere" }}')
    assert digest(scene, load_system(said[0])) == whole
    said[0].write_text(said[1] + f"f_number = {f_number * 1.01}")
    assert digest(scene, load_system(said[0])) != whole


def test_a_spectrum_counts_by_its_content(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text(
        'base = "paper"\n[filter]\ntransmission_csv = { value = "f.csv", source = "vendor" }'
    )
    found = []
    for top in ("0.5", "0.6", "0.5"):
        (tmp_path / "f.csv").write_text(f"nm,T\n1530,0\n1550,{top}\n1570,0\n")
        found.append(digest(load_system(file)))
    assert found[0] == found[2] != found[1]

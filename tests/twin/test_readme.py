"""What the README and the pages whose blocks build on each other show runs as it stands there."""

import re
from pathlib import Path

import numpy as np
import pytest

from twin.sweep import load_study
from twin.sweep.evaluate import evaluate_chunk
from twin.system import load_system

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text()


def blocks(page: str, language: str) -> list[str]:
    text = (ROOT / page).read_text()
    return re.findall(rf"```{language}\n(.*?)```", text, re.DOTALL)


def block(page: str, name: str) -> str:
    """The text of the file of that name."""
    text = (ROOT / page).read_text()
    (body,) = re.findall(rf"```{{code-block}} \w+\n:caption: {name}\n\n(.*?)```", text, re.DOTALL)
    return body


@pytest.mark.quick(1)
@pytest.mark.parametrize(
    ("page", "told"),
    [
        pytest.param(
            *("README.md", ["lmmse: PSNR", "Detection(range_m=5.63"]), marks=pytest.mark.whole
        ),
        ("docs/howto/accuracy.md", ["above their noise"]),
        pytest.param(*("docs/howto/micro_doppler.md", ["m/s"]), marks=pytest.mark.whole),
        ("docs/howto/moving_images.md", ["True"]),
        pytest.param(
            *(
                "docs/howto/own_parts.md",
                ["(64, 64)", "within 8 m", "range_m=20.0", "range_m=5.63"],
            ),
            marks=pytest.mark.whole,
        ),
        pytest.param(
            *(
                "docs/howto/python.md",
                ["runs/yard_(changed)-workable_(changed)-alone-hybrid-79_(ch"],
            ),
            marks=pytest.mark.whole,
        ),
    ],
)
def test_python_examples_run(
    page: str,
    told: list[str],
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    for code in blocks(page, "python"):
        exec(code, names)
    printed = capsys.readouterr().out
    for words in told:
        assert words in printed


def test_the_readme_is_one_screen() -> None:
    assert len(README) < 6000
    assert len(README.splitlines()) < 100


def test_figures_of_the_readme_are_those_of_the_validation() -> None:
    """One figure, one value: a row stands there as it stands here, less the command."""
    rows = re.findall(r"^(\| .* \| .*) \| `python -m benchmarks (\w+)` \|$", README, re.MULTILINE)
    assert len(rows) == 4
    validation = (ROOT / "docs" / "validation.md").read_text()
    for row, room in rows:
        assert f"{row} |\n" in validation
        assert (ROOT / "benchmarks" / f"{room}.py").is_file()


@pytest.mark.parametrize(
    "page",
    [
        "README.md",
        *(
            str(p.relative_to(ROOT))
            for p in (ROOT / "docs").rglob("*.md")
            if "generated" not in p.parts
        ),
    ],
)
def test_links_are_of_a_form_that_can_be_followed(page: str) -> None:
    """Within the repository to what is there; elsewhere by https, without blanks or odd ends.

    Whether what is elsewhere still is there `make docs-links` asks, which needs the network.
    """
    text = re.sub(r"```.*?```|`[^`\n]*`", "", (ROOT / page).read_text(), flags=re.DOTALL)
    folder = (ROOT / page).parent
    for target in re.findall(r"\]\(([^)\s]*)\)", text):
        if ":" in target:
            assert re.fullmatch(r"https://[\w-]+(\.[\w-]+)+(/[\w./~%#?=&:+-]*)?", target), target
            continue
        path, _, anchor = target.partition("#")
        there = (folder / path).resolve()
        if "generated" in there.parts:
            continue  # made by `make docs`, which checks them
        assert there.exists(), f"{page}: {target}"
        assert not anchor or path.endswith(".md") or not path
    for target in re.findall(r"(?<![(\"'<\w])https?://\S+", text):
        assert target.startswith("https://"), target


def test_the_study_runs(tmp_path: Path) -> None:
    (tmp_path / "study.toml").write_text(block("docs/howto/studies.md", "walls.toml"))
    study = load_study(tmp_path / "study.toml")
    chunk = evaluate_chunk(study, 0, 2)
    assert study.n_points == 36
    assert not chunk.errors
    assert np.isfinite(chunk.values["psnr_db"]).all()


def test_the_system_file_loads(tmp_path: Path) -> None:
    for name in ("mine.toml", "filter.csv"):
        (tmp_path / name).write_text(block("docs/howto/systems.md", name))
    assert load_system(tmp_path / "mine.toml").optics.f_number.value == 0.8


def test_a_system_of_own_parts_loads(tmp_path: Path) -> None:
    text = "".join(blocks("docs/howto/own_parts.md", "toml"))
    (tmp_path / "mine.toml").write_text(f'base = "workable"\n{text}')
    np.save(tmp_path / "masks.npy", np.zeros((512, 64, 64), np.uint8))
    code = "def counter(system): ...\nclass Dust:\n    def __init__(self, weather): ...\n"
    (tmp_path / "mine.py").write_text(code)
    assert load_system(tmp_path / "mine.toml").patterns.count == 512
    assert load_system(tmp_path / "mine.toml").weather is not None

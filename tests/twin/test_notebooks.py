"""The notebooks run as they stand, in a kernel of their own, and show figures; what is stored with
them is what they show.
"""

import re
from pathlib import Path
from typing import Any

import nbformat
import pytest
from nbclient import NotebookClient
from traitlets.config import Config

NOTEBOOKS = sorted((Path(__file__).parents[2] / "notebooks").glob("*.ipynb"))


def kinds(book: Any) -> list[list[str]]:
    """Of each cell of code what it shows: kinds of data, or text on a stream."""
    return [
        sorted(kind for o in cell.outputs for kind in o.get("data", [o.get("name", "error")]))
        for cell in book.cells
        if cell.cell_type == "code"
    ]


@pytest.mark.whole
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_to_its_figures(path: Path) -> None:
    book = nbformat.read(path, as_version=4)
    stored = kinds(book)
    local = Config({"AsyncKernelManager": {"transport": "ipc"}})  # no port is opened
    NotebookClient(book, config=local, timeout=120).execute()
    outputs = [output for cell in book.cells for output in cell.get("outputs", [])]
    assert sum("image/png" in output.get("data", {}) for output in outputs) >= 1
    complaints = [o["text"] for o in outputs if o.get("name") == "stderr"]
    assert not complaints, complaints
    assert kinds(book) == stored, f"{path}: other outputs are stored: make notebooks"


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_small_and_knows_public_names_alone(path: Path) -> None:
    assert path.stat().st_size < 200_000
    code = "\n".join(c.source for c in nbformat.read(path, as_version=4).cells)
    assert re.findall(r"(?:from|import) ((?:twin|hardware)\.[\w.]+)", code) == []
    assert re.search(r"^import twin$", code, re.MULTILINE)

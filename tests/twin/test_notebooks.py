"""The notebooks run as they stand, in a kernel of their own, and show figures."""

from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient
from traitlets.config import Config

NOTEBOOKS = sorted((Path(__file__).parents[2] / "notebooks").glob("*.ipynb"))


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_to_its_figures(path: Path) -> None:
    book = nbformat.read(path, as_version=4)
    assert not any(cell.get("outputs") or cell.get("execution_count") for cell in book.cells), (
        f"{path}: is committed with outputs"
    )
    local = Config({"AsyncKernelManager": {"transport": "ipc"}})  # no port is opened
    NotebookClient(book, config=local, timeout=120).execute()
    outputs = [output for cell in book.cells for output in cell.get("outputs", [])]
    assert sum("image/png" in output.get("data", {}) for output in outputs) >= 1
    complaints = [o["text"] for o in outputs if o.get("name") == "stderr"]
    assert not complaints, complaints

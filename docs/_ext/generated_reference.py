"""The reference, written anew at every build from what the code itself says: models of files,
commands, metrics, layouts of records, public names.
"""

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

from reference_api import api_page
from reference_commands import commands_page
from reference_files import catalogue_page, file_page
from reference_formats import formats_page
from reference_metrics import assumptions_page, knobs_page, metrics_page

ROOT = Path(__file__).parents[2]


def pages() -> dict[str, str]:
    """Text of every generated page by its name."""
    import hardware.cli
    import twin.cli
    from twin.schemas import KINDS

    files = {f"file-{kind}": file_page(kind) for kind in KINDS if kind != "part"}
    return {
        **files,
        "catalogue": catalogue_page(),
        "command-twin": commands_page("twin", twin.cli.app),
        "command-ugv": commands_page("ugv", hardware.cli.app),
        "metrics": metrics_page(),
        "knobs": knobs_page(),
        "formats": formats_page(),
        "assumptions": assumptions_page(),
        "api-twin": api_page("twin", ROOT / "twin" / "__init__.pyi"),
        "api-hardware": api_page("hardware", ROOT / "hardware" / "__init__.pyi"),
    }


def budget() -> str:
    """What `twin budget` prints, in lines of 110 columns."""
    command = [sys.executable, "-m", "twin", "budget"]
    environment = {**os.environ, "COLUMNS": "110", "PYTHONPATH": os.pathsep.join(sys.path)}
    said = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    return "\n".join(line.rstrip() for line in said.stdout.splitlines()) + "\n"


def write(app: Any) -> None:
    """Write the pages that have changed, so that Sphinx reads no other ones again."""
    folder = Path(app.srcdir) / "reference" / "generated"
    folder.mkdir(parents=True, exist_ok=True)
    texts = {folder / f"{name}.md": text for name, text in pages().items()}
    texts[folder / "budget.txt"] = budget()
    notebooks = (ROOT / "notebooks").glob("*.ipynb")
    texts |= {Path(app.srcdir) / "notebooks" / path.name: path.read_text() for path in notebooks}
    for path in set(folder.glob("*.md")) - texts.keys():
        path.unlink()
    for path, text in texts.items():
        if not path.is_file() or path.read_text() != text:
            path.write_text(text)


def setup(app: Any) -> dict[str, bool]:
    """Sphinx's entry point."""
    app.connect("builder-inited", write)
    return {"parallel_read_safe": True}

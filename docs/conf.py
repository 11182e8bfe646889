"""Sphinx: the documentation site, built by `make docs` without network."""

import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "docs" / "_ext")]

about = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
project = about["name"]
version = release = about["version"]
author = "the ugv-twin authors"
project_copyright = "the ugv-twin authors; Apache-2.0"

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx_copybutton",
    "sphinx_design",
    "docstrings",
    "equations",
    "generated_reference",
]
exclude_patterns = ["_ext", "notebooks/.ipynb_checkpoints"]
source_suffix = {".md": "myst-nb", ".ipynb": "myst-nb"}

myst_enable_extensions = ["dollarmath", "colon_fence", "fieldlist"]
myst_heading_anchors = 4
# The notebooks are executed by the tests and stored with what they print.
nb_execution_mode = "off"
nb_merge_streams = True

default_role = "code"
nitpicky = True
# Types of other libraries, and the project's own that are not public.
nitpick_ignore_regex = [(r"py:.*", r".*")]
autodoc_typehints_format = "short"
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
python_use_unqualified_type_names = True

html_math_renderer = "mathml"
html_theme = "furo"
html_title = "ugv-twin"
html_static_path = ["_static"]
html_css_files = ["tables.css"]
html_copy_source = False
html_show_sphinx = False
copybutton_exclude = ".linenos, .gp, .go"

# `make docs-links`: the one command that asks the network.
linkcheck_timeout = 20
linkcheck_retries = 2

"""The cases are a package of their own, run by ``python -m tests.extremes`` as well."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))

"""Systems by TOML text."""

from collections.abc import Callable
from pathlib import Path

import pytest

from twin.system import System, load_system


@pytest.fixture
def system(tmp_path: Path) -> Callable[..., System]:
    """A bundled system with changes to its sections, by TOML text."""

    def build(text: str = "", base: str = "workable") -> System:
        (tmp_path / "s.toml").write_text(f'base = "{base}"\n{text}')
        return load_system(tmp_path / "s.toml")

    return build

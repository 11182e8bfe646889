"""The designs with which tests/regression looks at scenes/yard."""

from pathlib import Path

_HERE = Path(__file__).parents[1] / "regression"
SYSTEM, RADAR = _HERE / "yard-32x32.toml", _HERE / "yard-radar.toml"

"""Studies that take a moment: 16 x 16 cells of table 1, and the closed form."""

from pathlib import Path

SMALL = """
scene = "table1"
metrics = ["snr_median", "psnr_db"]
[set]
"system.emitter.rows" = 16
"system.emitter.columns" = 16
"system.acquisition.n_patterns" = 256
"fidelity.samples" = 4
"fidelity.max_depth" = 1
"""
CLOSED = 'model = "closed-form"\nmetrics = ["snr", "minimum_time_s", "maximum_distance_m"]\n'


def write(folder: Path, text: str, head: str = SMALL, name: str = "study") -> Path:
    """A study's file from TOML text."""
    path = folder / f"{name}.toml"
    path.write_text(head + text)
    return path

"""Pictures as PNG files, where Pillow (the extra ``png``) is installed."""

from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hardware.errors import InputError
from hardware.files import whole_file

_LEAST_SIDE = 512  # pixels: smaller pictures are enlarged, cell by cell


def write_picture(path: Path, light: NDArray[np.floating[Any]]) -> None:
    """Grey image ``(rows, columns)`` on a square-root scale from 0 to the 99.5th percentile.

    Cells that are no number are black. The shorter side has 512 pixels or more. Raises InputError
    where Pillow is not installed.
    """
    known = np.nan_to_num(light, nan=0.0, posinf=0.0, neginf=0.0)
    top = float(np.percentile(known, 99.5)) or 1.0
    shown = np.sqrt(np.clip(known / top, 0, 1)) if top > 0 else np.zeros_like(known)
    enlarged = -(-_LEAST_SIDE // min(shown.shape))
    write_grey(path, np.kron(shown, np.ones((enlarged, enlarged))))


def expect_png(path: Path) -> None:
    """Raise InputError where Pillow is not installed, or for a name that says another kind of
    file.
    """
    if find_spec("PIL") is None:
        raise InputError(f"{path}: PNG needs Pillow: pip install 'ugv-twin[png]'")
    if path.suffix.lower() != ".png":
        raise InputError(f"{path}: expected a name that ends in .png")


def write_grey(path: Path, level: NDArray[np.floating[Any]]) -> None:
    """Levels from 0, black, to 1, white; row 0 on top.

    Whole or not at all. Raises InputError as `expect_png`; OSError, with the file, where it cannot
    be written.
    """
    expect_png(path)
    from PIL import Image

    picture = Image.fromarray((255 * np.clip(level, 0, 1)).round().astype(np.uint8))
    with whole_file(path) as partial:
        picture.save(partial, format="PNG")

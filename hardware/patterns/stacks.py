"""Stacks of images from files: NumPy's, images of several frames, folders of images."""

import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hardware.errors import InputError
from hardware.files import read_array

#: Of one stack: 2 GiB as float64.
MOST_VALUES = 2**28

Stack = NDArray[Any]


def read_stack(path: Path) -> Stack:
    """Images ``(count, rows, columns)`` of a file or folder, as it holds them.

    Raises FileNotFoundError; InputError naming the file for one that cannot be read.
    """
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such file of patterns")
    if path.is_dir():
        return _folder(path)
    if path.suffix in (".npy", ".npz"):
        return _numpy(path)
    return np.stack(_frames(path))


def _numpy(path: Path) -> Stack:
    try:
        if path.suffix == ".npy":
            return _checked(path, read_array(path))
        with zipfile.ZipFile(path) as archive:
            if sum(item.file_size for item in archive.infolist()) > 8 * MOST_VALUES:
                raise InputError(f"{path}: more than {MOST_VALUES} values")
        with np.load(path) as arrays:
            if "patterns" not in arrays and len(arrays.files) != 1:
                raise InputError(
                    f"{path}: arrays {', '.join(arrays.files)}, expected one, or `patterns`"
                )
            return _checked(path, arrays["patterns" if "patterns" in arrays else arrays.files[0]])
    except InputError:
        raise
    except (ValueError, OSError, EOFError, zipfile.BadZipFile) as error:
        raise InputError(f"{path}: can't be read as an array ({error})") from error


def _checked(path: Path, stack: Stack) -> Stack:
    if not isinstance(stack, np.ndarray) or stack.size > MOST_VALUES:
        raise InputError(f"{path}: expected one array of at most {MOST_VALUES} values")
    return stack


def _folder(path: Path) -> Stack:
    names = sorted(item for item in path.iterdir() if item.is_file())
    frames = [frame for name in names for frame in _frames(name)]
    if not frames:
        raise InputError(f"{path}: no images in it")
    if len({frame.shape for frame in frames}) > 1:
        raise InputError(f"{path}: images of different sizes, expected one for all")
    return np.stack(frames)


def _frames(path: Path) -> list[Stack]:
    """Frames of an image in grey, 8 or 16 bits."""
    try:
        from PIL import Image, ImageSequence
    except ImportError as error:
        raise InputError(f"{path}: images need Pillow: pip install 'ugv-twin[png]'") from error
    try:
        with Image.open(path) as image:
            return [_grey(frame) for frame in ImageSequence.Iterator(image)]
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise InputError(f"{path}: can't be read as an image ({error})") from error


def _grey(frame: Any) -> Stack:
    if frame.mode.startswith("I;16"):
        return np.asarray(frame, dtype=np.uint16)
    if frame.mode in ("1", "F"):
        return np.asarray(frame)
    return np.asarray(frame.convert("L"))

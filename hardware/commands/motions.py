"""The option ``--motion``: an estimate, a velocity, or a file of displacements or of objects."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from hardware.errors import InputError

if TYPE_CHECKING:
    from hardware.reconstruction.motion import Motion, Search

_EXPECTED = (
    "expected `estimate`, DOWN,RIGHT in cells/s, a CSV file of time_s, down_cells, right_cells, a "
    "TOML file of a background and objects, a NumPy file (rows, columns, 2) or (3, 3), or, for "
    "`ugv process` of a log with both sensors, `radar`"
)


def motion_of(given: str) -> "Motion | Search":
    """What ``--motion`` says. Raises InputError naming the value, or the file and its line."""
    from hardware.reconstruction.motion import Search, Shift

    if given == "estimate":
        return Search()
    if given == "radar":
        raise InputError("--motion: radar: is of a log with both sensors: `ugv process LOG`")
    if not given.strip():
        raise InputError(f"--motion: empty, {_EXPECTED}")
    path = Path(given)
    if path.suffix == ".csv":
        return _track(path)
    if path.suffix == ".npy":
        return _field(path)
    if path.suffix == ".toml":
        return _layers(path)
    try:
        down, right = (float(part) for part in given.split(","))
    except ValueError:
        raise InputError(f"--motion: {given!r:.60}: {_EXPECTED}") from None
    return Shift(down, right)


def _track(path: Path) -> "Motion":
    import csv

    import numpy as np

    from hardware.reconstruction.motion import ShiftTrack

    columns = ["time_s", "down_cells", "right_cells"]
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file of displacements")
    rows: list[list[float]] = []
    with path.open(newline="", encoding="utf-8", errors="replace") as file:
        lines = csv.reader(file)
        if (head := next(lines, [])) != columns:
            raise InputError(f"{path}: line 1: {head}, expected {','.join(columns)}")
        for line in lines:
            try:
                numbers = [float(part) for part in line]
            except ValueError:
                numbers = []
            if len(numbers) != len(columns) or not np.isfinite(numbers).all():
                raise InputError(f"{path}: line {lines.line_num}: {line}, expected three numbers")
            if rows and numbers[0] <= rows[-1][0]:
                raise InputError(
                    f"{path}: line {lines.line_num}: time_s: {numbers[0]:g} does not follow "
                    f"{rows[-1][0]:g}"
                )
            rows.append(numbers)
    table = np.array(rows).reshape(-1, 3)
    try:
        return ShiftTrack(table[:, 0], table[:, 1:])
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _layers(path: Path) -> "Motion":
    """A background and objects in front of it, the nearest first.

    ``background_cells_per_s = [down, right]``, and for each object a table ``[[object]]`` of
    ``box_cells = [top, left, bottom, right]`` at the reference time and ``cells_per_s = [down,
    right]``.
    """
    from hardware.files import read_toml
    from hardware.reconstruction.motion import Layers, MovingBox, Shift

    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file of moving objects")
    given = read_toml(path)
    _only(path, "", given, {"background_cells_per_s", "object"})
    if not given:
        raise InputError(f"{path}: empty, expected background_cells_per_s or [[object]]")
    tables = given.get("object", [])
    if not isinstance(tables, list) or not all(isinstance(one, dict) for one in tables):
        raise InputError(f"{path}: object: expected tables, each under [[object]]")
    boxes = []
    for k, table in enumerate(tables):
        where = f"object[{k}]."
        _only(path, where, table, {"box_cells", "cells_per_s"})
        moving = Shift(*_numbers(path, where, table, "cells_per_s", 2))
        top, left, bottom, right = _numbers(path, where, table, "box_cells", 4)
        try:
            boxes.append(MovingBox(top, left, bottom, right, moving))
        except InputError as error:
            raise InputError(f"{path}: object[{k}]: {error}") from error
    still = {"background_cells_per_s": [0.0, 0.0]}
    background = Shift(*_numbers(path, "", still | given, "background_cells_per_s", 2))
    return Layers(background, tuple(boxes))


def _only(path: Path, where: str, table: dict[str, Any], known: set[str]) -> None:
    if unknown := sorted(set(table) - known):
        raise InputError(
            f"{path}: {where}{unknown[0]}: no such key, expected some of {', '.join(sorted(known))}"
        )


def _numbers(path: Path, where: str, table: dict[str, Any], key: str, n: int) -> list[float]:
    import math

    if key not in table:
        raise InputError(f"{path}: {where}{key}: missing, expected {n} finite numbers")
    values = table[key]
    fits = isinstance(values, list) and len(values) == n
    if not fits or not all(
        isinstance(one, int | float) and not isinstance(one, bool) and math.isfinite(one)
        for one in values
    ):
        raise InputError(f"{path}: {where}{key}: {values!r:.60}, expected {n} finite numbers")
    return [float(one) for one in values]


def _field(path: Path) -> "Motion":
    import numpy as np

    from hardware.files import read_array
    from hardware.reconstruction.motion import CellMotion, Homography

    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file of displacements")
    array = read_array(path)
    if array.dtype.kind not in "fiu":
        raise InputError(f"{path}: {_EXPECTED}")
    values = np.asarray(array, np.float64)
    try:
        return Homography(values) if values.shape == (3, 3) else CellMotion(values)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error

"""Poses over time from files: CSV with units in its header, or a vehicle's log (MCAP)."""

import csv
import re
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from io import BytesIO, TextIOWrapper
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from hardware.files import read_regular
from hardware.units import quantity
from twin.files import InputError

Array = NDArray[np.float64]

_ANGLES = ("yaw", "pitch", "roll")
_QUATERNION = ("qw", "qx", "qy", "qz")
_UNITS = {"time": "s", "x": "m", "y": "m", "z": "m"} | dict.fromkeys(_ANGLES, "deg")
_HEADER = re.compile(
    r"\s*(time|x|y|z|yaw|pitch|roll|q[wxyz])(?:\s*[_\[( ]\s*([^\])]+?)\s*[\])]?)?\s*"
)
_EXPECTED = "time_s,x_m,y_m,z_m and qw,qx,qy,qz or yaw_deg,pitch_deg,roll_deg"


@dataclass(frozen=True, eq=False)
class PoseTable:
    """Poses as a file tells them.

    ``times_s`` (n,) from the first on, which is at ``first_s`` of the file; ``quaternions`` (n, 4),
    real part first, or None where the file tells positions alone. ``labels`` say where each is.
    """

    first_s: float
    times_s: Array
    positions_m: Array
    quaternions: Array | None
    labels: tuple[str, ...]


def read_pose_csv(path: Path) -> tuple[PoseTable, list[str]]:
    """Poses from a CSV file whose header names each column with its unit, and warnings about it.

    Columns: ``time_s``, ``x_m``, ``y_m``, ``z_m``, and ``qw, qx, qy, qz`` or any of ``yaw_deg,
    pitch_deg, roll_deg`` (REP 103); in any order, in any unit (``time_ns``, ``x_mm``,
    ``yaw [rad]``); others are left out with a warning, lines that begin with # without. Raises
    InputError naming file and line.
    """
    try:
        text = TextIOWrapper(BytesIO(read_regular(path)), encoding="utf-8-sig", newline="")
        lines = csv.reader(text)
        rows = [
            (lines.line_num, row)
            for row in lines
            if any(cell.strip() for cell in row) and not row[0].lstrip().startswith("#")
        ]
    except InputError:
        raise
    except (OSError, ValueError, csv.Error) as error:
        raise InputError(f"{path}: can't be read as CSV ({error})") from error
    if not rows:
        raise InputError(f"{path}: empty: expected {_EXPECTED}")
    columns = _columns(path, *rows[0])
    if len(rows) < 3:
        raise InputError(f"{path}: {len(rows) - 1} poses: expected at least two")
    labels = tuple(f"{path}: line {number}" for number, _ in rows[1:])
    numbers = [
        _numbers(label, row, columns, len(rows[0][1]))
        for label, (_, row) in zip(labels, rows[1:], strict=True)
    ]
    factor = columns["time"][1]
    first = numbers[0]["time"]
    # Of seconds since 1970 a double keeps 0.2 us: differences are taken before.
    times = np.array([float(row["time"] - first) * factor for row in numbers])
    held = {
        name: np.array([float(row[name]) for row in numbers]) * columns[name][1]
        for name in columns
        if name != "time"
    }
    table = PoseTable(
        first_s=float(first) * factor,
        times_s=times,
        positions_m=np.stack([held[axis] for axis in "xyz"], axis=1),
        quaternions=_quaternions(held, len(rows) - 1),
        labels=labels,
    )
    read = {place for place, _ in columns.values()}
    unread = [cell.strip() for place, cell in enumerate(rows[0][1]) if place not in read]
    return table, [f"{path}: not read: {', '.join(unread)}"] if any(unread) else []


def read_pose_log(path: Path, topic: str, child: str) -> tuple[PoseTable, list[str]]:
    """Poses from a log, and warnings about it; see `hardware.recording.poses.read_poses`."""
    from hardware.recording.ending import Ending
    from hardware.recording.poses import read_poses

    ending = Ending()
    try:
        found = read_poses(path, topic, child, ending)
    except OSError as error:
        raise InputError(f"{path}: can't be read ({error.strerror})") from error
    first = int(found.stamp_ns[0])
    numbers = np.array(found.poses, dtype=np.float64).reshape(-1, 7)
    table = PoseTable(
        first_s=first / 1e9,
        times_s=(found.stamp_ns - first) / 1e9,
        positions_m=numbers[:, :3],
        quaternions=numbers[:, 3:],
        labels=tuple(f"{path}: message {number} on {topic}" for number in found.message),
    )
    return table, [f"{path}: {ending.advice(path)}"] if ending.fault else []


def _columns(path: Path, line: int, row: list[str]) -> dict[str, tuple[int, float]]:
    """Place of each column and what its numbers are to be multiplied by."""
    found: dict[str, tuple[int, float]] = {}
    for place, cell in enumerate(row):
        match = _HEADER.fullmatch(cell)
        if match is None:
            continue
        name, unit = match.groups()
        if name in found:
            raise InputError(f"{path}: line {line}: column {name!r} stands twice")
        found[name] = place, _factor(f"{path}: line {line}: column {cell.strip()!r}", name, unit)
    missing = [name for name in ("time", "x", "y", "z") if name not in found]
    turns = [name for name in _QUATERNION if name in found]
    if missing or (turns and len(turns) < 4) or (turns and found.keys() & set(_ANGLES)):
        raise InputError(f"{path}: line {line}: {','.join(row):.200}: expected {_EXPECTED}")
    return found


def _factor(place: str, name: str, unit: str | None) -> float:
    if name in _QUATERNION:
        return 1.0
    if unit is None:
        raise InputError(f"{place}: expected its unit too, as in {name}_{_UNITS[name]}")
    try:
        return quantity(f"1 {unit}", _UNITS[name])
    except InputError as error:
        raise InputError(f"{place}: {error}") from None


def _numbers(
    label: str, row: list[str], columns: dict[str, tuple[int, float]], width: int
) -> dict[str, Decimal]:
    found = {}
    if any(cell.strip() for cell in row[width:]):
        raise InputError(f"{label}: {len(row)} columns, expected {width} as in the header")
    for name, (place, _) in columns.items():
        if place >= len(row):
            raise InputError(f"{label}: {len(row)} columns, expected a number for {name!r}")
        try:
            found[name] = Decimal(row[place].strip())
        except InvalidOperation:
            found[name] = Decimal("nan")
        # Python reads 8_0 as 80.
        if not found[name].is_finite() or "_" in row[place]:
            raise InputError(f"{label}: {name} = {row[place]!r:.60}: expected a number")
    return found


def _quaternions(held: dict[str, Array], count: int) -> Array | None:
    if "qw" in held:
        return np.stack([held[name] for name in _QUATERNION], axis=1)
    if not held.keys() & set(_ANGLES):
        return None
    angles = np.stack([held.get(name, np.zeros(count)) for name in _ANGLES], axis=1)
    quaternions: Array = Rotation.from_euler("ZYX", angles, degrees=True).as_quat(scalar_first=True)
    return quaternions

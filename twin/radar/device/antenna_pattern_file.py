"""Files of antenna patterns as vendors and solvers export them: a table over a sphere or two cuts.

The gain of an antenna in a direction is `antenna.Antenna.gain`.

A table is CSV with columns theta, phi and gain in dBi (HFSS: ``"Phi[deg]","Theta[deg]",
"dB(GainTotal)[]"``); two cuts are the Planet format (``.msi``, ``.pln``).
"""

import csv
import math
from dataclasses import dataclass
from functools import lru_cache
from io import StringIO
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hardware.files import read_regular
from twin.files import InputError

Array = NDArray[np.float64]

_DBD = 2.15  # of a half-wave dipole, dBi
_CUT = 360  # points of a Planet cut, one per degree
_GRID_DEG = np.arange(361.0)
_DECIMALS = 6  # of a degree, to which angles count as equal


@dataclass(frozen=True, eq=False)
class Pattern:
    """Power gain over the sphere, linear between the points of a grid: with points h apart it is
    off by h^2 / 8 of its second derivative.

    ``gain`` (n_thetas, n_phis) over ``theta_deg``, ascending from the pole, and ``phi_deg``,
    ascending through a whole turn, both ends included. Outside the thetas it is zero.
    """

    theta_deg: Array
    phi_deg: Array
    gain: Array

    def at(self, theta_deg: Array, phi_deg: Array) -> Array:
        """Gain in directions, any shape."""
        from scipy.interpolate import RegularGridInterpolator

        grid = (self.theta_deg, self.phi_deg)
        table = RegularGridInterpolator(grid, self.gain, bounds_error=False, fill_value=0.0)
        turned = self.phi_deg[0] + (phi_deg - self.phi_deg[0]) % 360
        values = table(np.stack([theta_deg, turned], axis=-1))
        return np.reshape(values, np.shape(theta_deg)).astype(np.float64)

    @property
    def efficiency(self) -> float:
        """Power radiated over power fed: the gain's mean over the sphere."""
        theta = np.radians(self.theta_deg)
        turn = np.diff(np.radians(self.phi_deg))
        around = (self.gain[:, 1:] + self.gain[:, :-1]) @ turn / 2
        # Between two rings the gain is linear in theta, and the sine is not: integrated by parts.
        slope = np.diff(around) / np.diff(theta)
        ends = -around[1:] * np.cos(theta[1:]) + around[:-1] * np.cos(theta[:-1])
        return float(np.sum(ends + slope * np.diff(np.sin(theta))) / (4 * np.pi))


def read_pattern(path: Path) -> Pattern:
    """Pattern of a file. Raises InputError naming the file, and the line where there is one."""
    try:
        text = read_regular(path).decode("utf-8-sig")
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: can't be read as text ({error})") from error
    try:
        return _pattern(path, text)
    except csv.Error as error:
        raise InputError(f"{path}: can't be read as a table ({error})") from error


@lru_cache(maxsize=16)
def _pattern(path: Path, text: str) -> Pattern:
    return (_planet if path.suffix.lower() in (".msi", ".pln") else _table)(text, path)


def _table(text: str, path: Path) -> Pattern:
    rows = csv.reader(StringIO(text, newline=""))
    names = [name.strip().lower() for name in next(rows, [])]
    kinds = {"theta": "theta", "phi": "phi", "gain": "gain"}
    columns = {k: [i for i, name in enumerate(names) if w in name] for k, w in kinds.items()}
    if any(len(names) != 1 for names in columns.values()):
        raise InputError(
            f"{path}:1: columns {', '.join(names) or 'none'}: expected one theta, one phi and one "
            "gain (dBi)"
        )
    if "db" not in names[columns["gain"][0]]:
        raise InputError(f"{path}:1: column {names[columns['gain'][0]]!r}: expected a gain in dBi")
    order = [columns[kind][0] for kind in ("theta", "phi", "gain")]
    gain_at: dict[tuple[float, float], float] = {}
    for line, row in enumerate(rows, start=2):
        if not row:
            continue
        theta, phi, gain = (_number(row, i, path, line) for i in order)
        if not -180 <= theta <= 180:
            raise InputError(f"{path}:{line}: theta {theta:g}: expected -180 to 180 deg")
        if theta < 0:  # solvers sweep whole circles
            theta, phi = -theta, phi + 180
        key = round(theta, _DECIMALS), round(phi % 360, _DECIMALS) % 360
        if abs(gain_at.setdefault(key, gain) - gain) > 0.1 and 0 < theta < 180:
            raise InputError(f"{path}:{line}: a second gain at theta {key[0]:g}, phi {key[1]:g}")
    thetas, phis = (sorted({key[i] for key in gain_at}) for i in (0, 1))
    for pole in {0.0, 180.0} & set(thetas):  # one direction, whatever phi says
        gain = next(value for (theta, _), value in gain_at.items() if theta == pole)
        gain_at |= {(pole, phi): gain for phi in phis}
    missing = next(((t, p) for t in thetas for p in phis if (t, p) not in gain_at), None)
    if missing or len(thetas) < 2 or len(phis) < 2:
        lacks = "too few points"
        if missing:
            lacks = f"theta {missing[0]:g}, phi {missing[1]:g} is missing"
        raise InputError(f"{path}: {lacks}: expected a full grid of thetas and phis")
    if np.diff([*phis, phis[0] + 360]).max() > 180:
        raise InputError(f"{path}: phi {phis[0]:g} to {phis[-1]:g} deg: expected a whole turn")
    decibel = np.array([[gain_at[t, p] for p in phis] for t in thetas])
    closed = np.column_stack([decibel, decibel[:, :1]])
    return Pattern(np.array(thetas), np.array([*phis, phis[0] + 360]), _power(closed))


def _planet(text: str, path: Path) -> Pattern:
    """Both cuts' attenuations added: exact on the cuts, an estimate between them.

    Horizontal angles are clockwise as seen from above, vertical ones downwards from the horizon.
    """
    cuts: dict[str, list[float]] = {}
    peak, reading = None, None
    for line, row in enumerate(text.splitlines(), start=1):
        words = row.split()
        if not words:
            continue
        if words[0].upper() in ("HORIZONTAL", "VERTICAL"):
            reading = cuts.setdefault(words[0].upper(), [])
        elif words[0].upper() == "GAIN":
            peak = _number(words, 1, path, line)
            peak += 0.0 if len(words) > 2 and words[2].lower() == "dbi" else _DBD
        elif reading is not None and len(reading) < _CUT:
            if _number(words, 0, path, line) != len(reading):
                raise InputError(f"{path}:{line}: angle {words[0]}: expected {len(reading)}")
            reading.append(abs(_number(words, 1, path, line)))
    if peak is None:
        raise InputError(f"{path}: no GAIN line")
    for name in ("HORIZONTAL", "VERTICAL"):
        if len(cuts.get(name, [])) != _CUT:
            raise InputError(
                f"{path}: {name}: {len(cuts.get(name, []))} points, expected {_CUT}, one per degree"
            )
    theta, phi = _GRID_DEG[:181], _GRID_DEG
    beside = np.array(cuts["HORIZONTAL"])[(-phi.astype(int)) % _CUT]
    above = np.array(cuts["VERTICAL"])[(theta.astype(int) - 90) % _CUT]
    return Pattern(theta, phi, _power(peak - above[:, None] - beside))


def _number(row: list[str], index: int, path: Path, line: int) -> float:
    try:
        value = float(row[index])
        if not math.isfinite(value):
            raise ValueError
    except (IndexError, ValueError):
        shown = repr(row[index]) if index < len(row) else "nothing"
        raise InputError(f"{path}:{line}: {shown}: expected a finite number") from None
    return value


def _power(decibel: Array) -> Array:
    return np.asarray(10 ** (np.minimum(decibel, 300.0) / 10), dtype=np.float64)

"""Vendors' curves: CSV files of two columns, wavelength in nm (or um), value (or per cent)."""

import csv
from array import array
from functools import lru_cache
from io import BytesIO, TextIOWrapper
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hardware.files import read_regular
from twin.files import InputError
from twin.system.detector import Photodetector
from twin.system.emitter import Emitter
from twin.system.optics import Filter
from twin.toml import Sourced

Array = NDArray[np.float64]


def read_curve(path: Path) -> tuple[Array, Array]:
    """A vendor's curve: wavelengths in nm, ascending, and values.

    Lines that are no two numbers are skipped as headers. Wavelengths below 20 are taken as um, and
    values are divided by 100 where a header says per cent or ``%``. Raises InputError.
    """
    try:
        return _curve(path, read_regular(path))
    except InputError:
        raise
    except (OSError, ValueError, csv.Error) as error:
        raise InputError(f"{path}: can't be read as a CSV curve ({error})") from error


def curves(*files: Sourced[str] | None) -> tuple[bytes, ...]:
    """What stands in files of curves: the part of a cache's key that their names do not tell."""
    try:
        return tuple(read_regular(file.value) for file in files if file is not None)
    except OSError as error:
        raise InputError(f"{error.filename}: can't be read ({error.strerror})") from error


@lru_cache(maxsize=32)
def _curve(path: Path, content: bytes) -> tuple[Array, Array]:
    nm, values, per_cent = _columns(content)
    if len(nm) < 2:
        raise InputError(f"{path}: expected two columns of numbers, wavelength and value")
    order = np.argsort(nm, kind="stable")
    nm, values = nm[order], values[order]
    if not (np.isfinite(nm).all() and np.isfinite(values).all() and (values >= 0).all()):
        raise InputError(f"{path}: a value is negative or no number")
    if (np.diff(nm) == 0).any():
        raise InputError(f"{path}: a wavelength stands twice")
    if nm[-1] < 20:  # micrometres
        nm = nm * 1e3
    if not 100 <= nm[0] < nm[-1] <= 20_000:
        raise InputError(
            f"{path}: wavelengths {nm[0]:g} to {nm[-1]:g} nm: expected nm or um, 100 to 20 000 nm"
        )
    if not values.any():
        raise InputError(f"{path}: every value is zero")
    return nm, values / 100 if per_cent else values


def _columns(content: bytes) -> tuple[Array, Array, bool]:
    """Both columns (n,), and whether a header says per cent; row by row, a number is 8 bytes."""
    nm, values, per_cent = array("d"), array("d"), False
    for row in csv.reader(TextIOWrapper(BytesIO(content), encoding="utf-8-sig", newline="")):
        try:
            pair = float(row[0]), float(row[1])
        except (ValueError, IndexError):
            header = " ".join(row).lower()
            per_cent = per_cent or "%" in header or "per cent" in header
            continue
        nm.append(pair[0])
        values.append(pair[1])
    return np.array(nm), np.array(values), per_cent


def read_transmission(path: Path) -> tuple[Array, Array]:
    """A curve whose values are shares. Raises InputError where one is above 1."""
    nm, values = read_curve(path)
    if values.max() > 1:
        raise InputError(
            f"{path}: transmission {values.max():g}: expected at most 1, or a header with %"
        )
    return nm, values


def read_responsivity(detector: Photodetector) -> tuple[Array, Array]:
    """Wavelengths in nm and A/W: the vendor's curve, or the one number over 900 to 1700 nm.

    Raises InputError for a curve above one electron a photon times the detector's gain.
    """
    if detector.responsivity_csv is not None:
        path = Path(detector.responsivity_csv.value)
        nm, curve = read_curve(path)
        worst = int(np.argmax(curve / nm))
        try:
            detector.check_quantum_limit(float(curve[worst]), float(nm[worst]) * 1e-9)
        except InputError as error:
            raise InputError(f"{path}: {error}") from error
        return nm, curve
    return np.array([900.0, 1700.0]), np.full(2, detector.responsivity_a_per_w.value)


def check_curves(
    emitter: Emitter | None, band: Filter | None, detector: Photodetector | None
) -> None:
    """Read every curve that parts name. Raises InputError, with the field, for the first that can't
    be used.
    """
    field = ""
    try:
        if emitter and emitter.spectrum_csv:
            field = "emitter.spectrum_csv"
            read_curve(Path(emitter.spectrum_csv.value))
        if band and band.transmission_csv:
            field = "filter.transmission_csv"
            read_transmission(Path(band.transmission_csv.value))
        if detector and detector.responsivity_csv:
            field = "detector.responsivity_csv"
            read_responsivity(detector)
    except InputError as error:
        raise InputError(f"{field}: {error}") from error

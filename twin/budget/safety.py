"""Margin of a design to the exposure limits of the eye, and its dependence on wavelength."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from hardware.formatting import json_text, number, si
from twin.optics.eye_safety import class_1_ael_j, mpe_j_per_m2
from twin.optics.hazards import Hazard, assumptions
from twin.system import System

Array = NDArray[np.float64]

#: From the paper's tens of ns to continuous light.
DURATIONS_S = (1e-9, 1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 0.1, 1.0, 10.0, 100.0)


def wavelength_ratio(
    time_s: Any, wavelength_m: float = 1550e-9, other_m: float = 850e-9
) -> tuple[Array, Array]:
    """Ratio of the limits of two wavelengths for pulses of a point source: exposure and energy.

    The energy is that through each wavelength's limiting aperture (class 1): with 1 mm for pulses
    at 1550 nm and 7 mm at 850 nm its ratio is 49 times smaller than that of the exposures.
    """
    exposure = mpe_j_per_m2(wavelength_m, time_s) / mpe_j_per_m2(other_m, time_s)
    energy = class_1_ael_j(wavelength_m, time_s) / class_1_ael_j(other_m, time_s)
    return exposure, energy


def print_safety(system: System, rows: Sequence[Hazard], console: Console) -> None:
    """The margins, and the ratio of 1550 to 850 nm over the duration of a pulse."""
    table = Table("limit", "clause", "wavelength", "exposure", "allowed", "margin", box=None)
    table.title = f"{system.name}: eye safety; a margin below 1 exceeds the limit"
    for row in rows:
        cells = (row.name, row.clause, f"{number(1e9 * row.wavelength_m, 4)} nm")
        values = (si(row.exposure, row.unit), si(row.limit, row.unit))
        style = "" if row.margin >= 1 else "bold"
        table.add_row(*cells, *values, number(row.margin), style=style)
    console.print(table)
    ratios = Table("pulse", "exposure, J/m^2", "energy into the aperture, J", box=None)
    ratios.title = "What 1550 nm may give over what 850 nm may (laser, one pulse, point source)"
    for duration, exposure, energy in zip(
        DURATIONS_S, *wavelength_ratio(np.array(DURATIONS_S)), strict=True
    ):
        ratios.add_row(si(duration, "s"), number(exposure), number(energy))
    console.print(ratios)


def safety_verdict(rows: Sequence[Hazard]) -> str:
    """Of the least margin at the first wavelength, the emitter's own."""
    own = [row for row in rows if row.wavelength_m == rows[0].wavelength_m]
    least = min(own, key=lambda row: row.margin)
    word = "within" if least.margin >= 1 else "beyond"
    return f"{word} the limits of the eye, least margin {number(least.margin)} ({least.name})"


def write_safety(system: System, rows: Sequence[Hazard], folder: Path) -> None:
    """``safety.json`` with every number."""
    (folder / "safety.json").write_text(json_text(safety_content(system, rows)))


def safety_content(system: System, rows: Sequence[Hazard]) -> dict[str, Any]:
    """Every number of the tables, for JSON."""
    exposure, energy = wavelength_ratio(np.array(DURATIONS_S))
    return {
        "system": system.name,
        "hazards": [{**asdict(row), "margin": row.margin} for row in rows],
        "assumed": assumptions(system),
        "ratio_1550_to_850": {
            "duration_s": list(DURATIONS_S),
            "exposure": exposure.tolist(),
            "energy": energy.tolist(),
        },
    }

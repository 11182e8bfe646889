"""Margin of a design to the exposure limits of the eye, and its dependence on wavelength."""

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from hardware.formatting import number, si
from twin.optics.eye_safety import (
    CLASS_1_TIME_S,
    LAMP_DISTANCE_M,
    LASER_DISTANCE_M,
    aperture_m,
    c5,
    class_1_ael_j,
    is_retinal,
    lamp_cornea_w_per_m2,
    lamp_retina,
    mpe_j_per_m2,
    t2_s,
)
from twin.system import System

Array = NDArray[np.float64]

#: From the paper's tens of ns to continuous light.
DURATIONS_S = (1e-9, 1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 0.1, 1.0, 10.0, 100.0)


@dataclass(frozen=True)
class Hazard:
    """One exposure limit: exposure by the design, limit, and clause of the standard.

    ``margin`` above 1 is safe. All cells are assumed lit all the time, the worst case of patterns.
    """

    name: str
    clause: str
    wavelength_m: float
    exposure: float
    limit: float
    unit: str

    @property
    def margin(self) -> float:
        """Limit over exposure."""
        return self.limit / self.exposure if self.exposure else math.inf


def hazards(system: System, wavelength_m: float | None = None) -> list[Hazard]:
    """All limits for the emitter, at its peak or at another wavelength.

    According to its kind, laser or LED; both where the system does not say. Raises InputError for
    wavelengths outside 700-1800 nm.
    """
    emitter = system.emitter
    wavelength = emitter.peak_wavelength_m.value if wavelength_m is None else wavelength_m
    diameter = emitter.source_diameter_m.value if emitter.source_diameter_m else 0.0
    kind = emitter.kind.value if emitter.kind else None
    rows = []
    if kind in ("laser", None):
        rows += _laser(system, wavelength, diameter)
    if kind in ("led", None):
        rows += _lamp(system, wavelength, diameter)
    return rows


def assumptions(system: System) -> list[str]:
    """Assumptions about whatever the system leaves out."""
    emitter, assumed = system.emitter, []
    if emitter.kind is None:
        assumed.append("emitter.kind: not given, both standards are applied")
    if emitter.source_diameter_m is None:
        assumed.append("emitter.source_diameter_m: not given, a point source (worst case)")
    assumed.append("all cells lit all the time; no optical instruments; no single fault")
    assumed.append("limits and clauses after secondary sources: check them against the standards")
    return assumed


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


def _laser(system: System, wavelength: float, diameter: float) -> list[Hazard]:
    """IEC 60825-1, 4.3 f): a single pulse, the average, and the train of pulses."""
    alpha = diameter / LASER_DISTANCE_M
    pulse = system.acquisition.integration_time_s.value
    pulse = min(max(pulse, 1e-9), CLASS_1_TIME_S)
    rows = []
    for name, clause, duration in (
        ("laser, one exposure", "4.3 f) 1", pulse),
        ("laser, continuous, 100 s", "4.3 f) 2", CLASS_1_TIME_S),
    ):
        energy = _collected_w(system, wavelength, duration) * duration
        limit = float(class_1_ael_j(wavelength, duration, alpha))
        table = "Table 4" if is_retinal(wavelength) and alpha > 1.5e-3 else "Table 3"
        where = f"IEC 60825-1 {clause}), {table}, class 1"
        rows.append(Hazard(name, where, wavelength, energy, limit, "J"))
    if is_retinal(wavelength):
        period = system.acquisition.pattern_period_s.value
        # Pulses closer than T_i, or continuous light: the whole period counts as the pulse.
        duration = max(period, 13e-6)
        pulses = min(t2_s(alpha), CLASS_1_TIME_S) / duration
        factor = c5(wavelength, duration, max(pulses, 1.0), alpha)
        duration = min(duration, CLASS_1_TIME_S)
        energy = _collected_w(system, wavelength, duration) * duration
        limit = factor * float(class_1_ael_j(wavelength, duration, alpha))
        where = "IEC 60825-1 4.3 f) 3), C5, class 1"
        rows.append(Hazard("laser, pulse train", where, wavelength, energy, limit, "J"))
    return rows


def _collected_w(system: System, wavelength: float, duration_s: float) -> float:
    """Power through the limiting aperture at 100 mm; at most the emitter's whole power."""
    emitter = system.emitter
    radius = float(aperture_m(wavelength, duration_s)) / 2
    seen = 2 * math.pi * (1 - math.cos(math.atan(radius / LASER_DISTANCE_M)))
    half = math.radians(emitter.field_of_view_deg.value) / 2
    whole = 4 * math.asin(math.sin(half) ** 2)  # solid angle of the square field
    return emitter.radiant_intensity_w_per_sr.value * min(seen, whole)


def _lamp(system: System, wavelength: float, diameter: float) -> list[Hazard]:
    """IEC 62471 at 0.2 m, exempt group."""
    intensity = system.emitter.radiant_intensity_w_per_sr.value
    irradiance = intensity / LAMP_DISTANCE_M**2
    pulse = min(max(system.acquisition.integration_time_s.value, 1e-5), 10.0)
    rows = []
    if wavelength >= 780e-9:
        limit = float(lamp_cornea_w_per_m2(1001.0))
        where = "IEC 62471 4.3.7, exempt"
        rows.append(Hazard("LED, cornea, > 1000 s", where, wavelength, irradiance, limit, "W/m^2"))
    if is_retinal(wavelength):
        for name, clause, duration in (
            ("LED, retina, one exposure", "4.3.5", pulse),
            ("LED, retina, 10 s", "4.3.5", 10.0),
            ("LED, retina, > 10 s, unseen", "4.3.6", 1000.0),
        ):
            retina = lamp_retina(wavelength, intensity, diameter, duration)
            where = f"IEC 62471 {clause}, exempt"
            unit = "W/(m^2 sr)"
            rows.append(Hazard(name, where, wavelength, retina.radiance, retina.limit, unit))
    return rows


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


def write_safety(system: System, rows: Sequence[Hazard], folder: Path) -> None:
    """``safety.json`` with every number."""
    exposure, energy = wavelength_ratio(np.array(DURATIONS_S))
    content = {
        "system": system.name,
        "hazards": [{**asdict(row), "margin": row.margin} for row in rows],
        "assumed": assumptions(system),
        "ratio_1550_to_850": {
            "duration_s": list(DURATIONS_S),
            "exposure": exposure.tolist(),
            "energy": energy.tolist(),
        },
    }
    (folder / "safety.json").write_text(json.dumps(content, indent=1))

"""Exposure of the eye to an emitter, against every limit that holds for its kind."""

import math
from dataclasses import dataclass

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
    t2_s,
)
from twin.system import System


@dataclass(frozen=True)
class Hazard:
    """One exposure limit: exposure by the design, limit, and clause of the standard.

    ``margin`` above 1 is safe. All cells are assumed lit all the time, the worst case of patterns;
    of a raster scan one cell after another. Modulated or pulsed light counts with the share of the
    time that it is on. ``single_fault``: of a scanner that stands still, which the design must
    detect and switch off.
    """

    name: str
    clause: str
    wavelength_m: float
    exposure: float
    limit: float
    unit: str
    single_fault: bool = False

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


def least_margins(system: System) -> tuple[Hazard, Hazard | None]:
    """The limits of least margin: in normal operation, and of a single fault where there is one.

    Raises InputError as `hazards`.
    """
    rows = sorted(hazards(system), key=lambda row: row.margin)
    faults = [row for row in rows if row.single_fault]
    return next(row for row in rows if not row.single_fault), faults[0] if faults else None


def assumptions(system: System) -> list[str]:
    """Assumptions about whatever the system leaves out."""
    emitter, assumed = system.emitter, []
    if emitter.kind is None:
        assumed.append("emitter.kind: not given, both standards are applied")
    if emitter.source_diameter_m is None:
        assumed.append("emitter.source_diameter_m: not given, a point source (worst case)")
    if system.is_raster:
        assumed.append("the beam fills one cell after another, as large at the eye as the cell is")
    lit = "one cell lit at a time" if system.is_raster else "all cells lit all the time"
    assumed.append(f"{lit}; no optical instruments; no single fault unless named")
    assumed.append("limits and clauses after secondary sources: check them against the standards")
    return assumed


def _laser(system: System, wavelength: float, diameter: float) -> list[Hazard]:
    """IEC 60825-1, 4.3 f): a single pulse, the average, and the train of pulses."""
    alpha = diameter / LASER_DISTANCE_M
    pulse = system.acquisition.integration_time_s.value
    pulse = min(max(pulse, 1e-9), CLASS_1_TIME_S)
    rows = []
    for name, clause, duration, fault in (
        *_single_pulse(system),
        ("laser, one exposure", "4.3 f) 1", pulse, False),
        ("laser, continuous, 100 s", "4.3 f) 2", CLASS_1_TIME_S, False),
        *([("laser, 100 s, scanner at rest", "4.3 f) 2", CLASS_1_TIME_S, True)] * system.is_raster),
    ):
        energy = _energy_j(system, wavelength, duration, at_rest=fault)
        limit = float(class_1_ael_j(wavelength, duration, alpha))
        table = "Table 4" if is_retinal(wavelength) and alpha > 1.5e-3 else "Table 3"
        where = f"IEC 60825-1 {clause}), {table}, class 1"
        rows.append(Hazard(name, where, wavelength, energy, limit, "J", fault))
    if is_retinal(wavelength):
        period = system.acquisition.pattern_period_s.value
        # Pulses closer than T_i, or continuous light: the whole period counts as the pulse.
        duration = max(period, 13e-6)
        pulses = min(t2_s(alpha), CLASS_1_TIME_S) / duration
        factor = c5(wavelength, duration, max(pulses, 1.0), alpha)
        duration = min(duration, CLASS_1_TIME_S)
        energy = _energy_j(system, wavelength, duration)
        limit = factor * float(class_1_ael_j(wavelength, duration, alpha))
        where = "IEC 60825-1 4.3 f) 3), C5, class 1"
        rows.append(Hazard("laser, pulse train", where, wavelength, energy, limit, "J"))
    return rows


def _single_pulse(system: System) -> list[tuple[str, str, float, bool]]:
    """The limit of one pulse of a pulsed source that is shorter than an exposure."""
    tof = system.time_of_flight
    if tof is None or tof.pulse_width_s is None:
        return []
    return [("laser, one pulse", "4.3 f) 1", max(tof.pulse_width_s.value, 1e-9), False)]


def _energy_j(
    system: System, wavelength: float, duration_s: float, *, at_rest: bool = False
) -> float:
    """Largest energy through the limiting aperture at 100 mm within a time.

    At most that of the whole emitter. Of a raster scan the beam of one cell, or as much of it as
    the aperture takes, for as long as the cell is lit, and that of all cells that the aperture
    takes after one another; ``at_rest``: the beam of one cell all the time.
    """
    emitter, tof = system.emitter, system.time_of_flight
    radius = float(aperture_m(wavelength, duration_s)) / 2
    seen = 2 * math.pi * (1 - math.cos(math.atan(radius / LASER_DISTANCE_M)))
    half = math.radians(emitter.field_of_view_deg.value) / 2
    whole = 4 * math.asin(math.sin(half) ** 2)  # solid angle of the square field
    peak, share = emitter.radiant_intensity_w_per_sr.value, 1.0
    pulse_s = 0.0
    if tof is not None and tof.pulse_width_s is not None:
        share, pulse_s = tof.emitter_share, tof.pulse_width_s.value
    # A pulse is within the time whole, or for as long as that lasts.
    lit_s = max(share * duration_s, min(pulse_s, duration_s))
    if not system.is_raster:
        return peak * min(seen, whole) * lit_s
    cell = whole / system.patterns.n_cells
    if at_rest:
        return peak * min(seen, cell) * lit_s
    # Cells that the aperture takes, in as many visits as fall into the time.
    in_view, frame_s = max(min(seen, whole) / cell, 1.0), system.frame_time_s
    visited_s = min(share * in_view * system.acquisition.pattern_period_s.value, lit_s)
    frames = max(duration_s / frame_s, 1.0)
    return peak * min(seen, cell) * max(visited_s * frames, min(pulse_s, duration_s))


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

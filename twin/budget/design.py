"""Budget of a system in front of a wall at normal incidence, in closed form.

Emitter, filter, lens, detector, amplifier, converter and patterns are the system's; the light is
that of `wall_power_w`, the noise that of the simulated camera (`noise_budget`).
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from twin.budget.field import field_means
from twin.camera.illumination import dark_share
from twin.camera.shutters import shutters
from twin.detector import FrontEnd, NoiseBudget, noise_budget
from twin.detector.flicker import in_image
from twin.files import InputError
from twin.optics.radiometry import Collection, collection, field_stop, lit_tan, wall_power_w
from twin.optics.spectra import responsivity_a_per_w
from twin.system import System
from twin.system.detector import check_has_closed_form
from twin.toml import Sourced

Array = NDArray[np.float64]

_WHOLE = 1e-6  # of a cell, which is rounding
_TIMES_S = (1e-9, 1e3)
_DISTANCES_M = (1e-2, 1e6)
_FARTHEST_M = 1e12  # that a row may ask for

#: Effects that the closed form leaves out, by the field of the system.
_LEFT_OUT = {
    "weather": "the air",
    "emitter.viewing_angle_deg": "the emitter's lobe",
    "emitter.blur_rms_deg": "its blur",
    "emitter.fill_factor": "its fill factor",
    "emitter.switching_time_s": "its switching time",
    "readout.bandwidth_hz": "the amplifier's settling",
    "optics.edge_illumination": "vignetting beyond cos^4",
    "optics.blur_rms_deg": "the lens's blur",
    "optics.focus_m": "its defocus",
}
#: Those that it knows of an image, not of one exposure.
_OF_IMAGE = {
    "readout.flicker_corner_hz": "1/f noise of the amplifier",
    "time_of_flight.modulation_hz": "the shutters of time of flight",
    "time_of_flight.gate_delays_s": "the gates",
}


@dataclass(frozen=True)
class WallRow:
    """A wall at one distance, of one reflectance.

    ``budget``: of one average exposure. ``snr_per_pixel``: of the image, mean over the cells in the
    field, those that its edge cuts as well; nan where the detector saturates. ``fill``: the all-lit
    exposure, its mean over the converter's range, or the well's where that is less.
    ``minimum_time_s``: integration for an SNR per pixel of 1, with as many patterns; infinite where
    the detector saturates before, or where noise that grows as the signal does forbids it (the
    emitter's fluctuation; behind a transimpedance amplifier, which averages, the converter's step).
    ``maximum_distance_m``: at which the SNR per pixel is 1; nan where the detector saturates there,
    and for gates.
    """

    distance_m: float
    reflectance: float
    signal_w: float
    budget: NoiseBudget
    snr_per_pixel: float
    fill: float
    minimum_time_s: float
    maximum_distance_m: float

    @property
    def saturates(self) -> bool:
        """Whether the all-lit exposure leaves the converter's range or fills the well."""
        return self.fill >= 1


def wall_rows(
    system: System, distances_m: Sequence[float], reflectances: Sequence[float]
) -> list[WallRow]:
    """Rows for every distance and reflectance. Raises InputError where there is no light at all."""
    if not all(0 < z <= _FARTHEST_M for z in distances_m):
        raise InputError(f"distances: expected lengths above 0, up to {_FARTHEST_M:g} m")
    design = _SystemBudget.of(system)
    if not design.watt(1.0, 1.0):
        raise InputError("budget: no light of the emitter passes the filter, or it emits none")
    nearest = design.lens.pupil_diameter_m
    if near := [z for z in distances_m if z < nearest]:
        raise InputError(
            f"distances: {near[0]:g} m: expected at least {nearest:.3g} m, the diameter of the "
            f"detector's pupil of system {system.name!r}"
        )
    return [design.row(z, rho) for z in distances_m for rho in reflectances]


def left_out_of_exposure(system: System) -> list[str]:
    """Effects of the system that the closed form of one exposure with all cells lit leaves out."""
    said = {name for name, _ in system.values()}
    return [what for name, what in (_LEFT_OUT | _OF_IMAGE).items() if name in said]


def left_out(system: System) -> list[str]:
    """Effects of the system that the closed form of its image leaves out."""
    said = {name for name, _ in system.values()} | ({"weather"} if system.weather else set())
    missing = [what for name, what in _LEFT_OUT.items() if name in said]
    if system.has_square_field and _cuts_cells(system):
        missing.append(
            "the field's edge within cells (the SNR is the mean over whole and cut cells alike)"
        )
    if system.optics.field_stop.value == "detector":
        missing.append("the field's outline (the SNR is the mean over all cells, unseen ones too)")
    return missing


@dataclass(frozen=True, eq=False)
class _SystemBudget:
    """The part of a system's budget that depends on neither distance nor reflectance.

    ``in_band``: share of the emitter's line behind the filter, mean over the light of a wall;
    ``sun_w``: the sun's power on one detector from a white wall at normal incidence.
    """

    system: System
    lens: Collection
    in_band: float
    sun_w: float
    responsivity: float

    @classmethod
    def of(cls, system: System) -> "_SystemBudget":
        check_has_closed_form(system.detector)
        lens, means = collection(system), field_means(system)
        collected = lens.transmission * lens.pupil_area_m2 * lens.field_area
        return cls(
            system=system,
            lens=lens,
            in_band=float(means.in_band),
            sun_w=float(means.sun_w_per_m2) / math.pi * collected / system.n_detectors,
            responsivity=responsivity_a_per_w(system.detector, system.emitter, system.filter),
        )

    def watts(self, distance_m: float, reflectance: float) -> Array:
        """All cells lit, on one detector, through each shutter (n_shutters,)."""
        path = np.array(2 * distance_m)
        shares = [
            shutter.light_share * float(shutter.response(path) if shutter.response else 1.0)
            for shutter in shutters(self.system)
        ]
        whole = wall_power_w(self.system, reflectance, distance_m) * self.in_band
        return whole / self.system.n_detectors * np.array(shares)

    def watt(self, distance_m: float, reflectance: float) -> float:
        """All cells lit, on one detector, mean over the shutters."""
        return float(self.watts(distance_m, reflectance).mean())

    def budget(
        self, distance_m: float, reflectance: float, time_s: float | None = None
    ) -> NoiseBudget:
        """Of one exposure with half of the cells lit, as long as the system's or ``time_s``."""
        opened = float(np.mean([shutter.open_share for shutter in shutters(self.system)]))
        half = (1 + dark_share(self.system)) / 2 * self.watt(distance_m, reflectance)
        fluctuation = self.system.emitter.intensity_noise
        front_end = self._front_end(time_s)
        budget = noise_budget(
            np.array([half]),
            opened * reflectance * self.sun_w,
            front_end,
            fluctuation.value if fluctuation else 0.0,
        )
        return in_image(budget, self.system.patterns, front_end.times)

    def snr(self, distance_m: float, reflectance: float, time_s: float | None = None) -> float:
        """Signal of a cell over noise of a pixel, summed over the shutters."""
        system, n_shutters = self.system, len(shutters(self.system))
        lit = self.watt(distance_m, reflectance) * self._front_end(time_s).electrons_per_watt
        cell = (1 - dark_share(system)) * lit / self._n_seen
        noise = self.budget(distance_m, reflectance, time_s).pixel_noise_e(system.patterns)
        return math.sqrt(n_shutters) * cell / noise

    @property
    def _n_seen(self) -> float:
        """Cells of a detector in a square field, whole or cut by its edge; of another outline all
        (`left_out`).
        """
        if self.lens.outline == "disc":
            return self.system.patterns.n_cells
        return math.prod(map(_seen, _across(self.system))) / self.system.n_detectors

    def fill(self, distance_m: float, reflectance: float, time_s: float | None = None) -> float:
        """Mean of the brightest exposure, all cells lit, over the converter's range, or over the
        well if that is less.
        """
        front_end = self._front_end(time_s)
        opened = np.array([shutter.open_share for shutter in shutters(self.system)])
        sun_w = opened * reflectance * self.sun_w
        brightest_w = float((self.watts(distance_m, reflectance) + sun_w).max())
        electrons = brightest_w * front_end.electrons_per_watt + front_end.dark_e
        counts = electrons / front_end.electrons_per_count + front_end.offset_counts
        return max(counts / (2**front_end.adc_bits - 1), electrons / front_end.full_well_e)

    def row(self, distance_m: float, reflectance: float) -> WallRow:
        fill = self.fill(distance_m, reflectance)
        return WallRow(
            distance_m=distance_m,
            reflectance=reflectance,
            signal_w=self.watt(distance_m, reflectance),
            budget=self.budget(distance_m, reflectance),
            snr_per_pixel=self.snr(distance_m, reflectance) if fill < 1 else math.nan,
            fill=fill,
            minimum_time_s=self.minimum_time_s(distance_m, reflectance),
            maximum_distance_m=self.maximum_distance_m(reflectance),
        )

    def minimum_time_s(self, distance_m: float, reflectance: float) -> float:
        time = _solve(lambda t: self.snr(distance_m, reflectance, t), _TIMES_S, 1.0)
        fits = time < math.inf and self.fill(distance_m, reflectance, time) < 1
        return time if fits else math.inf

    def maximum_distance_m(self, reflectance: float) -> float:
        tof = self.system.time_of_flight
        if tof is not None and tof.gate_delays_s is not None:
            return math.nan
        far = _solve(lambda z: -self.snr(z, reflectance), _DISTANCES_M, -1.0)
        return far if far == math.inf or self.fill(far, reflectance) < 1 else math.nan

    def _front_end(self, time_s: float | None = None) -> FrontEnd:
        """Of the system, or of exposures of another length, their period longer in proportion."""
        front_end = FrontEnd.of(self.system, self.responsivity)
        if time_s is None:
            return front_end
        exposure = Sourced(value=time_s, assumed="varied")
        changed = self.system.acquisition.unchecked_copy({"integration_time_s": exposure})
        longer = self.system.unchecked_copy({"acquisition": changed})
        return replace(FrontEnd.of(longer, self.responsivity), times=front_end.times)


def _across(system: System) -> tuple[tuple[int, float], tuple[int, float]]:
    """Cells across the lit field, and how many of them the detector's field is wide: of columns,
    all detectors together, and of rows.
    """
    share = min(field_stop(system)[0] / lit_tan(system), 1.0) if system.emitter.has_lens else 1.0
    rows, columns = system.image_shape
    return (columns, columns * share), (rows, rows * share)


def _seen(across: tuple[int, float]) -> int:
    """Of cells side by side, those of which a field in their middle sees any part."""
    n, wide = across
    middle = n % 2
    return middle + 2 * math.ceil(max(wide - middle, 0) / 2 - _WHOLE)


def _cuts_cells(system: System) -> bool:
    return any(_seen((n, wide)) - wide > 2 * _WHOLE for n, wide in _across(system))


def _solve(rising: Callable[[float], float], ends: tuple[float, float], level: float) -> float:
    """Argument at which a rising function reaches a level: the first end where it is above it
    everywhere, infinite where it is below.
    """
    from scipy.optimize import brentq  # takes 0.2 s to import

    low, high = (math.log(end) for end in ends)

    def off(log_x: float) -> float:
        return rising(math.exp(log_x)) - level

    if off(high) < 0:
        return math.inf
    return ends[0] if off(low) > 0 else math.exp(brentq(off, low, high, xtol=1e-12))

"""The paper's Table 1, cell by cell: printed, photon-limited and implied values."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from twin.budget.link import (
    OpticalLink,
    distance_sigma_m,
    implied_read_noise_e,
    maximum_distance_m,
    minimum_time_s,
    noise_e,
)
from twin.files import InputError
from twin.optics.radiometry import cell_centres, lit_share
from twin.optics.solar_irradiance import sun_in_band
from twin.optics.spectra import in_band_fraction, responsivity_a_per_w
from twin.system import Part, Photodetector, System
from twin.system.detector import check_has_closed_form

#: Reflectance; then distance in m and integration time in s, as printed, per sensor.
REFLECTANCES = (0.2, 0.5, 0.8)
PRINTED = {
    "g9201-256": ((1.8, 900e-6), (4.3, 1.5e-3), (9.4, 2.2e-3)),
    "g10768-1024d": ((2.2, 70e-6), (4.5, 250e-6), (10.0, 450e-6)),
    "fga015": ((2.0, 50e-6), (4.5, 150e-6), (10.0, 315e-6)),
}
#: Data sheets and the paper's own words, as catalogue parts.
SENSORS = ("fga015", "fga015-paper", "g10768-1024d", "g9201-256", "g9201-256-paper")
#: Assumed modulation of a time-of-flight measurement; not in the paper.
MODULATION_HZ = 10e6


@dataclass(frozen=True)
class AuditRow:
    """One sensor's three cells, each array (3,) over the reflectances.

    ``photon_limited_s``: no read noise at all. ``read_noise_e``: the one that fits the row's three
    times best (least squares of log time). ``time_s`` and ``distance_m``: with that read noise,
    the time needed at the printed distance and the distance reached in the printed time.
    ``residual``: time over printed time, less 1. ``distance_sigma_m``: of a time-of-flight reading
    at the printed distance and time.
    """

    sensor: str
    printed_distance_m: np.ndarray
    printed_time_s: np.ndarray
    photon_limited_s: np.ndarray
    implied_read_noise_e: np.ndarray
    read_noise_e: float
    time_s: np.ndarray
    distance_m: np.ndarray
    residual: np.ndarray
    distance_sigma_m: np.ndarray
    elasticity: dict[str, float]


def link_of(
    system: System, part: Part, *, whole_line: bool = False, filter_before_lens: bool = False
) -> OpticalLink:
    """Link of one pixel of a sensor, in place of the system's detector, as in the paper: on the
    axis, without the cosines of the field, which take 0.07 of a field of 20 degrees and 0.24 of one
    of 40, and without the filter's shift over it (`field_link` has both).

    ``whole_line``: as in the paper, the emitter's line is completely inside the filter.
    ``filter_before_lens``: the angles of incidence on the filter are those of the field, which
    shift its band; the share is the mean over the square field.
    """
    band, optics = system.filter, system.optics
    detector = detector_of(part)
    sun = sun_in_band(system.sky, band).irradiance_w_per_m2 if system.sky else 0.0
    return OpticalLink(
        radiant_intensity_w_per_sr=system.emitter.radiant_intensity_w_per_sr.value,
        in_band=1.0 if whole_line else _share(system, filter_before_lens),
        transmission=optics.transmission.value * band.transmission.value,
        f_number=optics.f_number.value,
        pixel_area_m2=detector.area_m2,
        responsivity_a_per_w=_responsivity(system, part),
        dark_current_a=detector.dark_current_a.value,
        sun_w_per_m2=sun,
        shot_variance=detector.multiplication * detector.excess_noise,
        lit_share=lit_share(system),
    )


def _responsivity(system: System, part: Part) -> float:
    """Raises InputError for more than one electron a photon."""
    detector, emitter = detector_of(part), system.emitter
    responsivity = responsivity_a_per_w(detector, emitter, system.filter)
    try:
        detector.check_quantum_limit(responsivity, emitter.peak_wavelength_m.value)
    except InputError as error:
        raise InputError(f"part {part.name}: {error}") from error
    return responsivity


def _share(system: System, over_field: bool) -> float:
    if not over_field:
        return in_band_fraction(system.emitter, system.filter)
    edge = np.tan(np.radians(system.optics.field_of_view_deg.value / 2))
    side = cell_centres(64)[32:] * edge  # a quarter of the field
    angles = np.degrees(np.arctan(np.hypot(side[:, None], side)))
    shares = [in_band_fraction(system.emitter, system.filter, a) for a in angles.ravel()]
    return float(np.mean(shares))


def detector_of(part: Part) -> Photodetector:
    """The detector of a part. Raises InputError where it is none."""
    if part.detector is None:
        raise InputError(f"part {part.name}: is a {part.kind}, expected a detector")
    check_has_closed_form(part.detector)
    return part.detector


def audit(link: OpticalLink, part: Part) -> AuditRow:
    """Re-derive one sensor's cells of Table 1. Raises KeyError for a sensor not in the table."""
    printed = PRINTED[part.name.removesuffix("-paper")]
    if not np.all(link.signal_e_per_s(1.0, 1.0)):
        raise InputError("budget: no light of the emitter passes the filter, or it emits none")
    z, t = (np.array(column) for column in zip(*printed, strict=True))
    read = _fitted_read_noise(link, z, t)
    signal, background = _rates(link, z)
    shot: dict[str, Any] = {"shot_variance": link.shot_variance}
    time = minimum_time_s(signal, background, read, **shot)
    snr = signal * t / noise_e(signal, background, t, read, **shot)
    at_1_m = link.signal_e_per_s(np.array(REFLECTANCES), 1.0)
    return AuditRow(
        sensor=part.name,
        printed_distance_m=z,
        printed_time_s=t,
        photon_limited_s=np.asarray(minimum_time_s(signal, background, 0.0, **shot)),
        implied_read_noise_e=np.asarray(implied_read_noise_e(signal, background, t, **shot)),
        read_noise_e=read,
        time_s=np.asarray(time),
        distance_m=np.asarray(maximum_distance_m(at_1_m, background, t, read, **shot)),
        residual=np.asarray(time / t - 1),
        distance_sigma_m=np.asarray(distance_sigma_m(snr, MODULATION_HZ)),
        elasticity=_elasticity(link, read, z[-1]),
    )


def _rates(link: OpticalLink, distance_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    rho = np.array(REFLECTANCES)
    signal = np.asarray(link.signal_e_per_s(rho, distance_m))
    return signal, np.asarray(link.background_e_per_s(rho))


def _fitted_read_noise(link: OpticalLink, z: np.ndarray, t: np.ndarray) -> float:
    """The read noise whose times fit the printed ones best, in the logarithm."""
    from scipy.optimize import minimize_scalar

    signal, background = _rates(link, z)
    shot: dict[str, Any] = {"shot_variance": link.shot_variance}
    implied = implied_read_noise_e(signal, background, t, **shot)
    start = np.log(np.maximum(implied, 1e-3)).mean()

    def misfit(log_read: float) -> float:
        times = minimum_time_s(signal, background, np.exp(log_read), **shot)
        return float(np.sum(np.log(times / t) ** 2))

    fit = minimize_scalar(misfit, bounds=(start - 5, start + 5), method="bounded")
    return float(np.exp(fit.x))


def _elasticity(link: OpticalLink, read_e: float, distance_m: float) -> dict[str, float]:
    """Relative change of the time at 80 % and the farthest distance per relative change of each
    input.
    """
    rho = REFLECTANCES[-1]

    def log_time(changed: OpticalLink, read: float) -> float:
        signal = changed.signal_e_per_s(rho, distance_m)
        background, shot = changed.background_e_per_s(rho), changed.shot_variance
        return float(np.log(minimum_time_s(signal, background, read, shot_variance=shot)))

    step = 1e-4
    moves = {
        name: (
            log_time(replace(link, **{name: value * (1 + step)}), read_e)
            - log_time(replace(link, **{name: value * (1 - step)}), read_e)
        )
        / (2 * step)
        for name, value in vars(link).items()
        # Only an avalanche has a variance to change, and only a narrow emitter a share.
        if name not in ("shot_variance", "lit_share") or value != 1
    }
    more, less = (log_time(link, read_e * (1 + s * step)) for s in (1, -1))
    moves["read_noise_e"] = (more - less) / (2 * step)
    return dict(sorted(moves.items(), key=lambda item: -abs(item[1])))

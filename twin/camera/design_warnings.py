"""What a camera's design does to its light before any count is read: none comes back, thick air,
a narrow filter, diffraction, cells that light the same.
"""

import numpy as np
from numpy.typing import NDArray

from twin.camera.illumination import amplifier_residue, residual_share, switched_residue
from twin.camera.shutters import farthest_gate_m, unambiguous_m
from twin.camera.verdict import quantisation_warnings
from twin.detector import NoiseBudget
from twin.optics.emission import emission_matrix, independent_patterns
from twin.optics.radiometry import Collection
from twin.optics.weather import air_of_system
from twin.system import System
from twin.warned import CaptureWarning

Array = NDArray[np.float64]

#: One-way optical depth of scattering from which a warning is given: 0.2 to 3 % of all light is
#: scattered more than once there in air that absorbs none, 0.7 to 4 % at an albedo of 0.2.
_THICK = 0.25

#: Distance at which a wall would leave as much of the air's light out as an open view.
_OPEN_VIEW_M = 12.5

#: What is left out, by a random walk through the bundled fog.
_MISSING_VEIL = (
    "in fog 3 to 8 % of all light at 0.5, 12 to 22 % at 1 and 20 to 45 % at 2 (there up to 4 times "
    "the light of the surfaces), for emitter and detector 0.1 to 0.4 m apart, 20 deg wide, and a "
    "wall 10 m away of reflectance 0.8 to 0.2; the more the farther apart they are; in air that "
    "absorbs most, of an albedo of 0.2, 3 to 14 % at 0.5"
)

#: Radius of the Airy disc over half the field above which a warning is given.
_LARGE_AIRY_DISC = 0.05


def design_warnings(
    system: System,
    lens: Collection,
    noise: NoiseBudget,
    in_band: float,
    scene_e: Array,
    depth_m: Array,
    *,
    may_be_missed: bool,
) -> tuple[CaptureWarning, ...]:
    """``in_band``: share of the emitter's light that the filter passes on axis, at most;
    ``scene_e`` (n_detectors, n_cells): electrons of the scene's cells; ``depth_m`` of its surfaces;
    ``may_be_missed``: whether all paths may have missed light.
    """
    return (
        *quantisation_warnings(noise),
        *_no_light(system, in_band, scene_e, depth_m, may_be_missed=may_be_missed),
        *_ambiguous(system, depth_m),
        *_narrow_filter(system, in_band),
        *_thick_air(system, depth_m),
        *_crosstalk(system, float(depth_m.min())),
        *_diffraction(system, lens),
    )


def _diffraction(system: System, lens: Collection) -> list[CaptureWarning]:
    """Warning of a pupil so small that its Airy disc blurs the edge of the field."""
    airy = 1.22 * system.emitter.peak_wavelength_m.value / lens.pupil_diameter_m
    share = airy / lens.tan_half_field
    if share < _LARGE_AIRY_DISC:
        return []
    return [
        CaptureWarning(
            "model",
            "the detector is too small for geometrical optics: diffraction at its pupil of "
            f"{lens.pupil_diameter_m:.2g} m blurs the field's edge by {100 * share:.2g} % of its "
            "half width, which is left out: optics.f_number, detector.width_m",
        )
    ]


def lag_shares(system: System) -> dict[str, float]:
    """Share of the exposures before in each exposure, by the fields that cause it: each by itself
    and, where there are two, both together.
    """
    shares = {
        "emitter.switching_time_s": residual_share(system),
        "readout.bandwidth_hz": amplifier_residue(system),
    }
    if all(shares.values()):
        shares[" and ".join(shares)] = switched_residue(system)
    return {field: share for field, share in shares.items() if share}


def _thick_air(system: System, depth_m: Array) -> list[CaptureWarning]:
    air = air_of_system(system)
    if air is None:
        return []
    seen_m = np.where(np.isfinite(depth_m), depth_m, _OPEN_VIEW_M)
    depth = air.scattering_per_m * float(np.median(seen_m))
    if depth < _THICK:
        return []
    return [
        CaptureWarning(
            "model",
            f"half of the cells look through an optical depth of scattering of {depth:.2g} or more "
            f"(an open view counts as {_OPEN_VIEW_M:g} m): light that hits no surface and is "
            "scattered by the air more than once is left out; it is spread over the image: "
            f"{_MISSING_VEIL}; the real image has less contrast",
        )
    ]


def _no_light(
    system: System, in_band: float, scene_e: Array, depth_m: Array, *, may_be_missed: bool
) -> list[CaptureWarning]:
    if in_band == 0 or system.emitter.radiant_intensity_w_per_sr.value == 0:
        text = "no light of the emitter passes the filter, or it emits none"
    elif not scene_e.any() and farthest_gate_m(system) < depth_m.min() < np.inf:
        text = (
            "no light of the emitter comes back: what is in the field of view lies beyond the last "
            f"gate, at {depth_m.min():.3g} m or more (time_of_flight.gate_delays_s)"
        )
    elif not scene_e.any() and system.weather and np.isfinite(depth_m).any():
        text = "no light of the emitter comes back: the air transmits none"
    elif not scene_e.any() and may_be_missed:
        text = (
            "no path brings back light of the emitter: what is in the field of view is hidden, or "
            "too small for so few paths"
        )
    elif not scene_e.any() and np.isfinite(depth_m).any():
        text = "no light of the emitter comes back: what is in the field of view reflects none"
    elif not scene_e.any():
        text = "no light of the emitter comes back: nothing in the field of view"
    else:
        return []
    return [CaptureWarning("no-light", text, void=True)]


def _ambiguous(system: System, depth_m: Array) -> list[CaptureWarning]:
    """Warning of surfaces whose distances repeat."""
    longest_m, seen = unambiguous_m(system), depth_m[np.isfinite(depth_m)]
    if not (seen > longest_m).any():
        return []
    field = "modulation_hz"
    if system.time_of_flight and system.time_of_flight.modulation_hz is None:
        field = "pulse_rate_hz"
    return [
        CaptureWarning(
            "design",
            f"distances are ambiguous: surfaces lie at up to {seen.max():.3g} m, and those beyond "
            f"{longest_m:.3g} m are measured nearer by multiples of it: time_of_flight.{field}",
        )
    ]


def _narrow_filter(system: System, in_band: float) -> list[CaptureWarning]:
    line, width = system.emitter.line_fwhm_m.value, system.filter.width_m.value
    curves = system.emitter.spectrum_csv or system.filter.transmission_csv
    if curves is not None or width >= line or in_band == 0:
        return []
    return [
        CaptureWarning(
            "design",
            f"the filter, {width * 1e9:g} nm, is narrower than the emitter's line, "
            f"{line * 1e9:g} nm: {in_band:.1%} of its light passes",
        )
    ]


def _crosstalk(system: System, distance_m: float) -> list[CaptureWarning]:
    """Warning of bare LEDs, each of which lights the whole field."""
    if system.emitter.has_lens or not np.isfinite(distance_m):
        return []
    n_images = independent_patterns(emission_matrix(system.emitter, distance_m))
    return [
        CaptureWarning(
            "design",
            f"bare LEDs: at {distance_m:.3g} m only {n_images} of {system.patterns.n_cells} images "
            "differ by more than 1 % of the signal; with a projection lens all would",
        )
    ]

"""Physical optics by shooting and bouncing rays: one kernel from the radar and back to it.

Ling, Chou and Lee (IEEE Trans. AP 37, 1989), for spherical waves, with the currents of physical
optics at *every* bounce: a ray is a tube of solid angle dOmega; where it meets a facet it drives
J = n x (H_i + H_r) and M = -n x (E_i + E_r) on the tube's footprint, and these radiate back to the
radar where it sees the facet. Where the phase runs from tube to tube so fast that the sum would
alias, the tube is faded out: such parts cancel, unless an edge stands there, and without it a
sphere is wrong by many dB.

Rays meet triangles in float32; the distance to the facet's plane, and with it the phase, is
float64. Distances are relative to the target's origin: one formula holds near and far.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray
from scipy.constants import speed_of_light

from twin.engine import mitsuba
from twin.radar.scattering.kernel import launch, opaque, trace
from twin.radar.scattering.surface import table
from twin.radar.scattering.target import Target
from twin.radar.scattering.wave import Polarization, Radar

Array = NDArray[np.float64]

_RAYS_AT_ONCE = 2**20  # 200 MB while they are under way
_SCOUTS = 2**13
_LEAST_SHORTENING = 0.05
#: Cosine and sine; the tangent is the golden ratio's.
TILT = np.array([0.8506508083520399, 0.5257311121191336])


@dataclass(frozen=True)
class Quality:
    """Knobs of the ray tracer, each with the error it bounds.

    rays_per_wavelength
        Across the wavefront; more where most facets are met obliquely. A tube counts whole or not
        at all where an edge cuts it. Median error of a plate of 53 x 26 wavelengths at 2, 4, 8, 16:
        0.04, 0.009, 0.002, 0.001 dB in the lobes up to 5 deg; 29, 0.5, 0.13, 0.03 dB at 40 to 50
        deg, 60 dB below (`python -m benchmarks` prints the curve).
    max_bounces
        What is reflected more often is lost.
    max_rays
        Bounds time. Where it bites, tubes are wider than asked for and `Echo.thinned` says so.
    min_rays
        Of a target small against the wavelength: bounds the error of its outline, about 3 / rays.
    """

    rays_per_wavelength: float = 8.0
    max_bounces: int = 8
    max_rays: int = 2**26
    min_rays: int = 2**15

    def __post_init__(self) -> None:
        if not self.rays_per_wavelength > 0:
            raise ValueError(f"rays_per_wavelength: {self.rays_per_wavelength}: expected above 0")
        if self.max_bounces < 1:
            raise ValueError(f"max_bounces: {self.max_bounces} is less than 1")
        if not 1 <= self.min_rays <= self.max_rays:
            raise ValueError(f"min_rays, max_rays: {self.min_rays}, {self.max_rays}: not in order")


@dataclass(frozen=True, eq=False)
class Echo:
    """What comes back, and what a reader should know about it.

    ``amplitude`` (2,) is S in metres for reception in V and H, of a wave of amplitude 1 at the
    target's origin: cross-section 4 pi |S|^2. ``lit_m2`` is the area of the wavefront that hits, on
    a sphere through the origin: a silhouette. Of it, ``grazing`` is the share that meets its facet
    within 15 deg of grazing, ``faded`` the share where rays are too few to follow the phase,
    ``unfinished`` what is still under way after the last bounce. ``thinned`` is the factor by which
    tubes are wider than asked for.
    """

    amplitude: NDArray[np.complex128]
    lit_m2: float
    grazing: float
    faded: float
    unfinished: float
    thinned: float
    rays: int


def physical_optics(
    target: Target,
    radar: Radar,
    carrier_hz: float,
    polarization: Polarization = "V",
    quality: Quality | None = None,
) -> Echo:
    """Scattered amplitude of a target for a wave sent in ``polarization``."""
    quality = quality or Quality()
    wavelength = speed_of_light / carrier_hz
    mi, engine = mitsuba(), target.engine
    patches = _patches(target, radar)
    setting = opaque(
        mi,
        {
            "wavelength": wavelength,
            "inverse_distance": radar.inverse_distance,
            "distance": float(min(radar.distance_m, 1e200)),
            "towards": radar.direction,
            "listener": radar.direction,
            "apart": False,
            "center": engine.center_m,
            "radius": 1.01 * engine.radius_m,
            "sent": radar.polarizations[0 if polarization == "V" else 1],
            "vertical": radar.polarizations[0],
            "horizontal": radar.polarizations[1],
        },
    )
    coefficients = mi.Float64(table(target.surfaces, carrier_hz).ravel())

    def shoot(spacing: float, max_bounces: int) -> Array:
        """Sums over all rays of what `trace` returns."""
        sums = np.zeros(9)
        bounces = dr.opaque(mi.UInt32, max_bounces)
        for patch in patches:
            for grid, size in _blocks(patch, spacing):
                rays = dr.arange(mi.UInt32, size)
                launched = launch(mi, setting, opaque(mi, grid), rays)
                parts = trace(mi, engine, setting, coefficients, bounces, *launched)
                sums += [float(dr.sum(part)[0]) for part in parts]
        return sums

    # A few rays tell how obliquely facets are met, and how dense rays must be to follow the phase.
    area = sum(float(np.prod(patch.high - patch.low)) for patch in patches)
    *_, lit, cosines, _, _, _ = shoot(_spacing(patches, area, 0.0, _SCOUTS), 1)
    shortening = np.clip(1.5 * cosines / lit, _LEAST_SHORTENING, 1) if lit else 1.0
    asked = wavelength / quality.rays_per_wavelength * float(shortening)
    dense = min(asked, (area / quality.min_rays) ** 0.5)
    spacing = _spacing(patches, area, dense, quality.max_rays)
    v_re, v_im, h_re, h_im, lit, _, *shares = shoot(spacing, quality.max_bounces)
    s = np.array([v_re + 1j * v_im, h_re + 1j * h_im]) * -1j / (2 * wavelength)
    grazing, faded, unfinished = (float(share / lit) if lit else 0.0 for share in shares)
    thinned = max(1.0, spacing / asked)
    return Echo(s, float(lit), grazing, faded, unfinished, thinned, rays=round(area / spacing**2))


@dataclass(frozen=True, eq=False)
class _Patch:
    """Part of a wavefront: a rectangle on a plane, centre and axes (3,), relative to the origin."""

    center: Array
    forward: Array
    axes: tuple[Array, Array]
    low: Array
    high: Array


def _patches(target: Target, radar: Radar) -> list[_Patch]:
    """One rectangle around the target's outline; six faces of a cube where the radar is close."""
    center, radius = target.sphere
    u, q = radar.direction, radar.inverse_distance
    towards = center * q - u
    if np.linalg.norm(towards) < 1.5 * radius * q:
        return _cube(radar, float(np.linalg.norm(towards) / q + radius))
    forward = towards / np.linalg.norm(towards)
    right = np.cross(forward, np.eye(3)[np.argmin(np.abs(forward))])
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    # Tilted against the axes: rows of tubes parallel to an edge would all be cut alike.
    first = TILT[0] * right + TILT[1] * up
    second = TILT[0] * up - TILT[1] * right
    points = target.used_m
    # Perspective onto the plane through the centre; parallel where q is 0.
    ray = points * q - u
    depth = np.linalg.norm(towards) / (ray @ forward)
    seen = ray * depth[:, None]
    if q:
        flat = np.stack([seen @ first, seen @ second], axis=1) / q
    else:
        flat = np.stack([(points - center) @ first, (points - center) @ second], axis=1)
    return [_Patch(center, forward, (first, second), flat.min(axis=0), flat.max(axis=0))]


def _cube(radar: Radar, reach_m: float) -> list[_Patch]:
    """The whole sphere of directions, for a radar inside the target or next to it."""
    here, half = radar.direction * radar.distance_m, np.full(2, reach_m)
    patches = []
    for i, axis in enumerate(np.eye(3)):
        sides = (np.eye(3)[i - 2], np.eye(3)[i - 1])
        for way in (axis, -axis):
            patches.append(_Patch(here + reach_m * way, way, sides, -half, half))
    return patches


def _spacing(patches: list[_Patch], area_m2: float, wanted_m: float, max_rays: int) -> float:
    """Spacing of rays, wider than wanted where they would be too many."""
    spacing = max(wanted_m, (area_m2 / max_rays) ** 0.5)
    if len(patches) > 1:  # faces of a cube must not overlap
        side = float(patches[0].high[0] - patches[0].low[0])
        spacing = side / float(np.ceil(side / spacing))
    return spacing


def _blocks(patch: _Patch, spacing: float) -> Iterator[tuple[dict[str, Any], int]]:
    """Rows of the patch's grid, as many as fit into one launch."""
    extent = (patch.high - patch.low) / spacing
    columns, rows = np.maximum(np.ceil(extent - 1e-6), 1).astype(np.int64)
    left, bottom = patch.low / spacing + 0.5 + (extent - (columns, rows)) / 2
    per_block = max(1, _RAYS_AT_ONCE // int(columns))
    for top in range(0, int(rows), per_block):
        count = min(per_block, int(rows) - top)
        yield (
            {
                "center": patch.center,
                "forward": patch.forward,
                "first": patch.axes[0],
                "second": patch.axes[1],
                "spacing": spacing,
                "columns": int(columns),
                "left": float(left),
                "bottom": float(bottom + top),
            },
            int(columns) * count,
        )

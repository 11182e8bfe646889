"""What a rendering leaves uncertain in a scene: each with its estimated error, for a warning."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from twin.optics.devices import Device
from twin.optics.weather import Air
from twin.scene import Scene
from twin.warned import CaptureWarning

Array = NDArray[np.float64]

_WORTH_SAYING = 0.004  # relative error of all the light
_STEP = 2.0**-24  # half a step of float32, relative
_THIN = 0.01  # share of the light
#: Steps that intersection and normal together are off at most: 4.2 were measured.
_STEPS = 8.0


def cut_off(indirect_share: float, albedo: Array, max_depth: int) -> list[CaptureWarning]:
    """Light of bounces beyond ``max_depth``, as a share of what was found.

    Bounces are taken to fall as powers of the mean reflectance r in sight, exact in a closed room
    of one colour: beyond the last one lies r^(d-1) / (1 - r^(d-1)) of the indirect light.
    """
    seen = albedo[albedo > 0]
    if max_depth == 1 or not len(seen) or not indirect_share:
        return []
    kept = float(seen.mean()) ** (max_depth - 1)
    if kept >= 1:
        text = f"bounces beyond max_depth {max_depth} are cut off: nothing here absorbs light"
        return [CaptureWarning("rendering", text)]
    lost = indirect_share * kept / (1 - kept)
    if lost < _WORTH_SAYING:
        return []
    text = (
        f"bounces beyond max_depth {max_depth} are cut off: some {100 * lost:.2g} % more light, "
        "if reflectances in sight hold everywhere"
    )
    return [CaptureWarning("rendering", text)]


def grazing(cells: Array, cosines: Array) -> list[CaptureWarning]:
    """Rounding of float32 rays on surfaces met at a grazing angle, weighted by their light.

    ``cells``, ``cosines``: light of each cell and cosine of incidence in its middle, alike shaped.
    """
    lit = (cells > 0) & (cosines > 0)
    if not lit.any():
        return []
    error = float(np.sum(cells[lit] * _STEPS * _STEP / cosines[lit]) / cells[lit].sum())
    if error < _WORTH_SAYING:
        return []
    text = f"surfaces are met at grazing angles: float32 rays leave up to {100 * error:.2g} %"
    return [CaptureWarning("rendering", text)]


def unspread(air: Air | None, distance_m: float, orders: int) -> list[CaptureWarning]:
    """Light scattered forward on the way to the nearest surface and left in its own cell, where no
    orders of scattering are followed.
    """
    if air is None or orders or not np.isfinite(distance_m):
        return []
    spread = float(-np.expm1(-air.scattering_per_m * distance_m * air.asymmetry**2))
    if spread < _THIN:
        return []
    text = (
        "light that the air scatters forward is left in its own cell (fidelity.air_orders = 0): "
        f"contrast of fine detail is too high by some {100 * spread / (1 - spread):.2g} %; orders "
        "of scattering spread it"
    )
    return [CaptureWarning("rendering", text)]


def unsampled(scene: Scene, camera: Device, rays: int) -> list[CaptureWarning]:
    """Objects in the field so small that none of ``rays`` need meet them.

    Their light comes out right in the mean only: with n rays expected, off by 1 / sqrt(n) of it.
    """
    found = []
    origin = scene.rig.position_m + camera.origin_m
    for item in scene.objects:
        seen = (item.vertices_m - origin) @ camera.axes.T
        if (seen[:, 0] <= 0).any():
            continue  # around or behind the camera, so not small
        flat = seen[:, 1:] / seen[:, :1] / camera.tan_half_field
        low, high = flat.min(axis=0), flat.max(axis=0)
        if (low > 1).any() or (high < -1).any():
            continue
        expected = rays * float(np.prod((high - low) / 2))
        if expected < 1:
            found.append((item.name, float(1 / np.sqrt(max(expected, 1e-30)))))
    return [_small(found)] if found else []


def _small(found: Sequence[tuple[str, float]]) -> CaptureWarning:
    worst = max(error for _, error in found)
    names = ", ".join(name for name, _ in found[:5]) + (", ..." if len(found) > 5 else "")
    return CaptureWarning(
        "rendering",
        f"smaller than the spacing of rays: {names}; light from there is off by up to "
        f"{100 * worst:.2g} % of itself; more samples find it",
    )

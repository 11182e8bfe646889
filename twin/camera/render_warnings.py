"""Warnings of a render's uncertainties, each with its estimated error."""

import math
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from twin.camera.left_out import bounces_share, rounding_share
from twin.camera.mounting import field_points
from twin.camera.permitted_error import PermittedError
from twin.optics.devices import Device, disc_error
from twin.optics.radiometry import mean_cos_power
from twin.optics.weather import Air
from twin.scene import Scene
from twin.warned import CaptureWarning

Array = NDArray[np.float64]

_WORTH_SAYING = 0.004  # relative error of all the light
_THIN = 0.01  # share of the light
#: How a limit of paths and bounces is raised.
_MORE_RAYS = "raise fidelity.light_rays"
_NO_MORE_PATHS = f"no more paths are traced; {_MORE_RAYS}"


def truncation_warnings(
    indirect_share: float, reflectance: float, max_depth: float, *, by_chance: bool = False
) -> list[CaptureWarning]:
    """Light of bounces beyond ``max_depth``, as a share of the computed light: `bounces_share`.

    ``by_chance``: bounces end so, and at that number only where light hardly ends.
    """
    if max_depth in (1, math.inf) or not indirect_share:
        return []
    lost = bounces_share(reflectance, max_depth, indirect_share)
    if lost < _WORTH_SAYING:
        return []
    bounces, knob = f"max_depth {max_depth:g}", ""
    if by_chance:
        bounces, knob = f"{max_depth:g}", f"; {_MORE_RAYS}"
    if lost == math.inf:
        text = f"bounces beyond {bounces} are cut off: nothing here absorbs light"
        return [CaptureWarning("rendering", text)]
    text = (
        f"bounces beyond {bounces} are cut off: some {100 * lost:.2g} % more light, "
        f"if the scene is as bright as its mean reflectance{knob}"
    )
    return [CaptureWarning("rendering", text)]


def tolerance_warnings(
    over: float, permitted: PermittedError, cells: Array
) -> tuple[CaptureWarning, ...]:
    """Light ``cells`` whose error over the permitted one, root mean square over the cells, is above
    1.
    """
    if over <= 1:
        return ()
    tolerance = permitted.tolerance_of(cells)
    text = (
        f"light is off by {over * tolerance:.2g} {permitted.unit}, root mean square over the "
        f"image, where {tolerance:.2g} are allowed: {_NO_MORE_PATHS}"
    )
    return (CaptureWarning("tolerance", text),)


def is_out_of_paths(warnings: Iterable[str]) -> bool:
    """Whether one says that the limit of paths is reached, beyond which no tolerance helps."""
    return any(_NO_MORE_PATHS in warning for warning in warnings)


def sun_warnings(over: float) -> tuple[CaptureWarning, ...]:
    """The sun's light whose error over the permitted one is above 1."""
    if over <= 1:
        return ()
    text = f"the sun's light is off by {over:.2g} times what the tolerance allows: {_NO_MORE_PATHS}"
    return (CaptureWarning("tolerance", text),)


def grazing_warnings(cells: Array, cosines: Array) -> list[CaptureWarning]:
    """Rounding of float32 rays on surfaces at grazing incidence, weighted by their light.

    ``cells``, ``cosines``: light of each cell and cosine of incidence in its middle, of one shape.
    """
    lit = (cells > 0) & (cosines > 0)
    if not lit.any():
        return []
    error = float(np.sum(cells[lit] * rounding_share(cosines[lit])) / cells[lit].sum())
    if error < _WORTH_SAYING:
        return []
    text = f"grazing incidence: float32 rays give an error of up to {100 * error:.2g} %"
    return [CaptureWarning("rendering", text)]


def near_pupil_warnings(
    cells: Array, cosines: Array, depth_m: Array, emitter: Device, detector: Device
) -> list[CaptureWarning]:
    """Form factor of a pupil near a surface, off the pupil's axis, weighted by the cells' light;
    and more light than the emitter sends, which bounces between surfaces that near can bring.

    ``cells``, ``cosines``, ``depth_m`` of one shape: light, cosine of incidence in the cell's
    middle, and depth along the emitter's axis.
    """
    radius = detector.disc_radius_m
    lit = (cells > 0) & (cosines > 0) & np.isfinite(depth_m)
    if not radius or not lit.any():
        return []
    left, up = field_points(cells.shape, emitter.tan_half_field)
    along = np.stack([np.ones_like(left), left, up], axis=-1) @ emitter.axes
    to_detector = depth_m[lit, None] * along[lit] + emitter.origin_m - detector.origin_m
    distance_m = np.linalg.norm(to_detector, axis=-1)
    at_pupil = np.clip(to_detector @ detector.axes[0] / distance_m, 1e-3, 1)
    errors = disc_error(radius, distance_m, np.clip(cosines[lit], 1e-3, 1) * at_pupil)
    error = float(errors @ cells[lit] / cells[lit].sum())
    found = []
    if error >= _WORTH_SAYING:
        text = (
            f"surfaces are near the detector's pupil, of radius {radius:.2g} m: the light that it "
            f"takes of them is exact on its axis only, and off by up to {100 * error:.2g} %"
        )
        found.append(CaptureWarning("model", text))
    tangent = emitter.tan_half_field
    sent = 4 * tangent**2 * mean_cos_power(3, tangent, "square")
    if emitter.pitch_m is not None:
        sent = 2 * np.pi / (emitter.lobe_exponent + 1)
    if (share := float(cells.sum()) * np.pi * radius**2 / sent) > 1:
        text = (
            f"{share:.3g} times the light of the emitter reaches the detector: surfaces are as "
            "near as its pupil is wide, and bounces pass through it: move the rig"
        )
        found.append(CaptureWarning("model", text, void=True))
    return found


def forward_scattering_warnings(
    air: Air | None, distance_m: float, orders: int
) -> list[CaptureWarning]:
    """Forward scattered light on the way to the nearest surface that stays in its own cell because
    scattering is not traced.
    """
    if air is None or orders or not np.isfinite(distance_m):
        return []
    spread = float(-np.expm1(-air.scattering_per_m * distance_m * air.asymmetry**2))
    if spread < _THIN:
        return []
    text = (
        "light that the air scatters forward stays in its own cell (fidelity.air_orders = 0): "
        f"contrast of fine detail is too high by some {100 * spread / (1 - spread):.2g} %; raise "
        "fidelity.air_orders"
    )
    return [CaptureWarning("rendering", text)]


def lost_orders_warnings(share: float, orders: int) -> list[CaptureWarning]:
    """Light that the air scatters more than ``orders`` times, as a share of the computed light."""
    if share < _WORTH_SAYING:
        return []
    more = f"{100 * share:.2g} % more" if share < 10 else f"{share:.1g} times the"
    text = (
        f"light that the air scatters more than {orders} times on the way to a surface or back is "
        f"left out: some {more} light, as before a wall at the mean distance; raise "
        "fidelity.air_orders"
    )
    return [CaptureWarning("rendering", text)]


def lost_airlight_warnings(lost: Array, sun: Array) -> list[CaptureWarning]:
    """Sunlight that the air scatters more than once, ``lost`` (rows, columns), beside ``sun``, the
    computed light of the sun in the same parts.
    """
    missing, computed = float(lost.sum()), float(sun.sum())
    if missing <= _THIN * computed:
        return []
    share = missing / computed if computed else math.inf
    more = f"{100 * share:.2g} % of" if share < 1 else f"{share:.2g} times"
    text = (
        f"sunlight that hits no surface and is scattered by the air more than once is left out: "
        f"{more} the sun's computed light, in a layer of air that ends 10 m above the sensor, or "
        "lower where it would dim the sun by e, over black ground at the first surface straight "
        "below, 1.5 m where there is none; thicker layers and brighter ground bring more"
    )
    return [CaptureWarning("model", text)]


def undersampling_warnings(scene: Scene, camera: Device, rays: float) -> list[CaptureWarning]:
    """Objects in the field so small that fewer than one of ``rays`` is expected to hit them.

    Their light is correct in the mean only: with n rays expected its relative error is 1 / sqrt(n).
    """
    small = []
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
            small.append((item.name, float(1 / np.sqrt(max(expected, 1e-30)))))
    return [_small_objects(small)] if small else []


def _small_objects(errors: Sequence[tuple[str, float]]) -> CaptureWarning:
    worst = max(error for _, error in errors)
    names = ", ".join(name for name, _ in errors[:5]) + (", ..." if len(errors) > 5 else "")
    return CaptureWarning(
        "rendering",
        f"smaller than the spacing of rays: {names}; the error of their light is up to "
        f"{100 * worst:.2g} %; raise fidelity.samples",
    )

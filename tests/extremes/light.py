"""Extremes of the camera: geometry, surfaces, sun, detector, through to photo-electrons."""

from collections.abc import Sequence
from dataclasses import replace

import mpmath as mp
import numpy as np

from tests.extremes import oracle
from tests.extremes.case import Case, Found
from tests.extremes.worlds import (
    Triangles,
    camera,
    has_tolerance,
    inclined,
    light_stated,
    look,
    mosaic,
    scene,
    square,
)
from twin.camera import Capture
from twin.fidelity import Fidelity
from twin.scene import Sun
from twin.system import System

#: Stated for direct light on a wall: what the transport is tested to everywhere.
LIGHT = 3e-3
_WALL = "mpmath: integral over the field, to electrons"
_PUPIL = "mpmath: integral over field and pupil, to electrons"


def expected_electrons(
    system: System, distance_m: float, reflectance: float, incline_deg: float = 90.0
) -> mp.mpf:
    """Electrons of all cells together, from the system's plain values."""
    e, f, o, d = system.emitter, system.filter, system.optics, system.detector
    field = o.field_of_view_deg.value
    pupil = oracle.pupil_m2(d.width_m.value, o.f_number.value, field)
    # Its own radius; the effective area is smaller than it by 4 N^2 / (4 N^2 + 1).
    radius = float(mp.sqrt(pupil / mp.pi * (1 + 1 / (4 * mp.mpf(o.f_number.value) ** 2))))
    if incline_deg == 90 and distance_m < 1e3 * radius:
        light = oracle.facing_light(distance_m, field, radius)
    else:
        light = oracle.plane_light(distance_m, incline_deg, field)
    watts = (
        mp.mpf(e.radiant_intensity_w_per_sr.value)
        * oracle.band_share(
            e.peak_wavelength_m.value,
            e.line_fwhm_m.value,
            f.center_wavelength_m.value,
            f.width_m.value,
        )
        * mp.mpf(f.transmission.value)
        * mp.mpf(o.transmission.value)
        * pupil
        * mp.mpf(reflectance)
        * light
    )
    time = mp.mpf(system.acquisition.integration_time_s.value)
    return watts * mp.mpf(d.responsivity_a_per_w.value) * time / oracle.Q


def finite(taken: Capture) -> bool:
    """Whether nothing in a capture is NaN."""
    arrays = (taken.cells_e, taken.cells_error_e, taken.snr, taken.signal_w, taken.truth.albedo)
    numbers = (taken.background_w, taken.noise.total_noise_e)
    return all(np.isfinite(a).all() for a in arrays) and bool(np.isfinite(numbers).all())


def plane(
    shape: Triangles,
    distance_m: float,
    *,
    incline_deg: float = 90.0,
    reflectance: float = 0.5,
    origin: Sequence[float] = (0.0, 0.0, 0.0),
    turned: bool = False,
    scalar: str = "double",
    **changes: object,
) -> Found:
    """Electrons of a frame of one plane against the closed form."""
    system = camera(**changes)
    with scene(
        shape, reflectance=reflectance, origin=origin, turned=turned, scalar=scalar
    ) as world:
        taken = look(world, system)
    exact = expected_electrons(system, distance_m, reflectance, incline_deg)
    total = float(taken.cells_e.sum()) if finite(taken) else np.nan
    warnings = (*world.warnings, *taken.warnings)
    return Found(oracle.relative(total, exact), light_stated(taken, exact), warnings=warnings)


def _facing(distance_m: float, **options: object) -> Found:
    return plane(square((distance_m, 0, 0), distance_m / 2), distance_m, turned=True, **options)  # type: ignore[arg-type]


def _grazing(incidence_deg: float, distance_m: float = 0.1) -> Found:
    a = round(90 - incidence_deg, 9)
    along = distance_m / np.radians(a)
    field = {"optics__field_of_view_deg": a, "emitter__field_of_view_deg": a}
    shape = inclined(distance_m, a, 1.2 * along)
    return plane(shape, distance_m, incline_deg=a, turned=True, **field)


def _speck(size_m: float) -> Found:
    """One small square alone at 5 m; its solid angle is all that counts."""
    system = camera()
    with scene(square((5.0, 0.013, 0.029), size_m / 2), turned=True) as world:
        taken = look(world, system)
    wall = expected_electrons(system, 5.0, 0.5)
    light = oracle.plane_light(5.0, 90.0, system.optics.field_of_view_deg.value)
    # On the axis but for 0.4 deg: cos^7 of that is 0.9999.
    away = mp.mpf(25) + mp.mpf("0.013") ** 2 + mp.mpf("0.029") ** 2
    one = mp.mpf(size_m) ** 2 * 25 * mp.sqrt(25 / away) / (mp.pi * away**3)
    error = oracle.relative(float(taken.cells_e.sum()), wall * one / light)
    bound = 5 * float(np.sqrt((taken.cells_error_e**2).sum()) / (wall * one / light)) + LIGHT
    # Of the noise it is next to nothing, which is what a tolerance asks for.
    stated = bound if has_tolerance() else min(bound, 0.2)
    return Found(error, stated, warnings=taken.warnings)


def _sun(lux: float) -> Found:
    """Power of the sun on the detector: E rho / pi cos(30 deg) over the field's cos^4."""
    system = camera()
    with scene(square((5.0, 0, 0), 10.0), sun_lx=lux) as world:
        taken = look(world, system)
    f, o, d = system.filter, system.optics, system.detector
    one = oracle.sun_per_lux(f.center_wavelength_m.value, f.width_m.value)
    field = o.field_of_view_deg.value
    exact = (
        one * mp.mpf(lux) * mp.mpf("0.5") / mp.pi * mp.cos(mp.pi / 6)
        * oracle.field_cos4(field)
        * oracle.pupil_m2(d.width_m.value, o.f_number.value, field)
        * mp.mpf(f.transmission.value) * mp.mpf(o.transmission.value)
    )  # fmt: skip
    found = taken.background_w if finite(taken) else np.nan
    return Found(oracle.relative(found, exact), LIGHT, warnings=taken.warnings)


def _sun_in_sight(behind_wall: bool) -> Found:
    """Power of the sun's disc on the detector, 5 deg off the axis: E cos(5 deg); or none of it."""
    system = camera()
    shapes = [square((5.0, 0, 0), 10.0)] if behind_wall else []
    with scene(*shapes) as world:
        world = replace(world, sun=Sun(3.0, 4.0, 1e3))
        taken = look(world, system)
    f, o, d = system.filter, system.optics, system.detector
    exact = (
        oracle.sun_per_lux(f.center_wavelength_m.value, f.width_m.value)
        * 1000 * mp.cos(mp.radians(3)) * mp.cos(mp.radians(4))
        * oracle.pupil_m2(d.width_m.value, o.f_number.value, o.field_of_view_deg.value)
        * mp.mpf(f.transmission.value) * mp.mpf(o.transmission.value)
    )  # fmt: skip
    found = taken.background_w if finite(taken) else np.nan
    exact = mp.mpf(0) if behind_wall else exact
    return Found(oracle.relative(float(found), exact), LIGHT, warnings=taken.warnings)


def _faces(how: str) -> Found:
    """A wall whose triangles are there twice, are flipped, or lie in two objects."""
    corners, faces = square((5.0, 0, 0), 10.0)
    made: list[Triangles] = {
        "twice": [(corners, np.vstack([faces, faces]))],
        "flipped": [(corners, faces[:, ::-1])],
        "both": [(corners, np.vstack([faces, faces[:, ::-1]]))],
        "coplanar": [(corners, faces), (corners, faces)],
    }[how]
    with scene(*made, turned=True) as world:
        taken = look(world, camera())
    exact = expected_electrons(camera(), 5.0, 0.5)
    error = oracle.relative(float(taken.cells_e.sum()), exact)
    inside = [w for w in world.warnings if "inside" in w]
    return Found(np.inf if inside else error, light_stated(taken, exact), warnings=taken.warnings)


def _empty() -> Found:
    with scene() as world:
        taken = look(world, camera())
    found = taken.cells_e.sum() + taken.background_w if finite(taken) else np.nan
    return Found(oracle.relative(float(found), mp.mpf(0)), 0.0, warnings=taken.warnings)


def _room(reflectance: float, max_depth: int) -> Found:
    """Inside a sphere, rig in its middle: bounce k adds rho^k of the same light each.

    Direct light is rho / pi / R^2 over the field; a diffuse bounce lands anywhere on the sphere
    alike, so of each further one the pupil sees its field's share, the integral of cos over 4 pi.
    """
    import trimesh

    ball = trimesh.creation.icosphere(5, radius=3.0)
    system = camera()
    field = system.optics.field_of_view_deg.value
    fidelity = Fidelity(samples=64, max_depth=max_depth, indirect_samples=256)
    with scene((np.array(ball.vertices), np.array(ball.faces)), reflectance=reflectance) as world:
        taken = look(world, system, fidelity)
    t = np.tan(np.radians(field / 2))
    with mp.workdps(18):
        solid, direct = (
            mp.quad(lambda x, y, p=p: (1 + x * x + y * y) ** -p, [-t, t], [-t, t])
            for p in (mp.mpf("1.5"), 2)
        )
    rho = mp.mpf(reflectance)
    # Where nothing absorbs there is no end: the bounces asked for are what is compared.
    endless = rho == 1 and has_tolerance()
    bounces = rho**2 / (1 - rho) if rho < 1 else mp.mpf(1e30 if endless else max_depth - 1)
    light = direct * rho + solid * bounces * oracle.field_cos4(field) / (4 * mp.pi)
    per_light = expected_electrons(system, 1.0, 1.0) / oracle.plane_light(1.0, 90.0, field)
    exact = per_light * light / (mp.pi * 9)
    error = oracle.relative(float(taken.cells_e.sum()), exact)
    noise = 5 * float(np.sqrt((taken.cells_error_e**2).sum()) / exact)
    return Found(error, LIGHT + noise, warnings=taken.warnings)


def _distances() -> list[Case]:
    made = [
        Case("distance", text, _WALL, lambda z=z: _facing(z), slow=slow)
        for text, z, slow in (
            ("10 cm", 0.1, True), ("10 m", 10.0, False), ("10 km", 1e4, False),
            ("40 km", 4e4, True),
        )
    ]  # fmt: skip
    near = [
        Case("distance", text, _PUPIL, lambda z=z: _facing(z), "warning", "pupil", slow=slow)
        for text, z, slow in (
            ("1 um", 1e-6, True), ("1 mm", 1e-3, False), ("1 cm", 1e-2, True),
        )
    ]  # fmt: skip
    return [
        *near,
        *made,
        Case("distance", "110 km", _WALL, lambda: _facing(1.1e5), "error", "m from the rig"),
    ]


def _surfaces() -> list[Case]:
    made = [
        Case("reflectance", "0", _WALL, lambda: _facing(5.0, reflectance=0.0), says="no light"),
        Case("reflectance", "1e-6", _WALL, lambda: _facing(5.0, reflectance=1e-6)),
        Case("reflectance", "1", _WALL, lambda: _facing(5.0, reflectance=1.0)),
        Case("reflectance", "1e-30", _WALL, lambda: _facing(5.0, reflectance=1e-30), slow=True),
    ]
    made += [
        Case("reflectance", str(r), "-", lambda r=r: _facing(5.0, reflectance=r), "error", "reflec")
        for r in (-1e-6, 1.000001)
    ]
    return made


def _far_from_the_origin() -> list[Case]:
    def at(x: float, scalar: str = "double") -> Found:
        origin = (x + 0.3, -x + 0.7, 300.1)
        shape = square((5.0371, 0, 0), 10.0)
        return plane(shape, 5.0371, origin=origin, turned=True, scalar=scalar)

    return [
        Case("origin", "1e6 m away", _WALL, lambda: at(1e6)),
        Case("origin", "9e8 m away", _WALL, lambda: at(9e8), slow=True),
        Case("origin", "1e12 m away", _WALL, lambda: at(1e12), "error", "position_m"),
        Case("origin", "1e6 m away, float32 mesh file", _WALL, lambda: at(1e6, "float"), "warning",
             "float32 coordinates"),
    ]  # fmt: skip


def _triangles() -> list[Case]:
    def fine() -> Found:
        return plane(mosaic(square((2e-5, 0, 0), 1e-5), 20), 2e-5, turned=True)

    def large(half: float) -> Found:
        return plane(square((5.0, 0, 0), half), 5.0, turned=True)

    def many() -> Found:
        return plane(mosaic(square((5.0, 0, 0), 10.0), 2237), 5.0, turned=True)

    ways = (
        ("twice", "twice"),
        ("other side out", "flipped"),
        ("both sides out", "both"),
        ("in two objects", "coplanar"),
    )
    return [
        Case("triangles", "10 008 338", _WALL, many, slow=True),
        *[Case("faces", f"a wall's, {text}", _WALL, lambda how=how: _faces(how))
          for text, how in ways],
        Case("triangles", "1 um, 800 of them at 20 um", _PUPIL, fine, "warning", "pupil"),
        Case("triangles", "10 km at 5 m", _WALL, lambda: large(5e3)),
        Case("triangles", "140 km at 5 m", _WALL, lambda: large(7e4), slow=True),
        Case("triangles", "400 km at 5 m", "-", lambda: large(2e5), "error", "m from the rig"),
        Case("triangles", "10 cm alone at 5 m", "mpmath: its solid angle", lambda: _speck(0.1)),
        Case("triangles", "1 um alone at 5 m", "mpmath: its solid angle", lambda: _speck(1e-6),
             "warning", "spacing of rays"),
    ]  # fmt: skip


def _angles() -> list[Case]:
    # All of them where two triangles join, through which rays would slip.
    made = [
        Case("grazing", f"{g} deg", _WALL, lambda g=g: _grazing(g), slow=slow)
        for g, slow in ((80.0, True), (89.9, True), (89.99, False))
    ]
    return [
        *made,
        Case("grazing", "89.998 deg", _WALL, lambda: _grazing(89.998), "warning", "grazing"),
        Case(
            "grazing",
            "89.998 deg, 290 km away",
            "-",
            lambda: _grazing(89.998, 10.0),
            "error",
            "m from the rig",
        ),
    ]


def _fields() -> list[Case]:
    def seen(field_deg: float) -> Found:
        shape = square((5.0, 0, 0), 100.0)
        field = {"optics__field_of_view_deg": field_deg, "emitter__field_of_view_deg": field_deg}
        return plane(shape, 5.0, turned=True, **field)

    return [
        Case("field", "0.002 deg", _WALL, lambda: seen(2e-3)),
        Case("field", "169 deg", _WALL, lambda: seen(169.0), slow=True),
        Case("field", "0.001 deg", "-", lambda: seen(1e-3), "error", "field_of_view_deg"),
        Case("field", "170 deg", "-", lambda: seen(170.0), "error", "field_of_view_deg"),
    ]


def _devices() -> list[Case]:
    def wide(width: float) -> Found:
        return _facing(5.0, detector__width_m=width)

    return [
        Case("detector", "1 um", _WALL, lambda: wide(1e-6), says="diffraction"),
        Case("detector", "150 um", _WALL, lambda: wide(150e-6), slow=True),
        Case("detector", "1 m", _PUPIL, lambda: wide(1.0), "warning", "pupil"),
        Case("detector", "0", "-", lambda: wide(0.0), "error", "width_m"),
    ]


def _light() -> list[Case]:
    sun = "mpmath: E rho / pi over the field"
    made = [
        Case("sun", f"{lux:g} lx", sun, lambda lux=lux: _sun(lux), slow=lux == 1.0)
        for lux in (0.0, 1.0, 130e3)
    ]
    return [
        *made,
        Case("sun", "in the field of view", "mpmath: E cos of the angle",
             lambda: _sun_in_sight(behind_wall=False), says="saturate the ADC"),
        Case("sun", "in the field of view, behind a wall", "zero",
             lambda: _sun_in_sight(behind_wall=True)),
        Case("sun", "5e6 lx", sun, lambda: _sun(5e6), says="saturate the ADC", slow=True),
        Case("sun", "1e300 lx", "-", lambda: _sun(1e300), "error", "illuminance_lx"),
        Case("scene", "empty", "zero", _empty, says="nothing in the field"),
        Case("scene", "closed room, reflectance 0.5", "mpmath: sum of all bounces",
             lambda: _room(0.5, 12)),
        Case("scene", "closed room, reflectance 0.9, 4 bounces", "mpmath: sum of all bounces",
             lambda: _room(0.9, 4), "warning", "max_depth"),
        Case("scene", "closed room, reflectance 0.999, 4 bounces", "mpmath: sum of all bounces",
             lambda: _room(0.999, 4), "warning", "max_depth", slow=True),
        Case("scene", "closed room, reflectance 1, 4 bounces", "mpmath: sum of 4 bounces",
             lambda: _room(1.0, 4), says="nothing here absorbs"),
    ]  # fmt: skip


def cases() -> list[Case]:
    """All of this room."""
    return [
        *_distances(),
        *_surfaces(),
        *_light(),
        *_far_from_the_origin(),
        *_triangles(),
        *_angles(),
        *_fields(),
        *_devices(),
    ]

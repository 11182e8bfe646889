"""Physical optics in the scene: near field, shadows, ground, motion; against closed forms, float64
integrals and Sionna RT.
"""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from scipy import constants

from benchmarks.cross_section_references import image_integral
from tests.physics.radar_worlds import (
    CARRIER_HZ,
    GAIN,
    OPTICS,
    RADAR,
    WAVELENGTH_M,
    ball,
    ground,
    plate,
    quad,
    reshaped,
    thing,
    trihedral,
    wave,
    world,
)
from twin.files import InputError
from twin.radar.propagation.scene.materials import radio_properties
from twin.radar.propagation.scene.scattering_models import ScatteringModel, assign_scattering_models
from twin.radar.propagation.sionna.paths import sionna_paths
from twin.radar.propagation.solvers import trace
from twin.radar.scattering import Radar
from twin.scene import Pose, Rig, Scene, Target

C = constants.c
K = 2 * np.pi / WAVELENGTH_M


def echo(scene: Scene, **knobs) -> complex:
    return wave(trace(scene, RADAR, fidelity=OPTICS.with_(**knobs)).echoes)


def point(position, velocity=(0.0, 0.0, 0.0), name: str = "t") -> Target:
    return Target(name, tuple(position), tuple(velocity), 10.0, "declared here")


# Objects by themselves.


def test_echoes_hold_over_the_whole_band() -> None:
    """Delays of their parts: a plate seen obliquely, at the band's edges, against integrals there.

    One phase for all of it would be off by 2 pi f dtau: 5 rad over 0.2 m sin(3 deg) x 2 x 4 GHz.
    """
    turn = np.radians(3.0)
    flat = plate("p", (0, 0, 0), 0.4).vertices_m
    turned = flat @ np.array(
        [[np.cos(turn), np.sin(turn), 0], [-np.sin(turn), np.cos(turn), 0], [0, 0, 1]]
    )
    echoes = trace(world(quad("p", turned + [8.0, 0, 0])), RADAR, fidelity=OPTICS).echoes
    for frequency in (77e9, 79e9, 81e9):
        s = image_integral([turned], Radar(np.array([-1.0, 0, 0]), 8.0), C / frequency, 0, 400)
        expected = GAIN * C / frequency / (4 * np.pi) * abs(s) / 64
        assert 20 * np.log10(abs(wave(echoes, frequency)) / expected) == pytest.approx(0, abs=0.5)


def test_first_hits_are_shared_out() -> None:
    """A plate half hidden by another, nearer one: the float64 sum of what is seen of each."""
    near = quad("near", [[4.0, 0.02, -0.3], [4.0, 0.4, -0.3], [4.0, 0.4, 0.3], [4.0, 0.02, 0.3]])
    far = plate("far", (8.0, 0, 0), 0.3)
    seen = [[8.0, -0.15, -0.15], [8.0, 0.04, -0.15], [8.0, 0.04, 0.15], [8.0, -0.15, 0.15]]
    expected = sum(_integral(np.array(corners)) for corners in (near.vertices_m, seen))
    for objects in ((near, far), (far, near)):
        found = echo(world(*objects), radar_bounces=1)
        assert abs(found - expected) < 0.03 * abs(expected)


def _integral(corners: np.ndarray, n: int = 1500) -> complex:
    """Echo of a conducting rectangle across x: -j / (4 pi) G(angle) dOmega, by midpoints."""
    (y0, z0), (y1, z1) = corners[:, 1:].min(axis=0), corners[:, 1:].max(axis=0)
    y = y0 + (np.arange(n) + 0.5) / n * (y1 - y0)
    z = z0 + (np.arange(n) + 0.5) / n * (z1 - z0)
    r = np.sqrt(corners[0, 0] ** 2 + y[:, None] ** 2 + z**2)
    cos = corners[0, 0] / r
    gain = RADAR.antenna.gain(np.stack([cos, np.sqrt(1 - cos**2), 0 * cos], axis=-1))
    gain = gain * GAIN / 100
    cell = (y1 - y0) * (z1 - z0) / n**2
    return complex(np.sum(-1j / (4 * np.pi) * gain * cos / r**2 * np.exp(-2j * K * r)) * cell)


def test_closed_boxes_echo_nothing_from_outside() -> None:
    """A radar in a closed conducting box hears the box alone."""
    corners = np.array([[x, y, z] for x in (-2, 3) for y in (-2, 2) for z in (-1, 2)], float)
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    box = [quad(f"side-{i}", corners[list(side)]) for i, side in enumerate(sides)]
    scene = world(*box, ball("outside", (10, 0, 0)))
    heard = {h.name for h in trace(scene, RADAR, fidelity=OPTICS).heard}
    assert "outside" not in heard


# Roles.


def test_who_scatters_is_a_rule_that_a_scene_can_override() -> None:
    small, wall = plate("small", (20.0, 0, 0), 0.3), plate("wall", (20.0, 0, 0), 40.0)
    tiny = plate("tiny", (20.0, 0, 0), 0.002)
    sphere = ball("ball", (20.0, 0, 0), 5.0)
    scene = world(small, wall, tiny, sphere)
    roles = {
        a.name: a.role for a in assign_scattering_models(scene, WAVELENGTH_M, with_optics=True)
    }
    assert roles == {
        "small": ScatteringModel.OPTICS,
        "wall": ScatteringModel.SURFACE,
        "tiny": ScatteringModel.OBSTACLE,
        "ball": ScatteringModel.OPTICS,
    }
    (one,) = assign_scattering_models(
        world(replace(small, radar="obstacle")), WAVELENGTH_M, with_optics=True
    )
    assert (one.role, one.declared) == (ScatteringModel.OBSTACLE, True)
    # The cheap rung knows no physical optics.
    (one,) = assign_scattering_models(world(replace(small, radar="optics")), WAVELENGTH_M)
    assert one.role is ScatteringModel.OBSTACLE


def test_a_smoothly_bent_surface_is_no_mirror() -> None:
    """A barrel of radius 100 m in strips 2 m wide: each is large, but the next one is 1 deg off."""
    angle = np.arange(-10, 11) * 0.02
    rim = np.stack([150 - 100 * np.cos(angle), 100 * np.sin(angle)], axis=1)
    low, high = (np.column_stack([rim, np.full(21, z)]) for z in (-20.0, 20.0))
    n = np.arange(20)
    faces = np.vstack([np.column_stack([n, n + 1, n + 22]), np.column_stack([n, n + 22, n + 21])])

    (role,) = assign_scattering_models(
        world(thing("b", np.vstack([low, high]), faces)), WAVELENGTH_M, with_optics=True
    )
    assert role.role is ScatteringModel.OPTICS


def test_a_declared_role_needs_a_target(tmp_path) -> None:
    from twin.scene.settings import load_settings

    path = tmp_path / "scene.toml"
    path.write_text(
        "[rig]\nposition_m = [0, 0, 0]\n[sun]\nazimuth_deg = 0\nelevation_deg = 0\n"
        "illuminance_lx = 0\n[objects.car]\nradar = 'declared'\n"
    )
    with pytest.raises(InputError, match=r"objects\.car\.radar = 'declared'"):
        load_settings(path, {"car"})


# Over the ground.


def test_images_agree_with_sionnas() -> None:
    """Mirrors and a point over two walls and the ground: delay, phase and level, path by path."""
    ahead = plate("ahead", (20.123456789, 0, 0), 40.0, "concrete")
    side = quad("side", [[0, 7, -20], [60, 7, -20], [60, 7, 20], [0, 7, 20]], "concrete")
    scene = world(
        ahead, ground(-1.0, "concrete"), side, targets=(point((12, 4, 0.3), (1.0, 2.0, 3.0)),)
    )
    sionna = {p.via: p for p in sionna_paths(scene, RADAR).paths}
    ours = {p.via: p for p in trace(scene, RADAR, fidelity=OPTICS).paths}
    legs = {(), ("ahead",), ("ground",), ("side",)}
    expected = {("ahead",)} | {(*a, "t", *b) for a in legs for b in legs}
    expected &= set(sionna)
    assert len(expected) >= 14
    for via in expected:
        one, other = ours[via], sionna[via]
        assert one.delay_s == pytest.approx(other.delay_s, abs=1e-17), via
        assert one.delay_rate == pytest.approx(other.delay_rate, rel=1e-5), via
        assert abs(np.angle(one.amplitude / other.amplitude)) < 1e-3, via
        # Sionna's isotropic antenna has another cross polarisation off its axis.
        assert 20 * np.log10(abs(one.amplitude / other.amplitude)) == pytest.approx(0, abs=0.2), via


def fresnel(material: str, cosine: float) -> complex:
    """TM, half space."""
    permittivity, conductivity, _ = radio_properties(
        material, world().materials[material], CARRIER_HZ
    )
    if conductivity > 1e5:
        return 1.0
    epsilon = permittivity - 1j * conductivity / (2 * np.pi * CARRIER_HZ * constants.epsilon_0)
    root = np.sqrt(epsilon - (1 - cosine**2))
    return (epsilon * cosine - root) / (epsilon * cosine + root)


def ball_over_ground(center: np.ndarray, radius: float, z: float, material: str) -> complex:
    """Four ways by geometrical optics of a convex mirror under a spherical wave, in closed form."""
    stations = (np.zeros(3), np.array([0, 0, 2 * z]))
    distance = [float(np.linalg.norm(center - s)) for s in stations]
    direction = [(center - s) / r for s, r in zip(stations, distance, strict=True)]
    gain = [float(RADAR.antenna.gain(d)) for d in direction]
    weight = [1.0, fresnel(material, direction[1][2])]
    total = 0j
    for i in range(2):
        for j in range(2):
            half = np.arccos(np.clip(direction[i] @ direction[j], -1, 1)) / 2
            there, back = (distance[n] - radius * np.cos(half) for n in (i, j))
            across = 1 / (1 / there + 2 * np.cos(half) / radius)
            within = 1 / (1 / there + 2 / (radius * np.cos(half)))
            spread = np.sqrt(across * within / ((across + back) * (within + back))) / there
            field = -WAVELENGTH_M / (4 * np.pi) * spread * np.sqrt(gain[i] * gain[j]) * GAIN / 100
            total += field * weight[i] * weight[j] * np.exp(-1j * K * (there + back))
    return total


@pytest.mark.thorough
@pytest.mark.parametrize("material", ["metal", "asphalt"])
def test_two_ray_ground(material: str) -> None:
    """A ball at 15 m over ground 1 m below the radar, 0.2 to 1.6 m high: within 0.5 dB of theory
    outside nulls (more than 10 dB below free space). Without the ground it is off by up to 12 dB.
    """
    worst, checked, swing = 0.0, 0, 0.0
    for height in np.linspace(0.2, 1.6, 6):
        center = np.array([15.0, 0.2, height - 1.0])
        scene = world(ball("b", center), ground(-1.0, material))
        expected = ball_over_ground(center, 0.15, -1.0, material)
        alone = GAIN * WAVELENGTH_M * 0.15 / (8 * np.pi) / (center @ center)
        level = 20 * np.log10(abs(expected) / alone)
        swing = max(swing, abs(level))
        if level > -10:
            worst = max(worst, abs(20 * np.log10(abs(echo(scene) / expected))))
            checked += 1
    assert checked >= 4
    assert swing > 2.5
    assert worst < 0.5


def test_rates_are_the_delays_derivatives() -> None:
    """A ball that moves over ground that sinks, direct and by the image, by finite differences."""
    step, velocity, sinking = 1e-5, np.array([-3.0, 1.0, 2.0]), np.array([0.0, 0.0, -0.5])

    def at(time: float):
        centre = np.array([12.0, 0.5, 0.2]) + velocity * time
        return trace(
            world(
                ball("b", centre, level=3, velocity_m_per_s=tuple(velocity)),
                ground(-1.0 - 0.5 * time, velocity_m_per_s=tuple(sinking)),
            ),
            RADAR,
            fidelity=OPTICS,
        ).echoes

    before, here, after = at(-step), at(0.0), at(step)
    # What is divided may change with time; the phase of the sum does what the mean rate says.
    turn = np.angle(wave(after) / wave(before)) / (2 * step)
    strength = here.amplitude * np.exp(-2j * np.pi * (CARRIER_HZ * here.delay_s % 1.0))
    mean = np.sum(strength * here.delay_rate) / np.sum(strength)
    assert turn == pytest.approx(-2 * np.pi * CARRIER_HZ * mean.real, rel=0.02)


# Invariance.


@pytest.mark.thorough
def test_a_scene_may_stand_a_thousand_kilometres_away() -> None:
    here = world(ball("b", (10, 0.3, 0)), ground(-1.0))
    there = np.array([1e6, -1e6, 500.0])
    moved = world(
        *(o.moved(there) for o in here.objects),
        rig=Rig(Pose(tuple(there)), radar=Pose((0.0, 0.0, 0.0))),
    )
    one, other = echo(here), echo(moved)
    assert abs(one - other) < 0.01 * abs(one)


@pytest.mark.thorough
def test_neither_order_nor_refinement_nor_winding_matters() -> None:
    things = (ball("b", (10, 0.3, 0)), plate("p", (11, -0.6, 0.2)), ground(-1.0))
    expected = echo(world(*things))
    assert echo(world(*things[::-1])) == pytest.approx(expected, rel=1e-9)
    inverted = tuple(reshaped(o, faces=o.geometry.faces[:, ::-1]) for o in things)
    assert abs(echo(world(*inverted)) - expected) < 0.01 * abs(expected)
    import trimesh

    vertices, faces = trimesh.remesh.subdivide(things[1].vertices_m, things[1].geometry.faces)
    finer = reshaped(things[1], vertices, faces)
    found = echo(world(things[0], finer, things[2]))
    assert abs(found - expected) < 0.02 * abs(expected)


@pytest.mark.thorough
def test_a_closer_tolerance_changes_little() -> None:
    """Two echoes differ by no more than both tolerances together."""
    things = (ball("b", (10, 0.3, 0)), ground(-1.0))
    coarse, fine = (echo(world(*things), radar_tolerance=t) for t in (0.1, 0.03))
    assert abs(coarse - fine) < 0.13 * abs(fine)


@pytest.mark.thorough
def test_the_same_again_has_the_same_bits() -> None:
    scene = world(ball("b", (10, 0.3, 0)), trihedral("t", (12, 1, 0)), ground(-1.0))
    one, other = (trace(scene, RADAR, fidelity=OPTICS).echoes for _ in range(2))
    assert np.array_equal(one.amplitude, other.amplitude)
    assert np.array_equal(one.delay_s, other.delay_s)


@pytest.mark.thorough
def test_materials_of_the_itu_are_read_without_the_engine() -> None:
    """P.2040's rows at their limits and between, bit for bit as Sionna has them, while Sionna RT
    itself is not imported for them.
    """
    code = (
        "import sys\n"
        "from twin.radar.propagation.scene.materials import _itu, _p2040\n"
        "hz = {n: [1e9 * f for low, high in r for f in (low, (low + high) / 2, high)]"
        " for n, r in _p2040().items()}\n"
        "rows = {(n, f): _itu(n, f) for n in hz for f in hz[n]}\n"
        "assert 'sionna' not in sys.modules and 'sionna.rt' not in sys.modules\n"
        "from twin.engine import sionna\n"
        "sionna()\n"
        "from sionna.rt.radio_materials.itu import itu_material\n"
        "assert len(rows) > 40\n"
        "wrong = {k: v for k, v in rows.items() if v and v != itu_material(*k)}\n"
        "assert not wrong, wrong\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)

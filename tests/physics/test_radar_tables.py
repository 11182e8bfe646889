"""Tables of physical optics against closed forms, Mie's series, Sionna's legs and the rung optics.

Tolerances are those of physical optics' own rays (see `test_rcs.py`) plus the interpolation's bound
of 0.6 / n^2.
"""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from benchmarks.cross_section_references import mie_coefficients
from tests.physics.radar_worlds import (
    AT_ORIGIN,
    CARRIER_HZ,
    OPTICS,
    RADAR,
    WAVELENGTH_M,
    ball,
    ground,
    plate,
    quad,
    thing,
    trihedral,
    wave,
    world,
)
from twin.fidelity import Fidelity
from twin.files import InputError
from twin.geometry import Geometry
from twin.radar import load_radar
from twin.radar.cross_section import Quality, physical_optics
from twin.radar.cross_section import table as tables
from twin.radar.cross_section.bistatic import scattering_dyadics
from twin.radar.cross_section.table import QUALITY, Table, table_of
from twin.radar.propagation.scene.atmosphere import Atmosphere
from twin.radar.propagation.scene.scattering_models import ScatteringModel, assign_scattering_models
from twin.radar.propagation.solvers import trace
from twin.radar.propagation.tabulated import specular_path
from twin.radar.scattering import PEC, LayeredSurface, MeshTarget, Radar
from twin.radar.truth import true_targets
from twin.scene import Pose, Rig, SceneObject, Target

PATHS = Fidelity(radar="paths")
FINE = OPTICS.with_(radar_tolerance=0.03)
K = 2 * np.pi / WAVELENGTH_M
HALF_M = 0.02  # of a plate
LIFTED = Rig(Pose((0.0, 0.0, 1.0)), radar=Pose((0.0, 0.0, 0.0)))


def towards(*azimuth_elevation_deg: tuple[float, float]) -> np.ndarray:
    return np.array([Radar.at(az, el).direction for az, el in azimuth_elevation_deg])


def around(direction, width_rad: float, n: int, seed: int) -> np.ndarray:
    found = np.array(direction) + width_rad * np.random.default_rng(seed).normal(size=(n, 3))
    return found / np.linalg.norm(found, axis=1, keepdims=True)


def body(item: SceneObject, surface: LayeredSurface = PEC) -> MeshTarget:
    return MeshTarget(Geometry(item.vertices_m, item.geometry.faces), (surface,))


def tabled(item: SceneObject) -> SceneObject:
    return replace(item, radar="table")


def plate_dyadics(source: np.ndarray, receiver: np.ndarray) -> np.ndarray:
    """Physical optics of a conducting plate of 2 x 2 HALF_M across x, in closed form."""
    q = K * (source + receiver)
    area = (2 * HALF_M) ** 2 * np.prod(np.sinc(q[:, 1:] * HALF_M / np.pi), axis=1)
    facing = np.array([1.0, 0, 0]) * np.sign(source[:, :1])
    # J of unit fields along x, y, z.
    current = np.cross(facing[:, None], np.cross(-source[:, None], np.eye(3)))
    return -1j * K / (2 * np.pi) * area[:, None, None] * current.swapaxes(1, 2)


def contracted(dyadics, receiver, source) -> np.ndarray:
    """V and H received of V and H sent, (n, 2, 2)."""
    heard = np.array([Radar(u).polarizations for u in receiver])
    sent = np.array([Radar(u).polarizations for u in source])
    return np.einsum("npx,nxy,nqy->npq", heard, dyadics, sent)


# Physical optics from one direction into another.


def test_a_plate_between_any_directions_is_the_closed_form() -> None:
    """Co- and cross-polar, mirrored and off by some lobes, front and back: to 0.3 % of the peak."""
    source = towards((0, 0), (2, 1), (20, 3), (40, -30), (175, 4))
    receiver = towards((1, 0), (-2, 0.5), (-19, -2), (-39, 31), (184, -5))
    found = scattering_dyadics(
        body(plate("p", (0, 0, 0), 2 * HALF_M)),
        source,
        receiver,
        np.array([CARRIER_HZ]),
        Quality(),
    )
    peak = (2 * HALF_M) ** 2 / WAVELENGTH_M
    off = contracted(found[:, 0] - plate_dyadics(source, receiver), receiver, source)
    np.testing.assert_allclose(np.abs(off) / peak, 0, atol=3e-3)


def test_what_stands_before_the_receiver_hides() -> None:
    """A plate that mirrors the wave 60 deg aside, and across that way one edge on to the source."""
    source, receiver = towards((0, 0), (60, 0))[:, None]
    cos, sin = np.cos(np.radians(30)), np.sin(np.radians(30))
    h = np.array([[0, -1, -1], [0, 1, -1], [0, 1, 1], [0, -1, 1]]) * HALF_M
    mirror = h @ np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]])
    screen = 2 * h[:, [1, 0, 2]] + 0.1 * receiver[0]
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    carrier = np.array([CARRIER_HZ])
    free, hidden = (
        abs(scattering_dyadics(target, source, receiver, carrier, QUALITY)[0, 0, 2, 2])
        for target in (
            MeshTarget(Geometry(mirror, faces)),
            MeshTarget(Geometry(np.vstack([mirror, screen]), np.vstack([faces, faces + 4]))),
        )
    )
    area = (2 * HALF_M) ** 2 * cos
    assert free == pytest.approx(area / WAVELENGTH_M, rel=0.01)
    assert hidden < 0.01 * free


@pytest.mark.parametrize("apart_deg", [0.0, 20.0, 60.0])
def test_a_sphere_between_two_directions_is_mies(apart_deg: float) -> None:
    """Bohren and Huffman eq. 4.74: S_1 across and S_2 in the plane of scattering, k r = 99.

    Within 0.4 dB, most of which is what the border of what both see scatters in physical optics.
    """
    radius = 0.06
    mesh = trimesh.creation.icosphere(6, radius=radius)
    source, receiver = towards((0, 0), (apart_deg, 0))[:, None]
    target = MeshTarget(Geometry(mesh.vertices, mesh.faces))
    (found,) = contracted(
        scattering_dyadics(target, source, receiver, np.array([CARRIER_HZ]), QUALITY)[:, 0],
        receiver,
        source,
    )
    n, a, b = mie_coefficients(K * radius)
    cosine = -np.cos(np.radians(apart_deg))  # forward is 180 deg from the source
    pi, tau, before = np.zeros(len(n)), np.zeros(len(n)), 0.0
    for i, order in enumerate(n):
        pi[i] = 1.0 if i == 0 else (2 * order - 1) / (order - 1) * cosine * pi[i - 1]
        if i > 0:
            pi[i] -= order / (order - 1) * before
            before = pi[i - 1]
        tau[i] = order * cosine * pi[i] - (order + 1) * before
    weight = (2 * n + 1) / (n * (n + 1))
    expected = [abs(np.sum(weight * (a * x + b * y))) / K for x, y in ((pi, tau), (tau, pi))]
    decibel = 20 * np.log10(np.abs(np.diag(found)) / expected)
    np.testing.assert_allclose(decibel, 0, atol=0.4)


@pytest.mark.parametrize("sent", ["V", "H"])
def test_back_to_the_source_it_is_twin_rcs(sent) -> None:
    """A trihedral and a dihedral turned by 22.5 deg, whose echo is half crossed: 0.1 dB."""
    corner = trihedral("t", (0, 0, 0), 0.3)
    turn = np.radians(22.5)
    rotation = np.array(
        [[1, 0, 0], [0, np.cos(turn), -np.sin(turn)], [0, np.sin(turn), np.cos(turn)]]
    )
    a = 0.04
    tips = np.array([[0, 0, -a], [0, 0, a], [-a, a, a], [-a, a, -a], [-a, -a, a], [-a, -a, -a]])
    faces = [[0, 1, 2], [0, 2, 3], [0, 1, 4], [0, 4, 5]]
    both = ((corner, (172.0, 5.0)), (thing("d", tips @ rotation.T, faces), (180.0, 0.0)))
    for item, aspect in both:
        radar, target = Radar.at(*aspect), body(item)
        direction = radar.direction[None]
        found = scattering_dyadics(target, direction, direction, np.array([CARRIER_HZ]), QUALITY)
        port = 0 if sent == "V" else 1
        expected = physical_optics(target, radar, CARRIER_HZ, sent).amplitude
        crossed = contracted(found[:, 0], direction, direction)[0, :, port]
        np.testing.assert_allclose(crossed, expected, atol=0.012 * np.abs(expected).max())


# Tables.


@pytest.mark.parametrize(("nodes", "rms"), [(2, 0.03), (4, 0.008), (8, 0.003)])
def test_interpolation_errs_by_what_the_rule_says(nodes: int, rms: float) -> None:
    """80 ways around the mirror's: never more than the bound and the rays' 0.3 %, and an rms that
    falls with the square of the nodes.
    """
    source = around([-1, 0.02, 0.03], 0.02, 80, 1)
    receiver = around([-1, -0.02, -0.02], 0.02, 80, 2)
    coarse = Quality(tolerance=0.05)
    found = Table(body(plate("p", (0, 0, 0), 2 * HALF_M)), CARRIER_HZ, nodes, coarse)
    off = found.dyadics(source, receiver)[:, 0] - plate_dyadics(source, receiver)
    error = np.abs(contracted(off, receiver, source)[:, 0, 0])
    error *= WAVELENGTH_M / (2 * HALF_M) ** 2
    assert error.max() < (np.pi / (2 * nodes)) ** 2 / 4 + 3e-3
    assert np.sqrt(np.mean(error**2)) < rms


def test_a_sphere_answers_alike_all_over_and_from_its_front() -> None:
    """Half the radius, 2 r / c before its middle: at poles, edges and corners of the cube too.

    Within 0.5 dB, which is what so few facets leave.
    """
    radius = 0.02
    mesh = trimesh.creation.icosphere(4, radius=radius)
    found = Table(MeshTarget(Geometry(mesh.vertices + [3.0, 1, 0], mesh.faces)), CARRIER_HZ, 4)
    corners = np.array([[0, 0, 1.0], [0, 0, -1], [1, 1, 0], [1, 1, 1], [-1, 1, -1], [0, -1, 1]])
    direction = np.vstack(
        [corners / np.linalg.norm(corners, axis=1)[:, None], around([1, 0, 0], 1, 4, 3)]
    )
    field = np.array([Radar(u).polarizations[0] for u in direction]).astype(complex)
    s, delay = found.answers(direction, direction, field, field)
    np.testing.assert_allclose(20 * np.log10(2 * np.abs(s) / radius), 0, atol=0.5)
    np.testing.assert_allclose(delay * 299792458.0, -2 * radius, atol=2e-3)


def test_a_table_is_filled_once_in_memory_and_on_disk(tmp_path, monkeypatch) -> None:
    """The second look-up evaluates nothing, nor does a new process; a broken file is no table."""
    monkeypatch.setenv("TWIN_TABLES", str(tmp_path))
    item = plate("p", (0, 0, 0), 0.013)
    fresh = lambda: (tables._tables.clear(), table_of(body(item), CARRIER_HZ, 4))[1]  # noqa: E731
    ways = around([-1, 0, 0], 0.1, 5, 4), around([-1, 0, 0], 0.1, 5, 5)
    first = fresh().dyadics(*ways)
    assert table_of(body(replace(item)), CARRIER_HZ, 4).filled > 16
    assert table_of(body(plate("p", (9, 2, -7), 0.013)), CARRIER_HZ, 4).filled > 16
    assert table_of(body(plate("p", (0, 0, 0), 0.014)), CARRIER_HZ, 4).filled == 0
    assert table_of(body(item, LayeredSurface(backing=4)), CARRIER_HZ, 4).filled == 0
    (file,) = tmp_path.glob("*.npz")
    with monkeypatch.context() as closed:
        closed.setattr(tables, "scattering_dyadics", None)
        np.testing.assert_array_equal(fresh().dyadics(*ways), first)
    for broken in (b"", b"not a table", file.read_bytes()[:200]):
        file.write_bytes(broken)
        np.testing.assert_array_equal(fresh().dyadics(*ways), first)


@pytest.mark.thorough
def test_what_was_asked_before_does_not_matter() -> None:
    """Alone, in company or in another order a way has the same bits."""
    target = body(trihedral("t", (0, 0, 0), 0.1))
    source, receiver = around([-1, 0, 0], 0.3, 12, 6), around([-1, 0, 0], 0.3, 12, 7)
    together = Table(target, CARRIER_HZ, 4).dyadics(source, receiver)
    alone = Table(target, CARRIER_HZ, 4)
    for i in reversed(range(12)):
        found = alone.dyadics(source[i : i + 1], receiver[i : i + 1])
        np.testing.assert_array_equal(found[0], together[i])


# In the scene.


def test_who_answers_from_a_table_is_a_rule_that_a_scene_can_override() -> None:
    small = trihedral("small", (30, 0, 0))

    def role(item: SceneObject, with_optics=False, **more) -> tuple[ScatteringModel, bool]:
        scene = world(item, **more)
        found = assign_scattering_models(scene, WAVELENGTH_M, with_optics=with_optics)[0]
        return found.role, found.declared

    assert role(small) == (ScatteringModel.TABLE, False)
    assert role(small, with_optics=True) == (ScatteringModel.OPTICS, False)
    assert role(tabled(small), with_optics=True) == (ScatteringModel.OPTICS, False)
    near = trihedral("near", (8, 0, 0))  # its far field begins at 11.8 m
    assert role(near) == (ScatteringModel.OBSTACLE, False)
    assert role(tabled(near)) == (ScatteringModel.TABLE, True)
    assert role(plate("large", (5000, 0, 0), 0.2)) == (ScatteringModel.OBSTACLE, False)
    assert role(plate("tiny", (30, 0, 0), 0.005)) == (ScatteringModel.OBSTACLE, False)
    declared = Target("small", (30.0, 0.0, 0.0), (0.0, 0.0, 0.0), 1.0, "here", "small")
    assert role(small, targets=(declared,)) == (ScatteringModel.TARGET, False)
    assert role(tabled(small), targets=(declared,)) == (ScatteringModel.TABLE, True)
    part = replace(plate("part", (30, 0, 0), 0.03), name="part")
    roles = assign_scattering_models(world(small, part, targets=(declared,)), WAVELENGTH_M)
    assert [a.role for a in roles] == [ScatteringModel.TARGET, ScatteringModel.OBSTACLE]


def test_legs_are_sionnas() -> None:
    """Over concrete and over a metal wall, 1 m^2 in place of the table: its amplitudes to 1e-4, and
    over the wall, which conducts 1e7 S/m there and without end here, to 2e-3.

    Where both polarise alike: in the antenna's two planes, so over one surface per leg.
    """
    where = np.array([12.0, 0.0, 1.0])
    wall = quad("wall", [[-5, 6, -9], [40, 6, -9], [40, 6, 9], [-5, 6, 9]])
    scene = world(
        ground(0, "concrete"),
        wall,
        rig=LIFTED,
        targets=(Target("t", tuple(where), (0.0, 0.0, 0.0), 1.0, "here"),),
    )
    from twin.radar.propagation.scene.materials import surface_of

    planes = {
        "ground": (np.array([0, 0, -1.0]), np.array([0, 0, 1.0])),
        "wall": (np.array([0, 6.0, 0]), np.array([0, -1.0, 0])),
    }
    surfaces = {o.name: surface_of(o, scene, CARRIER_HZ)[0] for o in scene.objects}
    found = [p for p in trace(scene, RADAR, fidelity=PATHS).paths if p.target]
    assert len(found) == 9
    loss = 10 ** (-RADAR.front_end.losses_db.value / 20)
    for path in found:
        at = path.via.index("t")
        there, back = (
            specular_path(
                where - [0, 0, 1],
                [planes[name] for name in names],
                [surfaces[name] for name in names],
                np.eye(3),
                CARRIER_HZ,
            )
            for names in (path.via[:at], path.via[:at:-1])
        )
        gain = np.sqrt(np.prod(RADAR.antenna.gain(np.array([path.departure, path.arrival]))))
        spread = (4 * np.pi) ** 1.5 * there.length_m * back.length_m
        sent, heard = (Radar(way.back).polarizations[0] @ way.field for way in (there, back))
        expected = WAVELENGTH_M / spread * loss * gain * sent * heard
        bound = 2e-3 if "wall" in path.via else 1e-4
        assert path.amplitude / expected == pytest.approx(1, abs=bound)


@pytest.mark.quick(1)
@pytest.mark.parametrize(
    ("item", "rig", "material"),
    [
        (trihedral("t", (20, 0, 1.1)), LIFTED, "concrete"),
        (
            trihedral("t", (40, 3, 1.1)),
            Rig(Pose((0.0, 0.0, 1.0), 10, 5, 20), radar=Pose((0.0, 0.0, 0.0))),
            "metal",
        ),
        (plate("t", (25, 0.1, 0.9), 0.1), LIFTED, "concrete"),
    ],
)
def test_over_a_ground_it_is_the_rung_of_physical_optics(item, rig, material: str) -> None:
    """The sum of four ways beyond 2 D^2 / lambda, turned rig or not, within 0.36 dB and 0.1 rad, of
    which the rung's tolerance of 3 % is 0.26 dB and the tables' coarse rays are 0.1.
    """
    floor = ground(0, material)
    found = trace(world(tabled(item), floor, rig=rig), RADAR, fidelity=PATHS)
    expected = trace(world(item, floor, rig=rig), RADAR, fidelity=FINE)
    assert len(found.echoes.delay_s) == 4
    assert found.warnings == ()
    assert found.heard[0].name == "t"
    ratio = wave(found.echoes) / wave(expected.echoes)
    assert 20 * np.log10(abs(ratio)) == pytest.approx(0, abs=0.36)
    assert np.angle(ratio) == pytest.approx(0, abs=0.1)


def test_a_sphere_over_a_conducting_ground_is_the_closed_form() -> None:
    """Half the radius whatever the way: S (sum of G e^-jkr / r over both ways)^2, G the antenna's
    gain along each; 3 deg lie between them. Within 0.35 dB.
    """
    radius, range_m, height = 0.03, 20.0, 0.5
    scene = world(tabled(ball("b", (range_m, 0, height), radius, 5)), ground(0), rig=LIFTED)
    echoes = trace(scene, RADAR, fidelity=PATHS).echoes
    found = wave(echoes)
    ways = np.array([[range_m, 0, height - 1], [range_m, 0, -height - 1]])
    length = np.linalg.norm(ways, axis=1)
    gain = RADAR.antenna.gain(ways / length[:, None]) ** 0.5
    # A conductor turns the vertical field with the wave: TM, +1. From the front of the sphere.
    field = np.sum(gain * np.exp(-1j * K * (length - radius)) / length)
    loss = 10 ** (-RADAR.front_end.losses_db.value / 20)
    expected = loss * WAVELENGTH_M / (4 * np.pi) * radius / 2 * field**2
    assert 20 * np.log10(abs(found / expected)) == pytest.approx(0, abs=0.35)


def test_the_cylinders_of_figure_3_at_the_prototypes_band() -> None:
    """One of them, 0.67 of a wavelength across, from the end of the rail and 1 m farther back:
    physical optics in the scene says the same within 0.5 and 0.3 dB, which is its radius over the
    distance.
    """
    from twin.scene import load_scene

    scene, radar = load_scene("fig3b"), load_radar("prototype")
    one = next(o for o in scene.objects if o.name == "cylinder_left")
    for back_m, bound_db in ((0.0, 0.5), (1.0, 0.3)):
        x, y, z = scene.rig.pose.position_m
        here = replace(scene.at(Pose((x - back_m, y, z))), targets=())
        found = trace(replace(here, objects=(tabled(one),)), radar, fidelity=PATHS)
        optics = trace(replace(here, objects=(one,)), radar, fidelity=FINE)
        carrier = radar.ofdm.carrier_hz
        ratio = wave(found.echoes, carrier, carrier) / wave(optics.echoes, carrier, carrier)
        assert 20 * np.log10(abs(ratio)) == pytest.approx(0, abs=bound_db)


def test_the_echo_stands_where_the_corner_is() -> None:
    """A trihedral's at its apex, 55 mm behind the middle of its box, within 5 mm."""
    (delay,) = trace(world(trihedral("t", (30, 0, 0))), RADAR, fidelity=PATHS).echoes.delay_s
    assert delay * 299792458.0 / 2 == pytest.approx(30.0, abs=5e-3)


def test_a_table_stands_in_for_what_is_declared_of_its_object() -> None:
    corner = tabled(trihedral("t", (30, 0, 0)))
    declared = Target("corner", (30.0, 0.0, 0.0), (0.0, 0.0, 0.0), 1.0, "here", "t")
    scene = world(corner, targets=(declared,))
    found = trace(scene, RADAR, fidelity=PATHS)
    assert found.paths == ()
    assert [(h.name, h.contributions) for h in found.heard] == [("t", 1)]
    (truth,) = true_targets(scene, RADAR, found, Atmosphere(None))
    assert truth.visible


def test_out_of_reach_is_said() -> None:
    """In the near field a number with a warning, hidden no echo, too large an error."""
    near = trace(world(tabled(plate("p", (5, 0, 0), 0.2))), RADAR, fidelity=PATHS)
    assert "begins at 2 D^2 / lambda = 42.2 m: 5 m away" in near.warnings[0]
    assert np.isfinite(near.echoes.amplitude).all()
    assert "7.55 range cells" in " ".join(near.assumptions)
    screen = replace(plate("screen", (5, 0, 0), 1.0), radar="obstacle")
    hidden = trace(world(trihedral("t", (30, 0, 0)), screen), RADAR, fidelity=PATHS)
    assert len(hidden.echoes.delay_s) == 0
    assert hidden.heard == ()
    with pytest.raises(InputError, match=r"objects.huge: .* directions, expected at most 3e\+09"):
        trace(world(tabled(plate("huge", (50, 0, 0), 6.0))), RADAR, fidelity=PATHS)


def test_around_and_inside_numbers_stay_finite() -> None:
    """The radar behind a plate, edge on, in a box's middle, turned over: echoes or none, no NaN."""
    box = trimesh.creation.box((0.05, 0.05, 0.05))
    shapes = [
        plate("p", (-20, 0, 0), 0.05),
        thing("edge", [[20, 0, 0], [20.05, 0, 0], [20, 0, 0.05]], [[0, 1, 2]]),
        thing("box", box.vertices + [1e-6, 0, 0], box.faces),
    ]
    for rig in (AT_ORIGIN, Rig(Pose((0.0, 0.0, 0.0), 180, 0, 180), radar=Pose((0.0, 0.0, 0.0)))):
        echoes = trace(world(*map(tabled, shapes), rig=rig), RADAR, fidelity=PATHS).echoes
        for part in (echoes.amplitude, echoes.delay_s, echoes.departure, echoes.arrival):
            assert np.isfinite(part).all()

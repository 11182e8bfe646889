"""Behind an edge it is not silent: diffraction round obstacles on the way to a target.

Truth is what nobody here wrote: the knife edge by Fresnel's integrals (SciPy; ITU-R P.526-15,
section 4.1), Sommerfeld's half plane and the wedge's series in closed form, Kirchhoff's double
integrals by numbers, and Sionna RT's uniform theory of diffraction.
"""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
import trimesh
from scipy.constants import speed_of_light
from scipy.special import erf, erfc, fresnel, jv

from benchmarks.screens_in_depth import field_behind
from tests.physics.radar_worlds import (
    CARRIER_HZ,
    OPTICS,
    RADAR,
    WAVELENGTH_M,
    ball,
    cross_section_db,
    ground,
    paths_of,
    thing,
    wave,
    world,
)
from tests.physics.shadow_worlds import (
    BEND,
    DEEP,
    Array,
    K,
    box,
    decibels,
    echo,
    found,
    pattern,
    point,
    rectangle,
    screen,
)
from twin.fidelity import PRESETS, Fidelity
from twin.radar.propagation.diffraction.knife_edge import (
    double_knife_edge,
    knife_edge_factor,
    missing_edge_bound,
    missing_edge_factor,
)
from twin.radar.propagation.diffraction.rims import DiffractedPaths
from twin.radar.propagation.diffraction.segments import Segment
from twin.radar.propagation.solvers import trace
from twin.scene import Pose, Rig, SceneObject


@pytest.mark.parametrize("aside_m", [0.0, 1e-9, -1e-7, 1e-5])
@pytest.mark.parametrize("sides", list(product([(0, 50), (-50, 0)], repeat=2)))
def test_a_corner_exactly_in_the_way_leaves_three_quarters(
    sides: tuple[tuple[int, int], tuple[int, int]], aside_m: float
) -> None:
    """Of the wave on either way, by symmetry; at round coordinates it was a half of that echo."""
    y, z = ((low + aside_m, high + aside_m) for low, high in sides)
    assert abs(echo(rectangle("quadrant", y, z))) == pytest.approx(0.75**2, rel=0.02)


@pytest.mark.parametrize("height", [-0.2, -0.05, -0.02, 0.0, 0.03, 0.1])
def test_the_echo_of_a_point_beside_an_edge_is_a_knife_edges(height: float) -> None:
    """Two-way: -12.0 dB at the edge, -19.6 and -33.4 dB 3 and 10 cm behind, ripple before it. The
    antenna sees the edge up to 2 degrees off its boresight, which takes less than 0.1 dB.

    Without diffraction: silence behind the edge and exactly 0 dB before it.
    """
    sine, cosine = fresnel(height * np.sqrt(2 / WAVELENGTH_M * (1 / 6 + 1 / 4)))
    j = np.hypot(1 - cosine - sine, cosine - sine) / 2
    assert decibels(echo(screen(height))) == pytest.approx(40 * np.log10(j), abs=0.1)


def test_a_shadow_is_as_deep_as_asked_for_and_silent_at_0() -> None:
    """One way the screen takes 16.7 dB: told at 20 dB, not at 10; the default tells it."""
    assert cross_section_db(wave(found(screen(0.1))), 10) == pytest.approx(-33.4, abs=0.1)
    assert len(found(screen(0.1), fidelity=Fidelity()).amplitude) == 1
    assert PRESETS["reference"].radar_shadow_db > PRESETS["standard"].radar_shadow_db
    for depth, count in ((20, 1), (10, 0), (0, 0)):
        told = found(screen(0.1), fidelity=OPTICS.with_(radar_shadow_db=float(depth)))
        assert len(told.amplitude) == count
    with pytest.raises(ValueError, match="radar_shadow_db: -1"):
        Fidelity(radar_shadow_db=-1)


def test_what_comes_over_an_edge_is_late_by_its_detour() -> None:
    """0.5 m over the line of sight the way out and back is 10.4 cm longer: over 4 GHz its phase
    turns by 9 rad, and level and phase are the knife edge's at every frequency.
    """
    for height in (0.1, 0.5):
        detour = np.hypot(6, height) + np.hypot(4, height) - 10
        for frequency in CARRIER_HZ + 2e9 * np.array([-1, -0.5, 0, 0.5, 1]):
            q = 2 * np.pi * frequency / 299792458 * detour
            due = (erfc(np.sqrt(1j * q)) / 2) ** 2
            got = echo(screen(height), frequency_hz=frequency)
            # The level goes with 1 / f, which is left out: 2.5 % at the band's ends.
            assert abs(got / (due * pattern(height)) - 1) < 0.03


def test_a_target_that_comes_out_of_the_shadow_has_no_step() -> None:
    """Within 0.2 mm of the border, where rays can't tell, the edge decides."""
    heights = np.concatenate([np.linspace(-0.02, 0.02, 9), [-1e-4, -1e-5, 1e-7, 1e-5, 1e-4]])
    for height in heights:
        due = (erfc(np.sqrt(1j * BEND) * height) / 2) ** 2
        assert abs(echo(screen(height)) - due) < 2e-3


@pytest.mark.parametrize(
    ("y", "z"),
    [
        ((-0.1, 0.1), (-0.15, 0.15)),
        ((-0.05, 0.12), (-0.3, 0.02)),
        ((0.01, 0.2), (-0.2, 0.2)),
        ((-0.02, 0.02), (-5, 5)),
        ((0.001, 0.3), (0.001, 0.3)),
    ],
)
def test_behind_a_plate_all_edges_and_corners_add_up(y, z) -> None:
    """By Babinet 1 less the Fresnel integral over the plate, a product; within 1 % of the straight
    wave, mostly the antenna's pattern.
    """
    assert abs(echo(rectangle("plate", y, z)) - (1 - opening(y, z)) ** 2) < 0.01


@pytest.mark.parametrize(("gap", "above"), [(1e-3, 0.0), (3e-3, 0.0), (3e-3, 3e-3)])
def test_plates_whose_corners_nearly_touch_shade_as_two(gap: float, above: float) -> None:
    """Diagonally, a mm or three apart: 0.7 were missing, since paths over one's edges were tried
    where the other is.
    """
    sides = ((-0.2, -gap / 2), (-0.2, -above / 2)), ((gap / 2, 0.2), (above / 2, 0.2))
    plates = [rectangle(f"plate {number}", *side) for number, side in enumerate(sides)]
    due = (1 - sum(opening(*side) for side in sides)) ** 2
    assert abs(echo(of_one_mesh(*plates)) - due) < 0.01


def opening(y: tuple[float, float], z: tuple[float, float], near: float = 1 / 6 + 1 / 4) -> complex:
    """The field behind a hole in a screen, by Fresnel's integral; ``near``: the sum of the inverse
    distances on both sides.
    """
    root = np.sqrt(0.5j * K * near)
    one, other = ((erf(root * high) - erf(root * low)) / 2 for low, high in (y, z))
    return complex(one * other)


def of_one_mesh(*parts: SceneObject) -> SceneObject:
    meshes = [trimesh.Trimesh(p.vertices_m, p.geometry.faces, process=False) for p in parts]
    mesh = trimesh.util.concatenate(meshes)
    return thing("parts", mesh.vertices, mesh.faces, radar="obstacle")


@pytest.mark.parametrize("y", [0.0, 0.05, 0.25])
def test_what_an_obstacle_has_behind_the_target_hides_no_rim(y: float) -> None:
    """A plate before the target and a wall behind it, of one mesh: as the plate alone. With its rim
    within the wall's outline left out, the target is silent behind it.
    """
    near = rectangle("near", (-0.1, 0.1), (-0.15, 0.15))
    wall = rectangle("wall", (-3, 3), (-3, 3), x=11.0)
    at = point((10.0, y, 0.02))
    assert abs(echo(of_one_mesh(near, wall), at=at) - echo(near, at=at)) < 1e-3


def test_objects_that_touch_shade_as_one() -> None:
    """Two plates that overlap, one of them twice: 1 less the integral over what they cover. It is
    farther off where each has an outline of its own.
    """
    one, other, z = (-0.33, -0.03), (-0.13, 0.02), (-0.4, 0.5)
    plates = [rectangle(name, at, z) for name, at in (("a", one), ("b", other), ("c", other))]
    due = (1 - opening((one[0], other[1]), z)) ** 2
    assert abs(echo(*plates) - due) < 0.03


def echo_behind_mirrors(*objects: SceneObject, place: tuple[float, float, float]) -> complex:
    """Of a point 10 m off, as of `echo`, without what the objects themselves return: by default
    those that are large and flat are mirrors.
    """
    paths = found(*(replace(item, radar=None) for item in objects), at=point(place))
    is_beyond = paths.delay_s * speed_of_light > 2 * 9.0
    return wave(paths.take(np.flatnonzero(is_beyond))) / wave(found(at=point(place)))


@pytest.mark.parametrize("height", [-0.03, -0.005, 0.0, 0.03, 0.1])
@pytest.mark.parametrize("gap", [0.005, 0.1])
@pytest.mark.parametrize("edge", [0.0, 0.5])
def test_large_flat_sheets_in_line_shade_as_one(edge: float, gap: float, height: float) -> None:
    """Two sheets with tops on one line of sight, large enough to be mirrors, before a point
    ``height`` below the border of the shadow: the knife edge of one, on either way. While mirrors
    had outlines of their own, all four waves came in full: 1 in place of 0.25 at the border, 0 just
    above it.
    """
    tops = [(x, edge * x / 3) for x in (3.0, 3.0 + gap)]
    sheets = [rectangle(f"sheet {x}", (-50, 50), (-5, top), x=x) for x, top in tops]
    z = edge * 10 / 3 - height
    beside = (
        erfc(np.sqrt(1j * K * (np.hypot(3, edge) + np.hypot(7, z - edge) - np.hypot(10, z)))) / 2
    )
    due = (beside if height >= 0 else 1 - beside) ** 2
    got = echo_behind_mirrors(*sheets, place=(10.0, 0.0, z))
    assert abs(got - due) < 0.02


@pytest.mark.parametrize("place", [(0.0, 0.0), (2e-5, 1e-5), (-2e-5, -1e-5), (0.03, 0.03)])
@pytest.mark.parametrize("seam", ["level", "upright", "level, 1 cm lower"])
def test_no_wave_passes_between_boxes_that_touch(seam: str, place: tuple[float, float]) -> None:
    """Before a point 1 m within the shadow of two boxes with the seam in the line of sight, or
    beside it: as of one box. Each with an outline of its own, up to 1.7 times the free echo came.
    """
    at = -0.01 if "lower" in seam else 0.0
    low, high = np.array([3.0, -1.0, -1.5]), np.array([4.0, 1.0, 1.5])
    cut_low, cut_high = low.copy(), high.copy()
    axis = 2 if "level" in seam else 1
    cut_high[axis] = cut_low[axis] = at
    boxes = [replace(box(low, cut_high), name="one"), box(cut_low, high)]
    assert abs(echo_behind_mirrors(*boxes, place=(10.0, *place))) < 0.01


@pytest.mark.quick(7)
@pytest.mark.parametrize("gap", [0.01, 0.03, 0.1, 0.3, 1.0, 3.0])
@pytest.mark.parametrize("kind", ["slit", "jut", "layers"])
def test_screens_behind_each_other_are_kirchhoffs_double_integral(kind: str, gap: float) -> None:
    """Two plates that do not touch: with 2 to 20 mm between them as seen from the radar, or one 2
    to 20 mm beyond the other's edge, or one almost behind the other, against Kirchhoff's integral
    over both planes. To 20 cm they have one outline, which is off by 0.14 at 10 cm; two whole ones
    are off by 0.3 to 0.5. Farther apart waves over an edge of each are added: 0.3 to 0.7 without.
    """
    for seed in range(4):
        rng = np.random.default_rng([seed, len(kind)])
        middle, wide = rng.uniform(-0.05, 0.05), rng.uniform(0.1, 0.3, 2)
        beyond = rng.uniform(0.002, 0.02)
        others = {
            "slit": (middle + beyond, middle + beyond + wide[1]),
            "jut": (middle - wide[1], middle + beyond),
            "layers": (middle - wide[0] + beyond / 5, middle - beyond / 5),
        }
        plates = [
            (5.0, (middle - wide[0], middle), (-0.3, 0.4)),
            (5.0 + gap, others[kind], (-0.3, 0.4)),
        ]
        place = (10.0, rng.uniform(-0.05, 0.05), 0.02)
        objects = [rectangle(f"plate {x}", y, z, x=x) for x, y, z in plates]
        due = field_behind(plates, np.array(place), K) ** 2
        assert abs(echo(*objects, at=point(place)) - due) < 0.02 + 0.4 * np.sqrt(min(gap, 0.1))


@pytest.mark.parametrize("at", [-0.06, -0.03, -0.01, 0.0, 0.01, 0.02])
def test_a_rim_within_the_outline_of_its_body_diffracts_nothing(at: float) -> None:
    """Of two plates 1 cm behind each other in one mesh, one juts out by 3 mm, which is nothing for
    the wave: 1 less the integral over both together. Counted twice, the rim is off by 0.5.
    """
    one, other = (at - 0.3, at), (at - 0.1, at + 0.003)
    z, within = (-0.4, 0.5), (-0.2, 0.3)
    plates = [rectangle("plate", one, z), rectangle("plate", other, within, x=6.01)]
    both = of_one_mesh(*plates)
    common = opening((other[0], one[1]), within)
    due = (1 - opening(one, z) - opening(other, within) + common) ** 2
    assert abs(echo(both) - due) < 0.03


@pytest.mark.parametrize("y", [0.54, 0.58, 0.6, 0.64, 0.66, 0.68])
def test_two_posts_of_one_mesh_shade_like_two_posts(y: float) -> None:
    """1 less the integrals over both, as of flat strips as wide as the posts: these are thick,
    which is up to 0.15. Where rims of one are taken as second edges of the other's, 0.4 to 0.6.
    """
    posts = [trimesh.creation.cylinder(0.05, 1.2, sections=9) for _ in range(2)]
    for post, place in zip(posts, (0.0, 0.3), strict=True):
        post.apply_translation([5, place, 0])
    sides = [5 * (post.vertices[:, 1] / post.vertices[:, 0] - y / 8) for post in posts]
    strips = [opening((side.min(), side.max()), (-0.6, 0.6), 1 / 5 + 1 / 3) for side in sides]
    mesh = trimesh.util.concatenate(posts)
    both = thing("posts", mesh.vertices, mesh.faces, radar="obstacle")
    assert abs(echo(both, at=point((8, y, 0))) - (1 - sum(strips)) ** 2) < 0.2


def test_behind_a_ball_there_is_poissons_spot() -> None:
    """On its axis as bright as without it (the antenna's pattern takes 1.5 %): a hundred edges."""
    assert abs(echo(ball("ball", (6, 0, 0), 0.15, 3, radar="obstacle"))) == pytest.approx(
        0.985, abs=0.02
    )


def test_two_edges_are_kirchhoffs_double_integral() -> None:
    """Both planes integrated by numbers along the paths of steepest descent."""
    nodes, weights = np.polynomial.legendre.leggauss(400)
    long = 12 * np.sqrt(2 / K)
    u, w = (nodes + 1) / 2 * long, weights / 2 * long
    turn = np.exp(-0.25j * np.pi)
    for a, b, c in ((4, 2, 4), (6, 0.3, 4), (5, 1, 1)):
        for h in (
            (0.0, 0.0),
            (0.03, 0.03),
            (0.1, 0.08),
            (0.02, 0.05),
            (-0.02, 0.01),
            (-0.03, -0.02),
        ):
            m = np.array([[1 / a + 1 / b, -1 / b], [-1 / b, 1 / b + 1 / c]])
            y = [h[0] + turn * u[:, None], h[1] + turn * u]
            quadratic = m[0, 0] * y[0] ** 2 + m[1, 1] * y[1] ** 2 + 2 * m[0, 1] * y[0] * y[1]
            due = (
                K
                / (2 * np.pi)
                * np.sqrt(np.linalg.det(m))
                * np.einsum("i,j,ij", w, w, np.exp(-0.5j * K * quadratic))
            )
            q = (
                K
                / 2
                * np.array([h[0] ** 2 * (1 / a + 1 / (b + c)), h[1] ** 2 * (1 / (a + b) + 1 / c)])
            )
            lit = np.array(h) < 0
            rho = np.sqrt(a * c / ((a + b) * (b + c)))
            both, alone = double_knife_edge(q[None], lit[None], np.array([rho]))
            total = K / 2 * (h[0] ** 2 / a + (h[1] - h[0]) ** 2 / b + h[1] ** 2 / c)
            got = both[0] * np.exp(-1j * total) + lit.all()
            got += np.sum(alone[0] * np.where(lit, -1, 1) * knife_edge_factor(q) * np.exp(-1j * q))
            assert abs(got - due) < 1e-5


def test_a_thick_wall_is_passed_over_both_of_its_edges() -> None:
    """Radar and target alike 20 cm below its top. 2 mm thick it takes what one edge does; 2 m thick
    10 dB more each way, by the integral over both planes; and both ways round are alike.
    """
    heights = 0.2 * np.array([1, 1])
    a, b, c = 5.0, 2.0, 3.0
    q = K / 2 * heights**2 * np.array([1 / a + 1 / (b + c), 1 / (a + b) + 1 / c])
    rho = np.array([np.sqrt(a * c / ((a + b) * (b + c)))])
    due = double_knife_edge(q[None], np.array([[False, False]]), rho)[0][0]
    got = echo(box([5, -30, -3], [7, 30, 0.2]))
    assert decibels(got / pattern(0.2, 5)) == pytest.approx(40 * np.log10(abs(due)), abs=0.05)
    thin = echo(box([5.999, -30, -3], [6.001, 30, 0.2]))
    one = (erfc(np.sqrt(1j * BEND) * 0.2) / 2) ** 2
    assert decibels(thin / pattern(0.2)) == pytest.approx(decibels(one), abs=0.1)
    turned = echo(box([3, -30, -3], [5, 30, 0.2]))  # the same seen from the target
    assert abs(turned / pattern(0.2, 3)) == pytest.approx(abs(got / pattern(0.2, 5)), rel=0.005)


@pytest.mark.parametrize("deep_m", [0.1, 1.0])
@pytest.mark.parametrize("side", [(1, 1), (1, -1), (2, 1), (2, -1)])
def test_along_a_side_both_of_its_edges_are_passed(side: tuple[int, int], deep_m: float) -> None:
    """The radar exactly in the plane of a box's side, the target too or a hair in the shadow, as at
    round coordinates: of boxes on all four sides the integral over both planes at their edges,
    1/4 + asin(rho) / (2 pi) each way (Sheppard's formula for an orthant of two normal variables).
    """
    axis, sign = side
    ends = np.array([[6, -4, -4], [6 + deep_m, 4, 4]], dtype=np.float64)
    ends[0 if sign > 0 else 1, axis] = 0.0
    a, b, c = 6.0, deep_m, 4 - deep_m
    due = (0.25 + np.arcsin(np.sqrt(a * c / ((a + b) * (b + c)))) / (2 * np.pi)) ** 2
    for into_shadow_m in (0.0, 1e-6, 2e-5):
        place = np.array([10.0, 0.0, 0.0])
        place[axis] = sign * into_shadow_m
        assert abs(echo(box(*ends), at=point(tuple(place)))) == pytest.approx(due, rel=0.01)


@pytest.mark.parametrize(("gap_m", "height_m"), [(0.1, 0.1), (0.2, 0.2)])
def test_deep_in_their_shadow_two_sheets_are_passed_over_both_edges(
    gap_m: float, height_m: float
) -> None:
    """So close that both have one outline, alike high: the farther stops the way over the edge of
    the nearer, and nothing came. Against the integral over both planes.
    """
    a, b, c = 5.0, gap_m, 5.0 - gap_m
    q = K / 2 * height_m**2 * np.array([1 / a + 1 / (b + c), 1 / (a + b) + 1 / c])
    rho = np.array([np.sqrt(a * c / ((a + b) * (b + c)))])
    due = abs(double_knife_edge(q[None], np.array([[False, False]]), rho)[0][0]) ** 2
    sheets = [rectangle(f"at {x}", (-4, 4), (-4, height_m), x=x) for x in (a, a + b)]
    assert abs(echo(*sheets)) == pytest.approx(due * pattern(height_m, 5), rel=0.02)


@pytest.mark.parametrize("beyond_m", [1e-15, 1e-12, 1e-10, 1e-8])
def test_a_hair_over_a_side_it_is_as_in_its_plane(beyond_m: float) -> None:
    """By rounding the radar stands on either side: a target in the light was off by 0.09."""
    at = point((10.0, 0.0, 0.03))
    exactly, over = (echo(box([6, -4, -4], [7, 4, z]), at=at) for z in (0.0, -beyond_m))
    assert abs(over - exactly) < 1e-3


def test_nothing_comes_under_a_box_that_stands_on_the_ground() -> None:
    """Without reflections in it the ground only closes the way below: as if the box went on down.
    Off the ground it lets through what the gap does.
    """
    at, low = point((10, 0, 0.05)), OPTICS.with_(radar_shadow_db=60.0, radar_images=0)
    floor = ground(-0.1, radar="obstacle")
    on_it = echo(box([5, -3, -0.1], [5.2, 3, 0.2]), floor, at=at, fidelity=low)
    deep = echo(box([5, -3, -3], [5.2, 3, 0.2]), at=at, fidelity=low)
    assert abs(on_it - deep) < 0.02 * abs(deep)
    raised = echo(box([5, -3, -0.06], [5.2, 3, 0.2]), floor, at=at, fidelity=low)
    assert abs(raised) > 1.5 * abs(deep)


def test_over_a_mirror_both_sides_of_it_are_obstructed() -> None:
    """Over a conducting ground, what comes by the radar's image is what a radar there would get
    past the screen and the screen's own image, but for the sign.
    """
    floor, at = ground(-1.0), point((10, 0, 0.0))
    upright = rectangle("screen", (-30, 30), (-1, -0.45), x=4.0)
    both = rectangle("screen", (-30, 30), (-1.55, -0.45), x=4.0)
    below = Rig(Pose((0.0, 0.0, 0.0)), radar=Pose((0.0, 0.0, -2.0)))
    real, unfolded = (
        trace(world(*objects, targets=(at,), rig=rig), RADAR, fidelity=DEEP)
        for objects, rig in (
            ((floor, upright), Rig(Pose((0.0, 0.0, 0.0)), radar=Pose((0.0, 0.0, 0.0)))),
            ((both,), below),
        )
    )
    over = paths_of(real, lambda path: path.target and path.via.count("ground") == 2)
    got, due = (wave(paths) for paths in (over, paths_of(unfolded)))
    assert abs(abs(got) / abs(due) - 1) < 0.02


def test_an_edge_that_moves_changes_the_way_over_it() -> None:
    """A lorry's tailboard 30 cm beside the line of sight: the way's rate is its length's."""
    velocity = (0.0, 0.0, 5.0)
    moving = [screen(h, velocity_m_per_s=velocity) for h in (0.3, 0.3 + 5e-3)]
    now, later = (found(item) for item in moving)
    assert now.delay_rate[0] == pytest.approx((later.delay_s - now.delay_s)[0] / 1e-3, rel=0.02)


def test_what_a_missing_edge_is_at_most() -> None:
    """Over all phases; far from the end no more than 1.6 times what it is."""
    rng = np.random.default_rng(1)
    q, p = 10 ** rng.uniform(-3, 5, (2, 100_000))
    value, bound = np.abs(missing_edge_factor(q, p)), missing_edge_bound(q, p)
    matters = value > 1e-12
    assert np.all(value[matters] <= bound[matters])
    assert np.all(bound[matters & (p > 10)] < 1.6 * value[matters & (p > 10)])


def sommerfeld(rho: float, off_rad: float, is_soft: bool) -> complex:
    """Field behind a conducting half plane that a plane wave meets at normal incidence, over that
    of the wave (Born and Wolf, section 11.5), ``off_rad`` within the shadow.
    """
    from_face, at = np.pi / 2, 1.5 * np.pi + off_rad  # angles from the lit face

    def part(angle: float) -> complex:
        w = np.sqrt(2 * K * rho) * np.cos(angle / 2)
        return complex(np.exp(1j * K * rho * np.cos(angle)) * erfc(-np.sqrt(1j) * w) / 2)

    sign = -1 if is_soft else 1
    straight = np.exp(1j * K * rho * np.cos(at - from_face))
    return (part(at - from_face) + sign * part(at + from_face)) / straight


@pytest.mark.parametrize(
    ("off_deg", "within_db"), [(0.1, 0.1), (1.0, 0.15), (5.0, 0.5), (15.0, 1.3)]
)
def test_a_knife_edge_is_a_conducting_half_plane(off_deg: float, within_db: float) -> None:
    """What is left out, the field's direction on the screen, is 0.5 dB 5 degrees into the shadow,
    where 30 dB are lost each way, and 1.3 dB at 15.
    """
    rho, off = 4.0, np.radians(off_deg)
    knife = knife_edge_factor(np.array([K * rho * (1 - np.cos(off))]))[0]
    for is_soft in (True, False):
        exact = sommerfeld(rho, off, is_soft)
        assert decibels(knife / exact) == pytest.approx(0, abs=within_db)


def corner_of_a_building(rho: float, off_rad: float, is_soft: bool) -> complex:
    """The same behind a conducting right angle that a plane wave meets 45 degrees from either
    face: the series of Bessel functions (Balanis, Advanced Engineering Electromagnetics, 13-40).
    """
    n, lit_rad = 1.5, 0.25 * np.pi
    at = np.pi + lit_rad + off_rad
    m = np.arange(int(n * (K * rho + 60 + 10 * np.cbrt(K * rho))))
    terms = np.where(m == 0, 1, 2) * np.exp(0.5j * np.pi * m / n) * jv(m / n, K * rho)
    waves = (np.sin, np.cos)[not is_soft]
    field = np.sum(terms * waves(m * lit_rad / n) * waves(m * at / n)) / n
    return complex(2 * field / np.exp(-1j * K * rho * np.cos(off_rad)))


@pytest.mark.parametrize(("off_deg", "within_db"), [(0.5, 0.3), (2.0, 0.6), (5.0, 1.3)])
def test_a_knife_edge_is_the_corner_of_a_building(off_deg: float, within_db: float) -> None:
    """What the angle and the polarisation change is 0.6 dB 2 degrees into the shadow, 1.3 at 5."""
    rho, off = 2.0, np.radians(off_deg)
    knife = knife_edge_factor(np.array([K * rho * (1 - np.cos(off))]))[0]
    for is_soft in (True, False):
        exact = corner_of_a_building(rho, off, is_soft)
        assert decibels(knife / exact) == pytest.approx(0, abs=within_db)


def sionna(height: float, polarization: str) -> float:
    """One way past the same screen by Sionna RT's edge diffraction, over free space, in dB."""
    from twin.engine import sionna as engine

    rt = engine()
    import mitsuba as mi

    item = screen(height)
    mesh = mi.Mesh("screen", 4, 2)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = item.vertices_m.astype(np.float32).ravel()
    parameters["faces"] = item.geometry.faces.astype(np.uint32).ravel()
    parameters.update()
    scene = rt.load_scene()
    scene.frequency = CARRIER_HZ
    array = rt.PlanarArray(num_rows=1, num_cols=1, pattern="iso", polarization=polarization)
    scene.tx_array = scene.rx_array = array
    scene.add(rt.Transmitter("radar", [0.0, 0.0, 0.0]))
    scene.add(rt.Receiver("target", [10.0, 0.0, 0.0]))
    metal = rt.RadioMaterial("metal", relative_permittivity=1.0, conductivity=1e7, thickness=0.1)
    scene.edit(add=[rt.SceneObject(mi_mesh=mesh, name="screen", radio_material=metal)])
    kinds = dict.fromkeys(("specular_reflection", "diffuse_reflection", "refraction"), False)
    edges = dict.fromkeys(("los", "diffraction", "edge_diffraction"), True)
    paths = rt.PathSolver()(scene, max_depth=1, samples_per_src=200_000, seed=1, **kinds, **edges)
    amplitude = np.array(paths.a[0]).ravel() + 1j * np.array(paths.a[1]).ravel()
    late = np.array(paths.tau, dtype=np.float64).ravel() - 10 / 299792458
    field = np.sum(amplitude * np.exp(-2j * np.pi * CARRIER_HZ * late))
    return decibels(complex(field) * 4 * np.pi * 10 / WAVELENGTH_M)


@pytest.mark.parametrize("height", [-0.02, 0.03, 0.1])
def test_sionna_rt_says_the_same_of_one_edge(height: float) -> None:
    """Its uniform theory of diffraction on its own scene, float32, both polarisations."""
    ours = decibels(echo(screen(height)) / pattern(height)) / 2
    for polarization in ("V", "H"):
        assert ours == pytest.approx(sionna(height, polarization), abs=0.25)


def test_an_edge_behind_a_mirrors_plane_by_rounding_leaves_no_nan(monkeypatch) -> None:
    """A way by it has no point on the mirror; by where rays pass beside it, it has. Then a trace
    ended with NumPy's error of a size.
    """
    turns = Segment.turns

    def lost(segment: Segment, paths: DiffractedPaths, edges: Array) -> Array:
        chain = turns(segment, paths, edges)
        return np.full_like(chain, np.nan) if np.array_equal(edges, paths.stops) else chain

    plain = echo(screen(0.02))
    monkeypatch.setattr(Segment, "turns", lost)
    assert echo(screen(0.02)) == pytest.approx(plain, abs=1e-4)

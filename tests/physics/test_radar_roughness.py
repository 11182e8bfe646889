"""Which large surfaces a tolerance takes for rough: a bound of their clutter that holds."""

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from scipy.constants import speed_of_light

from tests.physics.radar_worlds import (
    CARRIER_HZ,
    MATERIALS,
    RADAR,
    WAVELENGTH_M,
    plate,
    quad,
    wave,
    world,
)
from twin.fidelity import Fidelity, Tolerance
from twin.radar.propagation import physical_optics
from twin.radar.propagation.result import Propagation
from twin.radar.propagation.roughness import _clutter, _most_clutter
from twin.radar.propagation.scene.culling import noise_amplitude
from twin.radar.propagation.solvers import trace
from twin.radar.synthesis import Contributions
from twin.scene import Pose, Rig, Scene

ONCE = Fidelity(radar="auto", radar_bounces=1)


def surface(rms_height_m: float, gamma: float | None) -> dict:
    """The materials, with asphalt of this relief."""
    row = MATERIALS["asphalt"].model_dump()
    row["surface"] = {"rms_height_m": {"value": rms_height_m, "assumed": "for the test"}}
    if gamma is not None:
        row["surface"]["backscatter_gamma"] = {"value": gamma, "assumed": "for the test"}
    return {**MATERIALS, "asphalt": type(MATERIALS["asphalt"]).model_validate(row)}


def over_floor(rms_height_m: float, gamma: float | None, height_m: float = 1.0) -> Scene:
    """A plate above a floor that begins below the radar."""
    x, z = [0.3, 25, 25, 0.3], -height_m
    corners = np.array([x, [-12, -12, 12, 12], [z] * 4], float).T
    floor = quad("floor", corners, "asphalt", radar="surface")
    rig = Rig(Pose((0.0, 0.0, 0.0)), radar=Pose((0.0, 0.0, 0.0)))
    scene = world(floor, plate("sign", (9, 1, 0.3), 0.2), rig=rig)
    return replace(scene, materials=surface(rms_height_m, gamma))


def told(found: Propagation, effect: str) -> tuple[float, bool]:
    (decision,) = [d for d in found.decisions if d.effect == effect]
    return decision.bound, decision.taken


def same(one: Propagation, other: Propagation) -> bool:
    return all(
        np.array_equal(getattr(one.contributions, name), getattr(other.contributions, name))
        for name in ("amplitude", "delay_s", "falloff")
    )


@pytest.mark.parametrize(
    ("rms_height_m", "gamma", "is_rough"),
    [(0.0, 0.0, False), (1e-6, 1e-16, False), (1e-6, 0.05, True), (1e-3, 0.0, True)],
)
def test_surfaces_are_rough_where_it_counts(
    rms_height_m: float, gamma: float, is_rough: bool
) -> None:
    """Bit for bit what `rough` finds, or `optics`: by clutter, or by what a mirror loses."""
    scene = over_floor(rms_height_m, gamma)
    found = trace(scene, RADAR, fidelity=ONCE)
    fixed = trace(scene, RADAR, fidelity=ONCE.with_(radar="rough" if is_rough else "optics"))
    assert same(found, fixed)
    assert told(found, "clutter of floor")[1] == is_rough
    bound, is_taken = told(found, "what floor scatters of what it mirrors")
    assert is_taken == is_rough
    assert bound == pytest.approx(1 - np.exp(-2 * (2 * np.pi / WAVELENGTH_M * rms_height_m) ** 2))


@pytest.mark.thorough
@pytest.mark.parametrize("height_m", [0.05, 0.5, 3.0])
def test_no_cell_has_more_clutter_than_the_bound(height_m: float) -> None:
    """Power of all scatterers in the strongest range cell, of four surfaces: within the bound, that
    stays within 20 dB of it: it takes an image for as strong as the direct wave, 12 dB.
    """
    scene, noise = over_floor(1e-3, 0.05, height_m), noise_amplitude(RADAR)
    cell_m = speed_of_light / (2 * RADAR.total_bandwidth_hz)
    strongest = []
    for seed in range(4):
        found = trace(scene, RADAR, fidelity=ONCE.with_(radar_surface_seed=seed))
        clutter = found.contributions.object == found.objects.index("floor")
        cell = (found.contributions.delay_s[clutter] * speed_of_light / 2 / cell_m).astype(int)
        power = np.abs(found.contributions.amplitude[clutter]) ** 2
        strongest.append(np.sqrt(np.bincount(cell, weights=power).max()) / noise)
    bound, _ = told(found, "clutter of floor")
    assert bound / 10 < max(strongest) < bound


def test_a_surface_belongs_to_the_scene() -> None:
    """Other seeds of a measurement are the same surface, and other surface's seeds are others."""
    scene = over_floor(1e-3, 0.05)
    one, other = (trace(scene, RADAR, fidelity=ONCE, seed=seed) for seed in (1, 2))
    assert same(one, other)
    assert not same(one, trace(scene, RADAR, fidelity=ONCE.with_(radar_surface_seed=1)))


def test_a_tolerance_leaves_it_to_bounds() -> None:
    assert Tolerance().knobs().radar == "auto"
    assert Tolerance().knobs(CARRIER_HZ / 100).radar_surface_seed == 0


@pytest.mark.parametrize(
    ("rms_height_m", "gamma", "is_told"),
    [
        (2e-3, None, True),  # exp(-4 (k s)^2) of the power is left: 1e-19
        (0.26e-3, None, True),  # k s = 0.43: 0.48
        (0.24e-3, None, False),  # 0.53
        (2e-3, 1e-6, False),
        (2e-3, 0.0, False),  # so it was asked for
    ],
)
def test_a_rough_surface_without_gamma_is_told_to_absorb(
    rms_height_m: float, gamma: float | None, is_told: bool
) -> None:
    """What Ament's factor takes from the mirrored wave has to go somewhere: a material that says
    nothing of where makes a surface that the radar cannot see.
    """
    scene = over_floor(rms_height_m, gamma)
    warnings = [text for text in trace(scene, RADAR, fidelity=ONCE).warnings if "absorbs" in text]
    assert len(warnings) == is_told
    if is_told:
        left = np.exp(-4 * (2 * np.pi / WAVELENGTH_M * rms_height_m) ** 2)
        assert "floor absorbs what its roughness takes" in warnings[0]
        assert f"{left:.2g} of the power" in warnings[0]


def body_alone(side_m: float, distance_m: float, material: str = "asphalt") -> Scene:
    rig = Rig(Pose((0.0, 0.0, 0.0)), radar=Pose((0.0, 0.0, 0.0)))
    return world(plate("sign", (distance_m, 0, 0), side_m, material), rig=rig)


@pytest.mark.thorough
def test_a_body_mirrors_and_scatters_as_its_roughness_says() -> None:
    """A plate too small to be a large surface: its facets lose exp(-2 (k s)^2) of 0.5 mm, and its
    clutter, over 16 surfaces, is that of the radar equation within 1.5 dB: as many draws of
    exponential speckle are off by 1 dB (one standard error).
    """
    scene, gamma = body_alone(0.3, 3.0), 0.05
    smooth = trace(scene, RADAR, fidelity=ONCE.with_(radar="optics"))
    (role,) = smooth.roles
    assert role.role.name == "OPTICS"
    dull = trace(replace(scene, materials=surface(0.5e-3, 0.0)), RADAR, fidelity=ONCE)
    left = wave(dull.contributions) / wave(smooth.contributions)
    assert left == pytest.approx(np.exp(-2 * (2 * np.pi / WAVELENGTH_M * 0.5e-3) ** 2), rel=3e-3)

    bare = replace(scene, materials=surface(3e-3, gamma))  # nothing of it mirrors
    waves = [
        wave(trace(bare, RADAR, fidelity=ONCE.with_(radar_surface_seed=n)).contributions)
        for n in range(16)
    ]
    x = 0.3 * ((np.arange(200) + 0.5) / 200 - 0.5)
    y, z = np.meshgrid(x, x)
    r = np.sqrt(9.0 + y**2 + z**2)
    gain = RADAR.antenna.gain(np.stack([3.0 / r, y / r, z / r], axis=-1).reshape(-1, 3))
    density = gain.reshape(r.shape) ** 2 * gamma * (3.0 / r) / r**4
    expected = WAVELENGTH_M**2 / (4 * np.pi) ** 3 * density.mean() * 0.09
    expected *= 10 ** (-RADAR.front_end.losses_db.value / 10)
    assert 10 * np.log10(np.mean(np.abs(waves) ** 2) / expected) == pytest.approx(0, abs=2.5)
    strays = trace(bare, RADAR, fidelity=ONCE).contributions
    strays = strays.take(strays.wavelength_power == 1)
    assert np.sum(np.abs(strays.amplitude) ** 2) == pytest.approx(expected, rel=0.02)


def test_a_wall_that_grows_into_a_mirror_keeps_its_level() -> None:
    """Asphalt at 10 m, 1.9 and 2.0 m wide: facets, and an image. Smooth facets were 12 dB above."""
    bodies = [trace(body_alone(side_m, 10.0), RADAR, fidelity=ONCE) for side_m in (1.9, 2.0)]
    assert [found.roles[0].role.name for found in bodies] == ["OPTICS", "SURFACE"]
    facets, image = (abs(wave(found.contributions)) for found in bodies)
    assert 20 * np.log10(facets / image) == pytest.approx(0, abs=1.5)


@pytest.mark.parametrize(
    ("rms_height_m", "is_told"), [(0.5e-3, True), (0.25e-3, True), (0.1e-3, False)]
)
def test_what_optics_takes_for_smooth_is_told_by_how_much(
    rms_height_m: float, is_told: bool
) -> None:
    """A wall square on: the echo of `rough` is weaker by the exp(-4 (k s)^2) that is told. 0.1 mm
    take 0.5 dB, less than the tolerance of a tenth of the amplitude.
    """
    scene = replace(body_alone(2.0, 10.0), materials=surface(rms_height_m, 0.0))
    smooth, rough = (trace(scene, RADAR, fidelity=ONCE.with_(radar=m)) for m in ("optics", "rough"))
    expected_db = 40 * math.log10(math.e) * (2 * np.pi / WAVELENGTH_M * rms_height_m) ** 2
    levels = [abs(wave(found.contributions)) for found in (smooth, rough)]
    assert 20 * np.log10(levels[0] / levels[1]) == pytest.approx(expected_db, rel=0.01)
    warned = [text for text in smooth.warnings if "takes surfaces for smooth" in text]
    assert len(warned) == is_told
    assert all(f"sign (asphalt) by {expected_db:.1f} dB;" in text for text in warned)
    assert not any("for smooth" in text for text in rough.warnings)


def test_a_body_without_gamma_stays_smooth_and_is_told() -> None:
    scene = body_alone(0.3, 3.0, "cotton")
    found = trace(scene, RADAR, fidelity=ONCE)
    assert same(found, trace(scene, RADAR, fidelity=ONCE.with_(radar="optics")))
    assert any("cotton" in line and "smooth" in line for line in found.assumptions)


def test_a_small_body_on_wide_ground_has_speckle() -> None:
    """Not one scatterer, as its share of the area would have it."""
    floor = over_floor(1e-3, 0.05)
    tile = plate("tile", (9, 0, 0.5), 0.2, "asphalt")
    scene = replace(floor, objects=(floor.objects[0], tile))
    found = trace(scene, RADAR, fidelity=ONCE)
    strays = found.contributions.take(found.contributions.wavelength_power == 1)
    assert np.count_nonzero(strays.object == found.objects.index("tile")) > 32


def test_what_is_bounded_without_points_is_no_brighter_with_them() -> None:
    """Plates at random, in the beam and beside it: the bound that spares far ones of thousands from
    being sampled is never less than the sampled one, and within 10 times of it in the beam.
    """
    rng, scene = np.random.default_rng(3), over_floor(1e-3, 0.1)
    ratio = []
    for number in range(40):
        corners = rng.normal(0, 0.5, (4, 3)) * [1, 1, 1] + [rng.uniform(3, 30), 0, 0]
        corners[:, 1] += rng.uniform(-0.6, 0.6) * corners[0, 0]
        item = quad(f"plate {number}", corners, "asphalt")
        alone = replace(scene, objects=(item,))
        (bound,) = _most_clutter(alone, RADAR) * np.sqrt(0.1)
        ratio.append(bound / max(_clutter(alone, RADAR, item, 0.1), 1e-12))
    assert min(ratio) >= 1
    assert np.median(ratio) < 10


def test_between_facing_walls_clutter_comes_by_two_reflections_on_a_way_at_most(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of a body more are followed there. Each point has as many paths as there are pairs of images,
    by which a room of five walls took minutes and gigabytes.
    """
    walls = [
        quad(
            name,
            [[-4, y, -2], [14, y, -2], [14, y, 2], [-4, y, 2]],
            "asphalt",
            radar="surface",
        )
        for name, y in (("left", 1.0), ("right", -1.5))
    ]
    scene = replace(world(*walls, plate("sign", (5, 0, 0), 0.2)), materials=surface(0.003, 0.1))
    orders: list[int] = []

    def no_echoes(context, _anchor, surfaces, *_: object) -> Iterator[Contributions]:
        of_image = np.array(context.orders)
        orders.extend(int(of_image[source]) for one in surfaces for source in one.sources)
        return iter(())

    monkeypatch.setattr(physical_optics, "clutter_echoes", no_echoes)
    wide = RADAR.with_({"antenna.gain_dbi": 3.0103})
    found = trace(scene, wide, fidelity=Tolerance().knobs().with_(radar="rough"))
    assert max(orders) == 2
    bodies = found.contributions.take(slice(len(found.names), None))
    assert bodies.source.max() > max(orders)

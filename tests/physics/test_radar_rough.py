"""Rough surfaces: mean power, speckle, decorrelation with motion, what is left of the mirror."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from scipy.constants import speed_of_light

from tests.physics.radar_worlds import (
    CARRIER_HZ,
    MATERIALS,
    RADAR,
    WAVELENGTH_M,
    ground,
    plate,
    quad,
    wave,
    world,
)
from tests.physics.test_radar_walls import box, permittivity, slab
from twin.fidelity import Fidelity
from twin.radar import load_radar
from twin.radar.acquisition import contributions
from twin.radar.propagation.physical_optics import surface_clutter
from twin.radar.propagation.prepared_scene import PreparedScene, prepare_scene
from twin.radar.propagation.result import Propagation
from twin.radar.propagation.scene.atmosphere import Atmosphere
from twin.radar.propagation.scene.scattering_models import assign_scattering_models
from twin.radar.propagation.solvers import trace
from twin.radar.propagation.surface_clutter import coherent
from twin.radar.synthesis import Contributions
from twin.scene import Pose, Rig, Scene, SceneObject

K = 2 * np.pi / WAVELENGTH_M
GAMMA = 0.05


def rough(material: str = "asphalt") -> dict:
    """The table with a gamma of our own."""
    row = MATERIALS[material].model_dump()
    row["surface"] = {
        **row["surface"],
        "backscatter_gamma": {"value": GAMMA, "assumed": "for the test"},
    }
    return {**MATERIALS, material: type(MATERIALS[material]).model_validate(row)}


def scene(*objects: SceneObject, at=(0.0, 0.0, 0.0)) -> Scene:
    rig = Rig(Pose(tuple(at)), radar=Pose((0.0, 0.0, 0.0)))
    return replace(world(*objects, rig=rig), materials=rough())


def echoes(s: Scene, count: int = 20_000, seed: int = 0):
    return trace(
        s, RADAR, fidelity=Fidelity(radar="rough", radar_scatterers=count, radar_surface_seed=seed)
    ).echoes


def floor() -> SceneObject:
    """12 x 8 m, 1 m below the radar, from 8 m on."""
    corners = np.array([[8, -4, -1], [20, -4, -1], [20, 4, -1], [8, 4, -1]], float)
    return quad("floor", corners, "asphalt", radar="surface")


def expected_power(n: int = 2000) -> float:
    """The integral of gamma cos(theta) G^2 lambda^2 / ((4 pi)^3 R^4) over the floor."""
    x = 8 + 12 * (np.arange(n) + 0.5) / n
    y = -4 + 8 * (np.arange(n) + 0.5) / n
    r = np.sqrt(x[:, None] ** 2 + y**2 + 1)
    cos = x[:, None] / r
    gain = RADAR.antenna.gain(np.stack([cos, np.sqrt(1 - cos**2), 0 * cos], axis=-1))
    loss = 10 ** (-RADAR.front_end.losses_db.value / 10)
    density = GAMMA / r * gain**2 * WAVELENGTH_M**2 / ((4 * np.pi) ** 3 * r**4) * loss
    return float(density.sum() * 96 / n**2)


@pytest.mark.thorough
@pytest.mark.parametrize("count", [10_000, 100_000, 1_000_000])
def test_mean_power_does_not_depend_on_the_number(count: int) -> None:
    """Of scatterers: within 0.1 dB of the integral, averaged over four surfaces at 1e4."""
    runs = 4 if count == 10_000 else 1
    found = np.mean(
        [np.sum(np.abs(echoes(scene(floor()), count, seed).amplitude) ** 2) for seed in range(runs)]
    )
    assert 10 * np.log10(found / expected_power()) == pytest.approx(0, abs=0.1)


@pytest.mark.whole
def test_speckle_is_exponential() -> None:
    """Power over 200 surfaces of other seeds: a Kolmogorov-Smirnov test against the exponential
    with its mean, at a false-alarm rate of 1e-3, and the phase against the uniform one, likewise.
    """
    waves = np.array([wave(echoes(scene(floor()), 2000, seed)) for seed in range(200)])
    power = np.abs(waves) ** 2
    assert stats.kstest(power / expected_power(), "expon").pvalue > 1e-3
    assert stats.kstest(np.angle(waves) / (2 * np.pi) + 0.5, "uniform").pvalue > 1e-3


@pytest.mark.whole
def test_speckle_decorrelates_as_the_radar_moves() -> None:
    """Sideways by d before a wall W wide at R: sinc(2 W d / (lambda R)), the points being those of
    the surface: expectation over their phases, point by point.
    """
    width, distance = 1.0, 20.0
    wall = replace(plate("wall", (distance, 0, 0), width, "asphalt"), radar="surface")
    first = echoes(scene(wall), 1_100_000)
    # So many are asked for that all are kept, from every pose the same.
    for offset in (0.005, 0.01, 0.02, 0.038):
        second = echoes(scene(wall, at=(0.0, offset, 0.0)), 1_100_000)
        assert len(first.delay_s) == len(second.delay_s)
        turn = 2 * np.pi * (CARRIER_HZ * (second.delay_s - first.delay_s) % 1.0)
        joint = np.sum(np.abs(first.amplitude * second.amplitude) * np.exp(-1j * turn))
        found = joint / np.sqrt(
            np.sum(np.abs(first.amplitude) ** 2) * np.sum(np.abs(second.amplitude) ** 2)
        )
        same = first.amplitude * second.amplitude.conj()
        assert np.all(np.abs(np.angle(same)) < 1e-9)
        theory = np.sinc(2 * width * offset / (WAVELENGTH_M * distance))
        assert abs(found) == pytest.approx(abs(theory), abs=0.02)


def test_scatterers_move_with_their_surface() -> None:
    """Receding at 3 m/s: every rate is that of its delay."""
    velocity, step = (3.0, 0.0, 0.0), 1e-4
    wall = replace(plate("wall", (20.0, 0, 0), 4.0, "asphalt"), velocity_m_per_s=velocity)
    moved = wall.moved(np.array(velocity) * step)
    one, other = (echoes(scene(w), 2000) for w in (wall, moved))
    np.testing.assert_allclose((other.delay_s - one.delay_s) / step, one.delay_rate, rtol=1e-4)
    assert one.delay_rate.mean() == pytest.approx(6.0 / speed_of_light, rel=0.02)


def test_what_roughness_takes_from_the_mirror() -> None:
    """Asphalt of 0.5 mm at normal incidence: exp(-2 (k sigma)^2) on the amplitude, 11.9 dB."""
    wall = replace(plate("wall", (20.0, 0, 0), 40.0, "asphalt"), radar="surface")
    smooth, dull = (
        trace(scene(wall), RADAR, fidelity=Fidelity(radar=rung)).paths[0].amplitude
        for rung in ("optics", "rough")
    )
    rms = MATERIALS["asphalt"].surface.rms_height_m.value
    expected = float(coherent(rms, np.ones(1), WAVELENGTH_M)[0])
    assert expected == pytest.approx(np.exp(-2 * (K * rms) ** 2))
    assert abs(dull / smooth) == pytest.approx(expected, rel=1e-6)
    assert 20 * np.log10(expected) == pytest.approx(-11.9, abs=0.1)


def test_hidden_scatterers_are_silent() -> None:
    """A plate before the floor's middle takes its shadow out, not more."""
    screen = replace(plate("screen", (5.0, 0, -0.5), 1.0), radar="obstacle")
    alone, hidden = (echoes(scene(*objects), 20_000) for objects in ((floor(),), (floor(), screen)))
    assert 0 < len(hidden.delay_s) < len(alone.delay_s)
    across = np.abs(hidden.departure[:, 1] / hidden.departure[:, 0])
    down = -hidden.departure[:, 2] / hidden.departure[:, 0]
    assert not np.any((across < 0.099) & (down < 0.199))


# Not straight through the air.


def per_scatterer(found, count: int) -> np.ndarray:
    """Sums at the carrier of what comes from each, its walls' internal echoes included."""
    turns = CARRIER_HZ * found.delay_s % 1.0
    return (found.amplitude * np.exp(-2j * np.pi * turns)).reshape(-1, count).sum(axis=0)


@pytest.mark.parametrize(("material", "depth"), [("wood", 0.0125), ("reference_20", 0.1)])
def test_a_rough_patch_behind_a_wall(material: str, depth: float) -> None:
    """Mean power by the slab's transmission there and back, and by the spreading that a slab takes
    off, within 0.1 dB; the delay by its optical thickness, within 1 mm of range.
    """
    patch = replace(plate("patch", (6.0, 0, 0), 0.3, "asphalt"), radar="surface")
    panel = box("panel", (3.0, -15, -15), (3.0 + depth, 15, 15), material)
    alone, through = (echoes(scene(*objects), 2000) for objects in ((patch,), (patch, panel)))
    count = len(alone.delay_s)
    index = np.sqrt(permittivity(material))
    factor = slab(permittivity(material), depth, 0.0, CARRIER_HZ)[0] ** 2
    factor *= (6 / (6 - depth * (1 - 1 / index.real))) ** 2
    powers = [np.mean(np.abs(per_scatterer(found, count)) ** 2) for found in (through, alone)]
    ratio = powers[0] / powers[1]
    assert 10 * np.log10(ratio / abs(factor) ** 2) == pytest.approx(0, abs=0.1)
    later = (through.delay_s[:count] - alone.delay_s) * speed_of_light / 2
    np.testing.assert_allclose(later, depth * (index.real - 1), atol=1e-3)


def test_the_far_face_of_a_wall_lies_behind_it() -> None:
    """Both faces of 12.5 mm of wood that is rough itself: the far one answers through the slab."""
    panel = replace(box("w", (5.0, -0.5, -0.5), (5.0125, 0.5, 0.5), "wood"), radar="surface")
    s = replace(scene(panel), materials=rough("wood"))
    found = echoes(s, 4000)
    across = np.abs(found.departure[:, 1:] / found.departure[:, :1]).max(axis=1)
    found = found.take(across < 0.095)  # without the slab's narrow sides
    x = found.delay_s * speed_of_light / 2 * found.departure[:, 0]
    near = np.abs(x - 5.0) < 2e-3
    later = np.real(np.sqrt(permittivity("wood"))) * 0.0125
    far = np.abs(x - 5.0 - later) < 2e-3
    assert near.sum() > 100
    assert far.sum() > 100
    rest = ~near & ~far
    trips = np.count_nonzero(rest) / far.sum()
    assert trips == round(trips)  # each within the slab, once more to and fro
    sums = per_scatterer(found.take(~near), int(far.sum()))
    ratio = np.mean(np.abs(sums) ** 2) / np.mean(np.abs(found.amplitude[near]) ** 2)
    factor = abs(slab(permittivity("wood"), 0.0125, 0.0, CARRIER_HZ)[0]) ** 4
    assert 10 * np.log10(ratio / factor) == pytest.approx(0, abs=0.2)


def clutter_of(scene: Scene, prepared: PreparedScene, name: str) -> Contributions:
    """Of one object, without gains."""
    parts, _ = surface_clutter(scene, prepared, {name}, Fidelity(radar="rough"))
    return Contributions.concatenate(list(parts))


@pytest.mark.parametrize("material", ["wood", "asphalt"])
def test_a_mirror_does_not_show_its_own_face(material: str) -> None:
    """A rough wall, seen through or solid, and its image: no way from its points over itself."""
    panel = box("panel", (3.0, -15, -15), (3.0125, 15, 15), material)
    s = replace(scene(panel), materials=rough(material))
    prepared = prepare_scene(
        s,
        RADAR,
        assign_scattering_models(s, WAVELENGTH_M, with_optics=True),
        1,
        rough={"panel"},
    )
    assert {prepared.via(n) for n in range(len(prepared.images))} == {
        ()
    }  # nothing else is heard over it
    prepared = prepared.with_images(prepared.all_images)
    assert ("panel",) in {prepared.via(n) for n in range(len(prepared.images))}
    rays = clutter_of(s, prepared, "panel")
    assert len(rays.source) > 1000
    assert not rays.source.any()
    assert not rays.receiver.any()


def test_the_floor_behind_a_mirror() -> None:
    """A metal wall at 22 m: the floor before it answers over it too. Power by way of the mirror
    both ways is that of the mirrored floor, out one way and home the other that of bistatic
    scattering between the two angles; each against its integral, within 0.1 dB.
    """
    mirror = plate("mirror", (22.0, 0, 0), 60.0)
    s = scene(floor(), mirror)
    roles = assign_scattering_models(s, WAVELENGTH_M, with_optics=True)
    prepared = prepare_scene(s, RADAR, roles, 1, rough={item.name for item in s.objects})
    rays = clutter_of(s, prepared, "floor")
    (number,) = {int(n) for n in rays.source if n}
    n = 1000
    x = 8 + 12 * (np.arange(n) + 0.5) / n
    y = -4 + 8 * (np.arange(n) + 0.5) / n
    distance = [np.sqrt(d[:, None] ** 2 + y**2 + 1) for d in (x, 44 - x)]
    for out, home in ((0, 0), (0, number), (number, 0), (number, number)):
        which = (rays.source == out) & (rays.receiver == home)
        one, other = distance[bool(out)], distance[bool(home)]
        density = GAMMA * WAVELENGTH_M**2 / (4 * np.pi) ** 3 / (one * other) ** 2.5
        expected = density.sum() * 96 / n**2
        found = np.sum(np.abs(rays.amplitude[which]) ** 2)
        assert 10 * np.log10(found / expected) == pytest.approx(0, abs=0.1)


@pytest.mark.parametrize("carrier", [2.2e9, 2.8e9, 76.5e9, 80.5e9])
def test_every_material_answers_in_both_bands(carrier: float) -> None:
    """With a permittivity of at least 1 and a loss, each from a source or assumed."""
    from twin.radar.propagation.scene.materials import radio_properties

    for name, row in MATERIALS.items():
        permittivity, conductivity, _ = radio_properties(name, row, carrier)
        assert 1 <= permittivity < 50, name
        assert conductivity > 0, name
        if row.surface and row.surface.backscatter_gamma:
            assert 1e-4 < row.surface.backscatter_gamma.value < 1, name


def test_points_answer_with_the_wavelength_of_each_step() -> None:
    """A constant gamma at every carrier of a sweep: amplitudes go as lambda, as is the radar
    equation's.
    """
    radar = load_radar("prototype")
    floor = world(ground(-1.0, "asphalt"), plate("p", (6, 0, 0), 1.0))
    found = trace(floor, radar, fidelity=Fidelity(radar="rough", radar_scatterers=1000))
    diffuse = found.echoes.take(found.echoes.wavelength_power == 1)
    assert len(diffuse) > 100
    alone = Propagation(diffuse)
    levels = np.abs(contributions(alone, radar, Atmosphere(None)).amplitude)[
        :, :-1
    ]  # less the leakage
    levels = levels[:, levels[0] > 0]
    ratio = radar.burst.carriers_hz[0] / radar.burst.carriers_hz[:, None]
    np.testing.assert_allclose(levels / levels[0], ratio * np.ones(levels.shape[1]))

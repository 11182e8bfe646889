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
    plate,
    wave,
    world,
)
from twin.fidelity import Fidelity
from twin.radar.propagation.rough import coherent
from twin.radar.propagation.sionna_paths import trace
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
        s, RADAR, fidelity=Fidelity(radar="rough", radar_scatterers=count), seed=seed
    ).echoes


def floor() -> SceneObject:
    """12 x 8 m, 1 m below the radar, from 8 m on."""
    corners = np.array([[8, -4, -1], [20, -4, -1], [20, 4, -1], [8, 4, -1]], float)
    return replace(
        plate("floor", (0, 0, 0), material="asphalt"), vertices_m=corners, radar="surface"
    )


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


@pytest.mark.parametrize("count", [10_000, 100_000, 1_000_000])
def test_mean_power_does_not_depend_on_the_number(count: int) -> None:
    """Of scatterers: within 0.1 dB of the integral, averaged over four surfaces at 1e4."""
    runs = 4 if count == 10_000 else 1
    found = np.mean(
        [np.sum(np.abs(echoes(scene(floor()), count, seed).amplitude) ** 2) for seed in range(runs)]
    )
    assert 10 * np.log10(found / expected_power()) == pytest.approx(0, abs=0.1)


def test_speckle_is_exponential() -> None:
    """Power over 200 surfaces of other seeds: a Kolmogorov-Smirnov test against the exponential
    with its mean, at a false-alarm rate of 1e-3, and the phase against the uniform one, likewise.
    """
    waves = np.array([wave(echoes(scene(floor()), 2000, seed)) for seed in range(200)])
    power = np.abs(waves) ** 2
    assert stats.kstest(power / expected_power(), "expon").pvalue > 1e-3
    assert stats.kstest(np.angle(waves) / (2 * np.pi) + 0.5, "uniform").pvalue > 1e-3


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
    moved = replace(wall, vertices_m=wall.vertices_m + np.array(velocity) * step)
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


@pytest.mark.parametrize("carrier", [2.2e9, 2.8e9, 76.5e9, 80.5e9])
def test_every_material_answers_in_both_bands(carrier: float) -> None:
    """With a permittivity of at least 1 and a loss, each from a source or assumed."""
    from twin.radar.propagation.materials import radio_properties

    for name, row in MATERIALS.items():
        permittivity, conductivity, _ = radio_properties(name, row, carrier)
        assert 1 <= permittivity < 50, name
        assert conductivity > 0, name
        if row.surface and row.surface.backscatter_gamma:
            assert 1e-4 < row.surface.backscatter_gamma.value < 1, name

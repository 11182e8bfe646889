"""Which large surfaces a tolerance takes for rough: a bound of their clutter that holds."""

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
    world,
)
from twin.fidelity import Fidelity, Tolerance
from twin.radar.propagation.result import Propagation
from twin.radar.propagation.scene.culling import noise_amplitude
from twin.radar.propagation.solvers import trace
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

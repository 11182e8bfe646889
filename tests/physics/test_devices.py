"""Real lenses, LEDs and mirrors against closed forms and brute-force integrals in float64."""

import itertools
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import integrate, stats

from twin.fidelity import Fidelity
from twin.optics.devices import Device
from twin.optics.emission import (
    cell_gains,
    emission_matrix,
    independent_patterns,
    lobe_exponent,
)
from twin.optics.matrix import transport_matrix
from twin.optics.paths import TracingQuality
from twin.optics.problem import LightProblem
from twin.optics.transport import sunlight, transport
from twin.scene.mitsuba import _assemble
from twin.system import Emitter, System, load_part, load_system

TAN = math.tan(math.radians(10))
HERE = Device(np.zeros(3), np.eye(3), TAN)
ALL = TracingQuality(64, 1)


def wall(distance_m: float, left=(-50.0, 50.0), up=(-50.0, 50.0)):
    """White, facing the device, from right to left and from bottom to top."""
    (y0, y1), (z0, z1) = left, up
    corners = np.array([[0, y0, z0], [0, y1, z0], [0, y1, z1], [0, y0, z1]], dtype=np.float64)
    faces = np.array([[0, 2, 1], [0, 3, 2]])
    return _assemble([(corners + [distance_m, 0, 0], faces, None, 0.5)])


def cells(emitter: Device, detector: Device = HERE, shape=(16, 16), world=None, quality=ALL):
    problem = LightProblem(world or wall(5.0), emitter, detector)
    return transport(problem, shape, quality=quality, seed=1).total


def test_blur_softens_an_edge_as_the_error_function() -> None:
    """The wall ends on the axis; a cell at x sees the blurred share of it, box (x) Gauss."""
    sigma = 0.03 * TAN
    world = wall(5.0, left=(0.0, 50.0))
    quality = TracingQuality(1024, 1)
    sharp = cells(HERE, world=wall(5.0), quality=quality)
    soft = cells(replace(HERE, blur_tan=sigma), replace(HERE, tan_half_field=3 * TAN), world=world)
    wide = cells(replace(HERE, blur_tan=0.0), replace(HERE, tan_half_field=3 * TAN))
    share = (soft / wide).mean(axis=0)
    edges = TAN * (1 - 2 * np.arange(17) / 16)
    expected = [
        integrate.quad(lambda x: stats.norm.cdf(x / sigma), b, a)[0] / (a - b)
        for a, b in itertools.pairwise(edges)
    ]
    assert sharp.min() > 0
    np.testing.assert_allclose(share, expected, atol=0.01)


def test_blur_and_fill_look_alike_from_both_sides() -> None:
    """Dual draws the blurred direction, scatter the blurred cell: one matrix. Student t over 12
    seeds each, false alarm 1e-4 over all entries.
    """
    emitter = replace(HERE, blur_tan=0.05 * TAN, fill_factor=0.4)
    detector = replace(HERE, blur_tan=0.02 * TAN, edge_illumination=0.5)
    problem = LightProblem(wall(5.0, left=(0.1, 50.0)), emitter, detector)
    both = {
        start: np.array(
            [
                transport_matrix(
                    problem, (4, 4), (2, 4), quality=TracingQuality(1024, 1), seed=s, start=start
                )[0]
                for s in range(12)
            ]
        )
        for start in ("dual", "scatter")
    }
    lit = both["dual"].mean(axis=0) > 1e-3 * both["dual"].max()
    _, p = stats.ttest_ind(both["dual"][:, lit], both["scatter"][:, lit], equal_var=False)
    assert lit.sum() > 10
    assert p.min() > 1e-4 / lit.sum()


def test_a_half_filled_cell_lights_only_its_middle() -> None:
    """On a whole wall the light is the same; a wall that covers the outer fifth of a cell is
    missed by a lit square that leaves a quarter on either side.
    """
    gaps = replace(HERE, fill_factor=0.25)
    assert cells(gaps).sum() == pytest.approx(cells(HERE).sum(), rel=2e-3)
    cell = 5.0 * 2 * TAN / 16
    sliver = wall(5.0, left=(0.8 * cell, 50.0))
    column = 7  # from the axis one cell to the left
    assert cells(HERE, world=sliver)[8, column] > 0
    assert cells(gaps, world=sliver)[8, column] == 0
    assert cells(gaps, world=sliver)[8, column - 1] > 0


def test_a_lobe_falls_to_half_at_half_the_viewing_angle() -> None:
    """cos^m over the field: the sum against a float64 integral of cos^(7 + m)."""
    m = lobe_exponent(20.0)
    assert math.cos(math.radians(10)) ** m == pytest.approx(0.5)
    ratio = cells(replace(HERE, lobe_exponent=m)).sum() / cells(HERE).sum()
    node, weight = np.polynomial.legendre.leggauss(64)
    cos = (1 + (TAN * node[:, None]) ** 2 + (TAN * node) ** 2) ** -0.5
    expected = (weight @ cos ** (7 + m) @ weight) / (weight @ cos**7 @ weight)
    assert ratio == pytest.approx(expected, rel=2e-3)


def test_bare_leds_light_a_wall_as_their_lobes_say() -> None:
    """Each LED against the integral over the wall inside the detector's field, float64."""
    m, pitch, z = lobe_exponent(20.0), 0.05, 2.0
    array = replace(HERE, pitch_m=pitch, lobe_exponent=m)
    detector = replace(HERE, origin_m=np.array([0, -0.1, 0]))
    found = cells(array, detector, (2, 4), wall(z), TracingQuality(128**2, 1))
    node, weight = np.polynomial.legendre.leggauss(200)
    y, x = np.meshgrid(z * TAN * node, z * TAN * node)  # field of the detector on the wall
    area = np.outer(weight, weight) * (z * TAN) ** 2
    for row in range(2):
        for column in range(4):
            left = pitch * (1.5 - column)
            up = pitch * (0.5 - row)
            to_led2 = z**2 + (x - 0.1 - left) ** 2 + (y - up) ** 2
            cos_led = z / np.sqrt(to_led2)
            to_detector2 = z**2 + x**2 + y**2
            irradiance = cos_led**m * cos_led / to_led2 / 8  # eight LEDs share the intensity
            seen = irradiance * 0.5 / np.pi * (z**2 / to_detector2) / to_detector2
            assert found[row, column] == pytest.approx((seen * area).sum(), rel=3e-3)


def test_a_large_pupil_close_by_is_no_point() -> None:
    """A lit spot and a coaxial disc of radius a: the mean irradiance is that of a point times
    z^2 / (z^2 + a^2), the form factor of a disc.
    """
    spot = replace(HERE, tan_half_field=1e-3)
    wide = replace(HERE, tan_half_field=2.0)
    z, a = 1.0, 0.5
    ratio = (
        cells(
            spot, replace(wide, pupil_radius_m=a), world=wall(z), quality=TracingQuality(1024, 1)
        ).sum()
        / cells(spot, wide, world=wall(z)).sum()
    )
    assert ratio == pytest.approx(z**2 / (z**2 + a**2), rel=5e-3)


@pytest.mark.parametrize("focus_m", [math.inf, 2.0])
def test_a_point_out_of_focus_is_seen_by_part_of_the_pupil(focus_m: float) -> None:
    """A spot half a pupil radius outside the field. Focused on it: not seen. Focused at infinity:
    by the segment of the pupil beyond a/2, arccos(1/2) / pi - sqrt(3) / (4 pi) = 0.1955 of it.
    """
    z, a = 2.0, 0.02
    detector = replace(HERE, pupil_radius_m=a, focus_m=focus_m)
    aside = z * TAN + a / 2
    spot = replace(HERE, tan_half_field=1e-5, origin_m=np.array([0, aside, 0]))
    everything = replace(detector, tan_half_field=1.0)
    seen = cells(spot, detector, world=wall(z), quality=TracingQuality(1024, 1)).sum()
    whole = cells(spot, everything, world=wall(z), quality=TracingQuality(1024, 1)).sum()
    segment = math.acos(0.5) / math.pi - math.sqrt(3) / (4 * math.pi)
    assert seen / whole == pytest.approx(segment if focus_m == math.inf else 0, abs=2e-3)


def test_vignetting_darkens_the_edge_of_image_and_sun_alike() -> None:
    """v^(r^2): against the integral over the field; the sun's part at the edge's middle has v."""
    dim = replace(HERE, edge_illumination=0.5)
    node, weight = np.polynomial.legendre.leggauss(64)
    r2 = node[:, None] ** 2 + node**2
    cos = (1 + TAN**2 * r2) ** -0.5
    expected = (weight @ (cos**7 * 0.5**r2) @ weight) / (weight @ cos**7 @ weight)
    assert cells(HERE, dim).sum() / cells(HERE).sum() == pytest.approx(expected, rel=2e-3)
    sun = np.array([-1.0, 0, 0])
    parts = [
        sunlight(LightProblem(wall(5.0), HERE, d, sun), (65, 65), quality=ALL, seed=1).total
        for d in (dim, HERE)
    ]
    ratio = parts[0] / parts[1]
    assert ratio[32, 32] == pytest.approx(1, abs=1e-3)
    assert ratio[32, 0] == pytest.approx(0.5 ** ((64 / 65) ** 2), rel=1e-3)


def led_array(**changes: object) -> Emitter:
    part = load_part("eold-1550-525-16x16").emitter
    assert part is not None
    return Emitter.model_validate({**part.model_dump(), **changes})


def test_a_perfect_lens_keeps_cells_apart_and_bare_leds_do_not() -> None:
    """Singular values above 1 %: all 256 behind a lens; bare, a handful at 5 m, more up close."""
    perfect = emission_matrix(led_array(), 5.0)
    np.testing.assert_array_equal(perfect, np.eye(256))
    bare = led_array(projection="none", pitch_m=0.01, viewing_angle_deg=20.0)
    assert independent_patterns(perfect) == 256
    at = {z: independent_patterns(emission_matrix(bare, z)) for z in (0.2, 1.0, 5.0)}
    assert at[5.0] <= 6
    assert at[0.2] > at[1.0] > at[5.0]


def test_a_blurred_matrix_is_the_integral_of_its_gaussian() -> None:
    """One entry by quadrature; rows sum to one away from the edges."""
    matrix = emission_matrix(led_array(blur_rms_deg=0.5), 5.0)
    sigma = math.tan(math.radians(0.5)) / TAN
    row, column = 8 * 16 + 8, 8 * 16 + 9
    width = 2 / 16
    one, _ = integrate.quad(
        lambda x: stats.norm.cdf((width - x + width) / sigma) - stats.norm.cdf((width - x) / sigma),
        0,
        width,
    )
    same, _ = integrate.quad(
        lambda x: stats.norm.cdf((width - x) / sigma) - stats.norm.cdf(-x / sigma), 0, width
    )
    assert matrix[row, column] == pytest.approx(one * same / width**2, rel=1e-6)
    assert matrix[row].sum() == pytest.approx(1, rel=1e-9)


def test_a_blurred_emitter_sends_what_its_matrix_says() -> None:
    """Rendered cells of a blurred emitter = M x rendered cells of a sharp one, on the edge."""
    emitter = led_array(blur_rms_deg=0.5)
    blurred = replace(HERE, blur_tan=math.tan(math.radians(0.5)))
    world = wall(5.0, left=(0.0, 50.0))
    wide = replace(HERE, tan_half_field=3 * TAN)
    sharp = cells(HERE, wide, world=world, quality=TracingQuality(256, 1))
    soft = cells(blurred, wide, world=world, quality=TracingQuality(128**2, 1))
    expected = (emission_matrix(emitter, 5.0) @ sharp.ravel()).reshape(16, 16)
    inner = slice(2, 14), slice(2, 14)
    np.testing.assert_allclose(soft[inner], expected[inner], atol=0.015 * sharp.max())


def test_unequal_cells_are_drawn_once_and_for_all() -> None:
    uneven = led_array(intensity_spread=0.1, intensity_seed=3)
    gains = cell_gains(uneven)
    np.testing.assert_array_equal(gains, cell_gains(uneven))
    assert gains.mean() == pytest.approx(1)
    assert gains.std() == pytest.approx(0.1, rel=5 / math.sqrt(2 * 256))  # 5 sigma
    assert not np.array_equal(gains, cell_gains(led_array(intensity_spread=0.1, intensity_seed=4)))


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        ('projection = "none"\n', "projection none needs pitch_m"),
        ("pitch_m = 6e-3\n", "pitch_m = 0.006: expected none behind a lens"),
        ("contrast_ratio = 1.0\n", "contrast_ratio"),
        ("fill_factor = 1.5\n", "fill_factor"),
        ("blur_rms_deg = -1.0\n", "blur_rms_deg"),
    ],
)
def test_bad_emitters_are_named(tmp_path: Path, content: str, complaint: str) -> None:
    from twin.files import InputError

    (tmp_path / "s.toml").write_text(f'base = "workable"\n[emitter]\n{content}')
    with pytest.raises(InputError) as caught:
        load_system(tmp_path / "s.toml")
    assert complaint in str(caught.value)


def test_a_closed_white_box_loses_no_light() -> None:
    """Between perfectly white walls every bounce brings as much light as the one before; with
    reflectance 0.8 that much of it. Means over 2e5 paths, 5 sigma.
    """
    import trimesh

    from twin.optics.time_of_flight import trace_paths

    box = trimesh.creation.box((4.0, 3.0, 2.0))
    vertices, faces = np.array(box.vertices, dtype=np.float64), np.array(box.faces)
    wide = replace(HERE, tan_half_field=3.0)
    for reflectance in (1.0, 0.8):
        paths = trace_paths(
            LightProblem(_assemble([(vertices, faces, None, reflectance)]), wide, wide),
            (2, 2),
            quality=TracingQuality(224**2, 12),
            seed=4,
        )
        value = paths.value.reshape(4, 12, -1).sum(axis=0)  # by bounce
        # After a few bounces light has forgotten where it came from.
        mean, error = value.mean(axis=1), value.std(axis=1) / math.sqrt(value.shape[1])
        ratio = mean[7:] / mean[6:-1]
        spread = np.hypot(error[7:] / mean[7:], error[6:-1] / mean[6:-1])
        assert (np.abs(ratio / reflectance - 1) < 5 * spread).all()


def test_signal_scales_with_area_and_f_number_at_a_fixed_field(tmp_path: Path) -> None:
    """Same field: twice the diameter four times the light; f/1 to f/2 as 5 to 17."""
    from twin.camera import capture
    from twin.scene import load_scene

    def watts(**changes: str) -> tuple[float, float]:
        text = "".join(f"[{k}]\n{v}\n" for k, v in changes.items())
        (tmp_path / "s.toml").write_text(f'base = "workable"\n{text}')
        system: System = load_system(tmp_path / "s.toml")
        taken = capture(load_scene("table1"), system, fidelity=Fidelity(4, 1))
        return float(taken.signal_w.mean()), taken.background_w

    for before, after, law in (
        ("detector", {"detector": "width_m = 6e-3"}, 4.0),
        ("optics", {"optics": "f_number = 2.0"}, 5 / 17),
    ):
        one, two = watts(), watts(**after)
        assert before in after
        np.testing.assert_allclose(np.divide(two, one), law, rtol=1e-9)

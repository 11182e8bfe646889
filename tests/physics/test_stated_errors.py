"""The benchmark of stated errors: its cases, its truths, and a few of its verdicts."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.special import ndtr

from benchmarks.stated_errors import light, light_cases, radar, radar_cases
from benchmarks.stated_errors.cells import AIM, CellErrors, compared
from benchmarks.stated_errors.choosing import Choosing
from benchmarks.stated_errors.judged import Cheapest, Judged, summary
from benchmarks.stated_errors.light_reference import LightReference
from benchmarks.stated_errors.light_truth import Renderer, SunRenderer, covers
from benchmarks.stated_errors.worlds import square, thing, world
from twin.camera.rendered import DetectorLight
from twin.optics.problem import LightProblem
from twin.optics.radiometry import cell_centres
from twin.trade.camera import CameraCase

_SEED = 7  # one of those that development takes


@pytest.mark.parametrize("cases", [light_cases.cases, radar_cases.cases])
def test_a_case_depends_on_seed_and_number_alone(cases: Callable[..., Iterator[Any]]) -> None:
    one, again, other = (
        next(cases(seed, count, ["4 "])) for seed, count in ((_SEED, 5), (_SEED, 9), (_SEED + 1, 5))
    )
    assert one.name == again.name
    assert one.tolerance == again.tolerance
    for a, b in zip(one.scene.objects, again.scene.objects, strict=True):
        assert np.array_equal(a.vertices_m, b.vertices_m)
    first, second = (c.scene.objects[0].vertices_m for c in (one, other))
    assert first.shape != second.shape or not np.allclose(first, second)


def test_functions_that_decide_are_found() -> None:
    """They are named by text: a renamed one would end the benchmark."""
    with Choosing() as choosing:
        pass
    assert choosing.seconds == 0


def _judged(stated: float, true: float, **more: object) -> Judged:
    return Judged("case", "image", 0.2, stated, true, 0.0, "of a pixel's noise", **more)  # type: ignore[arg-type]


def test_an_error_that_the_truth_is_known_well_enough_to_show_counts() -> None:
    """The truth known to 2, stated 1: an error of 5 may be the truth's, one of 8 is not."""
    ones = [Judged("case", "image", 0.2, 1.0, true, 2.0, "of it") for true in (0.0, 5.0, 8.0)]
    assert [one.is_decided for one in ones] == [True, False, True]


def _drawn(rng: np.random.Generator, stated_share: float, n_cells: int) -> tuple[Judged, float]:
    """An image whose errors are normal, of which standard errors are stated that are this share of
    the true ones; the truth errs by half of what is stated.
    """
    error = np.exp(rng.normal(0, 0.5, n_cells))
    stated, own = stated_share * error, 0.5 * stated_share * error
    true_light, noise = np.full(n_cells, 100.0), np.ones(n_cells)
    seen = DetectorLight((true_light + error * rng.normal(size=n_cells))[None], stated[None])
    truth = LightReference(
        true_light + own * rng.normal(size=n_cells), own, noise, np.zeros((8, n_cells)), None
    )
    one = Judged("case", tolerance=0.2, **light.of_image(seen, truth))
    assert one.cells is not None
    return one, one.cells.share


def test_images_of_perfect_errors_pass_and_standard_errors_too_small_do_not() -> None:
    """Of 200 images of 1024 cells all but a few with right standard errors have 93 % of their cells
    within (0.4 of 100 have not, by the binomial distribution), and the root mean square error is
    within 15 % of the expected. With standard errors of 1 / 1.5 of the true ones not one has, of
    256 cells even, and the ratio tells the factor (1.42 with the truth's own error). A root mean
    square over 1.96 standard errors would be 0.51 and 0.77: both would pass.
    """
    rng = np.random.default_rng(1)
    right = [_drawn(rng, 1.0, 1024) for _ in range(200)]
    assert sum(share >= AIM for _, share in right) >= 195
    assert all(one.ratio == pytest.approx(1.0, abs=0.15) for one, _ in right)
    small = [_drawn(rng, 1 / 1.5, 256) for _ in range(200)]
    assert not any(share >= AIM for _, share in small)
    assert np.median([one.ratio for one, _ in small]) == pytest.approx(1.42, abs=0.05)


@pytest.mark.parametrize(("factor", "least", "most"), [(1.0, 0.8, 0.95), (1.5, 0.0, 0.01)])
def test_100_figures_tell_standard_errors_too_small_by_half(
    factor: float, least: float, most: float
) -> None:
    """The chance that 93 of 100 figures lie within their intervals, from 500 draws: 0.87 by the
    binomial distribution for right standard errors, less than 0.01 where the true ones are 1.5
    times as large. The truth errs by a fifth of what is stated.
    """
    rng, passed = np.random.default_rng(2), 0
    for _ in range(500):
        off = np.abs(rng.normal(0, factor, 100) + rng.normal(0, 0.2, 100))
        found = [Judged("case", "PSNR", 0.2, 1.96, float(true), 0.2 * 1.96, "dB") for true in off]
        assert all(one.is_decided for one in found)
        passed += np.mean([one.ratio <= 1 for one in found]) >= AIM
    assert least <= passed / 500 <= most


def test_cells_whose_truth_is_known_too_little_are_counted_apart() -> None:
    """Of five cells one is within, one twice beyond, the truth of one is known to five times what
    is stated, one is dark, and one off by less than counts.
    """
    off, error = np.array([1.0, 3.92, 6.0, 0.0, 1e-9]), np.array([1.0, 1.0, 1.0, 0.0, 0.0])
    cells = compared(off, error, np.zeros(5), np.array([0.0, 0.0, 5.0, 0.0, 0.0]), 1e-6)
    assert cells == CellErrors(judged=2, within=1, largest=2.0, undecided=1)


def test_undecided_bodies_and_those_of_no_independent_truth_are_told() -> None:
    known = Judged("case", "car", 0.1, 0.1, 0.05, 0.01, "of its echo", truth="sums of currents")
    same = replace(known, figure="ball", is_independent=False, truth="the solver at its finest")
    unknown = replace(known, figure="post", truth_error=0.5)
    said = {name: value for name, value, _ in summary("radar", [known, same, unknown])}
    assert said["radar: undecided, not counted"] == 1
    assert said["radar: within the stated interval"] == 100
    assert "truth, not independent: the solver at its finest" in str(same)
    assert "undecided" in str(unknown)


def test_the_summary_counts() -> None:
    """Three of four within, the fourth at twice its interval; twice the time of the cheapest."""
    cheapest = Cheapest(1.0, "64 paths")
    found = [
        _judged(1.0, x, seconds=2.0, cheapest=cheapest, searched=True, choosing=0.1)
        for x in (0, 0.5, 1, 2)
    ]
    said = {name: value for name, value, _ in summary("light", found)}
    assert said["light: within the stated interval"] == 75.0
    assert said["light: largest error over the stated one"] == 2.0
    assert said["light: time over that of the cheapest sufficient knobs, median"] == 2.0
    assert said["light: choosing, largest"] == pytest.approx(10.0)


def test_nothing_stated_is_no_statement() -> None:
    assert _judged(0.0, 1e-9).ratio == np.inf
    assert _judged(0.0, 0.0).ratio == 0.0


def test_the_truth_of_light_is_that_of_a_wall() -> None:
    """Stock Mitsuba's projector and camera against the integral over the field, within their steps
    (0.2 %); a projector turned or mirrored, or a wrong power of its cosine, would be off by more.
    """
    wall = thing("wall", square(np.array([5.0, 0, 1]), np.array([-1.0, 0, 0]), 10.0), 0.5)
    drawn = next(light_cases.cases(_SEED, 1, ["0 "]))
    case = CameraCase.of(world([wall]), drawn.system, 0)
    emitter, detector = case.problem.emitter, case.problem.detector
    problem: LightProblem = replace(
        case.problem,
        emitter=replace(emitter, blur_tan=0.0),
        detector=replace(detector, origin_m=np.zeros(3)),
    )
    cells = Renderer(problem, case.system.image_shape).render(4, 1)
    t = problem.emitter.tan_half_field
    x, weight = np.polynomial.legendre.leggauss(64)
    exact = (
        0.5 / np.pi / 25 * t**2 * weight @ (1 + t**2 * (x[:, None] ** 2 + x**2)) ** -3.5 @ weight
    )
    assert cells.sum() == pytest.approx(exact, rel=2e-3)


def test_blur_moves_light_to_the_cells_beside() -> None:
    """Light on one half of the field alone, blurred by half a cell: each cell has the integral of
    the error function over its width, to a thousandth; without blur the step.
    """
    pixels = 1.5 * cell_centres(3000)
    light = (pixels > 0) * 1e-3
    blur = 0.125
    plain, blurred = (covers(8, pixels, x) @ light for x in (0.0, blur))
    assert plain == pytest.approx([0, 0, 0, 0, 0.25, 0.25, 0.25, 0.25], abs=2e-3)
    edges = np.linspace(-1, 1, 9)
    # The integral of ndtr(x / blur).
    whole = edges * ndtr(edges / blur) + blur * np.exp(-((edges / blur) ** 2) / 2) / np.sqrt(
        2 * np.pi
    )
    assert blurred[:-1] == pytest.approx(np.diff(whole)[:-1], abs=1e-3 * 0.25)


def test_the_truth_of_the_sun_is_that_of_a_wall() -> None:
    """A wall across a round field under the sun: its radiance, reflectance / pi times the cosine of
    incidence, over the projected solid angle of the field, to 0.3 % (the field's edge is in steps
    of a pixel). A sun from the other side would leave it dark, a square field be 27 % brighter.
    """
    wall = thing("wall", square(np.array([5.0, 0, 1]), np.array([-1.0, 0, 0]), 30.0), 0.5)
    drawn = next(light_cases.cases(_SEED, 1, ["0 "]))
    problem = CameraCase.of(world([wall]), drawn.system, 0).problem
    problem = replace(problem, detector=replace(problem.detector, outline="disc"))
    assert problem.sun_direction is not None
    radiance = 0.5 / np.pi * -problem.sun_direction[0]
    assert radiance > 0
    tan = problem.detector.tan_half_field
    parts = SunRenderer(problem, (32, 32)).render(4, 1)
    exact = radiance * np.pi * tan**2 / (1 + tan**2)
    assert parts.sum() == pytest.approx(exact, rel=3e-3)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["grazing floor", "keyhole", "strong beside weak"])
def test_errors_of_light_are_within_those_stated(name: str) -> None:
    """Without median SNR and SSIM, whose intervals are too narrow in one case of five and of four
    (`docs/validation/stated_errors.md`).
    """
    case = next(light_cases.cases(_SEED, 0, [name]))
    for one in light.judged(case, 5.0, search=False):
        if one.figure in ("median SNR", "SSIM"):
            continue
        if one.cells:
            assert one.cells.share >= AIM, str(one)
        elif one.is_decided:
            assert one.ratio <= 1, str(one)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["strong beside weak", "keyhole", "tiny facing facet"])
def test_errors_of_bodies_are_within_those_stated(name: str) -> None:
    case = next(radar_cases.cases(_SEED, 0, [name]))
    for one in radar.judged(case, search=False):
        assert one.ratio <= 1, str(one)

"""The regression plugin's verdicts: how often they alarm, what they find, what they forgive."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom, hypergeom, ttest_1samp

from benchmarks.planted_losses import planted, share_worse
from twin.accuracy import Interval
from twin.regression.metrics import CAMERA_METRICS, RADAR_METRICS, Metric
from twin.regression.runs import SeedResults, repeated, run_camera
from twin.regression.statistics import compare, repeats, smallest_loss


def one(name: str = "psnr_db", **changes: object) -> Metric:
    (metric,) = (m for m in (*CAMERA_METRICS, *RADAR_METRICS) if m.name == name)
    return replace(metric, **changes)


def test_the_verdict_is_scipys_paired_t_test() -> None:
    """Bound against p-value, Bonferroni over three metrics and the test of single seeds, on both
    sides of the threshold.
    """
    rng = np.random.default_rng(0)
    metrics = CAMERA_METRICS
    said = []
    for _ in range(300):
        before = {m.name: rng.normal(40, 1, 12) for m in metrics}
        shift = rng.uniform(-0.1, 0.5)
        after = {
            m.name: before[m.name]
            + (-1 if m.higher_is_better else 1) * (shift + rng.normal(0, 0.2, 12))
            for m in metrics
        }
        for verdict in compare(metrics, before, after, false_alarm=0.03):
            m = verdict.metric
            loss = (before[m.name] - after[m.name]) * (1 if m.higher_is_better else -1)
            tolerance = m.tolerance * (before[m.name].mean() if m.relative else 1)
            p = ttest_1samp(loss, tolerance, alternative="greater").pvalue
            assert verdict.worse == (p < 0.008)
            said.append(verdict.worse)
    assert 0.2 < np.mean(said) < 0.8


def test_pairs_that_are_equal_are_the_same_and_a_constant_loss_is_found() -> None:
    figures = np.random.default_rng(0).normal(30, 1, 8)
    same, lost = (
        compare([one()], {"psnr_db": figures}, {"psnr_db": figures - loss})[0]
        for loss in (0.0, 0.2)
    )
    assert not same.worse
    assert not same.better
    assert lost.worse
    assert lost.loss == pytest.approx(0.2)


def test_one_figure_that_is_no_number_is_worse() -> None:
    before = np.full(8, 30.0)
    for bad in (np.nan, -np.inf, np.inf):
        after = before.copy()
        after[3] = bad
        assert compare([one()], {"psnr_db": before}, {"psnr_db": after})[0].worse


def test_what_gives_no_test_is_refused() -> None:
    with pytest.raises(ValueError, match="8 seeds before, 4 after"):
        compare([one()], {"psnr_db": np.zeros(8)}, {"psnr_db": np.zeros(4)})
    with pytest.raises(ValueError, match="metrics: none"):
        compare([], {}, {})
    with pytest.raises(ValueError, match="false_alarm: 1 "):
        compare([one()], {"psnr_db": np.zeros(8)}, {"psnr_db": np.zeros(8)}, false_alarm=1)


@pytest.mark.whole
def test_false_alarms_and_power_of_normal_figures() -> None:
    """What the docstring states: at the tolerance, 0.8 of the stated false alarms, and the rest for
    the test of single seeds; at the smallest loss, 95 % power. 20 000 draws each; six standard
    deviations of the count.
    """
    rng, n, times = np.random.default_rng(1), 24, 20_000
    metric = one()
    sample = rng.normal(size=n)
    sample /= np.std(sample, ddof=1)  # the scatter that is drawn from below, known exactly
    smallest = smallest_loss(metric, sample, 1, 0.01)
    for loss, low, high in ((metric.tolerance, 0.008, 0.01), (smallest, 0.94, 0.96)):
        before = rng.normal(30, 1, (times, n))
        after = rng.normal(30 - loss, 1, (times, n))
        share = np.mean(
            [
                compare([metric], {"psnr_db": b}, {"psnr_db": a})[0].worse
                for b, a in zip(before, after, strict=True)
            ]
        )
        slack = 6 * np.sqrt(high * (1 - high) / times)
        assert low - slack < share < high + slack


@pytest.mark.thorough
@pytest.mark.parametrize("paired", [True, False])
def test_single_seeds_alarm_no_more_often_than_stated(paired: bool) -> None:
    """Normal figures of a method that is equally good: at most a fifth of 1 % of 10 000
    comparisons, the mean taking the rest; six standard deviations of the count.
    """
    rng, n, times, metric = np.random.default_rng(2), 16, 10_000, one()
    failed = 0
    for _ in range(times):
        before = rng.normal(30, 1, n)
        after = before + rng.normal(0, 0.1, n) if paired else rng.normal(30, 1, n)
        figures = {"psnr_db": before}, {"psnr_db": after}
        failed += bool(compare([metric], *figures, paired=paired)[0].failed)
    assert failed / times < 0.002 + 6 * np.sqrt(0.002 / times)


def test_failures_of_few_seeds_are_no_scatter() -> None:
    """A black image in 5 of 48, a target lost in 5 of 16, one detection too many in 4 of 16: each
    lies within the mean's confidence bound, for it widens the scatter by as much as it moves the
    mean. With the same records one seed is enough; with others, chance has to be ruled out.
    """
    rng = np.random.default_rng(3)
    psnr = rng.normal(43, 0.2, 48)
    black = psnr.copy()
    black[[3, 11, 20, 21, 40]] = 12.0
    none, lost, ghosts = np.zeros(16), np.zeros(16), np.full(16, 5.0)
    lost[[1, 4, 5, 9, 15]] = 1.0
    more = ghosts + (np.arange(16) % 4 == 1)
    for metric, before, after in (
        (one(), psnr, black),
        (one("missed"), none, lost),
        (one("unmatched"), ghosts, more),
    ):
        figures = {metric.name: before}, {metric.name: after}
        of_mean = compare([metric], *figures)[0]
        assert of_mean.low < of_mean.tolerance
        found = compare([metric], *figures, paired=True)[0]
        assert found.worse
        assert found.failed == tuple(np.flatnonzero(before != after))
        assert f"at {len(found.failed)} seeds: " in str(found)
    rare = {"missed": none}, {"missed": lost}
    assert not compare([one("missed")], *rare)[0].worse  # 5 of 16: a chance of 0.6 %
    often = {"missed": np.zeros(48)}, {"missed": np.tile(lost, 3)}
    assert compare([one("missed")], *often)[0].worse


def test_a_seed_lost_for_a_seed_won_is_no_failure() -> None:
    before = np.zeros(16)
    before[2], after = 1.0, np.zeros(16)
    after[7] = 1.0
    figures = {"missed": before}, {"missed": after}
    assert not compare([one("missed")], *figures, paired=True)[0].worse


def gain(rng: np.random.Generator, n: int, few: float) -> np.ndarray:
    """8 dB at most seeds, another at a fifth of them."""
    return np.where(rng.random(n) < 0.2, few, 8.0) + rng.normal(0, 0.1, n)


@pytest.mark.parametrize("n", [16, 48])
@pytest.mark.parametrize("few", [1.0, 0.0])
def test_a_seed_that_gains_less_than_the_others_is_not_worse(n: int, few: float) -> None:
    """8 dB gained at most seeds, 1 dB or nothing at a fifth: none of 300 comparisons alarms,
    where 1 % is stated. On 43f3f9f7 97 to 100 % do; of those without a gain 75 to 98 % would if
    a seed's own loss had to be beyond the tolerance alone, and not beyond the scatter.
    """
    rng = np.random.default_rng(10)
    for _ in range(300):
        before = rng.normal(30, 0.2, n)
        figures = {"psnr_db": before}, {"psnr_db": before + gain(rng, n, few)}
        assert not compare([one()], *figures, paired=True)[0].worse


def test_false_alarms_that_become_none_are_no_loss() -> None:
    """Counts as one seed in 200 draws them: where there was one or none, the others gain more."""
    before = np.array([2, 1, 2, 2, 3, 1, 4, 2, 2, 2, 2, 2, 0, 2, 2, 2], float)
    figures = {"unmatched": before}, {"unmatched": np.zeros(16)}
    assert not compare([one("unmatched")], *figures, paired=True)[0].worse


def test_a_seed_that_is_lost_is_found_though_all_others_gain() -> None:
    """2 dB lost where the others gain 1 dB, and gains of the others do not make up for it."""
    rng = np.random.default_rng(11)
    before = rng.normal(30, 0.2, 16)
    after = before + 1 + rng.normal(0, 0.1, 16)
    after[3] = before[3] - 2
    verdict = compare([one()], {"psnr_db": before}, {"psnr_db": after}, paired=True)[0]
    assert verdict.failed == (3,)


@pytest.mark.parametrize(("lost", "won", "worse"), [(5, 1, True), (2, 1, True), (3, 3, False)])
def test_seeds_won_make_up_for_as_many_lost_and_no_more(lost: int, won: int, worse: bool) -> None:
    """Counted one for one, on the same records: five targets lost for one won is a loss of four.
    On ee37b06 no number lost is one, whatever it is, as soon as one is won.
    """
    before, after = np.zeros(16), np.zeros(16)
    before[:won], after[8 : 8 + lost] = 1.0, 1.0
    figures = {"missed": before}, {"missed": after}
    verdict = compare([one("missed")], *figures, paired=True)[0]
    assert verdict.worse == worse
    assert verdict.failed == (tuple(range(8, 8 + lost)) if worse else ())


def test_a_false_alarm_more_in_a_quarter_of_the_seeds_is_not_made_up_for_by_one_less() -> None:
    """The yard's baseline has one in seeds 0, 10 and 12; that of seed 0 goes, three others come."""
    before = np.isin(np.arange(16), (0, 10, 12)).astype(float)
    after = np.isin(np.arange(16), (10, 12, 1, 5, 9, 13)).astype(float)
    figures = {"unmatched": before}, {"unmatched": after}
    assert compare([one("unmatched")], *figures, paired=True)[0].worse


def camera(rng: np.random.Generator, share: float, n: int) -> np.ndarray:
    """PSNR that is 10 dB down in a share of the seeds."""
    return rng.normal(30, 0.2, n) - 10 * (rng.random(n) < share)


def ghosts(rng: np.random.Generator, mean: float, n: int) -> np.ndarray:
    return rng.poisson(mean, n).astype(float)


@pytest.mark.quick(1)
@pytest.mark.parametrize(("name", "draw"), [("psnr_db", camera), ("unmatched", ghosts)])
@pytest.mark.parametrize("n", [16, 48])
def test_rare_failures_at_random_alarm_no_more_often_than_stated(name: str, draw, n: int) -> None:
    """A method that is as good as before, on the same records, fails at other seeds than before:
    with its failures run anew, 1 % of 1000 comparisons, six standard deviations of the count.
    Without, 24 to 44 % alarm, as long as more seeds failed than gained.
    """
    metric, times = one(name), 1000
    for share in (0.03, 0.1):
        rng, alarms, at_once = np.random.default_rng(7), 0, 0
        for _ in range(times):
            before, after = ({name: draw(rng, share, n)} for _ in range(2))

            def run(seeds, share=share, rng=rng) -> SeedResults:
                return SeedResults({name: draw(rng, share, len(seeds))}, None, [], "")

            verdict = compare([metric], before, after, paired=True)[0]
            at_once += verdict.worse
            if not repeated(
                run, SeedResults(after, None, [], ""), verdict.failed, repeats(n, 1, 0.01)
            ):
                verdict = compare([metric], before, after)[0]
            alarms += verdict.worse
        assert alarms / times < 0.01 + 6 * np.sqrt(0.01 / times)
        assert at_once / times > 0.15


def test_what_repeats_itself_is_asked_often_enough() -> None:
    """By trying: of 16 seeds those that fail now and did not before, at the worst probability, all
    fail again r times with at most 0.2 % of 200 000 (six standard deviations), and with r - 2 more.
    """
    rng, n, times = np.random.default_rng(8), 16, 200_000
    r = repeats(n, 1, 0.01)

    def passes(q: float, r: int) -> float:
        failed = rng.binomial(n, q * (1 - q), times)
        return np.mean((failed > 0) & (rng.binomial(r * failed, q) == r * failed))

    shares = np.linspace(0.05, 0.5, 10)
    assert max(passes(q, r) for q in shares) < 0.002 + 6 * np.sqrt(0.002 / times)
    assert max(passes(q, r - 2) for q in shares) > 0.002


@pytest.mark.parametrize("before", [0, 1, 3])
def test_failures_of_other_records_are_counted_though_some_failed_before(before: int) -> None:
    """As many of 48 as a brute-force search over both binomials allows: no probability of failing
    gives the tables at least as extreme by Fisher's exact test, which is what Boschloo's (1970)
    ranks them by, more often than 0.2 %.
    """
    n, alpha = 48, 0.002

    def figures(failed: int) -> dict[str, np.ndarray]:
        return {"missed": (np.arange(n) < failed).astype(float)}

    found = [
        k
        for k in range(before, 24)
        if compare([one("missed")], figures(before), figures(k))[0].failed
    ]
    k = np.arange(n + 1)
    after, first = np.meshgrid(k, k, indexing="ij")
    fisher = hypergeom.sf(after - 1, 2 * n, after + first, n)
    q = np.linspace(0, 1, 2001)[:, None]
    probability = binom.pmf(k, n, q)

    def p_value(failed: int) -> float:
        extreme = fisher <= fisher[failed, before] * (1 + 1e-12)
        return np.einsum("qi,ij,qj->q", probability, extreme, probability).max()

    expected = next(x for x in range(before + 1, n) if p_value(x) <= alpha)
    assert found[0] == expected
    assert found == list(range(expected, 24))


def test_chance_is_told_beside_what_failed() -> None:
    """Five lost for one won: 7 of 64 by McNemar's exact test."""
    before, after = np.zeros(16), np.zeros(16)
    before[0], after[8:13] = 1.0, 1.0
    verdict = compare([one("missed")], {"missed": before}, {"missed": after}, paired=True)[0]
    assert verdict.chance == pytest.approx(7 / 64)
    assert "at 5 seeds: 8, 9, 10, 11, 12 (p = 0.11 by chance)" in str(verdict)


def test_views_have_levels_of_their_own() -> None:
    """Two views 10 dB apart are no scatter: what fails in a third of the seeds is found all the
    same, on other records too; and a view 10 dB below the other is no failure.
    """
    rng, n = np.random.default_rng(9), 48
    level = np.where(np.arange(n) % 2, 40.0, 30.0)
    before, after = (level + rng.normal(0, 0.2, n) for _ in range(2))

    def failed(figures: np.ndarray, views: int) -> tuple[int, ...]:
        found = {"psnr_db": before}, {"psnr_db": figures}
        return compare([one()], *found, views=views)[0].failed

    assert not failed(after, 2)
    after[::3] -= 5.0
    assert failed(after, 2) == tuple(range(0, n, 3))
    assert not failed(after, 1)


def test_seeds_whose_figure_is_no_number_are_named() -> None:
    before = np.random.default_rng(0).normal(30, 1, 8)
    after = np.where(np.isin(np.arange(8), (2, 5)), [np.inf, np.nan] * 4, before)
    verdict = compare([one()], {"psnr_db": before}, {"psnr_db": after})[0]
    assert str(verdict) == "psnr_db: no number at 2 seeds: 2, 5: WORSE"


def test_a_changed_offset_is_worse_either_way() -> None:
    """And never better: a bias that brings echoes nearer to declared centres is still a bias."""
    metric = one("range_offset_m")
    before = np.random.default_rng(4).normal(-0.02, 1e-5, 16)
    for shift in (0.0375, -0.0375):
        verdict = compare(
            [metric], {metric.name: before}, {metric.name: before + shift}, paired=True
        )[0]
        assert verdict.worse
        assert verdict.loss == pytest.approx(0.0375)
    same = compare([metric], {metric.name: before}, {metric.name: before}, paired=True)[0]
    assert not same.worse
    assert not same.better


def test_what_the_errors_of_both_models_explain_is_no_loss() -> None:
    """A level 0.3 dB lower, of other records: within 0.1 dB of standard error before and 0.1 dB
    that were left out after, beyond a tenth of both; and gains are held to the same.
    """
    rng = np.random.default_rng(0)
    before = {"psnr_db": 30 + 0.01 * rng.normal(size=48)}
    after = {"psnr_db": 29.7 + 0.01 * rng.normal(size=48)}

    def verdict(share: float, before=before, after=after):
        errors = [{"psnr_db": Interval(30.0, 0.1 * share)}, {"psnr_db": Interval(29.7, 0, share)}]
        return compare([one()], before, after, errors=errors if share else ())[0]

    assert verdict(0).worse
    assert "for errors of both models" not in str(verdict(0))
    assert verdict(0.1).worse
    explained = verdict(1)
    assert not explained.worse
    assert not explained.failed
    assert "for errors of both models, as records differ, which explain the loss" in str(explained)
    assert verdict(0, after, before).better
    assert not verdict(1, after, before).better


def test_errors_of_models_keep_the_false_alarms_and_find_what_is_larger() -> None:
    """3000 comparisons of models with normal errors of 0.1 dB each, of figures that scatter by
    0.2 dB: at most 1 % alarm (1.5 % would by chance once in 200 times), 1 dB is found.
    """
    rng, metric = np.random.default_rng(1), one()
    errors = [{"psnr_db": Interval(30.0, 0.1)}] * 2

    def alarms(loss: float, errors, times: int) -> float:
        worse = 0
        for _ in range(times):
            level = 30 + 0.1 * rng.normal(size=2) - [0, loss]
            before, after = ({"psnr_db": x + 0.2 * rng.normal(size=16)} for x in level)
            worse += compare([metric], before, after, errors=errors)[0].worse
        return worse / times

    assert alarms(0.02, errors, 3000) <= 0.015
    assert alarms(0.02, (), 300) > 0.1
    assert alarms(1.5, errors, 300) > 0.99


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["noise", "blur", "gain"])
def test_a_planted_loss_is_found_and_none_is_invented(yard, kind: str) -> None:
    """0.2 dB in LMMSE: found in at least 93 % of comparisons of 48 seeds, whether or not the draws
    of both runs are the same; no loss is called one in at most 1 %. 2000 comparisons each, drawn
    from 1600 seeds, whose scatter, 2 % more or less by chance, makes 93.5 to 96 % of it.
    """
    scene, system, light = yard
    found = run_camera(scene, system, light, "lmmse", range(1600), CAMERA_METRICS)
    images = planted(np.array(found.results), found.truth, kind, 0.2)
    worse = {m.name: np.array([m.of(found.truth, i) for i in images]) for m in CAMERA_METRICS}
    rng = np.random.default_rng(0)
    common = {"seeds": 48, "repetitions": 2000, "rng": rng}
    for paired in (True, False):
        assert share_worse(CAMERA_METRICS, found.figures, worse, paired=paired, **common) >= 0.93
    for figures in (found.figures, worse):
        assert share_worse(CAMERA_METRICS, figures, figures, paired=False, **common) <= 0.01


@pytest.mark.parametrize("kind", ["noise", "blur", "gain"])
def test_a_planted_loss_is_as_large_as_it_says(yard, kind: str) -> None:
    scene, system, light = yard
    found = run_camera(scene, system, light, "zero-fill", range(8), CAMERA_METRICS)
    images = planted(np.array(found.results), found.truth, kind, 0.2)
    after = np.mean([CAMERA_METRICS[0].of(found.truth, image) for image in images])
    assert found.figures["psnr_db"].mean() - after == pytest.approx(0.2, abs=1e-6)

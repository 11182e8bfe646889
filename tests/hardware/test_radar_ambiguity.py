"""Range rates beyond the Doppler ambiguity: solved where migration or phases tell, else listed."""

from dataclasses import replace

import numpy as np
import pytest

from hardware.processing import cloud
from hardware.radar.process import process
from hardware.radar.rate_evidence import ambiguous_rates, fastest_resolved, rate_evidence
from hardware.radar.refinement import blocks_about
from hardware.radar.settings import Processing
from hardware.waveform import OfdmWaveform
from tests.hardware.radar_cubes import MIMO, TURNS, WIDE, Echo, cube

C = 299_792_458.0
#: One span of the ambiguity, 12.1 m/s, moves a target by 3.1 cells.
SLOW = replace(WIDE, slot_period_s=156.25e-6)
#: 16 MHz of band: by 0.01 cells.
NARROW = OfdmWaveform(79e9, 64, 0.25e6, 64, 156.25e-6, 8, 4e-6)


def echoes(wave: OfdmWaveform, range_m, rate: float, amplitude) -> np.ndarray:
    """Channel (n_channels, n_subcarriers, n_slots) of points that move alike, by definition."""
    f, t = wave.frequency_offsets_hz[:, None], wave.slot_times_s
    total = np.zeros((len(amplitude), wave.n_subcarriers, wave.n_slots), dtype=complex)
    for own, strengths in zip(range_m, amplitude.T, strict=True):
        moved = 2 / C * rate * t
        cycles = wave.carrier_hz * moved % 1.0 + f * (2 / C * own + moved)
        total += strengths[:, None, None] * np.exp(-2j * np.pi * cycles)
    return total


def noisy(channel: np.ndarray, snr_db: float, rng: np.random.Generator) -> tuple[np.ndarray, float]:
    """With white noise, so that a unit echo has an SNR after processing; and a cell's noise."""
    cell = 10 ** (-snr_db / 10)
    noise = rng.normal(size=(*channel.shape, 2)).view(np.complex128)[..., 0]
    return channel + noise * np.sqrt(cell * channel[0].size / 2), cell


def test_a_wrong_rate_leaves_what_the_smear_leaves() -> None:
    """Against the sum over all subcarriers and slots, the highest of cells around the target: the
    mean of exp(2 pi j f (t 2 span / c + delay) + 2 pi j t doppler).
    """
    own = 2 / C * 3.0
    rates = ambiguous_rates(SLOW, own, 2 / C * 40.0)
    expected = own + 2 * SLOW.max_delay_rate * np.arange(-3, 4)
    np.testing.assert_allclose(np.sort(rates), expected, rtol=1e-12)
    channel = echoes(SLOW, [5.0], 3.0, np.ones((1, 1)))
    (blocks,) = blocks_about(channel, SLOW, "boxcar", np.array([2 / C * 5.0]), np.array([own]))
    seen = rate_evidence(blocks, rates, 1e-3)  # 30 dB
    f, t = SLOW.frequency_offsets_hz, SLOW.slot_times_s
    cells = np.arange(-8, 9) / 2
    left = []
    for rate in rates:
        smear = np.exp(2j * np.pi * f[:, None] * (rate - own) * t)
        by_delay = np.exp(2j * np.pi * np.outer(cells / SLOW.bandwidth_hz, f)) / len(f)
        by_rate = np.exp(2j * np.pi * np.outer(t, cells / (len(t) * SLOW.slot_period_s))) / len(t)
        left.append(np.max(np.abs(by_delay @ smear @ by_rate) ** 2))
    assert left[0] == pytest.approx(1)
    np.testing.assert_allclose(1e-3 * seen.log_likelihood[:3], left[:3], rtol=0.02)
    assert left[1] < 0.13  # or the test would tell nothing
    assert list(seen.possible) == [True] + 6 * [False]


@pytest.mark.parametrize("fastest", [25.0, 30.0, 45.0])
@pytest.mark.parametrize("rate", [-24.9, -24.3, -24.1, 24.2, 24.7, 3.0])
def test_rates_just_beyond_the_ambiguity_are_told_from_slow_ones(
    rate: float, fastest: float
) -> None:
    """24.3 m/s here. A target at 24.7 m/s had been one at -23.9 m/s wherever fewer than 48.6 m/s
    were asked for.
    """
    seen = process(
        cube(WIDE, [Echo((6.0, 0, 0), 1e-10, (rate, 0, 0))], noise_w=1e-11),
        0,
        Processing(fastest_m_per_s=fastest),
    ).detections[0]
    assert seen.range_rate_m_per_s == pytest.approx(rate, abs=5 * seen.range_rate_error_m_per_s)


def test_a_rate_at_the_limit_may_be_measured_beyond_it() -> None:
    """-49.999 of up to 50 m/s, folded to 44.9, 27 dB: 17 of 30 had been told as that alone."""
    wave = OfdmWaveform(79e9, 64, 4e6, 32, 20e-6, 1, 0.25e-6)
    for seed in range(10):
        record = cube(
            wave, [Echo((12.0, 0, 0), 1e-9, (-49.999, 0, 0))], noise_w=4.1e-9, counts=300, seed=seed
        )
        (seen,) = process(record).detections
        rates = np.array([seen.range_rate_m_per_s, *seen.range_rate_alternatives_m_per_s])
        assert np.abs(rates + 49.999).min() < 5 * seen.range_rate_error_m_per_s


@pytest.mark.parametrize("seed", [10, 11, 16, 20, 28, 29])
def test_a_rate_at_the_limit_is_found_where_its_echo_is_smeared(seed: int) -> None:
    """4 GHz: at another fold the echo crosses 13 range cells, and its peak is up to 0.3 m/s off. Of
    these, 6 of 30 seeds at 28 dB, the true fold was neither told nor left open.
    """
    wave = OfdmWaveform(79e9, 256, 4e9 / 256, 64, 156e-6, 1, 0.5e-6)
    noise_w = 1e-9 * 10**-2.8 * wave.n_subcarriers * wave.n_slots
    rate = -49.999 if seed % 2 else 49.999
    echo = Echo((3 + 0.1 * seed, 0, 0), 1e-9, (rate, 0, 0), phase_rad=seed)
    seen, *_ = process(cube(wave, [echo], noise_w=noise_w, counts=300, seed=seed)).detections
    assert seen.range_rate_m_per_s == pytest.approx(rate, abs=5 * seen.range_rate_error_m_per_s)


def test_a_rate_measured_across_the_ambiguitys_edge_is_the_slow_one() -> None:
    """With nothing faster to be told from, a rate stays within the unambiguous ones."""
    for rate in np.linspace(-24.28, -24.1, 5):
        record = cube(WIDE, [Echo((6.0, 0, 0), 1e-10, (float(rate), 0, 0))], noise_w=1e-11)
        seen = process(record, 0, Processing(fastest_m_per_s=20.0)).detections[0]
        assert abs(seen.range_rate_m_per_s) <= WIDE.max_velocity_m_per_s
        assert seen.range_rate_m_per_s == pytest.approx(rate, abs=0.1)


@pytest.mark.parametrize("n_points", [1, 20])
@pytest.mark.parametrize("n_channels", [1, 8])
def test_no_rate_is_given_wrongly(n_points: int, n_channels: int) -> None:
    """60 points at 16 dB, or bodies of 20 points over 1.5 m: the rate is right, and hardly ever
    left open. An error in a thousand is allowed for: three or more in 240 come at 2e-3.
    """
    rng = np.random.default_rng(n_points + n_channels)
    wrong, candidates = 0, 0
    for _ in range(60):
        rate = rng.uniform(-50, 50)
        ranges = 5.0 + (rng.uniform(-0.75, 0.75, n_points) if n_points > 1 else np.zeros(1))
        strengths = rng.normal(size=(n_channels, n_points, 2)).view(np.complex128)[..., 0]
        strengths = strengths if n_points > 1 else strengths / np.abs(strengths)
        channel, cell = noisy(echoes(SLOW, ranges, rate, strengths), 16.0, rng)
        near = ranges[np.argmax(np.abs(strengths).sum(axis=0))]
        rates = ambiguous_rates(SLOW, 2 / C * rate, 2 / C * 50.0)
        (blocks,) = blocks_about(channel, SLOW, "boxcar", np.array([2 / C * near]), rates[:1])
        possible = C / 2 * rates[rate_evidence(blocks, rates, cell).candidates]
        wrong += np.abs(possible - rate).min() > 1
        candidates += len(possible) > 1
    assert wrong == 0
    assert candidates <= 6


@pytest.mark.parametrize("rate", [-41.0, -17.6, 1.4, 22.0, 36.5])
def test_a_target_beyond_the_ambiguity_has_its_true_rate(rate: float) -> None:
    """One transmitter, slots that fold at 6.07 m/s; range and level are those of a slow one."""
    record = cube(SLOW, [Echo((5.0, 0, 0), velocity_m_per_s=(rate, 0, 0))], noise_w=1e-8)
    (found,) = process(record).detections
    assert found.range_rate_m_per_s == pytest.approx(rate, abs=5 * found.range_rate_error_m_per_s)
    assert found.range_m == pytest.approx(5.0, abs=5 * found.range_error_m + 1e-4)
    assert found.power_w == pytest.approx(1e-9, rel=0.05)
    assert found.range_rate_alternatives_m_per_s == ()


def test_an_array_in_turns_knows_the_rate_of_an_extended_target() -> None:
    """A body of six points across 1.2 m, at several angles, so that no one direction explains the
    phases; each of its detections has the body's rate, beyond the turns' 12.1 m/s.
    """
    rng = np.random.default_rng(2)
    body = [
        Echo((5 + x, y, 0), 1e-9, (17.6, 0, 0), phase)
        for x, y, phase in zip(
            rng.uniform(0, 0.3, 6), rng.uniform(-0.6, 0.6, 6), rng.uniform(0, 6.28, 6), strict=True
        )
    ]
    found = process(cube(WIDE, body, noise_w=1e-9, **MIMO)).detections
    assert found
    for one in found:
        assert one.range_rate_m_per_s == pytest.approx(17.6, abs=0.4)


def test_a_fragment_of_a_smeared_echo_leads_to_the_echo() -> None:
    """At 22 dB what a wrong rate leaves of an echo is detected anywhere in the smear, off in range
    and in rate: of 30 echoes up to 48 m/s all that are found have their own range and rate, once.
    """
    rng = np.random.default_rng(7)
    seen = 0
    for _ in range(30):
        rate, range_m = rng.uniform(-48, 48), rng.uniform(3, 8)
        place, velocity = (range_m, 0.0, 0.0), (rate, 0.0, 0.0)
        # Noise of a sample, and 22 dB after 256 x 64 of them.
        noise_w = 1e-9 * 256 * 64 / 10**2.2
        found = process(
            cube(SLOW, [Echo(place, velocity_m_per_s=velocity)], noise_w=noise_w)
        ).detections
        told = [(d.range_rate_m_per_s, *d.range_rate_alternatives_m_per_s) for d in found]
        assert all(np.abs(np.array(rates) - rate).min() < 0.5 for rates in told)
        assert all(
            d.range_m == pytest.approx(range_m, abs=0.06)
            for d in found
            if not d.range_rate_alternatives_m_per_s
        )
        assert len(found) <= 1
        seen += len(found)
    assert seen >= 12  # smeared, an echo of 22 dB is found half of the time


def test_a_weak_echo_keeps_its_rate_beside_a_strong_one() -> None:
    """60 dB at rest and 28 dB ten cells of rate away, at one range: the strong one, smeared by a
    wrong rate, must not pass for the weak one.
    """
    cells = -10 * SLOW.velocity_cell_m_per_s
    strong = Echo((5.0, 0, 0), 1e-9)
    weak = Echo((5.0, 0, 0), 1e-9 * 10**-3.2, (cells, 0, 0))
    noise_w = 1e-9 * 256 * 64 / 10**6.0
    found = process(cube(SLOW, [strong, weak], noise_w=noise_w)).detections
    assert [d.range_rate_m_per_s for d in found] == pytest.approx([0.0, cells], abs=0.05)
    assert not any(d.range_rate_alternatives_m_per_s for d in found)


@pytest.mark.parametrize("spans", [1, 2])
def test_two_bodies_a_whole_span_apart_are_both_found(spans: int) -> None:
    """At one range, folded onto one cell of the map, 30 and 26 dB, so that each smears over the
    other: both are given with their own rates, and no rate is called ambiguous.
    """
    rng = np.random.default_rng(spans)
    for seed in range(6):
        rates = rng.uniform(-20, 10) + np.array([0, spans * 2 * SLOW.max_velocity_m_per_s])
        pair = [
            Echo((5.0, 0, 0), 1e-9 * level, (rate, 0, 0), rng.uniform(0, 6))
            for rate, level in zip(rates, (1, 10**-0.4), strict=True)
        ]
        found = process(cube(SLOW, pair, noise_w=1e-9 * 256 * 64 / 10**3, seed=seed)).detections
        assert np.sort([one.range_rate_m_per_s for one in found]) == pytest.approx(rates, abs=0.1)
        assert not any(one.range_rate_alternatives_m_per_s for one in found)


@pytest.mark.parametrize("rates", [(-17.6, -18.4), (-17.6, 31.0), (36.5, 22.0)])
def test_two_fast_targets_are_both_found(rates: tuple[float, float]) -> None:
    """Apart in range and both folded: the stronger one is no explanation of the weaker one, whose
    smear a window shows with more power than blocks without one.
    """
    pair = [
        Echo((range_m, 0, 0), power_w, (rate, 0, 0))
        for range_m, power_w, rate in zip((4.0, 7.0), (1e-9, 0.6e-9), rates, strict=True)
    ]
    found = process(cube(SLOW, pair, noise_w=1e-9 * 256 * 64 / 10**5)).detections
    assert [one.range_m for one in found] == pytest.approx([4.0, 7.0], abs=0.01)
    assert [one.range_rate_m_per_s for one in found] == pytest.approx(rates, abs=0.1)


@pytest.mark.parametrize("seed", [3, 10])
def test_weak_echoes_beside_a_body_of_many_parts_are_no_fast_ones(seed: int) -> None:
    """A body of up to 300 parts, 75 dB over the noise, and three weak points, all of which move by
    less than 2 m/s: what is left of the body where a weak echo is tested with other rates had been
    taken for an echo of 48 m/s.
    """
    wave = replace(TURNS, n_subcarriers=512, subcarrier_spacing_hz=7.8125e6, n_slots=256)
    rng = np.random.default_rng(1000 + seed)
    noise_w, points = 1e-9, []
    cell_w = noise_w / (wave.n_subcarriers * wave.n_slots)
    for level_db in (75.0, *rng.uniform(20, 30, 3)):
        rate, nearest = rng.choice([0.0, 0.0, rng.uniform(-1.5, 1.5)]), rng.uniform(6, 10)
        is_point = level_db < 75
        count = 1 if is_point else int(rng.integers(50, 300))
        length = 0.0 if is_point else rng.uniform(0.2, 2)
        power_w = cell_w * 10 ** (level_db / 10) * rng.exponential(size=count)
        for part_w, place in zip(power_w, rng.uniform(0, 1, count), strict=True):
            at, phase = (nearest + length * place, 0.0, 0.0), rng.uniform(0, 2 * np.pi)
            points.append(Echo(at, part_w, (rate, 0, 0), phase))
    frame = process(cube(wave, points, noise_w=noise_w, seed=seed))
    rates = np.array([point.range_rate_m_per_s for point in frame.detections])
    assert len(rates) >= 4
    assert np.abs(rates).max() < 2


@pytest.mark.parametrize("seed", [0, 5, 9])
def test_parts_that_move_against_each_other_exclude_no_rate_of_theirs(seed: int) -> None:
    """A body of 40 parts over 2 m, 60 dB over the noise, whose rates differ by up to 0.6 m/s, where
    a span, 12.2 m/s, migrates by 0.8 cells. It fits no rate to within the noise, and detections had
    been given rates near none of the parts', which stood not even among the alternatives.
    """
    rng = np.random.default_rng(seed)
    wave = OfdmWaveform(79e9, 512, 1e6, 128, 156e-6, 8, 0.5e-6)
    rates = rng.uniform(-2, 2) + rng.uniform(-0.3, 0.3, 40)
    parts = [
        Echo((range_m, 0, 0), power_w, (rate, 0, 0), phase)
        for range_m, power_w, rate, phase in zip(
            rng.uniform(8, 10, 40),
            rng.exponential(1e-9 / 40, 40),
            rates,
            rng.uniform(0, 2 * np.pi, 40),
            strict=True,
        )
    ]
    record = cube(wave, parts, noise_w=1e-9 * 512 * 128 / 1e6, seed=seed)
    found = process(record, 0, Processing(fastest_m_per_s=50.0)).detections
    assert found
    for one in found:
        told = np.array([one.range_rate_m_per_s, *one.range_rate_alternatives_m_per_s])
        assert np.abs(told[:, None] - rates).min() < 0.5


def test_weak_evidence_excludes_no_rate() -> None:
    """One span migrates 0.1 cells, at 28 dB: of 60 targets the true rate is told, or stands among
    the alternatives, in all (false alarm 0.06, at a thousandth each). Where the noise of a few
    cells was that of each rate by itself, four were excluded.
    """
    rng = np.random.default_rng(5)
    wave = OfdmWaveform(79e9, 256, 1e6, 32, 60e-6, 4, 0.5e-6)
    for _ in range(60):
        rate, range_m = rng.uniform(-14, 14), rng.uniform(20, 100)
        target = Echo((range_m, 0, 0), velocity_m_per_s=(rate, 0, 0))
        noise_w = 1e-9 * 256 * 32 / 10**2.8
        record = cube(wave, [target], noise_w=noise_w, seed=int(rng.integers(1 << 30)))
        (found,) = process(record).detections
        told = np.array([found.range_rate_m_per_s, *found.range_rate_alternatives_m_per_s])
        assert np.abs(told - rate).min() < 0.5


def test_what_cannot_be_told_apart_is_listed() -> None:
    """In a narrow band nothing migrates: the nearest rate is given, all others beside it."""
    record = cube(NARROW, [Echo((50.0, 0, 0), velocity_m_per_s=(15.0, 0, 0))], noise_w=1e-8)
    found = process(record).detections[0]
    told = np.sort([found.range_rate_m_per_s, *found.range_rate_alternatives_m_per_s])
    expected = C / 2 * np.sort(ambiguous_rates(NARROW, 2 / C * 15.0, 2 / C * 50.0))
    np.testing.assert_allclose(told, expected, atol=0.05)
    assert np.abs(told - 15.0).min() < 0.05


def test_phases_across_turns_tell_a_lone_target_only() -> None:
    """Narrow band, two transmitters: one target's rate is found by the array; of two at one range
    and rate, 57 degrees apart, it is left open.
    """
    wave = replace(NARROW, slot_period_s=78.125e-6, repeats=4)
    places = {**MIMO, "transmitters_m": MIMO["transmitters_m"]}
    ahead = Echo((50.0, 0, 0), 1e-9, (9.0, 0, 0))
    lone = process(cube(wave, [ahead], noise_w=1e-9, **places)).detections[0]
    assert lone.range_rate_m_per_s == pytest.approx(9.0, abs=0.05)
    assert lone.azimuth_rad == pytest.approx(0.0, abs=5e-3)
    spans = 2 * wave.max_velocity_m_per_s
    for other in lone.range_rate_alternatives_m_per_s:  # whole spans of the slots themselves
        assert (other - 9.0) / spans == pytest.approx(round((other - 9.0) / spans), abs=0.01)
    aside = 50 * np.array([np.cos(1.0), np.sin(1.0), 0.0])
    both = [ahead, Echo(tuple(aside), 0.7e-9, tuple(9.0 * aside / 50))]
    two = process(cube(wave, both, noise_w=1e-9, **places)).detections[0]
    told = [two.range_rate_m_per_s, *two.range_rate_alternatives_m_per_s]
    assert np.abs(np.array(told) - 9.0).min() < 0.05
    assert len(told) > len(lone.range_rate_alternatives_m_per_s) + 1


def test_a_cloud_holds_every_alternative() -> None:
    """As many columns as the most ambiguous detection has; NaN where another has fewer."""
    record = cube(NARROW, [Echo((50.0, 0, 0), velocity_m_per_s=(15.0, 0, 0))], noise_w=1e-8)
    found = process(record).detections[0]
    clear = replace(found, range_rate_alternatives_m_per_s=())
    columns = cloud([found, clear])
    rates = found.range_rate_alternatives_m_per_s
    np.testing.assert_array_equal(columns["range_rate_alternatives"], [len(rates), 0])
    for k, rate in enumerate(rates, 1):
        np.testing.assert_array_equal(
            columns[f"range_rate_alternative_{k}_m_per_s"], [rate, np.nan]
        )


def test_slots_far_apart_bound_the_rates_that_are_tried() -> None:
    """64 slots in 6.4 s: at 50 m/s a target would cross 8200 cells, and 52 000 rates fold to one,
    of which at most 64 cells' worth are tried: 21. Both echoes are found with their rates.
    """
    wave = replace(WIDE, slot_period_s=0.1)
    still, slow = Echo((5.0, 0, 0)), Echo((7.0, 0, 0), velocity_m_per_s=(0.006, 0, 0))
    frame = process(cube(wave, [still, slow], noise_w=1e-8))
    told = sorted((d.range_m, d.range_rate_m_per_s) for d in frame.detections)
    np.testing.assert_allclose(told, [(5.0, 0.0), (7.0, 0.006)], atol=1e-3)
    assert "beyond 0.39 m/s none is told from slower ones" in frame.warnings[0]
    assert len(ambiguous_rates(wave, 0.0, fastest_resolved(wave, 2 / C * 50.0))) < 64
    # Of a narrow band no target crosses a cell: the number of rates is the bound.
    narrow = replace(NARROW, slot_period_s=10.0)
    assert len(ambiguous_rates(narrow, 0.0, fastest_resolved(narrow, 2 / C * 50.0))) < 520

"""The radar's front end: every fault against its closed form, phase noise against brute force."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hardware.records import Flag
from hardware.waveform import OfdmWaveform
from twin.files import InputError
from twin.radar import load_radar
from twin.radar.acquisition import channel
from twin.radar.device.design import RadarDesign
from twin.radar.device.electronics import Oscillator
from twin.radar.device.front_end import arriving, digitize, full_scale_w, image_rejection_db
from twin.radar.device.phase_noise import apply_phase_noise, draw_phase_noise, residual_rad
from twin.radar.propagation.result import Propagation
from twin.radar.propagation.scene.atmosphere import Atmosphere

NOTHING = Propagation()


def design(name: str = "hybrid-79-slow", **changes: object) -> RadarDesign:
    """A bundled radar changed by ``section__field``; None takes a section away."""
    content = load_radar(name).model_dump()
    for key, value in changes.items():
        section, _, field = key.partition("__")
        if not field:
            content[section] = value
        else:
            content[section] = (content[section] or {}) | {field: value}
    return RadarDesign.model_validate(content)


def small(**changes: object) -> RadarDesign:
    return design(waveform__n_subcarriers=64, waveform__n_slots=8, **changes)


def tone(radar: RadarDesign, bin_: int, power_w: float) -> np.ndarray:
    """Channel for which one subcarrier alone arrives, at a power."""
    wave = radar.ofdm
    found = np.zeros((1, wave.n_slots, 1, wave.n_subcarriers), dtype=complex)
    sent = wave.sent() * np.sqrt(radar.front_end.transmit_power_w.value / wave.n_subcarriers)
    found[..., bin_] = np.sqrt(power_w) / sent[bin_]
    return found


def spectrum(counts: np.ndarray) -> np.ndarray:
    wave = counts[..., 0] + 1j * counts[..., 1]
    return np.fft.fftshift(np.fft.fft(wave, axis=-1), axes=-1) / wave.shape[-1]


# Mixer.


@pytest.mark.parametrize(("gain_db", "phase_deg"), [(0.5, 0.0), (0.0, 3.0), (-1.0, 5.0)])
def test_mirror_images_are_as_far_down_as_the_formula_says(
    gain_db: float, phase_deg: float
) -> None:
    """(1 + 2 g cos a + g^2) / (1 - 2 g cos a + g^2), to 0.01 dB, on a tone 20 dB below clipping."""
    radar = small(front_end__iq_gain_db=gain_db, front_end__iq_phase_deg=phase_deg)
    rng = np.random.default_rng(0)
    quiet = tone(radar, 32 + 5, full_scale_w(radar) / 100)
    counts, flags, _ = digitize(quiet, radar, rng=rng, noisy=False)
    power = np.mean(np.abs(spectrum(counts)) ** 2, axis=(0, 1, 2))
    assert not flags.any()
    g, a = 10 ** (gain_db / 20), np.radians(phase_deg)
    closed = 10 * np.log10((1 + 2 * g * np.cos(a) + g * g) / (1 - 2 * g * np.cos(a) + g * g))
    assert image_rejection_db(radar) == pytest.approx(closed)
    assert 10 * np.log10(power[32 + 5] / power[32 - 5]) == pytest.approx(closed, abs=0.01)


def test_branches_alike_leave_no_image() -> None:
    radar = small(front_end__iq_gain_db=0.0, front_end__iq_phase_deg=0.0)
    assert image_rejection_db(radar) == np.inf
    same = digitize(tone(radar, 37, 1e-6), radar, rng=np.random.default_rng(1))
    plain = digitize(tone(radar, 37, 1e-6), small(), rng=np.random.default_rng(1))
    np.testing.assert_array_equal(same[0], plain[0])


# Converter.


@pytest.mark.parametrize("bits", [4, 8, 12])
def test_quantisation_noise_is_a_twelfth_of_a_squared_step(bits: int) -> None:
    """One repeat, thermal noise of several codes as dither: error (step^2 / 12) in each branch.

    16384 samples of a uniform error: its variance scatters by 0.7 %; 4 % is 5.7 sigma.
    """
    step = 2.0 ** (16 - bits)
    radar = design(
        waveform__n_subcarriers=1024, waveform__n_slots=8, waveform__repeats=1,
        front_end__noise_counts=4 * step if bits > 4 else step, front_end__adc_bits=bits,
    )  # fmt: skip
    channel = np.zeros((1, 8, 1, 1024), dtype=complex)
    counts, _, _ = digitize(channel, radar, rng=np.random.default_rng(2))
    assert not (counts % step).any()
    rng = np.random.default_rng(2)
    exact = rng.normal(size=counts.shape) * radar.front_end.noise_counts.value / np.sqrt(2)
    assert np.mean((counts - exact) ** 2) == pytest.approx(step**2 / 12, rel=0.04)


@pytest.mark.parametrize("noise_counts", [64.0, 256.0])
def test_averaging_repeats_averages_the_converters_error_too(noise_counts: float) -> None:
    """R repeats of independent error: noise power + step^2 / 12 / R in each branch, converted one
    by one (noise of 0.7 codes) and at once (2.8 codes).
    """
    radar = design(
        waveform__n_subcarriers=512, waveform__n_slots=16, waveform__repeats=16,
        front_end__noise_counts=noise_counts, front_end__adc_bits=8,
    )  # fmt: skip
    counts, _, _ = digitize(np.zeros((1, 16, 1, 512), complex), radar, rng=np.random.default_rng(3))
    expected = noise_counts**2 / 2 + 256.0**2 / 12 / 16 + 1 / 12
    # 16384 numbers: 1.1 %, so 5 sigma.
    assert np.mean(counts.astype(float) ** 2) == pytest.approx(expected, rel=0.055)


@pytest.mark.parametrize("bits", [None, 12, 1])
def test_a_converter_saturates_at_its_rails_and_says_so(bits: int | None) -> None:
    changes = {} if bits is None else {"front_end__adc_bits": bits}
    radar = small(**changes)
    counts, flags, _ = digitize(tone(radar, 37, 1e6), radar, rng=np.random.default_rng(4))
    assert (flags == Flag.SATURATED).all()
    step = 1 if bits is None else 2 ** (16 - bits)
    assert counts.min() == -32768
    assert counts.max() == 32768 - step


def test_full_scale_is_the_strongest_tone_that_does_not_clip() -> None:
    radar = small(front_end__adc_bits=12)
    for power, clips in ((0.98, False), (1.02, True)):
        quiet = tone(
            radar, 32, power * full_scale_w(radar)
        )  # subcarrier 0: constant, on one branch
        _, flags, _ = digitize(quiet, radar, rng=np.random.default_rng(5), noisy=False)
        assert bool(flags.any()) == clips


# Leakage.


def test_leakage_has_its_level_and_the_phase_of_its_delay() -> None:
    radar = small(leakage={"level_db": -33.0, "delay_s": 1.7e-9})
    found = channel(NOTHING, radar, Atmosphere())
    f = radar.ofdm.carrier_hz + radar.ofdm.frequency_offsets_hz
    exact = 10 ** (-33 / 20) * np.exp(-2j * np.pi * f * 1.7e-9)
    np.testing.assert_allclose(
        found, np.broadcast_to(exact, found.shape), atol=1e-6 * 10 ** (-33 / 20)
    )


def test_huge_leakage_clips_every_slot() -> None:
    radar = small(leakage={"level_db": 0.0, "delay_s": 0.0})
    _, flags, _ = digitize(
        channel(NOTHING, radar, Atmosphere()), radar, rng=np.random.default_rng(0)
    )
    assert (flags == Flag.SATURATED).all()


# Retunes.


def test_retunes_turn_each_step_by_a_phase_of_its_own() -> None:
    """25 steps of the leakage alone: constant within a step; uniform phases between them.

    Of uniform phases the mean's squared length is exponential with mean 1 / 25; above 0.55 by
    chance 1e-6. Same seed, same phases.
    """
    radar = design("prototype", oscillator=None)
    found = channel(NOTHING, radar, Atmosphere())
    one, again, other = (
        arriving(found, radar, rng=np.random.default_rng(seed)) for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(one, again)
    steady = arriving(found, design("prototype", oscillator=None, steps__random_phase=False),
                      rng=np.random.default_rng(1))  # fmt: skip
    turned = one / steady
    np.testing.assert_allclose(np.abs(turned), 1, rtol=1e-9)
    assert np.abs(turned - turned[:, :1, :1, :1]).max() < 1e-9
    assert np.abs(turned[:, 0, 0, 0].mean()) ** 2 < 0.55
    assert np.abs(one - other).max() > 0.1 * np.abs(one).max()


def test_timing_offsets_turn_subcarriers_in_proportion() -> None:
    """Slope of the phase over frequency in each step: normal with the declared rms (5 sigma)."""
    radar = design("prototype", oscillator=None, steps__timing_rms_s=2e-9, steps__count=400)
    found = channel(NOTHING, radar, Atmosphere())
    sent = radar.ofdm.sent()
    seen = np.fft.fftshift(
        np.fft.fft(arriving(found, radar, rng=np.random.default_rng(3))), axes=-1
    )
    turned = seen[:, 0, 0] / sent / found[:, 0, 0]
    slopes = np.diff(np.unwrap(np.angle(turned), axis=-1), axis=-1)
    late = -slopes.mean(axis=-1) / (2 * np.pi * radar.ofdm.subcarrier_spacing_hz)
    assert np.abs(slopes - slopes[:, :1]).max() < 1e-6
    assert late.std() == pytest.approx(2e-9, rel=5 / np.sqrt(2 * 400))


# Phase noise.

WAVE = OfdmWaveform(10e9, 128, 1e6, 40, 10e-6, 8, 1e-6)


def oscillator(level: float = -110.0, *, slope: bool = False, shared: bool = True) -> Oscillator:
    points = ((1e4, level + 20), (1e8, level - 60)) if slope else ((1e4, level), (1e8, level))
    return Oscillator.model_validate(
        {
            "offset_hz": [p[0] for p in points],
            "phase_noise_dbc_per_hz": [p[1] for p in points],
            "shared": shared,
        }
    )


def modelled(
    kind: Oscillator, wave: OfdmWaveform, delay: int, seed: int, sent: np.ndarray | None = None
) -> np.ndarray:
    """One echo of unit amplitude, ``delay`` samples late: (n_slots, n_subcarriers) in time."""
    sent = wave.sent() if sent is None else sent
    rng = np.random.default_rng(seed)
    f = np.arange(wave.n_subcarriers) - wave.n_subcarriers // 2
    late = np.exp(-2j * np.pi * f * delay / wave.n_subcarriers)
    one = draw_phase_noise(kind, wave, rng)
    other = one if kind.shared.value else draw_phase_noise(kind, wave, rng)
    alike = np.broadcast_to(late, (wave.n_slots, 1, wave.n_subcarriers))
    return apply_phase_noise(alike, sent, wave, one, other)[:, 0]


def brute_force(
    kind: Oscillator, wave: OfdmWaveform, delay: int, seed: int, sent: np.ndarray | None = None
) -> np.ndarray:
    """The same sample by sample, four in the time of one of the record's: phase over the whole
    burst, every repeat by itself, then the receiver's filter.
    """
    rng = np.random.default_rng(seed)
    sent = wave.sent() if sent is None else sent
    n, fine = wave.n_subcarriers, 4 * wave.n_subcarriers
    late = 4 * delay
    total = 4 * round(wave.n_slots * wave.slot_period_s * wave.bandwidth_hz)
    f = np.arange(1, total // 8) * (4 * wave.bandwidth_hz / total)  # to half the band
    band = (np.arange(n) - n // 2) % fine
    spectrum = np.zeros(fine, complex)
    spectrum[band] = sent
    symbol = np.fft.ifft(spectrum) * fine

    def phase() -> np.ndarray:
        lines = np.zeros(total // 2 + 1, complex)
        lines[1 : len(f) + 1] = (rng.normal(size=(len(f), 2)) @ [1, 1j]) * np.sqrt(
            kind.level(f) * f[0] / 2
        )
        return np.fft.irfft(lines, total) * total

    sending = phase()
    receiving = sending if kind.shared.value else phase()
    found = np.zeros((wave.n_slots, fine), complex)
    starts = np.arange(wave.n_slots)[:, None] * wave.slot_period_s + wave.prefix_s
    starts = starts + np.arange(wave.repeats) * wave.symbol_s
    for slot, repeat in np.ndindex(starts.shape):
        index = (round(starts[slot, repeat] * 4 * wave.bandwidth_hz) + np.arange(fine)) % total
        arriving = symbol[(np.arange(fine) - late) % fine] * np.exp(1j * sending[index - late])
        found[slot] += arriving * np.exp(-1j * receiving[index]) / wave.repeats
    filtered = np.fft.fft(found)[:, band] / fine
    return np.fft.ifft(np.fft.ifftshift(filtered, axes=-1)) * n


def error_power(found: np.ndarray, wave: OfdmWaveform, delay: int, *, turned: bool = True) -> float:
    """Over the echo's own; not ``turned``: without a common turn of each slot."""
    clean = np.roll(np.fft.ifft(np.fft.ifftshift(wave.sent())) * wave.n_subcarriers, delay)
    ratio = found / clean
    common = 1.0 if turned else ratio.mean(axis=1, keepdims=True)
    return float(np.mean(np.abs(ratio - common) ** 2))


@pytest.mark.quick(4)
@pytest.mark.parametrize("delay", [0, 3, 17, 100])
@pytest.mark.parametrize("slope", [False, True])
def test_range_correlation_is_brute_forces(delay: int, slope: bool) -> None:
    """Pedestal of an echo at several delays: model, sample-by-sample sum and closed form.

    The receiver's filter cuts what phase noise moves out of the band: a quarter of white noise's.
    24 draws of 40 slots: 1 to 3 %, where slow lines dominate; 8 % leaves room for what the model
    leaves out.
    """
    kind = oscillator(slope=slope)
    powers = [
        np.mean([error_power(make(kind, WAVE, delay, seed), WAVE, delay) for seed in range(24)])
        for make in (modelled, brute_force)
    ]
    if delay == 0:
        assert powers[0] < 1e-20
        return
    assert powers[0] == pytest.approx(powers[1], rel=0.08)
    assert powers[0] == pytest.approx(residual_rad(kind, WAVE, delay / 128e6) ** 2, rel=0.08)


def test_separate_oscillators_do_not_cancel() -> None:
    """Twice one oscillator's power, whatever the delay."""
    kind = oscillator(shared=False)
    for delay in (0, 17):
        ours, theirs = (
            np.mean(
                [
                    error_power(make(kind, WAVE, delay, seed), WAVE, delay, turned=False)
                    for seed in range(8)
                ]
            )
            for make in (modelled, brute_force)
        )
        assert ours == pytest.approx(theirs, rel=0.08)
        assert ours == pytest.approx(residual_rad(kind, WAVE, 0.0) ** 2, rel=0.08)


def closed_form(kind: Oscillator, wave: OfdmWaveform, delay_s: float, line: np.ndarray):
    """Power of lines of the spectrum: phase noise of an echo, L(f) 4 sin^2(pi f tau), through the
    averaging of all repeats and the transform over one symbol, together a sinc.

    Sums over 40 points per width of the kernel, up to half the band.
    """
    samples = wave.repeats * wave.n_subcarriers
    width = wave.bandwidth_hz / samples / 40
    f = np.arange(width / 2, wave.bandwidth_hz / 2, width)
    f = np.concatenate([-f[::-1], f])
    noise = kind.level(np.abs(f)) * 4 * np.sin(np.pi * f * delay_s) ** 2
    x = samples * (f - line[:, None] * wave.subcarrier_spacing_hz) / wave.bandwidth_hz
    return (noise * np.sinc(x) ** 2).sum(axis=1) * width


@pytest.mark.quick(7)
@pytest.mark.parametrize("repeats", [8, 1])
@pytest.mark.parametrize("delay", [8, 32, 64])
@pytest.mark.parametrize("slope", [False, True])
@pytest.mark.parametrize("make", [modelled, brute_force])
def test_the_nulls_of_range_correlation_are_as_deep_as_the_averaging_time_lets_them_be(
    make, slope: bool, delay: int, repeats: int
) -> None:
    """Echoes 1/16, 1/4 and 1/2 of a symbol late: every 16th, 4th and 2nd line is a null.

    A tone is sent, so that all lines are within the receiver's band. The nulls' mean and that of
    the lines half-way between, over the closed form: of the model, and of the sum sample by sample.
    12 draws of 40 slots scatter by 2 to 4 %. The model joins a symbol to the one before by its mean
    and slope only: up to 1.5 times too much where the spectrum is steep. Without the symbol before,
    nulls were 1e-2 to 1e-6 of what they are.
    """
    wave = replace(WAVE, repeats=repeats)
    kind = oscillator(-125.0, slope=slope)
    tone = np.zeros(wave.n_subcarriers)
    tone[wave.n_subcarriers // 2] = 1.0  # at the carrier
    lines = np.zeros(wave.n_subcarriers)
    for seed in range(12):
        found = make(kind, wave, delay, seed, tone)
        lines += np.mean(np.abs(np.fft.fft(found) / wave.n_subcarriers) ** 2, axis=0) / 12
    period = wave.n_subcarriers // delay
    for first in (period, period // 2):  # nulls, and highest lines
        there = np.arange(first, wave.n_subcarriers // 2, period)
        exact = closed_form(kind, wave, delay / wave.bandwidth_hz, there)
        most = 1.5 if slope and make is modelled else 1.1
        assert 0.9 < np.mean(lines[there] / exact) < most


def test_phase_noise_leaves_the_thermal_noise_alone() -> None:
    """The same thermal draw, whatever else is switched on."""
    plain = small()
    noisy = small(
        oscillator={"offset_hz": [1e6], "phase_noise_dbc_per_hz": [-90.0], "shared": True}
    )
    none = np.zeros((1, 8, 1, 64), dtype=complex)
    a, b = (digitize(none, r, rng=np.random.default_rng(7))[0] for r in (plain, noisy))
    np.testing.assert_array_equal(a, b)


def test_one_subcarrier_has_no_phase_noise_within_a_symbol() -> None:
    wave = OfdmWaveform(10e9, 1, 1e6, 1, 2e-6, 1, 0.0)
    assert residual_rad(oscillator(), wave, 1e-7) < 1e-3
    assert np.isfinite(modelled(oscillator(shared=False), wave, 0, 0)).all()


# Designs.


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("[leakage]\nlevel_db = 3.0\ndelay_s = 0.0", "leakage.level_db"),
        ("[leakage]\nlevel_db = -3.0", "leakage.delay_s: missing"),
        ("[front_end]\nadc_bits = 17", "front_end.adc_bits"),
        ("[front_end]\niq_phase_deg = 90.0", "front_end.iq_phase_deg"),
        (
            "[oscillator]\noffset_hz = [1e3, 1e2]\nphase_noise_dbc_per_hz = [-80.0, -90.0]\n"
            "shared = true",
            "offset_hz does not ascend",
        ),
        (
            "[oscillator]\noffset_hz = [1e3]\nphase_noise_dbc_per_hz = [-80.0, -90.0]\n"
            "shared = true",
            "offset_hz has 1 points",
        ),
        ("[elements]\ntransmitters_m = []\nreceivers_m = [[0.0, 0.0, 0.0]]", "transmitters_m"),
        ("[elements]\ntransmitters_m = [[0.0, nan, 0.0]]\nreceivers_m = [[0.0, 0.0, 0.0]]", "nan"),
        (
            "[waveform]\nn_slots = 2\n[elements]\nreceivers_m = [[0.0, 0.0, 0.0]]\n"
            "transmitters_m = [[0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 2.0, 0.0]]",
            "3 take turns in 2 slots",
        ),
        (
            "[steps]\ncount = 4096\nspacing_hz = 1e6\nsettling_s = 0.0\nrandom_phase = true\n"
            "timing_rms_s = 0.0",
            "n_subcarriers x n_slots x 4096 steps",
        ),
        ("[leakage]\nlevel_db = -30.0\ndelay_s = 1.0", "leakage.delay_s = 1: expected less than"),
        *(
            (
                "[waveform]\nn_subcarriers = 64\nn_slots = 16\n[steps]\ncount = 3\n"
                f"spacing_hz = {spacing}\nsettling_s = 5e-3\nrandom_phase = true\n"
                "timing_rms_s = 0.0",
                "steps.spacing_hz = ",
            )
            for spacing in ("60e6", "65e6")  # of 62.5 MHz: they overlap, they leave a gap
        ),
    ],
)
def test_impossible_front_ends_are_refused(tmp_path: Path, text: str, expected: str) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(f'base = "hybrid-79"\n{text}\n')
    with pytest.raises(InputError) as caught:
        load_radar(path)
    assert str(path) in str(caught.value)
    assert expected in str(caught.value)


def test_the_prototype_is_table_2() -> None:
    radar = load_radar("prototype")
    carriers = radar.burst.carriers_hz
    assert len(carriers) * radar.ofdm.bandwidth_hz == pytest.approx(500e6)
    assert carriers.mean() == pytest.approx(2.5e9)
    assert radar.ofdm.slot_period_s == pytest.approx(3.6e-6)
    assert radar.ofdm.max_range_m == pytest.approx(479.7, abs=0.05)
    assert any("protects 60.0 m of 479.7 m" in w for w in radar.warnings())
    assert image_rejection_db(radar) == pytest.approx(35, abs=0.5)
    f = np.geomspace(1e3, 1e7, 20_000)
    rms = np.degrees(np.sqrt(2 * np.trapezoid(radar.oscillator.level(f), f)))
    assert rms == pytest.approx(1.0 * 2.5 / 3.5, rel=0.02)


def test_taking_turns_costs_velocity() -> None:
    alone, three = load_radar("hybrid-79"), load_radar("hybrid-79-mimo")
    ratio = alone.ofdm.max_velocity_m_per_s / three.channel_waveform.max_velocity_m_per_s
    assert ratio == pytest.approx(3)
    assert any("beyond the unambiguous +/- 8.10" in w for w in three.warnings(0, 10.0))

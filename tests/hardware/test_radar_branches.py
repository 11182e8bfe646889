"""A receiver's two branches: images, offsets of the converters, samples that are none."""

from dataclasses import replace

import numpy as np
import pytest

from hardware.errors import InputError
from hardware.radar.demodulation import complex_samples
from hardware.radar.process import process
from hardware.radar.quadrature import branch_faults, by_delay, image_spreads, without_faults
from hardware.waveform import OfdmWaveform
from tests.hardware.radar_cubes import STEP, WIDE, Echo, cube


def ratio(steps: list[np.ndarray], waveform: OfdmWaveform) -> complex:
    """Amplitude of the first receiver's image over its signal."""
    return complex(branch_faults(*by_delay(steps, waveform), image_spreads(waveform))[1][0])


@pytest.mark.parametrize(("gain_db", "phase_deg"), [(0.2, 1.6), (-1.0, 5.0)])
def test_the_image_of_unlike_branches_is_found(gain_db: float, phase_deg: float) -> None:
    """B = (1 - g exp(-j a)) / (1 + g exp(-j a)) (Valkama et al. 2001), within 2 %; none in a record
    without.
    """
    carriers = 2.26e9 + 20e6 * np.arange(25)
    record = cube(
        STEP, [Echo((5, 0, 0), 1e-8)], carriers_hz=carriers, leakage=(1e-6, 4e-9), noise_w=1e-11
    )
    x = complex_samples(record.iq[0])
    g, angle = 10 ** (gain_db / 20), np.radians(phase_deg)
    y = x.real + 1j * g * (np.cos(angle) * x.imag + np.sin(angle) * x.real)
    turn = g * np.exp(-1j * angle)
    assert ratio(list(y), STEP) == pytest.approx((1 - turn) / (1 + turn), rel=0.02)
    assert ratio(list(x), STEP) == 0


@pytest.mark.parametrize("offset", [1, 2, 20, -500])
def test_an_offset_of_the_converters_changes_no_echo(offset: int) -> None:
    """Of some counts, in noise of ten: it looks like an image as strong as the signal. 2 counts
    had taken it up by some dB; 20 were refused.
    """
    record = cube(WIDE, [Echo((6.0, 0, 0), 1e-12)], noise_w=1e-11, counts=40)
    due = process(record).detections[0]
    shifted = replace(record, iq=record.iq + np.int16(offset))
    got = process(shifted).detections[0]
    assert got.power_w == pytest.approx(due.power_w, rel=1e-3)
    assert got.range_m == pytest.approx(due.range_m, abs=0.1 * due.range_error_m)
    x = complex_samples(shifted.iq[0])
    assert ratio(list(x), WIDE) == 0


def with_faults(record, offset: complex, gain_db: float = 0.0, drift: float = 0.0):
    """The record of branches that differ in gain, with an offset in counts that changes by
    ``drift`` of it over the burst.
    """
    course = 1 + drift * np.linspace(-0.5, 0.5, record.iq.shape[2])[:, None, None, None]
    parts = record.iq * np.array([10 ** (gain_db / 20), 1.0])
    parts += course * np.array([np.real(offset), np.imag(offset)])
    return replace(record, iq=np.rint(parts).astype(np.int16))


@pytest.mark.parametrize(("offset", "gain_db"), [(30j, 0.3), (20 + 300j, 1.0), (300, 3.0)])
def test_echoes_at_rest_outlive_offset_and_image_of_strong_leakage(offset, gain_db) -> None:
    """Leakage of 95 dB, an echo at rest of 40, noise of 18 counts: the level within 0.4 dB (five
    standard errors). Delays where the offset happened to cancel the image had counted as quiet:
    the image stayed, and the echo was lost in it.
    """
    noise_w = 10**-9.5 * WIDE.n_subcarriers * WIDE.n_slots
    echo = Echo((3.0, 0, 0), 10**-5.5)
    record = cube(WIDE, [echo], noise_w=noise_w, leakage=(1.0, 0.3e-9))
    frame = process(with_faults(record, offset, gain_db))
    assert len(frame.detections) == 1
    assert not frame.warnings
    gain = abs((10 ** (gain_db / 20) + 1) / 2) ** 2
    level_db = 10 * np.log10(frame.detections[0].power_w / echo.power_w / gain)
    assert level_db == pytest.approx(0, abs=0.4)


@pytest.mark.parametrize("symbols", ["zadoff-chu", "flat"])
def test_an_offset_far_above_echoes_hides_none_of_them(symbols) -> None:
    """Of 50 times the noise; 45 and 26 dB at rest. Levels of 8 records are as without an offset
    within a third of their errors, rms; what was found had been off by 2, and weak ones were lost.
    """
    wave = replace(WIDE, n_subcarriers=64, symbols=symbols)
    changes = []
    for seed in range(8):
        places = 1 + 0.11 * seed, 4 + 0.05 * seed
        echoes = [Echo((r, 0, 0), p) for r, p in zip(places, (1e-9, 10**-10.9), strict=True)]
        record = cube(wave, echoes, noise_w=64 * 64 * 10**-13.5, counts=100, seed=seed)
        due, got = (process(r).detections for r in (record, with_faults(record, 800 - 600j)))
        assert len(due) == len(got) == 2
        changes += [
            (b.power_w - a.power_w) / a.power_error_w for a, b in zip(due, got, strict=True)
        ]
    assert np.sqrt(np.mean(np.square(changes))) < 1 / 3


def test_an_offset_that_drifts_hides_no_slow_echo() -> None:
    """By a fifth of 100 times the noise within the burst; 28 dB, two cells of rate from rest."""
    echo = Echo((3.0, 0, 0), 1e-9, (2 * WIDE.velocity_cell_m_per_s, 0, 0))
    noise_w = echo.power_w * 10**-2.8 * WIDE.n_subcarriers * WIDE.n_slots
    record = cube(WIDE, [echo], noise_w=noise_w, counts=40)
    due = process(record).detections[0]
    frame = process(with_faults(record, 1000, drift=0.2))
    assert not frame.warnings
    assert frame.detections[0].power_w == pytest.approx(due.power_w, abs=due.power_error_w / 2)


@pytest.mark.parametrize(("n_slots", "seed"), [(16, 192), (16, 595), (32, 208), (32, 561)])
def test_quiet_delays_alike_by_chance_are_no_dead_branch(n_slots: int, seed: int) -> None:
    """Of 8 subcarriers of noise 1 record in 100 has an image of 0.9 to 1.3 by the mean over slots,
    while samples of I and Q are independent.
    """
    wave = replace(WIDE, n_subcarriers=8, n_slots=n_slots)
    record = cube(wave, [], noise_w=1e-12, counts=100, seed=seed)
    assert not process(record).detections
    iq = record.iq.copy()
    iq[..., 1] = 3
    with pytest.raises(InputError, match="I and Q depend on each other"):
        process(replace(record, iq=iq))


@pytest.mark.parametrize(("subcarriers", "receivers"), [(8, 8), (16, 4), (32, 1)])
def test_noise_of_few_subcarriers_has_neither_image_nor_offset(subcarriers, receivers) -> None:
    """Of 8, 16 and 32 subcarriers 1 receiver in 8, 100 and 240 had one by chance. None of 2400 has;
    1 in 7e10 is meant to.
    """
    waveform = OfdmWaveform(79e9, subcarriers, 4e6, 8, 4e-6, 8, 0.5e-6)
    rng = np.random.default_rng(5)
    for _ in range(2400 // receivers):
        noise = rng.normal(size=(2, 1, receivers, subcarriers))
        direct, image = by_delay([noise[0] + 1j * noise[1]], waveform)
        offsets, ratios = branch_faults(direct, image, image_spreads(waveform))
        assert not offsets.any()
        assert not ratios.any()


@pytest.mark.parametrize("size", [(9, 16), (16, 4), (16, 16), (64, 16)])
@pytest.mark.parametrize("fault", ["dead", "alike"])
def test_dependent_branches_of_noise_are_told_on_small_maps(size, fault) -> None:
    """Q of a fifteenth of the noise, or I and a sixth of it: samples tell it, where the mean over
    slots does not.
    """
    wave = replace(WIDE, n_subcarriers=size[0], n_slots=size[1])
    for seed in range(8):
        record = cube(wave, [], noise_w=1e-12, counts=100, seed=seed)
        own = np.random.default_rng(seed).normal(0, record.iq.std(), record.iq.shape[:-1])
        iq = record.iq.astype(float)
        iq[..., 1] = own / 15 if fault == "dead" else iq[..., 0] + own / 6
        with pytest.raises(InputError, match="I and Q depend on each other"):
            process(replace(record, iq=np.rint(iq).astype(np.int16)))


@pytest.mark.parametrize(
    ("symbols", "n", "snr_db", "fastest_m_per_s"),
    [("zadoff-chu", 8, 40, 0.3), ("zadoff-chu", 11, 60, 2.0), ("flat", 16, 60, 2.0)],
)
def test_strong_echoes_of_few_subcarriers_are_no_dead_branch(
    symbols, n: int, snr_db: float, fastest_m_per_s: float
) -> None:
    """Two echoes that hardly move look alike in I and Q: 3 of the 200 records of 8 subcarriers had
    been refused.
    """
    wave = replace(WIDE, n_subcarriers=n, n_slots=16, symbols=symbols)
    rng = np.random.default_rng(1)
    for seed in range(200):
        echoes = [
            Echo((wave.max_range_m * place, 0, 0), 1.0, (fastest_m_per_s * rate, 0, 0))
            for place, rate in zip(rng.uniform(0.1, 0.9, 2), rng.uniform(-1, 1, 2), strict=True)
        ]
        record = cube(wave, echoes, noise_w=10 ** (-snr_db / 10) * n * 16, seed=seed)
        without_faults(list(complex_samples(record.iq[0])), wave)


def test_branches_alike_by_rounding_alone_are_processed() -> None:
    """A tenth of a count of noise about the middle between two codes: I has both, Q one."""
    parts = np.random.default_rng(0).normal(0, 0.1, (1, 1, 64, 1, 256, 2)) + np.array([0.5, 0.0])
    record = replace(cube(WIDE, []), iq=np.rint(parts).astype(np.int16))
    assert not process(record).detections
    with pytest.raises(InputError, match="I and Q depend on each other"):
        process(replace(record, iq=50 * record.iq))


@pytest.mark.parametrize(
    ("counts", "fault"),
    [
        ((12, 12), "receiver 0: all samples are the same"),
        ((32767, 32767), "receiver 0: all samples are the same"),
        ((12, 0), "receiver 0: all samples are the same"),
        ((0, 0), None),
    ],
)
def test_samples_that_are_constant_are_told(counts: tuple[int, int], fault: str | None) -> None:
    """A receiver that is stuck, or a converter at its rail; of silence there is nothing to tell."""
    record = cube(WIDE, [], noise_w=1e-10)
    stuck = replace(record, iq=np.broadcast_to(np.array(counts, np.int16), record.iq.shape).copy())
    if fault is None:
        assert not process(stuck).detections
        return
    with pytest.raises(InputError, match=fault):
        process(stuck)

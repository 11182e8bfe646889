"""Carrier steps of a burst, joined to one wide channel."""

import re
from dataclasses import replace

import numpy as np
import pytest
from radar_cubes import CARRIERS, STEP, Echo, cube

from hardware.errors import InputError
from hardware.radar import Cfar, OfdmWaveform
from hardware.radar.burst import demodulate
from hardware.radar.clutter import without_leakage
from hardware.radar.process import process
from hardware.radar.settings import Processing
from hardware.radar.stitching import range_per_rate_s, scatter_per_rate, stitch
from hardware.records import Flag

LEAK = (1e-7, 1.1e-9)


def test_carrier_steps_become_one_channel() -> None:
    """Echoes 20 dB below the leakage: range to the phase that unresolved echoes leave.

    A phase from the plain sum of each step would halve the echoes and mirror them.
    """
    echoes = [Echo((0.9, 0, 0)), Echo((3.1, 0, 0)), Echo((8.0, 0, 0))]
    record = cube(STEP, echoes, carriers_hz=CARRIERS, leakage=LEAK, noise_w=1e-12)
    frame = process(record, 0, Processing(window="hann", cfar=Cfar(1e-6, guard=(3, 0))))
    assert frame.waveform.bandwidth_hz == pytest.approx(500e6)
    found = sorted(d.range_m for d in frame.detections if d.power_w > 3e-10)
    np.testing.assert_allclose(found, [0.9, 3.1, 8.0], atol=0.02)


def test_the_reference_costs_echoes_little() -> None:
    """Power within 0.5 dB, phases of the steps within 0.02 rad; no mirror above -25 dB."""
    echo = Echo((2.4, 0, 0))
    scrambled, still = (
        demodulate(cube(STEP, [echo], carriers_hz=CARRIERS, leakage=LEAK, scrambled=s), 0)
        for s in (True, False)
    )
    for burst in (scrambled, still):
        left = without_leakage(burst.channel, burst.waveform, LEAK[1])
        profile = np.abs(np.fft.ifft(left[0].mean(axis=1) * np.hanning(1600) * 2)) ** 2
        assert 10 * np.log10(profile.max() / 1e-9) == pytest.approx(0, abs=0.7)
        assert profile[-40:].max() < 1e-9 * 10**-2.5


@pytest.mark.parametrize(
    ("range_m", "amplitude"), [(2.0, 0.3), (3.0, 0.42), (4.1, 0.22), (5.0, 0.15), (10.0, 0.04)]
)
def test_a_near_strong_echo_is_within_its_range_error(range_m: float, amplitude: float) -> None:
    """What the phases of steps have of an echo that no step resolves from the reference, without
    noise: at 2 m, where most is, 5 errors and more with those of noise alone.
    """
    leakage = 1e-7, 4e-9
    power_w = leakage[0] * amplitude**2
    off = []
    for seed in range(4):
        echo = Echo((range_m, 0, 0), power_w, phase_rad=1.5 * seed)
        record = cube(STEP, [echo], carriers_hz=CARRIERS, leakage=leakage, noise_w=1e-13, seed=seed)
        found = process(record).detections[0]
        off.append((found.range_m - range_m) / found.range_error_m)
    assert np.sqrt(np.mean(np.square(off))) < 1.5


@pytest.mark.parametrize("range_m", [0.76, 0.85, 0.95, 1.03, 1.1, 1.27, 1.6])
def test_an_echo_beside_the_reference_is_within_its_errors(range_m: float) -> None:
    """Half a cell to 3 cells from it, whose fit takes a part of the echo: ranges were off by 4 to
    16 of the errors stated. What is nearer than a cell is warned of.
    """
    leakage = 1e-7, 4e-9
    power_w = leakage[0] * 10**-2.5
    off = []
    for seed in range(6):
        echo = Echo((range_m, 0, 0), power_w, phase_rad=1.05 * seed)
        record = cube(STEP, [echo], carriers_hz=CARRIERS, leakage=leakage, noise_w=1e-13, seed=seed)
        frame = process(record)
        found = frame.detections[0]
        error_m, error_w = found.range_error_m, found.power_error_w
        assert ("within a cell" in " ".join(frame.warnings)) == (range_m < 0.9)
        off.append([(found.range_m - range_m) / error_m, (found.power_w - power_w) / error_w])
    assert np.abs(off).max() < 1.96


@pytest.mark.parametrize("prefix_symbols", [0.5, 0.99, 1.0, 2.0])
def test_a_prefix_of_a_symbol_leaves_levels_right(prefix_symbols: float) -> None:
    """The path comes again after one symbol. A model with echoes up to there has one at every
    delay and explains any phases of steps: the level fell by 4 dB, mirrored about the path.
    """
    wave = OfdmWaveform(2.25e9, 64, 1e6, 16, 40e-6, 8, prefix_symbols * 1e-6)
    leakage, power_w = (1e-7, 4e-9), 1e-9
    record = cube(
        wave,
        [Echo((1.3, 0, 0), power_w)],
        carriers_hz=2.25e9 + 64e6 * np.arange(8),
        leakage=leakage,
        noise_w=1e-11,
    )
    (found,) = process(record).detections
    assert abs(found.range_m - 1.3) < 1.96 * found.range_error_m
    assert abs(found.power_w - power_w) < 1.96 * found.power_error_w < 0.2 * power_w


def test_late_samples_of_a_retune_are_found() -> None:
    rng = np.random.default_rng(1)
    late = rng.integers(-9, 9, 25)
    f = STEP.frequency_offsets_hz
    channel = np.exp(-2j * np.pi * (CARRIERS[:, None] + f) * LEAK[1])
    channel = channel * np.exp(-2j * np.pi * np.outer(late, f) / STEP.bandwidth_hz)
    steps = np.repeat(channel[None, ..., None], 2, axis=-1)
    joined = stitch(steps, replace(STEP, n_slots=2), CARRIERS, LEAK[1])
    np.testing.assert_array_equal(joined.late_samples, late)
    shuffled = rng.permutation(25)
    other = stitch(steps[:, shuffled], replace(STEP, n_slots=2), CARRIERS[shuffled], LEAK[1])
    np.testing.assert_allclose(other.channel, joined.channel, atol=1e-9)


def test_motion_between_steps_is_taken_out() -> None:
    """5 m/s over 26 ms of retunes moves the echo by 12 cm and smears it unless it is known."""
    echo = Echo((6.0, 0, 0), velocity_m_per_s=(5.0, 0, 0))
    record = cube(STEP, [echo], carriers_hz=CARRIERS, leakage=LEAK)
    how = Processing(window="hann", cfar=Cfar(1e-6, guard=(3, 0)), range_rate_m_per_s=5.0)
    found = process(record, 0, how).detections[0]
    assert found.range_m == pytest.approx(6.0, abs=0.03)
    ignored = process(record, 0, replace(how, range_rate_m_per_s=0.0))
    shift = ignored.detections[0].range_m - 6.0
    assert abs(shift) > 0.2
    (told,) = (line for line in ignored.warnings if "carrier steps" in line)
    assert "holds at a range rate of 0 m/s" in told
    (per_rate,) = re.findall(r"shift it by ([\d.]+) m for each m/s", told)
    assert float(per_rate) == pytest.approx(shift / 5.0, rel=0.05)


def test_steps_in_random_order_shift_little() -> None:
    """One after the other fc / (df/dt); 400 random orders a fifth of that, rms."""
    times, rng = 1e-3 * np.arange(25), np.random.default_rng(1)
    due = CARRIERS.mean() / 20e9
    assert range_per_rate_s(CARRIERS, times) == pytest.approx(due)
    shuffled = [range_per_rate_s(rng.permutation(CARRIERS), times) for _ in range(400)]
    assert np.sqrt(np.mean(np.square(shuffled))) == pytest.approx(due / np.sqrt(24), rel=0.15)
    assert range_per_rate_s(CARRIERS[:1], times[:1]) == 0


def _of_steps(leakage_w: float, rate_m_per_s: float = 0.0, order=slice(None)) -> tuple[str, ...]:
    """Warnings of 8 steps and an echo of 1e-9 W."""
    carriers = CARRIERS[:8][order]
    echo = Echo((6.0, 0, 0), velocity_m_per_s=(rate_m_per_s, 0, 0))
    wave = replace(STEP, carrier_hz=float(carriers[0]))
    leakage = (leakage_w, LEAK[1]) if leakage_w else None
    record = cube(wave, [echo], carriers_hz=carriers, leakage=leakage, noise_w=1e-11)
    end = replace(record.front_end, leakage_delay_s=LEAK[1])
    how = Processing(window="hann", cfar=Cfar(1e-6, guard=(3, 0)))
    return process(replace(record, front_end=end), 0, how).warnings


@pytest.mark.parametrize("leakage_w", [0.0, 1e-11, 1e-10, 1e-9])
def test_a_reference_below_an_echo_is_warned_of(leakage_w: float) -> None:
    """The echo is taken for it: its phases, or the delay of the receiver. 20 dB above is enough."""
    assert any(
        "reference is" in line or "unless the receiver was late" in line
        for line in _of_steps(leakage_w)
    )
    assert not any("reference" in line for line in _of_steps(1e-7))


def test_side_lobes_and_smear_of_moving_echoes_are_warned_of() -> None:
    """Between steps in random order a moving echo has side lobes all over. One after the other a
    stair is left of its phase, of steps of 4 pi fc dt / c for each m/s: rms that over sqrt(12).
    """
    moving = _of_steps(1e-7, 12.0, np.random.default_rng(0).permutation(8))
    assert any("smear over ranges" in line for line in moving)
    assert any("may be side lobes of stronger ones that move" in line for line in moving)
    times, high = 1e-3 * np.arange(25), CARRIERS + 77e9
    stair = 4 * np.pi * high.mean() / 299_792_458 * 1e-3 / np.sqrt(12)
    assert scatter_per_rate(high, times, STEP) == pytest.approx(stair, rel=0.01)
    assert scatter_per_rate(CARRIERS[:1], times[:1], STEP) == 0


@pytest.mark.parametrize(
    ("carriers", "delay", "told"),
    [
        (CARRIERS[[0, 1, 3]], 1e-9, "carriers_hz: 2.28e+09 and 2.32e+09 are not one step"),
        (CARRIERS[:3], np.nan, "leakage_delay_s: unknown"),
    ],
)
def test_steps_that_cannot_be_joined(carriers, delay: float, told: str) -> None:
    steps = np.ones((1, 3, 64, 16), dtype=complex)
    with pytest.raises(ValueError, match=told.replace("+", r"\+")):
        stitch(steps, STEP, carriers, delay)


def test_a_gap_between_steps_leaves_a_narrower_band() -> None:
    record = cube(STEP, [Echo((4.0, 0, 0))], carriers_hz=CARRIERS, leakage=LEAK)
    record.flags[0, 20, 3] = Flag.OVERRUN
    frame = process(record, 0, Processing(window="hann", cfar=Cfar(1e-6, guard=(3, 0))))
    assert frame.waveform.bandwidth_hz == pytest.approx(400e6)
    assert (
        "step 20, slot 3: flagged as overrun (1 of 400 slots lost); processed are steps 0 to 19"
        in (frame.warnings[0])
    )


def test_a_reference_delay_is_within_the_unambiguous_one() -> None:
    """It may be negative: of a reference that arrives before the clock's zero."""
    early = (LEAK[0], -1e-9)
    record = cube(STEP, [Echo((4.0, 0, 0))], carriers_hz=CARRIERS, leakage=early)
    cfar = Cfar(1e-6, guard=(3, 0))
    how = Processing(window="hann", cfar=cfar, reference_delay_s=early[1])
    assert process(record, 0, how).detections[0].range_m == pytest.approx(4.0, abs=0.05)
    with pytest.raises(InputError, match=r"reference_delay_s: -1\.0, expected within"):
        process(record, 0, replace(how, reference_delay_s=-1.0))

"""Echoes to the channel: the non-uniform FFT with range migration against the direct sum."""

import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from scipy.constants import c as C  # noqa: N812

from hardware.radar import OfdmWaveform
from twin.radar.synthesis import Contributions, direct_sum, nonuniform_fft, synthesize

WAVE = OfdmWaveform(79e9, 4096, 976_562.5, 64, 156.25e-6, 151, 1.024e-6)


@pytest.mark.parametrize("shape", [(4096, 64), (255, 33), (64, 1), (1, 16)])
@pytest.mark.parametrize("kind", ["static", "two bodies", "spread", "everything"])
def test_nufft_is_the_direct_sum(kind: str, shape: tuple[int, int]) -> None:
    """Error below 1e-5 of the channel's rms, at frequencies and times all over the grid."""
    rng = np.random.default_rng(1)
    n = 3000
    rates = {
        "static": np.zeros(n),
        "two bodies": np.where(rng.random(n) < 0.5, 0, 2 * 5.5 / C),
        "spread": 2 * (5.5 + 0.1 * rng.normal(size=n)) / C,
        "everything": rng.uniform(-2 * 30 / C, 2 * 30 / C, n),
    }[kind]
    amplitude = rng.normal(size=n) + 1j * rng.normal(size=n)
    # What moves crosses as well, at 15 m/s in 5 to 50 m.
    crossing = np.where(rates != 0, 2 * 15.0**2 / C / rng.uniform(5, 50, n), 0)
    echoes = Contributions.ahead(amplitude, rng.uniform(1e-10, 1.02e-6, n), rates, crossing)
    wave = replace(WAVE, n_subcarriers=shape[0], n_slots=shape[1])
    found = synthesize(echoes, wave)
    rows = np.unique(np.linspace(0, shape[0] - 1, 9).astype(int))
    columns = np.unique(np.linspace(0, shape[1] - 1, 5).astype(int))
    exact = direct_sum(
        echoes, wave.frequency_offsets_hz[rows], wave.slot_times_s[columns], wave.carrier_hz
    )
    rms = np.sqrt(np.mean(np.abs(found) ** 2))
    assert np.abs(found[np.ix_(rows, columns)] - exact).max() < 1e-5 * rms


def test_tolerance_is_what_bounds_the_error() -> None:
    rng = np.random.default_rng(2)
    echoes = Contributions.ahead(
        rng.normal(size=500) + 0j, rng.uniform(0, 1e-6, 500), 2 * rng.uniform(4, 5, 500) / C
    )
    exact = direct_sum(echoes, WAVE.frequency_offsets_hz[::500], WAVE.slot_times_s, WAVE.carrier_hz)
    errors = []
    for tolerance in (1e-3, 1e-6, 1e-9):
        found = synthesize(echoes, WAVE, tolerance)
        rms = np.sqrt(np.mean(np.abs(found) ** 2))
        errors.append(np.abs(found[::500] - exact).max() / rms)
        assert errors[-1] < 10 * tolerance
    assert errors[0] > errors[1] > errors[2]


@pytest.mark.quick(4)
@pytest.mark.parametrize("slots", [16, 256])
@pytest.mark.parametrize("n", [1, 3, 40, 20_000])
@pytest.mark.parametrize("unlike", [0.0, 1e-4, 0.5, 30.0])
def test_accelerations_whichever_way_is_taken(n: int, slots: int, unlike: float) -> None:
    """Alike (bulk motion in closed form), slightly unlike (series, interpolation), and so unlike
    that every slot is computed; products of a few echoes and transforms of many: each within 3
    tolerances of the direct sum. The largest are those of 25 m/s in 5 m and far beyond.
    """
    wave = replace(WAVE, n_subcarriers=64, n_slots=slots, slot_period_s=10e-3 / slots, repeats=1)
    rng = np.random.default_rng(3)
    rates = 2 / C * (5 + 0.1 * rng.uniform(-1, 1, n))
    faster = 2 / C * 125 * (1 + unlike * rng.uniform(-1, 1, n))
    echoes = Contributions.ahead(rng.normal(size=n) + 0j, rng.uniform(0, 1e-6, n), rates, faster)
    rows = np.arange(0, 64, 9)
    exact = direct_sum(
        echoes, wave.frequency_offsets_hz[rows], wave.slot_times_s[::5], wave.carrier_hz
    )
    rms = np.sqrt(np.mean(np.abs(exact) ** 2))
    for tolerance in (1e-3, 1e-6):
        found = synthesize(echoes, wave, tolerance)[rows, ::5]
        assert np.abs(found - exact).max() < 3 * tolerance * rms


@pytest.mark.parametrize("n", [1, 3, 200])
def test_accelerations_of_what_nearly_touches_the_radar(n: int) -> None:
    """25 m/s a micrometre away and farther, up to 1e7 rad within the interval: still the sum."""
    wave = replace(WAVE, n_subcarriers=16, n_slots=256, slot_period_s=39.0625e-6, repeats=1)
    rng = np.random.default_rng(6)
    faster = 2 / C * 25.0**2 / 10 ** rng.uniform(-6, 0, n)
    echoes = Contributions.ahead(np.ones(n, complex), rng.uniform(0, 1e-9, n), np.zeros(n), faster)
    exact = direct_sum(echoes, wave.frequency_offsets_hz, wave.slot_times_s, wave.carrier_hz)
    assert np.abs(synthesize(echoes, wave) - exact).max() < 1e-4 * np.sqrt(n)


def test_no_acceleration_is_motion_to_first_order_to_the_bit() -> None:
    rng = np.random.default_rng(4)
    amplitude, delay = rng.normal(size=500) + 0j, rng.uniform(0, 1e-6, 500)
    for rates in (np.zeros(500), 2 * rng.uniform(4, 5, 500) / C):
        none, zero = (
            synthesize(Contributions.ahead(amplitude, delay, rates, faster), WAVE)
            for faster in (None, np.zeros(500))
        )
        assert none.tobytes() == zero.tobytes()


def test_what_is_at_rest_is_transformed_once_beside_what_moves_slowly(monkeypatch) -> None:
    """10 000 echoes at rest beside 10 that creep: one transform of them, not one at every time."""
    transform, transformed = nonuniform_fft._at_times, []

    def counting(contributions, members, times_s, *rest):
        transformed.append((len(members), len(times_s)))
        return transform(contributions, members, times_s, *rest)

    monkeypatch.setattr(nonuniform_fft, "_at_times", counting)
    rates = np.where(np.arange(10_010) < 10, 2 * 0.4 / C, 0) * np.linspace(1, 2, 10_010)
    rng = np.random.default_rng(5)
    echoes = Contributions.ahead(np.ones(10_010, complex), rng.uniform(0, 1e-6, 10_010), rates)
    synthesize(echoes, WAVE)
    assert [times for n, times in transformed if n > 10] == [1]
    assert sum(n for n, _ in transformed) == 10_010


def test_a_body_takes_few_times_however_many_slots_there_are(monkeypatch) -> None:
    """A car at 1.5 m/s whose parts differ by 0.1 m/s, 3.3 rad after 5 ms either way: some 10."""
    transform, counts = nonuniform_fft._at_times, []

    def counting(contributions, members, times_s, *rest):
        counts.append(len(times_s))
        return transform(contributions, members, times_s, *rest)

    monkeypatch.setattr(nonuniform_fft, "_at_times", counting)
    rng = np.random.default_rng(7)
    rates = 2 / C * (1.5 + 0.1 * rng.uniform(-1, 1, 20_000))
    echoes = Contributions.ahead(np.ones(20_000, complex), rng.uniform(0, 1e-7, 20_000), rates)
    for slots in (64, 256):
        synthesize(echoes, replace(WAVE, n_slots=slots, slot_period_s=10e-3 / slots, repeats=1))
    assert max(counts) <= 16


@pytest.mark.parametrize("moving", [False, True])
def test_what_falls_off_over_the_band_does_so_exactly(moving: bool) -> None:
    """Powers 0 to 2, as of faces, edges and corners, and delays of up to five unambiguous ranges:
    the first two terms of the power's series would be 6e-4 off at the band's ends.
    """
    rng, n = np.random.default_rng(8), 2000
    rates = 2 / C * rng.uniform(-9, 9, n) * moving
    part = Contributions.ahead(rng.normal(size=n) + 0j, rng.uniform(0, 5e-6, n), rates)
    part = replace(part, falloff=rng.integers(0, 3, n).astype(float))
    wave = replace(WAVE, n_slots=16)
    exact = direct_sum(part, wave.frequency_offsets_hz[::91], wave.slot_times_s, wave.carrier_hz)
    rms = np.sqrt(np.mean(np.abs(exact) ** 2))
    for tolerance in (1e-3, 1e-6, 1e-9):
        off = np.abs(synthesize(part, wave, tolerance)[::91] - exact).max()
        assert off < 3 * tolerance * rms


def test_the_same_bits_whatever_the_number_of_threads(monkeypatch) -> None:
    """A world at rest and two bodies, 80 000 echoes: several threads would have their share."""
    rng, n = np.random.default_rng(9), 80_000
    rates = 2 / C * rng.choice([0.0, 1.5, -8.0], n) * rng.uniform(0.95, 1.05, n)
    part = Contributions.ahead(rng.normal(size=n) + 0j, rng.uniform(0, 1e-6, n), rates)
    part = replace(part, falloff=rng.integers(0, 3, n).astype(float))
    channels = []
    for threads in ("1", "2", "5"):
        monkeypatch.setenv("OMP_NUM_THREADS", threads)
        channels.append(synthesize(part, WAVE))
    assert all(channel.tobytes() == channels[0].tobytes() for channel in channels)


@pytest.mark.thorough
def test_the_same_bits_whatever_the_number_of_threads_of_blas() -> None:
    """Movers that take more times than one matrix product has, an odd subcarrier and slot over:
    shapes that BLAS would give to several threads, or to a kernel that adds in another order.
    """
    code = """
import hashlib, numpy as np
from hardware.waveform import OfdmWaveform
from twin.radar.synthesis import Contributions, synthesize
rng, n = np.random.default_rng(10), 5000
rates = rng.uniform(-1, 1, n) * 4e-8
part = Contributions.ahead(rng.normal(size=n) + 0j, rng.uniform(0, 1e-6, n), rates)
wave = OfdmWaveform(79e9, 513, 976562.5, 257, 39e-6, 1, 1.024e-6)
print(hashlib.sha1(synthesize(part, wave).tobytes()).hexdigest())
"""
    found = [
        subprocess.run(
            [sys.executable, "-c", code],
            env=os.environ | {"OPENBLAS_NUM_THREADS": threads},
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for threads in ("1", "4")
    ]
    assert found[0] == found[1]


def test_no_contribution_is_silence() -> None:
    assert not synthesize(Contributions.none(), WAVE).any()

"""Echoes to the channel: the non-uniform FFT with range migration against the direct sum."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.constants import c as C  # noqa: N812

from hardware.radar import OfdmWaveform
from twin.radar.synthesis import Contributions, direct_sum, synthesize

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
    echoes = Contributions.ahead(amplitude, rng.uniform(1e-10, 1.02e-6, n), rates)
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


def test_no_contribution_is_silence() -> None:
    assert not synthesize(Contributions.none(), WAVE).any()

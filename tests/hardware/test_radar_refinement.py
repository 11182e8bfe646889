"""Climbing to the place of an echo between the cells: against definitions and a plain search."""

from dataclasses import replace

import numpy as np
import pytest
from radar_cubes import WIDE
from scipy.optimize import minimize

from hardware.radar.refinement import blocks_about, peak_offsets, unit_echoes


@pytest.mark.parametrize("phase", [0.0, 1e-3, 0.3, 2.0, 4.99, 5.01, 40.0])
def test_migration_is_the_exponential(phase: float) -> None:
    """exp(2 pi j f rate t) by series and by exponentials, for several rates at once and alone, to
    the rounding of a series of terms up to exp(5); and a whole step with the carrier's turn.
    """
    (blocks,) = blocks_about(
        np.ones((WIDE.n_subcarriers, WIDE.n_slots), complex), WIDE, "boxcar", *np.zeros((2, 1))
    )
    grid = blocks.grid
    rate = phase / (2 * np.pi * np.abs(grid.f_hz).max() * np.abs(grid.t_s).max())
    for rates in (np.array([rate]), np.array([-rate, 0.4 * rate])):
        exact = np.exp(2j * np.pi * rates[:, None, None] * np.outer(grid.f_hz, grid.t_s))
        np.testing.assert_allclose(grid.migration(rates), exact, atol=2e-13)
    delay, rate = np.array([-1.7, rate / grid.cell[1]]) * grid.cell
    cycles = delay * grid.f_hz[:, None] + rate * np.outer(grid.carrier_hz + grid.f_hz, grid.t_s)
    step = np.array([delay, rate]) / grid.cell
    np.testing.assert_allclose(grid.phasor(step), np.exp(2j * np.pi * cycles), atol=1e-11)


@pytest.mark.parametrize("n_slots", [48, 1])
def test_peaks_are_those_of_a_search(n_slots: int) -> None:
    """Of three echoes cells apart on two channels, climbed all at once: against SciPy's Nelder and
    Mead on the power by its definition; with one slot, of the delay alone.
    """
    rng = np.random.default_rng(4)
    wave = replace(WIDE, n_subcarriers=64, n_slots=n_slots)
    f, t = wave.frequency_offsets_hz[:, None], wave.slot_times_s
    places = np.array([[20.3, 5.2], [33.7, -11.4], [41.1, 7.9]]) * [1, n_slots > 1]  # cells
    cell = np.array([wave.delay_cell_s, wave.delay_rate_cell])
    strength = rng.normal(size=(2, 3, 2)).view(complex)[..., 0] + 2

    def turn(place: np.ndarray) -> np.ndarray:
        delay, rate = place * cell
        return np.exp(-2j * np.pi * (delay * f + rate * (wave.carrier_hz + f) * t))

    channel = np.tensordot(strength, [turn(place) for place in places], 1)
    near = np.rint(places)
    steps = peak_offsets(blocks_about(channel, wave, "boxcar", *(near * cell).T))

    def loss(place: np.ndarray) -> float:
        power = np.abs(np.sum(channel * turn(place).conj(), axis=(1, 2))) ** 2
        return -float(power.sum()) / channel.size**2

    axes = slice(None) if n_slots > 1 else slice(1)
    for found in near + steps:
        search = minimize(loss, found + 0.1, method="Nelder-Mead", options={"xatol": 1e-7})
        # Blocks of one subcarrier and one slot: the sums are exact.
        np.testing.assert_allclose(found[axes], search.x[axes], atol=1e-5)


@pytest.mark.parametrize("window", ["boxcar", "blackmanharris"])
def test_echoes_of_another_fold_are_modelled(window: str) -> None:
    """Slots of one block see an echo of another fold turn by whole turns, and lose nothing of it:
    sums over 32 blocks of channels by definition, 0 to 2 spans off, to what migrates in a block.
    """
    wave = replace(WIDE, slot_period_s=156.25e-6)
    f, t = wave.frequency_offsets_hz[:, None], wave.slot_times_s
    delay_s, rate = 33e-9, 2e-9 + 2 * wave.max_delay_rate * np.arange(3)
    for own in rate:
        cycles = own * t * (wave.carrier_hz + f) + f * (delay_s + 0.13e-9)
        channel = np.exp(-2j * np.pi * cycles)
        (blocks,) = blocks_about(channel, wave, window, np.array([delay_s]), rate[:1], 32)
        steps = np.array([[0.13e-9, own - rate[0]]]) / blocks.grid.cell
        np.testing.assert_allclose(unit_echoes(blocks, steps), blocks.sums, atol=4e-5)


@pytest.mark.parametrize("window", ["boxcar", "blackmanharris", "hann", "taylor"])
@pytest.mark.parametrize("away", [(0.4, 0.3), (-0.45, -0.5)])
def test_a_window_moves_no_echo_of_a_cell(window: str, away: tuple[float, float]) -> None:
    """Many samples in a block, of uneven weight: an echo between cells is found at its place, to
    1e-5 of a cell; with blocks counted from their plain middles it is a thousandth of ``away`` off.
    """
    wave = replace(WIDE, n_subcarriers=4096, n_slots=256, slot_period_s=39.0625e-6)
    cell = np.array([wave.delay_cell_s, wave.delay_rate_cell])
    delay, rate = (np.array([40.0, 20.0]) + away) * cell
    cycles = delay * wave.frequency_offsets_hz[:, None] + rate * np.outer(
        wave.carrier_hz + wave.frequency_offsets_hz, wave.slot_times_s
    )
    about = np.array([[40.0], [20.0]]) * cell[:, None]
    blocks = blocks_about(np.exp(-2j * np.pi * cycles), wave, window, *about)
    np.testing.assert_allclose(peak_offsets(blocks)[0], away, atol=1e-5)

"""Echoes of facets by pairs of paths, against integrals and sums made facet by facet."""

import numpy as np
import pytest

from twin.radar.propagation.diffraction import two_way_echoes
from twin.radar.propagation.diffraction.shadowed_facets import Facets
from twin.radar.propagation.diffraction.triangle_means import mean_waves
from twin.radar.rows import phasors

_K, _STEP, _BIN_M = 1655.0, two_way_echoes._STEP, two_way_echoes._BIN_M


def _means(longer_m: np.ndarray, factor: np.ndarray, by: float) -> np.ndarray:
    """Over triangles, of values (3, n) at the corners; the second leg changes nothing."""
    number, triangle = np.arange(longer_m.size).reshape(3, -1), np.arange(longer_m.shape[1])
    longer_m = np.append(longer_m, np.zeros_like(longer_m))
    waves = longer_m, np.append(factor, np.ones_like(factor)), phasors(-_K * longer_m)
    first = np.multiply.outer([0, number.size], np.ones_like(triangle))
    return mean_waves((*waves, phasors(-by * longer_m)), first, number, triangle, _K, by)[0]


def test_means_over_triangles_are_gauss_integrals() -> None:
    """Of waves with linear phases and amplitudes, at three wavenumbers: triangles from 1 um, where
    all corners are alike, to 2 cm; some with two corners alike, or all three.
    """
    rng = np.random.default_rng(1)
    longer_m = rng.normal(size=(3, 700)) * 10 ** rng.uniform(-6, -1.7, 700) + rng.normal(size=700)
    factor = rng.normal(size=(3, 700)) + 1j * rng.normal(size=(3, 700))
    factor[:, :100], longer_m[1, 100:200], longer_m[:, 200:230] = 1, longer_m[0, 100:200], 1.0
    means = _means(longer_m, factor, _STEP)
    nodes, weights = np.polynomial.legendre.leggauss(60)
    u, v = np.meshgrid((nodes + 1) / 2, (nodes + 1) / 2)
    share = np.array([1 - u - v * (1 - u), u, v * (1 - u)]).reshape(3, -1)
    area = (np.outer(weights, weights) / 2 * (1 - u)).ravel()
    for mean, k in zip(means, (_K - _STEP, _K, _K + _STEP), strict=True):
        wave = (factor.T @ share) * np.exp(-1j * k * (longer_m.T @ share))
        np.testing.assert_allclose(mean, wave @ area, rtol=0, atol=5e-6)


def test_means_of_facets_are_those_of_linear_phases() -> None:
    """By their gradients, as `Facets.mean` takes them, from square to steep."""
    rng = np.random.default_rng(3)
    corners = rng.normal(size=(500, 3, 3)) * 10 ** rng.uniform(-6, -2, 500)[:, None, None]
    nothing, slope = np.zeros(500, dtype=np.int64), _K * rng.normal(size=(500, 3))
    facets = Facets(corners, nothing, nothing)
    longer_m = -np.einsum("nci,ni->cn", corners - facets.middle[:, None], slope) / _K
    ones = np.ones((3, 500), dtype=complex)
    mean = _means(longer_m, ones, 0.0)[1]
    np.testing.assert_allclose(facets.mean(slope), mean, rtol=0, atol=5e-6)


def test_binned_waves_sum_to_the_same_all_over_the_band() -> None:
    """Three lengths for each wave are exact at the carrier and 1.7 GHz from it, and right to 0.004
    of each wave between and up to 2 GHz; with two, an eighth of the square of the phase between
    them was missing, 0.02. Each group has its own sums.
    """
    rng = np.random.default_rng(5)
    group = np.sort(rng.integers(0, 40, 3000))
    longer_m = rng.uniform(-0.02, 0.3, 3000) + 0.1 * group
    wave = rng.normal(size=3000) + 1j * rng.normal(size=3000)
    waves = [wave * phasors(-k * longer_m) for k in (_K - _STEP, _K, _K + _STEP)]
    total, first, bins = two_way_echoes._binned(*waves, longer_m, group, _K)
    for off, permitted in ((0.0, 1e-11), (_STEP, 1e-11), (-_STEP, 1e-11), (42.0, 4e-3), (21, 4e-3)):
        parts = total * np.exp(-1j * (_K + off) * bins * _BIN_M)
        for number in np.unique(group):
            ours, every = parts[group[first] == number], group == number
            direct = np.sum(wave[every] * np.exp(-1j * (_K + off) * longer_m[every]))
            assert abs(ours.sum() - direct) <= permitted * np.sum(abs(wave[every]))


@pytest.mark.parametrize("above", [0.0, 0.25, 0.5])
def test_a_wave_that_is_no_single_length_is_right_over_the_band(above: float) -> None:
    """The mean of a wave over 2 cm of lengths, which halves and doubles from one end of the band to
    the other.
    """
    longer_m = np.array([(7 + above) * _BIN_M])

    def wave(off: float) -> np.ndarray:
        return np.sinc(0.02 * (_K + off) / (2 * np.pi)) * phasors(-(_K + off) * longer_m)

    waves = [wave(off) for off in (-_STEP, 0.0, _STEP)]
    group = np.zeros(1, dtype=np.int64)
    total, _, bins = two_way_echoes._binned(*waves, longer_m, group, _K)
    for off in np.linspace(-42, 42, 9):
        parts = total * np.exp(-1j * (_K + off) * bins * _BIN_M)
        assert abs(parts.sum() - wave(off)) < 0.02 * np.abs(waves).max()

"""Echoes of facets by pairs of paths, against sums made facet by facet."""

import numpy as np
import pytest

from twin.radar.propagation.diffraction import two_way_echoes
from twin.radar.propagation.diffraction.shadowed_facets import Facets
from twin.radar.rows import dots, phasors

_K, _STEP = 1655.0, two_way_echoes._STEP


def test_means_over_facets_are_those_of_the_sum_of_both_paths() -> None:
    """Phasors of two paths multiply: the mean for the sum of both gradients, from products of
    phasors, is the one that `Facets.mean` integrates for that sum. Facets from 1 um, where all
    phases are small, to 2 cm; edges along which the phase does not change are among them. With any
    corner out of order the means would be off by as much as they are.
    """
    rng = np.random.default_rng(3)
    size_m = 10 ** rng.uniform(-6, -1.7, 5000)
    corners = rng.normal(size=(5000, 3, 3)) * size_m[:, None, None]
    one, other = rng.normal(size=(2, 5000, 3))
    one[:500], other[:500] = (
        v - dots(v, side)[:, None] * side
        for side in [_unit(corners[:500, 1] - corners[:500, 0])]
        for v in (one[:500], other[:500])
    )
    nothing = np.zeros(5000, dtype=np.int64)
    facets = Facets(corners, nothing, nothing)
    off = (corners - facets.middle[:, None]).swapaxes(0, 1)
    lengths_m = [np.stack([dots(corner, way) for corner in off]) for way in (one, other)]
    half, step = (
        phasors(k * lengths_m[0] / 2) * phasors(k * lengths_m[1] / 2) for k in (_K, _STEP)
    )
    means = two_way_echoes._means(sum(lengths_m), half, step, _K)
    for mean, k in zip(means, (_K - _STEP, _K, _K + _STEP), strict=True):
        np.testing.assert_allclose(mean, facets.mean(k * (one + other)), rtol=0, atol=1e-11)


def test_binned_waves_sum_to_the_same_at_the_carrier_and_nearly_at_the_ends_of_the_band() -> None:
    """Two lengths for each wave are exact at the carrier; at 2 GHz from it, where the phase between
    the two is 0.3 rad, an eighth of its square is missing of each at most. Each group has
    its own sums.
    """
    rng = np.random.default_rng(5)
    group = np.sort(rng.integers(0, 40, 3000))
    longer_m = rng.uniform(-0.02, 0.3, 3000) + 0.1 * group
    wave = rng.normal(size=3000) + 1j * rng.normal(size=3000)
    turned, none = wave * np.exp(-1j * _K * longer_m), np.zeros(3000, dtype=complex)
    total, first, bins = two_way_echoes._binned(turned, none, longer_m, group, _K)
    for k, permitted in ((_K, 1e-12), (_K + 42.0, 0.31**2 / 8)):
        parts = total * np.exp(-1j * k * bins * two_way_echoes._BIN_M)
        for number in np.unique(group):
            ours, every = parts[group[first] == number], group == number
            direct = np.sum(wave[every] * np.exp(-1j * k * longer_m[every]))
            assert abs(ours.sum() - direct) <= permitted * np.sum(abs(wave[every]))


@pytest.mark.parametrize("above", [0.0, 0.25])
def test_a_moment_moves_a_wave_to_another_length(above: float) -> None:
    """A wave with a moment m is to first order one that is m longer, where it is on a bin and where
    it is between two.
    """
    longer_m = np.array([(7 + above) * two_way_echoes._BIN_M])
    wave, moment_m = np.ones(1, dtype=complex), np.full(1, 1e-4 + 0j)
    group = np.zeros(1, dtype=np.int64)
    turn = np.exp(-1j * _K * longer_m)
    total, _, bins = two_way_echoes._binned(wave * turn, moment_m * turn, longer_m, group, _K)
    for off in (-1.0, 1.0):
        parts = total * np.exp(-1j * (_K + off) * bins * two_way_echoes._BIN_M)
        expected = np.exp(-1j * (_K + off) * longer_m[0]) * (1 - 1j * off * 1e-4)
        assert abs(parts.sum() - expected) < 1e-5


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)

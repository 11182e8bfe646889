"""Orthogonal matching pursuit in a DCT or Haar dictionary (the paper's choice).

Atoms are A d_k w_k with w_k the standard deviation of the coefficient under the 1/f^2 prior. They
are not normalised: low-sequency patterns hardly measure fine atoms, which normalisation would
amplify, at a loss of 5 dB.

The number of selected atoms is bounded; the rest of the measurements beyond the noise is explained
by projection onto the nearest image that agrees with them.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from hardware.reconstruction.dictionaries import DICTIONARIES, prior_deviation
from hardware.reconstruction.projection import allowed
from hardware.reconstruction.pursuit import batch_omp
from hardware.reconstruction.registry import Array, method
from hardware.reconstruction.sensing import Sensing

#: Candidate atoms per measurement, those of largest weighted norm. More have no effect (an atom's
#: correlation is bounded by its norm), and memory grows with their square.
ATOMS_PER_MEASUREMENT = 4
#: The same in all: the Gram matrix takes 8 bytes times its square, 128 MiB.
MOST_ATOMS = 4096
#: Selected atoms per measurement, where the noise does not stop the pursuit earlier.
CHOSEN_PER_MEASUREMENT = 0.75
#: The same in all: the time grows with its square, to half a second. A cap of 256 costs 2 dB at
#: 1024 patterns of 64 x 64 without noise; with noise the pursuit stops long before.
MOST_CHOSEN = 768


@method("omp")
def omp_dct(values: Array, noise_variance: float, sensing: Sensing) -> tuple[Array, None]:
    """Batch orthogonal matching pursuit, DCT dictionary weighted by the 1/f^2 prior."""
    return _pursue(values, noise_variance, sensing, "dct"), None


@method("omp-haar")
def omp_haar(values: Array, noise_variance: float, sensing: Sensing) -> tuple[Array, None]:
    """Batch orthogonal matching pursuit, Haar dictionary weighted by the 1/f^2 prior."""
    return _pursue(values, noise_variance, sensing, "haar"), None


@dataclass(frozen=True, eq=False)
class OmpPlan:
    """Atoms as measured (count, n), less the flat image's direction, and their Gram matrix.

    ``bases`` make an image from coefficients, of which ``candidates`` take part with ``weights``;
    ``flat`` (count,) is the flat image as measured.
    """

    atoms: Array
    gram: Array
    bases: tuple[Array, Array]
    candidates: NDArray[np.intp]
    weights: Array
    flat: Array
    n_atoms: int


@lru_cache(maxsize=8)
def omp_plan(sensing: Sensing, dictionary: str) -> OmpPlan:
    """What depends on the patterns alone."""
    rows, columns = sensing.shape
    bases = DICTIONARIES[dictionary](rows), DICTIONARIES[dictionary](columns)
    weights = prior_deviation(dictionary, rows, columns).ravel()
    flat = sensing.of_flat
    along_flat, energy = np.zeros((2, sensing.n_cells))
    for some, rows_seen in _measured(sensing, bases):
        energy += np.einsum("ij,ij->j", rows_seen, rows_seen)
        along_flat += flat[some] @ rows_seen
    if (power := float(flat @ flat)) > 0:
        energy -= along_flat**2 / power
        along_flat /= power
    n = min(ATOMS_PER_MEASUREMENT * sensing.count, MOST_ATOMS, sensing.n_cells)
    candidates = np.argsort(-energy * weights**2, kind="stable")[:n]
    atoms = np.empty((sensing.count, n))
    for some, rows_seen in _measured(sensing, bases):
        atoms[some] = (
            rows_seen[:, candidates] - np.outer(flat[some], along_flat[candidates])
        ) * weights[candidates]
    n_atoms = min(int(np.ceil(CHOSEN_PER_MEASUREMENT * sensing.count)), MOST_CHOSEN)
    return OmpPlan(atoms, atoms.T @ atoms, bases, candidates, weights[candidates], flat, n_atoms)


def _measured(sensing: Sensing, bases: tuple[Array, Array]) -> Iterator[tuple[slice, Array]]:
    """All atoms as measured, 128 measurements at a time: ``(128, n_cells)``."""
    down, along = bases
    for start in range(0, sensing.count, 128):
        some = slice(start, min(start + 128, sensing.count))
        units = np.eye(sensing.count, some.stop - start, -start)
        rows = sensing.adjoint(units).T.reshape(-1, *sensing.shape)
        yield some, np.asarray((down @ rows @ along.T).reshape(-1, sensing.n_cells))


def _pursue(values: Array, noise_variance: float, sensing: Sensing, dictionary: str) -> Array:
    plan = omp_plan(sensing, dictionary)
    power = float(plan.flat @ plan.flat)
    structure = values - plan.flat * (float(plan.flat @ values) / power) if power else values
    support, x = batch_omp(
        plan.gram,
        plan.atoms.T @ structure,
        plan.n_atoms,
        energy=float(structure @ structure),
        tolerance=len(values) * noise_variance,
    )
    down, along = plan.bases
    coefficients = np.zeros(len(down) * len(along))
    coefficients[plan.candidates[support]] = x * plan.weights[support]
    cells = (down.T @ coefficients.reshape(len(down), -1) @ along).ravel()
    if power:  # what the atoms leave of the flat image's direction is the mean
        cells += float(plan.flat @ (values - sensing.forward(cells))) / power
    return allowed(cells, values, noise_variance, sensing)

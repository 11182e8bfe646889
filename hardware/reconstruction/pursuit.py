"""Orthogonal matching pursuit from a Gram matrix (Batch-OMP).

Rubinstein, Zibulevsky and Elad, "Efficient implementation of the K-SVD algorithm using batch
orthogonal matching pursuit", Technion CS-2008-08. Here the Cholesky factor is carried along as the
correlations of all atoms with the orthonormalised chosen ones: one product per atom, no solves
until the end.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hardware import compiled

Array = NDArray[np.float64]

#: An atom whose part outside those chosen has less than this share of its energy adds nothing.
_DEPENDENT = 1e-12


def batch_omp(
    gram: Array, correlations: Array, n_atoms: int, *, energy: float = np.inf, tolerance: float = 0
) -> tuple[NDArray[np.intp], Array]:
    """Atoms chosen greedily and their least-squares coefficients.

    Parameters
    ----------
    gram : (n, n) array, C-contiguous
        D^T D of the atoms; their norms are used as they are.
    correlations : (n,) array
        D^T y.
    n_atoms
        Stop at this number of atoms,
    energy, tolerance
        or when the residual's energy ``|y - D x|^2``, which starts at ``energy``, has come down to
        ``tolerance``, or when nothing correlates any more.

    Returns
    -------
    Support and coefficients, both ``(k,)``, in the order chosen.
    """
    n_atoms = min(n_atoms, len(correlations))
    support = np.empty(n_atoms, np.intp)
    basis = np.empty((n_atoms, len(correlations)))
    scores = np.empty(n_atoms)
    residual = np.array(correlations, dtype=np.float64)
    select = compiled.kernel(_select_loops) if compiled.available() else _select_arrays
    k = select(gram, residual, float(energy), float(tolerance), support, basis, scores)
    atoms = support[:k]
    if k == 0:
        return atoms, np.empty(0)
    factor = basis[:k, atoms]  # upper triangular: gram[atoms][:, atoms] = factor^T factor
    return atoms, np.asarray(_back_substitution(factor, scores[:k]))


def _back_substitution(upper: Array, right: Array) -> Array:
    from scipy.linalg import lapack  # takes 0.1 s to import

    return lapack.dtrtrs(upper, right)[0]


def _select_arrays(
    gram: Array,
    residual: Array,
    energy: float,
    tolerance: float,
    support: NDArray[np.intp],
    basis: Array,
    scores: Array,
) -> int:
    size = np.empty_like(residual)
    change = np.empty_like(residual)
    for k in range(len(support)):
        np.abs(residual, out=size)
        atom = int(size.argmax())
        row = basis[k]
        if energy <= tolerance or size[atom] == 0 or atom in support[:k]:
            return k
        earlier = basis[:k, atom]
        np.dot(earlier, basis[:k], out=row)
        np.subtract(gram[atom], row, out=row)
        if row[atom] <= _DEPENDENT * gram[atom, atom]:
            return k
        row *= 1 / np.sqrt(row[atom])
        score = residual[atom] / row[atom]
        residual -= np.multiply(row, score, out=change)
        support[k], scores[k] = atom, score
        energy -= score**2
    return len(support)


def _select_loops(
    gram: Any, residual: Any, energy: float, tolerance: float, support: Any, basis: Any, scores: Any
) -> int:
    """The same, as loops for the compiler."""
    n = residual.size
    for k in range(support.size):
        largest = 0.0
        for i in range(n):
            largest = max(largest, abs(residual[i]))
        atom = 0
        while atom < n - 1 and abs(residual[atom]) != largest:
            atom += 1
        if energy <= tolerance or largest == 0.0:
            return k
        for j in range(k):
            if support[j] == atom:
                return k
        row = basis[k]
        for i in range(n):
            row[i] = gram[atom, i]
        j = 0
        while j + 4 <= k:  # four at a time: a quarter of the passes over row
            a, b, c, d = basis[j, atom], basis[j + 1, atom], basis[j + 2, atom], basis[j + 3, atom]
            for i in range(n):
                row[i] -= (
                    a * basis[j, i]
                    + b * basis[j + 1, i]
                    + c * basis[j + 2, i]
                    + d * basis[j + 3, i]
                )
            j += 4
        while j < k:
            a = basis[j, atom]
            for i in range(n):
                row[i] -= a * basis[j, i]
            j += 1
        if row[atom] <= 1e-12 * gram[atom, atom]:
            return k
        scale = 1 / np.sqrt(row[atom])
        score = residual[atom] * scale
        for i in range(n):
            row[i] *= scale
            residual[i] -= score * row[i]
        support[k], scores[k] = atom, score
        energy -= score**2
    return int(support.size)

"""Many images at once, over any array library: NumPy, CuPy, PyTorch (the Array API standard).

The same algorithms as in `hardware.reconstruction.methods`, with the images along one more axis and
without Python loops over them, so that a GPU runs a video, a sweep or the columns of a line sensor
in parallel. Arrays come back in the library, on the device and in the precision they came in.
Values are ``(count, n_images)``; needs ``array-api-compat`` (extra ``batch``).
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hardware.patterns import PatternSet
from hardware.patterns.transform import small_matrix
from hardware.reconstruction.cosine import dct_matrix
from hardware.reconstruction.dictionaries import prior_deviation
from hardware.reconstruction.methods import fista as single_fista
from hardware.reconstruction.methods import total_variation as single_tv
from hardware.reconstruction.methods.lmmse import lmmse_blocks
from hardware.reconstruction.primal_dual import RELAXATION
from hardware.reconstruction.prior import prior_spectrum, walsh_variance
from hardware.reconstruction.sensing import Sensing


def batch_fwht(cells: Any) -> Any:
    """Walsh-Hadamard transform along the first axis of ``(n, n_images)``, natural order."""
    xp = _namespace(cells)
    n, images = cells.shape
    x, left, inner = cells, n, images
    while left > 1:
        factor = min(left, 64)
        x = _like(small_matrix(factor), cells) @ xp.reshape(x, (-1, factor, inner))
        left, inner = left // factor, inner * factor
    return xp.reshape(x, (n, images))


def batch_lmmse(values: Any, noise_variance: Any, patterns: PatternSet) -> Any:
    """Cells ``(n_cells, n_images)`` of linear minimum mean-square error.

    ``noise_variance`` (n_images,), of one measurement.
    """
    xp = _namespace(values)
    blocks = lmmse_blocks(Sensing(patterns))
    is_mean = _like((patterns.indices == 0).astype(float)[:, None], values)
    structure = values * (1 - is_mean)
    scale = _prior_scale(xp.sum(structure**2, axis=0), noise_variance, patterns)
    some = scale > 0
    safe = xp.where(some, scale, xp.ones_like(scale))
    ratio = xp.maximum(noise_variance / safe, xp.full_like(safe, blocks.floor))
    found, places = [], []
    for b in blocks.blocks:
        vectors = _like(b.eigenvectors, values)
        y = xp.take(structure, _index(b.place, values), axis=0)
        scores = xp.matrix_transpose(vectors) @ y / (_like(b.eigenvalues[:, None], values) + ratio)
        found.append(vectors @ scores)
        places.append(b.place)
    found.append(0 * structure[: len(blocks.mean_at), :])
    place = np.argsort(np.concatenate([*places, blocks.mean_at]))
    duals = xp.take(xp.concat(found, axis=0), _index(place, values), axis=0)
    spectrum = _like(prior_spectrum(patterns.rows, patterns.columns), values)
    analysed, synthesised = _cosine(patterns, values)
    cells = synthesised(spectrum * analysed(_adjoint(duals, patterns)))
    mean = xp.sum(values * is_mean, axis=0) / patterns.n_cells
    return mean + xp.where(some, cells, xp.zeros_like(cells))


def batch_pursuit(
    gram: Any, correlations: Any, n_atoms: int, *, energy: Any = None, tolerance: float = 0.0
) -> tuple[Any, Any]:
    """Batch-OMP of many signals in one dictionary, as `pursuit.batch_omp` does one.

    Parameters
    ----------
    gram : (n, n) array
    correlations : (n_images, n) array
    n_atoms, energy, tolerance
        As there; ``energy`` (n_images,).

    Returns
    -------
    Support and coefficients, ``(n_images, n_atoms)``; coefficients are 0 from where a signal
    stopped.
    """
    xp = _namespace(gram)
    n = correlations.shape[1]
    residual = correlations
    left = xp.full_like(residual[:, 0], np.inf) if energy is None else energy
    diagonal = xp.linalg.diagonal(gram)
    rows: list[Any] = []
    support: list[Any] = []
    scores: list[Any] = []
    chosen = xp.zeros_like(residual)
    for _ in range(min(n_atoms, n)):
        atom = xp.argmax(xp.abs(residual), axis=1)
        row = xp.take(gram, atom, axis=0)
        for earlier in rows:
            row = row - _pick(earlier, atom) * earlier
        pivot = _pick(row, atom)
        independent = pivot > 1e-12 * xp.take(diagonal, atom)[:, None]
        going = independent & (left > tolerance)[:, None] & (_pick(chosen, atom) == 0)
        row = xp.where(going, row / xp.sqrt(xp.where(going, pivot, xp.ones_like(pivot))), 0 * row)
        root = xp.where(going, _pick(row, atom), xp.ones_like(pivot))
        score = xp.where(going, _pick(residual, atom) / root, 0 * pivot)
        residual = residual - score * row
        left = xp.where(going[:, 0], left - score[:, 0] ** 2, xp.full_like(left, -np.inf))
        chosen = chosen + xp.where(going, _one_hot(atom, chosen), 0 * chosen)
        rows.append(row)
        support.append(atom)
        scores.append(score)
    picked = xp.stack(
        [xp.concat([_pick(row, atom) for atom in support], axis=1) for row in rows], axis=1
    )
    stopped = xp.concat(scores, axis=1) == 0  # their rows are 0: any diagonal will do
    identity = xp.eye(len(rows), dtype=gram.dtype, **_device(gram))
    factor = xp.triu(picked) + identity * xp.astype(stopped, gram.dtype)[:, None, :]
    solved = xp.linalg.solve(factor, xp.stack(scores, axis=1))
    return xp.stack(support, axis=1), xp.where(stopped, 0 * solved[..., 0], solved[..., 0])


def batch_fista(
    values: Any, noise_variance: Any, patterns: PatternSet, *, iterations: int | None = None
) -> Any:
    """Cells ``(n_cells, n_images)`` with sparse DCT coefficients, as the method ``fista``."""
    xp = _namespace(values)
    rows, columns, n = patterns.rows, patterns.columns, patterns.n_cells
    is_mean = _like((patterns.indices == 0).astype(float)[:, None], values)
    scale = _prior_scale(xp.sum((values * (1 - is_mean)) ** 2, axis=0), noise_variance, patterns)
    threshold = single_fista.threshold(noise_variance, scale, float(n), n, xp)
    deviation = prior_deviation("dct", rows, columns)
    inverse = np.divide(1, deviation, out=np.zeros_like(deviation), where=deviation > 0)
    root = xp.sqrt(xp.where(scale > 0, scale, xp.ones_like(scale)))
    thresholds = (threshold / root)[:, None, None] * _like(inverse, values)

    analysed, synthesised = _cosine(patterns, values)
    current = analysed(batch_lmmse(values, noise_variance, patterns))
    ahead, t = current, 1.0
    for _ in range(single_fista.ITERATIONS if iterations is None else iterations):
        residual = values - _forward(synthesised(ahead), patterns)
        moved = ahead + analysed(_adjoint(residual, patterns)) / n
        new = moved - xp.clip(moved, -thresholds, thresholds)
        t, earlier = (1 + math.sqrt(1 + 4 * t * t)) / 2, t
        ahead = new + (earlier - 1) / t * (new - current)
        current = new
    radius = xp.sqrt(patterns.count * noise_variance)
    return _allowed(synthesised(current), values, radius, patterns)


def batch_total_variation(
    values: Any, noise_variance: Any, patterns: PatternSet, *, iterations: int | None = None
) -> Any:
    """Cells ``(n_cells, n_images)`` of least total variation, as the method ``tv``."""
    xp = _namespace(values)
    shape = (patterns.rows, patterns.columns, values.shape[1])
    start = batch_lmmse(values, noise_variance, patterns)
    spread = xp.std(start, axis=0)
    spread = xp.where(spread > 0, spread, xp.ones_like(spread))
    y, image = values / spread, start / spread
    radius = xp.sqrt(single_tv.MISFIT * patterns.count * noise_variance) / spread
    (w_down, w_along), dual_step = single_tv.steps(shape[:2])
    relaxation, new = RELAXATION, image
    p = xp.zeros_like(xp.reshape(image, shape))
    q = p
    for _ in range(single_tv.ITERATIONS if iterations is None else iterations):
        above = xp.concat([xp.zeros_like(p[:1, ...]), p[:-1, ...]], axis=0)
        before = xp.concat([xp.zeros_like(q[:, :1, :]), q[:, :-1, :]], axis=1)
        flow = w_down * (p - above) + w_along * (q - before)
        moved = image + single_tv.STEP * xp.reshape(flow, image.shape)
        new = _allowed(moved, y, radius, patterns)
        x = xp.reshape(2 * new - image, shape)
        down = xp.concat([x[1:, ...] - x[:-1, ...], xp.zeros_like(x[:1, ...])], axis=0)
        along = xp.concat([x[:, 1:, :] - x[:, :-1, :], xp.zeros_like(x[:, :1, :])], axis=1)
        p_new, q_new = p + dual_step * w_down * down, q + dual_step * w_along * along
        length = xp.sqrt(xp.maximum(p_new**2 + q_new**2, xp.ones_like(p)))
        p = p + relaxation * (p_new / length - p)
        q = q + relaxation * (q_new / length - q)
        image = image + relaxation * (new - image)
    return new * spread


def _allowed(cells: Any, values: Any, radius: Any, patterns: PatternSet) -> Any:
    """Onto the images whose misfit is at most ``radius`` (n_images,), see `projection`."""
    xp = _namespace(cells)
    misfit = values - _forward(cells, patterns)
    size = xp.sqrt(xp.sum(misfit**2, axis=0))
    excess = 1 - radius / xp.where(size > 0, size, xp.ones_like(size))
    excess = xp.maximum(excess, xp.zeros_like(excess))
    return cells + _adjoint(misfit * excess, patterns) / patterns.n_cells


def _forward(cells: Any, patterns: PatternSet) -> Any:
    return _namespace(cells).take(batch_fwht(cells), _index(patterns.indices, cells), axis=0)


def _adjoint(values: Any, patterns: PatternSet) -> Any:
    xp = _namespace(values)
    place = np.full(patterns.n_cells, patterns.count)  # rows not shown: zeros
    place[patterns.indices] = np.arange(patterns.count)
    padded = xp.concat([values, xp.zeros_like(values[:1, :])], axis=0)
    return batch_fwht(xp.take(padded, _index(place, values), axis=0))


def _cosine(patterns: PatternSet, like: Any) -> tuple[Callable[[Any], Any], Callable[[Any], Any]]:
    """Cosine transform, (n_cells, n_images) to (n_images, rows, columns), and its inverse."""
    xp = _namespace(like)
    down, along = (_like(dct_matrix(n), like) for n in (patterns.rows, patterns.columns))

    def analysed(cells: Any) -> Any:
        picture = xp.reshape(xp.matrix_transpose(cells), (-1, patterns.rows, patterns.columns))
        return down @ picture @ xp.matrix_transpose(along)

    def synthesised(coefficients: Any) -> Any:
        picture = xp.matrix_transpose(down) @ coefficients @ along
        return xp.matrix_transpose(xp.reshape(picture, (-1, patterns.n_cells)))

    return analysed, synthesised


def _prior_scale(energy: Any, noise_variance: Any, patterns: PatternSet) -> Any:
    """`prior.prior_scale` of many images."""
    xp = _namespace(energy)
    expected = float(walsh_variance(patterns.rows, patterns.columns)[patterns.indices].sum())
    if expected == 0:
        return xp.zeros_like(energy)
    excess = energy - patterns.count * noise_variance
    return xp.maximum(excess, math.sqrt(2 * patterns.count) * noise_variance) / expected


def _pick(rows: Any, column: Any) -> Any:
    """One value of each row, ``(n, 1)``."""
    xp = _namespace(rows)
    n, width = rows.shape
    flat = column + xp.arange(n, dtype=column.dtype, **_device(rows)) * width
    return xp.take(xp.reshape(rows, (-1,)), flat)[:, None]


def _one_hot(column: Any, like: Any) -> Any:
    xp = _namespace(like)
    places = xp.arange(like.shape[1], dtype=column.dtype, **_device(like))
    return xp.astype(places[None, :] == column[:, None], like.dtype)


def _namespace(array: Any) -> Any:
    from array_api_compat import array_namespace

    return array_namespace(array)


def _device(array: Any) -> dict[str, Any]:
    from array_api_compat import device

    return {"device": device(array)}


def _like(array: NDArray[np.float64], other: Any) -> Any:
    return _namespace(other).asarray(np.array(array), dtype=other.dtype, **_device(other))


def _index(array: NDArray[np.intp], other: Any) -> Any:
    xp = _namespace(other)
    return xp.asarray(np.array(array), dtype=xp.int64, **_device(other))

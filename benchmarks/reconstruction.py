"""Figures of patterns and reconstruction: time beside the peers, and quality on pictures.

Quality: 22 pictures of scikit-image (`benchmarks.pictures`), patterns in sequency order. With
noise: standard deviation 0.1 of the picture's range in each cell of a full set's plain inverse.
Each method's PSNR stands beside its margin over zero-fill, the plain inverse.
Peers are timed where they are installed (extra ``peers``), in the same run on one core.
"""

import importlib.util
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.pictures import pictures
from benchmarks.timing import Figure, timed
from hardware import PatternSet, compiled
from hardware.patterns import fwht
from hardware.reconstruction import METHODS, Method, Sensing
from hardware.reconstruction.cosine import dct_matrix
from hardware.reconstruction.dictionaries import prior_deviation
from hardware.reconstruction.methods.lmmse import lmmse_plan
from hardware.reconstruction.methods.total_variation import total_variation
from hardware.reconstruction.pursuit import batch_omp
from hardware.reconstruction.stream import SlidingWindow

Array = NDArray[np.float64]
CASES = ((64, 16, 64, 0.0), (64, 64, 128, 0.0), (64, 64, 128, 0.1), (64, 64, 1024, 0.0))
CASES += ((64, 64, 1024, 0.1),)


def figures() -> Iterator[Figure]:
    """Name, value and unit of everything that is measured."""
    for label, paths in (("numba", True), ("NumPy", False)):
        if paths and not compiled.available():
            continue
        with _path(paths):
            yield from _transforms(label)
            yield from _pursuit(label)
            yield from _methods(label)
    yield from _quality()
    yield from _convergence()
    yield from _line_sensor()


class _path:  # noqa: N801
    """Compiled kernels or the NumPy path, for the length of a ``with``."""

    def __init__(self, use_compiled: bool) -> None:
        self.use, self.kept = use_compiled, compiled.available

    def __enter__(self) -> None:
        if not self.use:
            compiled.available = lambda: False  # type: ignore[assignment]

    def __exit__(self, *_: object) -> None:
        compiled.available = self.kept


def _transforms(label: str) -> Iterator[Figure]:
    for n in (1024, 4096, 2**20):
        x = np.random.default_rng(0).normal(size=n)
        ours = timed(lambda x=x: fwht(x), runs=25 if n > 4096 else 501)
        yield f"transform, {n}, {label}", ours, ""
        if importlib.util.find_spec("spyrit"):
            import torch
            from spyrit.core.torch import fwht as spyrit_fwht

            torch.set_num_threads(1)
            tensor = torch.asarray(x)
            peer = timed(lambda t=tensor: spyrit_fwht(t, order=False), runs=25)
            yield f"transform, {n}, spyrit", peer, ""
            yield f"transform, {n}: spyrit over {label}", peer.median_s / ours.median_s, ""


def _pursuit(label: str) -> Iterator[Figure]:
    """All atoms of a DCT, as scikit-learn takes them: one Gram matrix, one vector."""
    for rows, columns, count, n_atoms in ((64, 16, 64, 16), (64, 64, 128, 32)):
        sensing = Sensing(PatternSet(rows, columns, count))
        weights = prior_deviation("dct", rows, columns).ravel()
        weights[0] = 1.0
        synthesis = np.kron(dct_matrix(rows), dct_matrix(columns)).T
        atoms = sensing.matrix @ synthesis * weights
        gram = atoms.T @ atoms
        correlations = atoms.T @ (sensing.forward(pictures(rows, columns)[2].ravel()))
        ours = timed(lambda g=gram, c=correlations, n=n_atoms: batch_omp(g, c, n), runs=101)
        name = f"Batch-OMP, {rows} x {columns}, {count} patterns, {n_atoms} atoms"
        yield f"{name}, {label}", ours, ""
        if importlib.util.find_spec("sklearn"):
            from sklearn.linear_model import orthogonal_mp_gram

            peer = timed(
                lambda g=gram, c=correlations, n=n_atoms: orthogonal_mp_gram(
                    g, c, n_nonzero_coefs=n
                ),
                runs=5,
            )
            yield f"{name}, scikit-learn", peer, ""
            yield f"{name}: scikit-learn over {label}", peer.median_s / ours.median_s, ""
            theirs = orthogonal_mp_gram(gram, correlations, n_nonzero_coefs=n_atoms)
            support, x = batch_omp(gram, correlations, n_atoms)
            dense = np.zeros_like(theirs)
            dense[support] = x
            difference = abs(dense - theirs).max() / abs(theirs).max()
            yield f"{name}: difference to scikit-learn, {label}", float(difference), ""


def _methods(label: str) -> Iterator[Figure]:
    for rows, columns, count in ((64, 16, 64), (64, 64, 128), (64, 64, 1024)):
        sensing = Sensing(PatternSet(rows, columns, count))
        y = sensing.forward(pictures(rows, columns)[2].ravel())
        name = f"{count} of {rows} x {columns}"
        plan = lmmse_plan(sensing)
        work = timed(lambda p=plan, y=y: p.image(y, 1e-3), runs=201)
        yield f"lmmse, image alone, {name}, {label}", work, ""
        for method in METHODS.values():
            if method.joint or (method.slow and label == "NumPy"):
                continue
            runs = 3 if method.slow or method.name.startswith("omp") else 25
            work = timed(lambda m=method, y=y, s=sensing: m(y, 1.0, s), runs=runs)
            yield f"{method.name}, {name}, {label}", work, ""
    window = SlidingWindow(PatternSet(64, 64, 1024), 1.0)
    places, clock = np.arange(64), iter(range(10**6))
    new = np.random.default_rng(0).normal(size=64)
    work = timed(lambda: window.push(places, new, float(next(clock))))
    yield f"sliding window, 64 new of 1024, 64 x 64, {label}", work, ""


def _quality() -> Iterator[Figure]:
    from skimage.metrics import structural_similarity

    for rows, columns, count, noise in CASES:
        plain = 0.0
        for method in sorted(METHODS.values(), key=lambda m: m.name != "zero-fill"):
            if method.joint:
                continue
            found = [
                (x, image)
                for x, image in images(
                    lambda y, s, p, m=method: m(y, s, p)[0], rows, columns, count, noise
                )
            ]
            label = f"{method.name}, {count} of {rows} x {columns}, noise {noise:g}"
            decibels = [psnr(x, image) for x, image in found]
            yield f"{label}: PSNR", float(np.mean(decibels)), "dB"
            if method.name == "zero-fill":
                plain = float(np.mean(decibels))
            else:
                yield f"{label}: PSNR over zero-fill", float(np.mean(decibels)) - plain, "dB"
            similar = [structural_similarity(x, image, data_range=1.0) for x, image in found]
            yield f"{label}: SSIM", float(np.mean(similar)), ""
            if noise == 0 and count < 1024:
                yield f"{label}: PSNR, half not tuned on", float(np.mean(decibels[1::2])), "dB"


def _convergence() -> Iterator[Figure]:
    """How far the default number of steps is from the converged image, over all pictures."""
    for count, noise in ((128, 0.0), (1024, 0.0), (1024, 0.1)):

        def solve(steps: int, count: int = count, noise: float = noise) -> Array:
            def tv(y: Array, s: float, sensing: Sensing) -> Array:
                options: dict[str, Any] = {"iterations": steps} if steps else {}
                return total_variation(y, s, sensing, **options)[0]

            return np.array([psnr(x, i) for x, i in images(tv, 64, 64, count, noise)])

        change = solve(0) - solve(1000)
        label = f"tv, {count} of 64 x 64, noise {noise:g}: PSNR less that of 1000 steps"
        yield f"{label}, mean", float(change.mean()), "dB"
        yield f"{label}, worst picture", float(change.min()), "dB"


def _line_sensor() -> Iterator[Figure]:
    """Each column a detector behind 16 rows of LEDs: alone, and with its neighbours."""
    for count, noise in ((8, 0.0), (16, 0.2)):
        sensing = Sensing(PatternSet(16, 1, count))
        variance = np.full(64, noise**2 * 16)
        for name in ("lmmse", "tv", "tv-joint"):
            found = []
            for seed, picture in enumerate(pictures(16, 64)):
                draw = np.random.default_rng(seed).normal(size=(count, 64))
                y = sensing.forward(picture) + draw * np.sqrt(variance)
                found.append(psnr(picture, _columns(METHODS[name], y, variance, sensing)))
            label = f"{name}, {count} of 16 rows, 64 columns, noise {noise:g}: PSNR"
            yield label, float(np.mean(found)), "dB"


def _columns(method: Method, values: Array, variance: Array, sensing: Sensing) -> Array:
    if method.joint:
        return method(values, variance, sensing)[0]
    solved = [method(y, s, sensing)[0] for y, s in zip(values.T, variance, strict=True)]
    return np.stack(solved, axis=1)


def images(
    solve: Callable[[Array, float, Sensing], Array],
    rows: int,
    columns: int,
    count: int,
    noise: float,
) -> Iterator[tuple[Array, Array]]:
    """Each picture and its reconstruction, both ``(rows, columns)``."""
    sensing = Sensing(PatternSet(rows, columns, count))
    variance = noise**2 * rows * columns
    for seed, picture in enumerate(pictures(rows, columns)):
        draw = np.random.default_rng(seed).normal(size=count)
        y = sensing.forward(picture.ravel()) + draw * np.sqrt(variance)
        yield picture, solve(y, variance, sensing).reshape(rows, columns)


def psnr(truth: Array, image: Array) -> float:
    """Peak signal-to-noise ratio with peak 1, dB."""
    return float(-10 * np.log10(np.mean((truth - image) ** 2)))

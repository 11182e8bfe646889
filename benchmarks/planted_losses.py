"""How often a comparison finds a loss that is there, and one that is not: both by trying.

Images of a method at many seeds are made a little worse by a known mean PSNR. Comparisons of a few
seeds each are then drawn from them, paired or not, and counted.
"""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from twin.errors import InputError
from twin.regression.metrics import Metric
from twin.regression.statistics import compare

Array = NDArray[np.float64]


def planted(images: Array, truth: Array, kind: str, loss_db: float, seed: int = 0) -> Array:
    """Images (n, rows, columns), worse than they were by a mean PSNR of ``loss_db``.

    ``noise``: white noise of its own in every image. ``blur``: part of each is its 3 x 3 mean.
    ``gain``: all are too bright. Raises InputError for another kind.
    """
    from scipy.optimize import brentq

    if kind not in _FAULTS:
        raise InputError(f"kind: {kind!r} is none of {', '.join(_FAULTS)}")
    fault = _FAULTS[kind](images, truth, np.random.default_rng(seed))
    before = _psnr_loss(images, truth)
    share = brentq(lambda s: _psnr_loss(images + s * fault, truth) - before - loss_db, 0, 1)
    return images + share * fault


def share_worse(
    metrics: Sequence[Metric],
    before: Mapping[str, Array],
    after: Mapping[str, Array],
    *,
    seeds: int,
    paired: bool,
    repetitions: int,
    rng: np.random.Generator,
    false_alarm: float = 0.01,
) -> float:
    """Share of comparisons that find ``after`` worse, each of ``seeds`` drawn without replacement.

    ``paired``: both runs take the same seeds; else no seed is in both.
    """
    n, worse = len(next(iter(before.values()))), 0
    for _ in range(repetitions):
        drawn = rng.choice(n, size=2 * seeds, replace=False)
        first, second = drawn[:seeds], drawn[:seeds] if paired else drawn[seeds:]
        verdicts = compare(
            metrics,
            {name: values[first] for name, values in before.items()},
            {name: values[second] for name, values in after.items()},
            false_alarm,
        )
        worse += any(verdict.worse for verdict in verdicts)
    return worse / repetitions


def _noise(images: Array, truth: Array, rng: np.random.Generator) -> Array:
    return rng.normal(size=images.shape) * np.sqrt(np.mean((images - truth) ** 2))


def _blur(images: Array, _: Array, __: np.random.Generator) -> Array:
    from scipy.ndimage import uniform_filter

    return uniform_filter(images, (0, 3, 3), mode="nearest") - images


def _gain(images: Array, _: Array, __: np.random.Generator) -> Array:
    return images


_FAULTS: dict[str, Callable[[Array, Array, np.random.Generator], Array]] = {
    "noise": _noise,
    "blur": _blur,
    "gain": _gain,
}


def _psnr_loss(images: Array, truth: Array) -> float:
    """Mean over the images of 10 log10 of the error; the peak is the truth's, and drops out."""
    return float(np.mean(10 * np.log10(np.mean((images - truth) ** 2, axis=(1, 2)))))

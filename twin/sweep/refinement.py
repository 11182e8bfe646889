"""Where a sweep spends its effort: which points may lie on the front that its study names.

All points are computed to a coarse tolerance first. Those that another point surely beats, by the
intervals of both, stay as they are; the others are computed as asked for, until none that is coarse
may lie on the front.
"""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from twin.fidelity import Tolerance
from twin.sweep.accuracy_names import TOLERANCE, names_accuracy

if TYPE_CHECKING:
    from twin.sweep.study import Study

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

#: Tolerance of points before they are known to matter: their error adds as much as the noise does.
COARSE_SHARE = 1.0
#: Of errors of cells, echoes and distances, beside it.
_TIMES_COARSER = 5.0
_MOST_CELL_SHARE, _MOST_ECHO_DB = 1.0, 20.0
#: Share of sweeps in which any point's error may exceed what is taken for its largest.
_ANY_MISSED = 0.05


def coarse_study(study: "Study") -> "Study | None":
    """The study of the first pass; None where all points are computed at once: without a front, and
    where the points' accuracy is given by a preset, by knobs alone or varies, or is coarse itself.

    >>> from twin.sweep import Study
    >>> said = {"name": "s", "metrics": ["psnr_db", "ssim"], "front": ["psnr_db", "ssim"]}
    >>> coarse_study(Study(**said)).set
    {'fidelity.tolerance': '1.0'}
    """
    if study.front is None or study.model != "rendered":
        return None
    if names_accuracy(study.parameters) and TOLERANCE not in study.set:
        return None
    asked = Tolerance.of(str(study.set[TOLERANCE])) if TOLERANCE in study.set else Tolerance()
    coarse = _coarser(asked)
    return None if coarse == asked else study.with_set({**study.set, TOLERANCE: str(coarse)})


def _coarser(asked: Tolerance) -> Tolerance:
    cell, echo, distance = asked.cell_share, asked.echo_db, asked.distance_m
    return replace(
        asked,
        noise_share=max(asked.noise_share, COARSE_SHARE),
        cell_share=cell and min(_TIMES_COARSER * cell, _MOST_CELL_SHARE),
        echo_db=echo and min(_TIMES_COARSER * echo, _MOST_ECHO_DB),
        distance_m=distance and _TIMES_COARSER * distance,
    )


def largest_errors(standard_errors: Array, systematic: Array) -> Array:
    """Errors that all points together exceed in one of 20 sweeps (Bonferroni), of the shape given;
    infinite where they are not known.
    """
    deviations = -ndtri(_ANY_MISSED / 2 / max(standard_errors.size, 1))
    errors = deviations * standard_errors + systematic
    return np.where(np.isnan(errors), np.inf, errors)


def may_be_on_front(gains: Array, errors: Array, counts: Flags) -> Flags:
    """Points (n,) that no other one surely beats.

    A point beats another if, whatever their errors, it is as good in both metrics and better in
    one. A point without a number may turn out to have any.

    Parameters
    ----------
    gains, errors
        Of two metrics, so that more is better, and the most that they may be off by, (2, n).
    counts
        Points that may beat others, (n,): those whose record means something.
    """
    known = np.isfinite(gains)
    gains, errors = np.where(known, gains, 0.0), np.where(known, errors, np.inf)
    low, high = gains - errors, gains + errors
    beaten = _as_good(low[:, counts], high, strictly=False) > high[1]
    beaten |= _as_good(low[:, counts], high, strictly=True) >= high[1]
    return np.asarray(~beaten)


def _as_good(low: Array, high: Array, *, strictly: bool) -> Array:
    """Of points whose first gain reaches (exceeds) another's, the best second gain, for each."""
    order = np.argsort(-low[0], kind="stable")
    best = np.concatenate([[-np.inf], np.maximum.accumulate(low[1, order])])
    n = np.searchsorted(-low[0, order], -high[0], "left" if strictly else "right")
    return np.asarray(best[n])

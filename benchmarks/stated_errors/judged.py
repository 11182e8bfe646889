"""What a case came to, and what all of them come to."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import binomtest

from benchmarks.timing import Figure

#: Standard errors of a truth, beyond which an error is not the truth's.
_SURE = 3.0


@dataclass(frozen=True)
class Cheapest:
    """The cheapest setting of the knobs whose error is within the tolerance."""

    seconds: float
    knobs: str


@dataclass(frozen=True)
class Judged:
    """One figure of one case: what was stated of its error, 95 %, and what it is.

    Parameters
    ----------
    name, figure
        Of the case, and what of it.
    tolerance
        Asked for.
    stated, true, truth_error
        Half width of the stated interval; the error; the standard error of the truth itself. All in
        ``unit``.
    seconds, cheapest, searched, choosing
        CPU time of the run; the cheapest sufficient setting, None if none that takes no longer is
        sufficient, and whether it was looked for; share of the time that went into choosing. NaN
        and None where not measured.
    inside
        Share of an image's cells within their own intervals.
    """

    name: str
    figure: str
    tolerance: float
    stated: float
    true: float
    truth_error: float
    unit: str
    seconds: float = math.nan
    cheapest: Cheapest | None = None
    searched: bool = False
    choosing: float = math.nan
    inside: float = math.nan
    warnings: tuple[str, ...] = ()

    @property
    def ratio(self) -> float:
        """True error over the stated interval."""
        return self.true / self.stated if self.stated else (math.inf if self.true else 0.0)

    @property
    def is_decided(self) -> bool:
        """Whether the truth itself is known to within what is stated, or well enough to say that
        the error is beyond it.
        """
        beyond = self.true > self.stated + _SURE * self.truth_error
        return self.truth_error <= self.stated or beyond or not self.true

    @property
    def over_cheapest(self) -> float:
        """Time over that of the cheapest sufficient setting; 1 where that takes no less."""
        return self.seconds / self.cheapest.seconds if self.cheapest else 1.0

    def __str__(self) -> str:
        parts = [
            f"tolerance {self.tolerance:g}, stated {self.stated:.2g}, true {self.true:.2g} "
            f"{self.unit} (truth itself to {self.truth_error:.1g})"
        ]
        if self.seconds >= 0:
            parts.append(f"{self.seconds:.2g} s of CPU")
        if self.searched:
            parts.append(
                f"{self.over_cheapest:.2f} times the {self.cheapest.seconds:.2g} s of "
                f"{self.cheapest.knobs}"
                if self.cheapest
                else "no setting that takes less is sufficient"
            )
        if self.choosing >= 0:
            parts.append(f"choosing {100 * self.choosing:.1f} %")
        if self.inside >= 0:
            parts.append(f"{100 * self.inside:.1f} % of cells within their own intervals")
        if self.warnings:
            parts.append("warned: " + " | ".join(w[:100] for w in self.warnings))
        return "; ".join(parts)


def summary(what: str, found: Sequence[Judged]) -> Iterator[Figure]:
    """Coverage with its interval, the worst ratio, and times. Errors where the truth itself is
    known too little (`Judged.is_decided`) are not counted.
    """
    everything, found = found, [one for one in found if one.is_decided]
    yield f"{what}: truths too uncertain to count", float(len(everything) - len(found)), "cases"
    if not found:
        return
    ratio = np.array([one.ratio for one in found])
    within = int(np.sum(ratio <= 1))
    interval = binomtest(within, len(found)).proportion_ci(method="wilson")
    yield (
        f"{what}: within the stated interval",
        100 * within / len(found),
        f"% ({within} of {len(found)}; 95 % interval {100 * interval.low:.1f} to "
        f"{100 * interval.high:.1f} %)",
    )
    worst = found[int(np.argmax(ratio))]
    yield f"{what}: largest error over the stated one", worst.ratio, f"({worst.name})"
    yield f"{what}: error over the stated one, median", float(np.median(ratio)), ""
    inside = [one.inside for one in found if one.inside >= 0]
    if inside:
        yield f"{what}: cells within their own intervals", 100 * float(np.mean(inside)), "%"
    timed = [one for one in everything if one.searched]
    if timed:
        over = np.array([one.over_cheapest for one in timed])
        name = f"{what}: time over that of the cheapest sufficient knobs"
        yield f"{name}, median", float(np.median(over)), ""
        yield f"{name}, largest", float(over.max()), ""
        cheaper = sum(one.cheapest is not None for one in timed)
        yield f"{what}: cases in which some knobs take less", float(cheaper), f"of {len(timed)}"
    choosing = [one.choosing for one in everything if one.choosing >= 0]
    if choosing:
        yield f"{what}: choosing, median", 100 * float(np.median(choosing)), "% of the time"
        yield f"{what}: choosing, largest", 100 * max(choosing), "% of the time"

"""What a case came to, and what all of them come to."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import binomtest

from benchmarks.stated_errors.cells import AIM, CellErrors
from benchmarks.timing import Figure

#: Half widths of a truth's own error, beyond which an error is not the truth's.
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
    stated, systematic
        Half width of the stated interval, and the part of it that is a bound, not a deviation.
    true, truth_error
        The difference from the truth, and half the width of the truth's own interval. All in
        ``unit``.
    truth, is_independent
        Where the truth is from, and whether it comes from elsewhere than what is judged.
    seconds, cheapest, searched, choosing
        CPU time of the run; the cheapest sufficient setting, None if none that takes no longer is
        sufficient, and whether it was looked for; share of the time that went into choosing. NaN
        and None where not measured.
    cells
        Of an image: its cells, each against its own interval. ``stated`` is then the root mean
        square that its standard errors let expect, not the end of an interval.
    """

    name: str
    figure: str
    tolerance: float
    stated: float
    true: float
    truth_error: float
    unit: str
    systematic: float = 0.0
    truth: str = ""
    is_independent: bool = True
    seconds: float = math.nan
    cheapest: Cheapest | None = None
    searched: bool = False
    choosing: float = math.nan
    cells: CellErrors | None = None
    warnings: tuple[str, ...] = ()

    @property
    def ratio(self) -> float:
        """The difference over what the stated error and the truth's own explain together."""
        explained = self.systematic + math.hypot(self.stated - self.systematic, self.truth_error)
        return self.true / explained if explained else (math.inf if self.true else 0.0)

    @property
    def is_decided(self) -> bool:
        """Whether an error is bounded, and the truth itself known to within what is stated, or well
        enough to say that the error is beyond it.
        """
        beyond = self.true > self.stated + _SURE * self.truth_error
        is_known = self.truth_error <= self.stated or beyond or not self.true
        return is_known and math.isfinite(self.stated)

    @property
    def over_cheapest(self) -> float:
        """Time over that of the cheapest sufficient setting; 1 where that takes no less."""
        return self.seconds / self.cheapest.seconds if self.cheapest else 1.0

    def __str__(self) -> str:
        stated = "expected" if self.cells else "stated"
        parts = [
            f"tolerance {self.tolerance:g}, {stated} {self.stated:.2g}, true {self.true:.2g} "
            f"{self.unit} (truth itself to {self.truth_error:.1g})"
        ]
        if self.truth:
            independence = "" if self.is_independent else ", not independent"
            parts.append(f"truth{independence}: {self.truth}")
        if not self.is_decided:
            parts.append("undecided")
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
        if self.cells:
            parts.append(str(self.cells))
        if self.warnings:
            parts.append("warned: " + " | ".join(w[:100] for w in self.warnings))
        return "; ".join(parts)


def summary(what: str, found: Sequence[Judged]) -> Iterator[Figure]:
    """Of figures with an interval: coverage with its own, and the worst ratio. Of images: shares of
    their cells, and errors over those expected. Of both: times.

    Errors where the truth itself is known too little (`Judged.is_decided`) are not counted.
    """
    figures = [one for one in found if one.cells is None]
    if figures:
        yield from _of_intervals(what, figures)
    images = [one for one in found if one.cells is not None]
    if images:
        yield from _of_images(what, images)
    yield from _times(what, found)


def _of_intervals(what: str, everything: Sequence[Judged]) -> Iterator[Figure]:
    found = [one for one in everything if one.is_decided]
    undecided = len(everything) - len(found)
    yield f"{what}: undecided, not counted", float(undecided), f"of {len(everything)}"
    if not found:
        return
    ratio = np.array([one.ratio for one in found])
    yield _share(f"{what}: within the stated interval", int(np.sum(ratio <= 1)), len(found))
    worst = found[int(np.argmax(ratio))]
    where = f"({worst.name}: {worst.figure})"
    yield f"{what}: largest error over the stated one", worst.ratio, where
    yield f"{what}: error over the stated one, median", float(np.median(ratio)), ""


def _of_images(what: str, images: Sequence[Judged]) -> Iterator[Figure]:
    cells = [one.cells for one in images if one.cells is not None and one.cells.judged]
    undecided = sum(one.cells.undecided for one in images if one.cells is not None)
    judged = sum(each.judged for each in cells)
    if judged:
        share = 100 * sum(each.within for each in cells) / judged
        yield f"{what}: cells within their own intervals", share, f"% of {judged} in all images"
        well = sum(each.share >= AIM for each in cells)
        yield f"{what}: images with {100 * AIM:g} % of their cells", float(well), f"of {len(cells)}"
        worst = max(images, key=lambda one: one.cells.largest if one.cells else 0.0)
        assert worst.cells is not None
        largest = worst.cells.largest
        yield f"{what}: largest error of a cell over the stated", largest, f"({worst.name})"
    yield f"{what}: cells undecided, not counted", float(undecided), f"beside {judged}"
    known = [one for one in images if one.is_decided and one.stated]
    if not known:
        return
    ratio = np.array([one.ratio for one in known])
    name = f"{what}: root mean square error over the expected"
    yield f"{name}, median", float(np.median(ratio)), f"of {len(known)} images; 1 is right"
    yield f"{name}, least", float(ratio.min()), f"({known[int(np.argmin(ratio))].name})"
    yield f"{name}, largest", float(ratio.max()), f"({known[int(np.argmax(ratio))].name})"


def _share(what: str, within: int, count: int) -> Figure:
    interval = binomtest(within, count).proportion_ci(method="wilson")
    of = f"{within} of {count}; 95 % interval {100 * interval.low:.1f} to {100 * interval.high:.1f}"
    return what, 100 * within / count, f"% ({of} %)"


def _times(what: str, everything: Sequence[Judged]) -> Iterator[Figure]:
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

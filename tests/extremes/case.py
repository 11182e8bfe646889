"""One extreme: what was asked, what the oracle says, and how the twin came out of it."""

import re
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

Outcome = Literal["within", "warning", "error"]


@dataclass(frozen=True)
class Found:
    """How far a result is from its oracle, and what the twin said about it.

    ``stated``: the error that the twin promises, in the unit of ``error``.
    """

    error: float
    stated: float
    unit: Literal["relative", "sigma"] = "relative"
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True)
class Case:
    """One value of one axis.

    ``expected``: how the twin comes out. ``says``: words that the error or warning must hold, among
    them the field. Where a warning is expected it must give an estimate, the number before ``%``,
    that is not below the measured error.
    """

    axis: str
    value: str
    oracle: str
    run: Callable[[], Found]
    expected: Outcome = "within"
    says: str = ""
    slow: bool = False

    @property
    def name(self) -> str:
        """As tests and the table call it."""
        return f"{self.axis}: {self.value}"


@dataclass(frozen=True)
class Row:
    """A line of the table."""

    case: Case
    measured: str
    stated: str
    outcome: str
    fault: str
    seconds: float


def judged(case: Case) -> Row:
    """Run a case; ``fault`` says what is wrong with its outcome, empty if nothing is."""
    start = time.perf_counter()
    try:
        found = case.run()
    except ValueError as error:  # InputError is one
        text = re.sub(r"\S*/tmp\w+/", "", str(error))
        fault = "" if case.expected == "error" else "an error was not expected"
        if case.says not in text:
            fault = f"the error does not say {case.says!r}"
        return Row(case, "-", "-", f"error: {text}", fault, time.perf_counter() - start)
    seconds = time.perf_counter() - start
    measured, stated = shown(found.error, found.unit), shown(found.stated, found.unit)
    spoken = [w for w in found.warnings if case.says and case.says in w]
    if case.expected == "within":
        fault = "" if found.error <= found.stated else "silently outside its stated error"
        if case.says and not spoken:
            fault = f"no warning says {case.says!r}"
        outcome = f"within; warning: {spoken[0]}" if spoken else "within"
        return Row(case, measured, stated, outcome, fault, seconds)
    if case.expected == "error":
        return Row(case, measured, stated, "no error", "an error was expected", seconds)
    outcome = f"warning: {spoken[0]}" if spoken else "silent"
    return Row(case, measured, stated, outcome, _fault_of_warning(found, spoken), seconds)


def _fault_of_warning(found: Found, spoken: list[str]) -> str:
    if not spoken:
        return "no warning"
    if not np.isfinite(found.error):
        return "the result is no number"
    estimate = re.search(r"([\d.e+-]+) %", spoken[0])
    if estimate is None:
        return "the warning has no estimate"
    if found.error > float(estimate[1]) / 100:
        return f"the error is larger than the estimate, {estimate[1]} %"
    return ""


def shown(value: float, unit: str) -> str:
    """An error as the table has it."""
    return f"{value:.2g} sigma" if unit == "sigma" else f"{value:.1e}"

"""Every extreme comes out as it must: within its stated error, warned of, or refused.

Statistical bounds hold at 5 sigma, a false-alarm rate of 6e-7 per case; seeds are fixed.
"""

from dataclasses import replace

import pytest

from tests.extremes.case import Case, Found, judged
from tests.extremes.table import all_cases, to_a_tolerance
from tests.extremes.tolerances import judged_within

CASES = [
    pytest.param(case, id=case.name, marks=pytest.mark.slow if case.slow else ())
    for case in all_cases()
]


@pytest.mark.parametrize("case", CASES)
def test_an_extreme_comes_out_as_it_must(case: Case) -> None:
    row = judged(case)
    assert not row.fault, f"{row.fault} (measured {row.measured}, stated {row.stated})"


#: Under a tolerance too, a few of them every day.
QUICK = ("distance: 10 m", "grazing: 89.99 deg", "field: 0.002 deg")
TO_A_TOLERANCE = [
    pytest.param(case, id=case.name, marks=() if case.name in QUICK else pytest.mark.slow)
    for case in to_a_tolerance()
]


@pytest.mark.parametrize("case", TO_A_TOLERANCE)
def test_an_extreme_to_a_tolerance_is_within_warned_of_or_refused(case: Case) -> None:
    row = judged_within(case)
    assert not row.fault, f"{row.fault} (measured {row.measured}, stated {row.stated})"


def test_names_are_unique() -> None:
    names = [case.name for case in all_cases()]
    assert len(set(names)) == len(names)


def _case(found: Found, **changes: object) -> Case:
    made = Case("axis", "value", "oracle", lambda: found)
    return replace(made, **changes)  # type: ignore[arg-type]


def test_the_judge_finds_every_kind_of_silence() -> None:
    """A wrong number, a NaN, a warning without or with too small an estimate, an error unseen."""
    warned = ("field: some 2 % more",)
    assert "silently" in judged(_case(Found(0.1, 0.01))).fault
    assert "silently" in judged(_case(Found(float("nan"), 0.01))).fault
    for found, fault in (
        (Found(0.1, 0.01), "no warning"),
        (Found(0.1, 0.01, warnings=warned), "larger than the estimate"),
        (Found(0.1, 0.01, warnings=("field: wrong",)), "no estimate"),
        (Found(float("inf"), 0.01, warnings=warned), "no number"),
    ):
        assert fault in judged(_case(found, expected="warning", says="field")).fault
    good = _case(Found(0.015, 0.01, warnings=warned), expected="warning", says="field")
    assert not judged(good).fault
    assert "error was expected" in judged(_case(Found(0.0, 0.1), expected="error")).fault


def test_the_judge_wants_the_field_in_an_error() -> None:
    def refuse() -> Found:
        raise ValueError("width_m: 0 is not above 0")

    case = Case("axis", "value", "oracle", refuse, "error", "width_m")
    assert not judged(case).fault
    assert "does not say" in judged(replace(case, says="height_m")).fault
    assert "not expected" in judged(replace(case, expected="within")).fault

"""Extremes of the tolerance itself; and every other case under one."""

import re
import time

from tests.extremes import oracle
from tests.extremes.case import Case, Found, Row, judged, shown
from tests.extremes.light import expected_electrons
from tests.extremes.waves import plate
from tests.extremes.worlds import camera, light_stated, look, scene, square, under_tolerance
from twin.errors import InputError

#: The error that the model may add, as a share of the sensor's noise, in a second run of all cases.
TOLERANCE = 0.2


def judged_within(case: Case) -> Row:
    """Run a case to a tolerance: its error is within what is stated, warned of, or refused.

    What knobs cut off and had to warn of may now be within, and a warning may say it otherwise.
    """
    if case.expected == "error":
        with under_tolerance(TOLERANCE):
            return judged(case)
    start = time.perf_counter()
    try:
        with under_tolerance(TOLERANCE):
            found = case.run()
    except InputError as error:
        return Row(case, "-", "-", f"refused: {error}", "", time.perf_counter() - start)
    seconds = time.perf_counter() - start
    measured, stated = shown(found.error, found.unit), shown(found.stated, found.unit)
    if found.error <= found.stated:
        return Row(case, measured, stated, "within", "", seconds)
    warned = [w for w in found.warnings if _covers(w, found.error, case)]
    outcome = f"warning: {warned[0]}" if warned else "silent"
    fault = "" if warned else "silently outside its stated error"
    return Row(case, measured, stated, outcome, fault, seconds)


def _covers(warning: str, error: float, case: Case) -> bool:
    """Whether a warning says that the light cannot be had as asked for, or estimates the error, or
    is the one that the case must have.
    """
    estimate = re.search(r"([\d.e+-]+) %", warning)
    estimated = estimate is not None and error <= float(estimate[1]) / 100
    named = bool(case.says) and case.says in warning and case.expected == "within"
    return estimated or named or "no more paths are traced" in warning


def _asked(share: float) -> Found:
    """A wall at 5 m, to an error of this share of the noise."""
    system = camera()
    with under_tolerance(share), scene(square((5.0, 0, 0), 10.0)) as world:
        taken = look(world, system)
        exact = expected_electrons(system, 5.0, 0.5)
        stated = light_stated(taken, exact)
    error = oracle.relative(float(taken.cells_e.sum()), exact)
    return Found(error, stated, warnings=taken.warnings)


def cases() -> list[Case]:
    """All of this room."""
    wall = "mpmath: integral over the field, to electrons"
    echo = "mpmath: Kirchhoff's integral over the plate"
    return [
        Case("tolerance", "1e-6", "-", lambda: _asked(1e-6), "error", "tolerance"),
        Case("tolerance", "0.002", wall, lambda: _asked(0.002), slow=True),
        Case("tolerance", "2", wall, lambda: _asked(2.0)),
        Case("tolerance", "10", wall, lambda: _asked(10.0)),
        # Half of it is the error of echoes, from 0.001 to 1 of themselves.
        Case(
            "tolerance", "0.001, by radar", "-", lambda: plate(0.001), "error", "cannot be promised"
        ),
        Case("tolerance", "0.002, by radar", echo, lambda: plate(0.002)),
        Case("tolerance", "10, by radar", echo, lambda: plate(10.0)),
    ]

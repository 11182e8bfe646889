"""The table of extremes: for a terminal, and as Markdown."""

from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from tests.extremes import air, electrons, light, patterns, reports, tolerances, waves
from tests.extremes.case import Case, Row, judged
from tests.extremes.tolerances import TOLERANCE, judged_within

_PAGE = Path(__file__).parents[2] / "docs" / "extremes.md"
_HEAD = """# Extremes

Printed by `make extremes`; the same cases run in the tests. Each value of each axis goes through
the twin and is compared with an oracle that shares no code with it. *Measured* is the relative
error (or the deviation in standard errors, sigma), *stated* what the twin promises. Outcomes:
within the stated error; a warning that gives an estimate of the error; or an error that names the
field. Never a silent wrong number.
"""
_TO_A_TOLERANCE = f"""
## To a tolerance

The same to an error of {TOLERANCE} of the sensor's noise, in place of the knobs that each case
names: within what is stated (of light, five standard errors besides), warned of, or refused.
"""
_LIMITS = """
## Known limits

- Light beyond `max_depth` is estimated for one bucket detector, not for a line sensor.
- The detector's diffraction is warned of, not computed; its estimate is the width of the blur.
- Light that hardly ends (a closed room that reflects 90 % and more) ends to a tolerance after
  `fidelity.light_rays` rays, with a warning of the error that they reached.
- Air is compared where it absorbs alone; what it scatters is compared with random walks in tests.
- A radar's surface of triangles larger than 256 times their distance (or than 256 m within 1 m) is
  warned of; the camera's are divided and keep their accuracy.
- LMMSE from a subset of the patterns is refused where its matrices exceed 4 GiB.
"""


def all_cases() -> list[Case]:
    """Every case, axis by axis."""
    rooms = (light, air, electrons, patterns, waves, tolerances, reports)
    return [case for room in rooms for case in room.cases()]


def to_a_tolerance() -> list[Case]:
    """Those that are run to a tolerance too."""
    return [case for case in all_cases() if case.axis != "tolerance"]


def main() -> int:
    """Run, print and write everything; 1 where a case came out otherwise than it must."""
    console = Console(width=160)
    with console.status("pushing"):
        rows = [judged(case) for case in all_cases()]
        again = [judged_within(case) for case in to_a_tolerance()]
    for some in (rows, again):
        console.print(_printed(some))
    _PAGE.write_text(_page(rows, again))
    faults = [f"{row.case.name}: {row.fault}" for row in (*rows, *again) if row.fault]
    for fault in faults:
        console.print(f"[bold red]{fault}")
    count = len(rows) + len(again)
    console.print(f"{count - len(faults)} of {count} as they must be; written: {_PAGE.name}")
    return bool(faults)


def _printed(rows: Sequence[Row]) -> Table:
    table = Table("axis", "value", "oracle", "measured", "stated", "outcome", box=None)
    for row in rows:
        case = row.case
        style = "bold red" if row.fault else ""
        cells = (case.axis, case.value, case.oracle, row.measured, row.stated, row.outcome)
        table.add_row(*cells, style=style)
    return table


def _page(rows: Sequence[Row], to_a_tolerance: Sequence[Row]) -> str:
    return _HEAD + "\n" + _lines(rows) + _TO_A_TOLERANCE + "\n" + _lines(to_a_tolerance) + _LIMITS


def _lines(rows: Sequence[Row]) -> str:
    lines = ["| axis | value | oracle | measured | stated | outcome |", "|---|---|---|---|---|---|"]
    for row in rows:
        case = row.case
        outcome = f"**{row.fault}** {row.outcome}" if row.fault else row.outcome
        cells = (case.axis, case.value, case.oracle, row.measured, row.stated, outcome)
        lines.append("| " + " | ".join(cell.replace("|", "/") for cell in cells) + " |")
    return "\n".join(lines) + "\n"

"""How often the true error is within the stated one, and what choosing the effort costs.

Scenes and systems drawn by a seed, and those made to be hard, for light and for radar. The error
asked for is given, everything else is the twin's own choice (`Tolerance`); truth comes from
elsewhere (stock Mitsuba's path tracer; sums of currents). Times are of the CPU, so that other work
on the machine hardly counts.

`python -m benchmarks.stated_errors light 3 boxes keyhole` runs some cases of another seed, by parts
of their names; with `--errors` without the search for the cheapest knobs, and with truths of 3 s.
"""

from collections.abc import Iterator, Sequence

from benchmarks.stated_errors import light, light_cases, radar, radar_cases
from benchmarks.stated_errors.judged import Judged, summary
from benchmarks.timing import Figure

#: Published; development takes those below 100.
SEED = 17017
_CASES = 36  # of each sensor, besides the hard ones
_TRUTH_S, _QUICK_S = 10.0, 3.0  # of CPU, for a truth of light


def figures(
    seed: int = SEED,
    sensors: Sequence[str] = ("light", "radar"),
    names: Sequence[str] = (),
    *,
    search: bool = True,
) -> Iterator[Figure]:
    """Name, value and unit of everything that is measured.

    ``names``: parts of the names of cases, none: all; ``search``: for the cheapest sufficient
    knobs.
    """
    for sensor in sensors:
        found: list[Judged] = []
        for one in _JUDGED[sensor](seed, names, search):
            found.append(one)
            yield (
                f"{sensor}, {one.name}: error of {one.figure} over the stated",
                one.ratio,
                str(one),
            )
        for figure in dict.fromkeys(one.figure for one in found if sensor == "light"):
            yield from summary(f"{sensor}, {figure}", [o for o in found if o.figure == figure])
        yield from summary(f"{sensor}, all", found)


def _light(seed: int, names: Sequence[str], search: bool) -> Iterator[Judged]:
    for case in light_cases.cases(seed, _CASES, names):
        yield from light.judged(case, _TRUTH_S if search else _QUICK_S, search=search)


def _radar(seed: int, names: Sequence[str], search: bool) -> Iterator[Judged]:
    for case in radar_cases.cases(seed, _CASES, names):
        yield from radar.judged(case, search=search)


_JUDGED = {"light": _light, "radar": _radar}

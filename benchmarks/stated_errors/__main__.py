"""Some cases of one seed: sensor, seed, parts of the cases' names."""

import argparse
from pathlib import Path

from benchmarks.stated_errors import figures, resumable_figures
from benchmarks.stated_errors.resumed import Run
from benchmarks.timing import Timing


def main() -> None:
    parser = argparse.ArgumentParser("python -m benchmarks.stated_errors")
    parser.add_argument("sensor", choices=("light", "radar"))
    parser.add_argument("seed", type=int)
    parser.add_argument("names", nargs="*", help="parts of the names of cases; none: all")
    parser.add_argument("--errors", action="store_true", help="no search for the cheapest knobs")
    parser.add_argument("--into", type=Path, metavar="FILE", help="of results; resumed")
    parser.add_argument("--limit-s", type=int, default=600, help="CPU time of a case (--into)")
    told = parser.parse_args()
    search = not told.errors
    found = (
        resumable_figures(Run(told.sensor, told.seed, search), told.names, told.into, told.limit_s)
        if told.into
        else figures(told.seed, (told.sensor,), told.names, search=search)
    )
    for name, value, what in found:
        assert not isinstance(value, Timing)
        print(f"{name}: {value:.4g} {what}", flush=True)


if __name__ == "__main__":
    main()

"""Some cases of one seed: sensor, seed, parts of the cases' names."""

import sys

from benchmarks.stated_errors import figures
from benchmarks.timing import Timing

sensor, seed, *names = (word for word in sys.argv[1:] if word != "--errors")
search = "--errors" not in sys.argv
for name, value, what in figures(int(seed), (sensor,), names, search=search):
    assert not isinstance(value, Timing)
    print(f"{name}: {value:.4g} {what}", flush=True)

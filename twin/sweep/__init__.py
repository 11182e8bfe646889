"""Design-space sweeps: a study in, one labelled dataset out, resumable and shared over workers."""

from twin.sweep.checksums import DamagedWarning
from twin.sweep.opening import open_sweep
from twin.sweep.run import Summary, run_sweep
from twin.sweep.study import Study, load_study

__all__ = ["DamagedWarning", "Study", "Summary", "load_study", "open_sweep", "run_sweep"]

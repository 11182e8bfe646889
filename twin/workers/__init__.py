"""Who computes what takes long: this process, a cluster of processes here, or a running Dask
scheduler.
"""

from twin.workers.cluster import dask
from twin.workers.process_counts import check_workers, n_cores, usual_workers
from twin.workers.submit import (
    AskedToEndError,
    SchedulerGoneError,
    Submit,
    WorkerDiedError,
    here,
)

__all__ = [
    "AskedToEndError",
    "SchedulerGoneError",
    "Submit",
    "WorkerDiedError",
    "check_workers",
    "dask",
    "here",
    "n_cores",
    "usual_workers",
]

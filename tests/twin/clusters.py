"""Schedulers of Dask, and workers that lack the project."""

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from distributed import LocalCluster


@contextmanager
def running_cluster() -> Iterator[LocalCluster]:
    """A running scheduler without workers; those that it is scaled to are of this process."""
    quiet = {"dashboard_address": "127.0.0.1:0", "silence_logs": 50, "threads_per_worker": 1}
    where = {"host": "127.0.0.1", "protocol": "tcp"}
    with LocalCluster(n_workers=0, processes=False, **quiet, **where) as cluster:
        yield cluster


@contextmanager
def worker_without_the_project(cluster: LocalCluster, folder: Path) -> Iterator[None]:
    """One more worker of a scheduler, in whose place of this project nothing can be loaded."""
    package = folder / "twin" / "__init__.py"
    package.parent.mkdir()
    package.write_text('raise ImportError("none of it is here")\n')
    command = [sys.executable, "-m", "distributed.cli.dask_worker", cluster.scheduler_address]
    worker = subprocess.Popen(
        [*command, "--no-dashboard", "--no-nanny", "--nthreads", "1", "--name", "without"],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(folder)},
        stderr=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
    )
    try:
        while "without" not in [one.name for one in cluster.scheduler.workers.values()]:
            time.sleep(0.05)
        yield
    finally:
        worker.terminate()
        worker.wait()

"""Studies beside the tests, and one worker for all that want to know what comes of a sweep."""

import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))


@pytest.fixture
def study(tmp_path: Path) -> Callable[..., Path]:
    """A study's file from TOML text."""
    from studies import write

    return partial(write, tmp_path)


@pytest.fixture(scope="session")
def a_worker() -> Iterator[str]:
    """Address of a scheduler with one worker: to start a process with a renderer takes seconds."""
    from distributed import LocalCluster

    quiet = {"dashboard_address": "127.0.0.1:0", "silence_logs": 50}
    with LocalCluster(n_workers=1, threads_per_worker=1, processes=True, **quiet) as cluster:
        yield cluster.scheduler_address

"""Processes that compute a sweep's points."""

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from distributed import LocalCluster
from items_to_make import with_process

from tests.twin.clusters import running_cluster, worker_without_the_project
from twin.workers import AskedToEndError, SchedulerGoneError, dask

#: An end that closes nothing, as of a kill, with what a cluster holds meanwhile.
ENDED_EARLY = """
import multiprocessing, os
from twin.workers.cluster import _local, _loop

if __name__ == "__main__":
    with _loop() as loop, _local(1, loop, lambda: False):
        held = multiprocessing.get_context("spawn").Lock()
        os._exit(130)
"""


@pytest.fixture
def running() -> Iterator[LocalCluster]:
    """A running scheduler, so far without workers."""
    with running_cluster() as cluster:
        yield cluster


def test_a_worker_that_comes_later_has_what_is_shared(running: LocalCluster) -> None:
    """As where workers are replaced one after another: what is shared had been sent once, to those
    of the beginning, and all work was lost with the last of them.
    """
    running.scale(1)
    with dask(running.scheduler_address, None) as submit:
        shared = submit.share([1, 2, 3])
        assert submit.result(submit(sum, shared)) == 6
        running.scale(0)
        while running.scheduler.workers:
            time.sleep(0.01)
        running.scale(1)
        assert submit.result(submit(sum, shared)) == 6


def test_a_process_has_one_object_of_what_is_shared() -> None:
    """What is found of it is kept by its identity."""
    with dask(None, 1) as submit:
        again = [submit.share([1.0, 2.0]) for _ in range(2)]
        identities = [submit.result(submit(id, shared)) for shared in (*again, again[0])]
        assert len(set(identities)) == 1
        assert submit.result(submit(sum, submit.share([3.0, 4.0]))) == 7


@pytest.mark.thorough
def test_large_work_is_sent_without_words(recwarn: pytest.WarningsRecorder) -> None:
    """Dask warns of more than 10 MB."""
    with dask(None, 1) as submit:
        assert submit.result(submit(len, submit.share(bytes(12_000_000)))) == 12_000_000
    assert [str(one.message) for one in recwarn if "large graph" in str(one.message)] == []


def test_no_worker_is_waited_for_when_it_is_over(running: LocalCluster) -> None:
    """As after Ctrl-C: it had been a minute for a scheduler's workers, as long as it takes for
    processes here.
    """
    with (
        pytest.raises(AskedToEndError),
        dask(running.scheduler_address, None, is_over=lambda: True),
    ):
        pass
    with pytest.raises(AskedToEndError), dask(None, 2, is_over=lambda: True):
        pass


@pytest.mark.thorough
def test_a_worker_without_the_project_is_left_out(
    running: LocalCluster, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """All work is done by the other one, and one line says why; it had ended the command."""
    running.scale(1)
    address = running.scheduler_address
    with worker_without_the_project(running, tmp_path), dask(address, None) as submit:
        sent = [submit(with_process, number, "slow") for number in range(8)]
        found = [submit.result(one) for one in sent]
        found += [submit.result(submit(with_process, 8, "late"))]
    assert [number for number, _, _ in found] == list(range(9))
    assert {process for _, _, process in found} == {os.getpid()}
    told = rf"scheduler {address}: worker tcp://\S+ left out: none of it is here; all machines need"
    assert len(re.findall(told, capfd.readouterr().err)) == 1


@pytest.mark.quick(1)
@pytest.mark.parametrize("moment", ["before the work", "within it"])
def test_workers_of_which_none_has_the_project_are_told(
    running: LocalCluster, tmp_path: Path, moment: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With address and what they lack; at once where nothing is computed yet, else others are
    waited for.
    """
    address = running.scheduler_address
    monkeypatch.setattr("twin.workers.pool.LOOK_S", 0.1)
    told = rf"scheduler {address}: worker tcp://\S+: none of it is here; all machines need"
    if moment == "within it":
        running.scale(1)
        monkeypatch.setattr("twin.workers.pool.WITHOUT_WORKERS_S", 1.0)
        told = "no workers for 1 s"
    with worker_without_the_project(running, tmp_path), dask(address, None) as submit:
        if moment == "within it":
            assert submit.result(submit(sum, [1])) == 1
            running.scale(0)
            while len(running.scheduler.workers) > 1:
                time.sleep(0.01)
        with pytest.raises(SchedulerGoneError, match=told):
            submit.result(submit(sum, [1]))


def test_work_of_a_worker_that_leaves_goes_to_one_that_came_since(
    running: LocalCluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Work that is bound to the workers of its time is sent anew when all of these are gone."""
    monkeypatch.setattr("twin.workers.pool.LOOK_S", 0.1)
    running.scale(1)
    address = running.scheduler_address
    with worker_without_the_project(running, tmp_path), dask(address, None) as submit:
        sent = [submit(with_process, number, "slow") for number in range(4)]
        assert [submit.result(one)[0] for one in sent] == list(range(4))
        waiting = [submit(with_process, number, "slow") for number in range(4)]
        running.scale(0)
        while len(running.scheduler.workers) > 1:
            time.sleep(0.01)
        running.scale(1)
        assert [submit.result(one)[0] for one in waiting] == list(range(4))


@pytest.mark.thorough
def test_an_early_end_leaves_no_words_of_pythons_own(tmp_path) -> None:
    """Python's tracker had told of semaphores that it then removed, with a path of its source."""
    script = tmp_path / "ended.py"
    script.write_text(ENDED_EARLY)
    done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (130, "")


@pytest.mark.thorough
def test_ctrl_c_in_a_terminal_reaches_the_main_process_alone() -> None:
    """It goes to all processes of the terminal; workers that still imported printed a trace."""
    with dask(None, 2) as submit:
        masks = [submit(signal.pthread_sigmask, signal.SIG_BLOCK, ()) for _ in range(8)]
        assert all(signal.SIGINT in submit.result(mask) for mask in masks)
        assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())

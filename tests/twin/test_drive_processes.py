"""A drive computed by several processes: the same bytes, in order, whatever happens to them."""

import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import psutil
import pytest

from hardware.errors import InputError
from tests.twin import driven
from tests.twin.clusters import running_cluster, worker_without_the_project
from twin.drive import DeviceClock, drive, measuring
from twin.drive.measuring import in_order, pool_of
from twin.drive.plan import Event
from twin.drive.sensors import Measured, Sensors
from twin.scene import load_scene
from twin.workers import Submit, WorkerDiedError, here

#: Seven frames and five bursts.
plan = partial(driven.plan, duration_s=0.1, **dict.fromkeys(driven.CLOCKS, DeviceClock()))


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """The log of a drive that one process computed."""
    path = tmp_path_factory.mktemp("drive") / "alone.mcap"
    done = drive(plan(), path, workers=0)
    assert done.complete
    assert done.events == 7 + 5 + 11
    return path.read_bytes()


class Killer:
    """Kills one of the processes that compute, after half of a drive: one that was started since,
    for other tests keep a cluster.
    """

    def __init__(self) -> None:
        self._others, self._is_done = _children(), False

    def __call__(self, reference_s: float) -> None:
        if reference_s > 0.05 and not self._is_done:
            computing = _children() - self._others
            max(computing, key=lambda child: child.memory_info().rss).kill()
            self._is_done = True


def _children() -> set[psutil.Process]:
    return set(psutil.Process().children(recursive=True))


@pytest.mark.whole
def test_where_the_only_process_is_killed_another_takes_its_place(
    alone: bytes, tmp_path: Path
) -> None:
    """It has what the killed one had: the drive had ended there."""
    path = tmp_path / "run.mcap"
    assert drive(plan(), path, workers=1, tell=Killer()).complete
    assert path.read_bytes() == alone


@pytest.mark.whole
def test_two_processes_write_the_same_bytes(alone: bytes, tmp_path: Path) -> None:
    """Also one after the other, and after one of them has been killed."""
    path, over = tmp_path / "two.mcap", threading.Event()

    def end_early(reference_s: float) -> None:
        if reference_s > 0.03:
            over.set()

    stopped = drive(plan(), path, workers=2, over=over, tell=end_early)
    assert not stopped.complete
    assert 0 < stopped.events < 23
    done = drive(plan(), path, workers=2, tell=Killer())
    assert done.complete
    assert done.resumed == stopped.events
    assert path.read_bytes() == alone


@contextmanager
def reversed_answers(sent: list[str], asked: list[int]) -> Iterator[Submit]:
    """Work is done when it is asked for; three pieces ahead."""

    def send(work, sensors, event):
        sent.append(f"{event.kind} {event.number}")
        return work, sensors, event

    def result(handle):
        asked.append(len(sent))
        work, *given = handle
        return work(*given)

    yield Submit(send, result, 3)


def test_events_come_in_order_and_few_are_computed_ahead() -> None:
    sent: list[str] = []
    asked: list[int] = []
    drives = plan()
    with reversed_answers(sent, asked) as submit:
        found = list(in_order(drives, drives.events(), submit, lambda: False))
    assert [event for event, _ in found] == list(drives.events())
    assert all((one is None) == (event.kind == "truth") for event, one in found)
    assert len(sent) == 12
    # Of the measurements never more than three were under way.
    assert max(n - k for k, n in enumerate(asked)) == 3


def test_what_is_over_is_not_waited_for() -> None:
    sent: list[str] = []
    drives, over = plan(), threading.Event()
    with reversed_answers(sent, []) as submit:
        found = in_order(drives, drives.events(), submit, over.is_set)
        first = next(one for one in found if one[1] is not None)
        over.set()
        rest = [one for one in found if one[1] is not None]
    assert first[1] is not None
    assert rest == []
    assert len(sent) == 3


@pytest.mark.whole
def test_processes_that_start_are_not_waited_for_when_it_ends(tmp_path: Path) -> None:
    """Ctrl-C meanwhile: nothing is computed, and no log is left."""
    over, path = threading.Event(), tmp_path / "run.mcap"
    threading.Timer(0.5, over.set).start()
    before, begin = _children(), time.monotonic()
    done = drive(plan(), path, workers=8, over=over)
    assert (done.complete, done.events) == (False, 0)
    assert not path.exists()
    assert not [child for child in _children() - before if child.name().startswith("python")]
    assert time.monotonic() - begin < 20


def test_what_is_computed_when_it_ends_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    """In one process the signal comes while an event is computed: that one is written."""
    over, measured = threading.Event(), Sensors.measured

    def interrupted(self: Sensors, event: Event) -> Measured:
        over.set()
        return measured(self, event)

    monkeypatch.setattr(Sensors, "measured", interrupted)
    drives = plan()
    with here() as submit:
        found = [one for _, one in in_order(drives, drives.events(), submit, over.is_set)]
    assert sum(one is not None for one in found) == 1


def test_an_error_is_raised_once_and_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    """As an exception a scheduler would try it three times."""
    calls: list[int] = []

    def fail(*_: object) -> None:
        calls.append(1)
        raise InputError("scene.xml: no such wall")

    monkeypatch.setattr(Sensors, "measured", fail)
    drives = plan()
    with here() as submit, pytest.raises(InputError, match=r"scene\.xml: no such wall"):
        list(in_order(drives, drives.events(), submit, lambda: False))
    assert calls == [1]


def test_where_processes_are_gone_the_drive_says_how_it_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, alone: bytes
) -> None:
    """Their death loses nothing that is in the log."""
    path = tmp_path / "run.mcap"

    @contextmanager
    def dies_at_the_fourth(*_: object) -> Iterator[Submit]:
        answers = iter(range(3))

        def result(handle):
            if next(answers, None) is None:
                raise WorkerDiedError("the worker's process died")
            return handle

        yield Submit(lambda work, *given: work(*given), result, 1)

    monkeypatch.setattr(measuring, "dask", dies_at_the_fourth)
    told = r"died; 6 of 23 events are in .*run\.mcap, the same command continues it"
    with pytest.raises(WorkerDiedError, match=told):
        drive(plan(), path, workers=2)
    assert drive(plan(), path, workers=0).resumed == 6
    assert path.read_bytes() == alone


def test_a_worker_without_the_project_does_not_end_a_drive(
    tmp_path: Path, alone: bytes, capfd: pytest.CaptureFixture[str]
) -> None:
    """The other one computes all of it, to the same bytes."""
    path = tmp_path / "run.mcap"
    with running_cluster() as cluster, worker_without_the_project(cluster, tmp_path):
        cluster.scale(1)
        cluster.wait_for_workers(2)
        assert drive(plan(), path, scheduler=cluster.scheduler_address).complete
    assert path.read_bytes() == alone
    assert "left out: none of it is here; all machines need" in capfd.readouterr().err


@pytest.mark.parametrize(
    ("changes", "workers", "expected"),
    [
        ({}, None, 2),
        ({}, 0, 0),
        ({}, 1, 1),
        ({"scene": load_scene("table1")}, None, 0),
        ({"scene": load_scene("table1")}, 2, 2),
        ({"duration_s": 0.025}, None, 0),
    ],
)
def test_processes_are_started_where_they_pay(
    changes: dict[str, object],
    workers: int | None,
    expected: int,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Not for a few frames, nor where the world rests, unless asked for."""
    monkeypatch.setattr(measuring, "usual_workers", lambda: 2)
    monkeypatch.setattr(measuring, "dask", lambda scheduler, n, is_over: n)
    monkeypatch.setattr(measuring, "here", lambda: 0)
    drives = plan(**changes)
    measured = sum(event.kind != "truth" for event in drives.events())
    assert pool_of(drives, measured, None, workers, lambda: False) == expected


@pytest.mark.parametrize("workers", [-1, 100_000, 1.5, "2", float("nan")])
def test_processes_that_cannot_be_are_refused(tmp_path: Path, workers: object) -> None:
    """100 000 had been started, one after another."""
    path = tmp_path / "run.mcap"
    told = rf"workers: {workers!r}: expected a whole number from 0 to \d+$"
    with pytest.raises(InputError, match=told):
        drive(plan(), path, workers=workers)  # type: ignore[arg-type]
    assert not path.exists()


@pytest.mark.thorough
def test_schedulers_that_cannot_be_are_refused(tmp_path: Path) -> None:
    path, address = tmp_path / "run.mcap", "tcp://127.0.0.1:1"
    with pytest.raises(InputError, match=rf"scheduler: '{address}': can't be reached"):
        drive(plan(), path, scheduler=address)
    with pytest.raises(InputError, match="workers, scheduler: expected one of them"):
        drive(plan(), path, workers=2, scheduler=address)
    assert not path.exists()


@pytest.mark.thorough
def test_a_scheduler_that_is_no_address_is_one_line(tmp_path: Path) -> None:
    """Dask's client had added a stack trace of its own, 20 s later."""
    options = ["--duration", "1 s", "--out", str(tmp_path / "run.mcap"), "--scheduler", "nonsense"]
    command = [sys.executable, "-m", "twin", "drive", "yard", *options]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert line.startswith("twin: error: scheduler: 'nonsense': can't be reached (missing port")

"""Cases in a process each, within a limit of CPU time; what is judged is appended to a file.

A run that is interrupted goes on after the cases that its file holds.
"""

import json
import multiprocessing
import resource
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from benchmarks.stated_errors.judged import Judged

_JUDGED: TypeAdapter[tuple[Judged, ...]] = TypeAdapter(tuple[Judged, ...])


@dataclass(frozen=True)
class Run:
    """What lines of a file are of."""

    sensor: str
    seed: int
    search: bool


@dataclass(frozen=True)
class CaseResult:
    """What a case came to; ``left_out``: why it came to nothing, empty if it came to something."""

    case: str
    judged: tuple[Judged, ...] = ()
    left_out: str = ""


def results(
    run: Run,
    cases: Sequence[str],
    judge: Callable[[Run, str], Iterator[Judged]],
    file: Path,
    limit_s: int,
) -> Iterator[CaseResult]:
    """Of every case, from the file where it is there.

    ``judge``: a function of a module, as it is called in processes of their own.
    """
    known = {result.case: result for result in _read(run, file)}
    spawn = multiprocessing.get_context("spawn")
    for case in cases:
        if case not in known:
            process = spawn.Process(target=_judge_into, args=(run, case, judge, file, limit_s))
            process.start()
            process.join()
            known |= {result.case: result for result in _read(run, file)}
            if case not in known:
                why = f"stopped within {limit_s} s of CPU time, exit code {process.exitcode}"
                known[case] = CaseResult(case, left_out=why)
                _append(run, known[case], file)
        yield known[case]


def _judge_into(
    run: Run,
    case: str,
    judge: Callable[[Run, str], Iterator[Judged]],
    file: Path,
    limit_s: int,
) -> None:
    resource.setrlimit(resource.RLIMIT_CPU, (limit_s, limit_s))
    _append(run, CaseResult(case, tuple(judge(run, case))), file)


def _append(run: Run, result: CaseResult, file: Path) -> None:
    with file.open("a") as lines:
        lines.write(json.dumps({"run": asdict(run), **asdict(result)}) + "\n")


def _read(run: Run, file: Path) -> Iterator[CaseResult]:
    for line in file.read_text().splitlines() if file.is_file() else ():
        with suppress(json.JSONDecodeError):  # a line cut off by a kill
            held: dict[str, Any] = json.loads(line)
            if held["run"] == asdict(run):
                judged = _JUDGED.validate_python(held["judged"])
                yield CaseResult(held["case"], judged, held["left_out"])

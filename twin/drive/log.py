"""The log of a drive: events one after another, and the same bytes after any number of kills.

Each event ends with a mark and closes its chunk. What a kill left is written anew, event by event,
over the same bytes, which it must equal; what follows the last whole event is cut off. Whole events
that follow damage stay in a copy of the file.
"""

import json
import shutil
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from io import BytesIO
from itertools import islice
from pathlib import Path
from types import TracebackType
from typing import IO, Self

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Metadata
from mcap.writer import MCAP0_MAGIC, CompressionType, Writer

from hardware.errors import InputError
from hardware.files import is_held, naming, whole_file
from hardware.formatting import counted
from hardware.recording import Log
from hardware.recording.ending import Ending
from hardware.recording.reading import Beside, LoggedMessage, read_all
from hardware.recording.recovery import LOST, path_of_damaged
from hardware.recording.ros import Definition
from twin.drive.truth import CLOCK, Mark
from twin.fidelity import Fidelity

MARKS = "/truth/clock"
_KNOB = "fidelity."
_MAGIC_BYTES, _MOST_ABOUT_BYTES = len(MCAP0_MAGIC), 1 << 16


class DifferentBytesError(InputError):
    """What is written anew is not what stands in the file."""


class DriveLog:
    """The log of a drive, new or gone on with.

    Parameters
    ----------
    path
        A new file, or what is left of the log of the same drive.
    about
        Words at the beginning of the log; ``digest`` tells drives apart.
    n_events
        Of the whole drive. A log that was recovered has its footer, but not all of them.

    A log without any event is removed at the end.

    Raises InputError for another file at ``path``, one that is being written, or one whose bytes
    are not those that this software writes.
    """

    def __init__(self, path: Path, about: Mapping[str, str], n_events: int) -> None:
        self.path, self.events, self.complete = path, 0, False
        left = _left(path, about, n_events)
        self.complete = left.complete
        if left.complete:
            self.events = n_events
            return
        copy = _copied(path) if left.behind else None
        with naming(path):
            self._output = _Output(path)
        if not left.events:
            self._output.cut()
        self._log = Log(path, flush_s=float("inf"), file=self._output, about=about)  # type: ignore[arg-type]
        try:
            for messages in islice(_whole_events(path), left.events):
                for logged in messages:
                    definition = Definition(logged.schema.name, logged.schema.data.decode())
                    times = (logged.message.log_time, logged.message.publish_time)
                    self._log.message(logged.topic, definition, logged.message.data, *times)
                self._log.flush()
                self.events += 1
        except DifferentBytesError:
            self._output.close()
            raise
        self._output.cut()
        if copy:
            print(
                f"warning: {path}: damaged behind {counted(left.events, 'whole event')}, at byte "
                f"{self._output.tell()}; the rest is computed anew, and "
                f"{counted(left.behind, 'whole event')} of it are in {copy} still",
                file=sys.stderr,
                flush=True,
            )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if not self.complete:
            self._output.close()
            if not self.events:
                self.path.unlink(missing_ok=True)

    def event(self, mark: Mark, write: Callable[[Log], None]) -> None:
        """Append an event: what ``write`` writes, and its mark."""
        write(self._log)
        self._log.message(MARKS, CLOCK, mark.pack(), mark.end_ns, mark.end_ns)
        self._log.flush()
        self._output.flush()
        self.events += 1

    def finish(self) -> None:
        """Write index and footer, and close."""
        self._log.close()
        self.complete = True


@dataclass(frozen=True)
class _Left:
    """What a file holds of a drive: so many whole events, and ``behind`` damage some more."""

    events: int = 0
    behind: int = 0
    complete: bool = False


def _left(path: Path, about: Mapping[str, str], n_events: int) -> _Left:
    if path.is_symlink() and not path.exists():
        raise InputError(f"{path}: is a link to no file: expected a new file")
    if path.exists() and not path.is_file():
        raise InputError(f"{path}: exists, and is no file: expected a new one")
    if not path.exists() or path.stat().st_size == 0:
        return _Left()
    if is_held(path):
        raise InputError(f"{path}: still being written by another process")
    found = _about(path)
    if path.stat().st_size < _MOST_ABOUT_BYTES and _begins(found or about, path.read_bytes()):
        return _Left()
    if found is None:
        raise InputError(f"{path}: exists, and is no log of a drive: expected a new file")
    if found.get("digest") != about["digest"]:
        raise InputError(
            f"{path}: exists, and is the log of another drive ({_difference(found, about)}): "
            "expected a new file"
        )
    ending = Ending()
    records = read_all(path, ending)
    events = sum(1 for _ in _events_before_damage(records, ending))
    behind = sum(isinstance(one, LoggedMessage) and one.topic == MARKS for one in records)
    with path.open("rb") as file:
        file.seek(-_MAGIC_BYTES, 2)
        is_closed = ending.fault is None and file.read() == MCAP0_MAGIC
    return _Left(events, behind, complete=is_closed and events == n_events)


def _copied(path: Path) -> Path:
    """A copy of a damaged log."""
    copy = path_of_damaged(path)
    with whole_file(copy) as partial:
        shutil.copyfile(path, partial)
    return copy


def words_of(knobs: Fidelity) -> dict[str, str]:
    """Knobs among the words of a log."""
    return {f"{_KNOB}{name}": json.dumps(value) for name, value in knobs.said().items()}


def stored_fidelity(path: Path) -> Fidelity | None:
    """Knobs of the drive that a log is of; None where there is no log that holds them.

    Raises InputError for knobs that this software does not have.
    """
    found = (_about(path) if path.is_file() else None) or {}
    knobs = {
        name.removeprefix(_KNOB): json.loads(value)
        for name, value in found.items()
        if name.startswith(_KNOB)
    }
    return Fidelity().with_(knobs) if knobs else None


def _whole_events(path: Path) -> Iterator[list[LoggedMessage]]:
    """Messages of each event of a log up to the first that is damaged."""
    ending = Ending()
    return _events_before_damage(read_all(path, ending), ending)


def _events_before_damage(
    records: Iterable[LoggedMessage | Beside], ending: Ending
) -> Iterator[list[LoggedMessage]]:
    """Messages of each event up to the first that is damaged, or was before it was recovered."""
    messages, expected = list[LoggedMessage](), 0
    for logged in records:
        if ending.fault is not None or (isinstance(logged, Metadata) and logged.name == LOST):
            return
        if not isinstance(logged, LoggedMessage):
            continue
        messages.append(logged)
        if logged.topic != MARKS:
            continue
        if Mark.unpack(logged.message.data).event != expected:
            return
        yield messages
        messages, expected = [], expected + 1


def _about(path: Path) -> dict[str, str] | None:
    """Words at the beginning of a log; None where there are none."""
    with path.open("rb") as file:
        data = file.read(_MOST_ABOUT_BYTES)
    at = _MAGIC_BYTES
    for kind in (Opcode.HEADER, Opcode.METADATA):
        length = int.from_bytes(data[at + 1 : at + 9], "little")
        body = data[at + 9 : at + 9 + length]
        if len(data) < at + 9 or data[at] != kind or len(body) < length:
            return None
        at += 9 + length
    try:
        return dict(Metadata.read(ReadDataStream(BytesIO(body))).metadata)
    except (McapError, ValueError):
        return None


def _begins(about: Mapping[str, str], data: bytes) -> bool:
    """Whether data are the first bytes of a log with these words, cut before its first event."""
    stream = BytesIO()
    writer = Writer(stream, 1 << 20, CompressionType.ZSTD)
    writer.start(profile="ros2", library="ugv")
    writer.add_metadata("about", dict(about))
    return stream.getvalue().startswith(data)


def _difference(found: Mapping[str, str], about: Mapping[str, str]) -> str:
    """The words that differ, in words."""
    other = [
        f"{name}: {found.get(name, 'none')}, not {value}"
        for name, value in about.items()
        if name != "digest" and found.get(name) != value
    ]
    return "; ".join(other) or "of other content, or made by another version of this software"


class _Output:
    """A file that is written from its beginning: bytes that are there already must be the same."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._file: IO[bytes] = path.open("r+b" if path.exists() else "x+b")
        self._there = self._file.seek(0, 2)
        self._at = self._file.seek(0)

    @property
    def closed(self) -> bool:
        """Whether it is."""
        return self._file.closed

    def fileno(self) -> int:
        """Of the file."""
        return self._file.fileno()

    def tell(self) -> int:
        """Bytes written or compared so far."""
        return self._at

    def write(self, data: bytes) -> int:
        """Compare what is there, append the rest."""
        piece = memoryview(data)
        if self._at < self._there:
            known = self._file.read(min(len(piece), self._there - self._at))
            if known != piece[: len(known)]:
                raise DifferentBytesError(
                    f"{self._path}: written anew, it differs from byte {self._at} on: it was made "
                    "by other versions of the libraries, or damaged; expected a new file"
                )
            self._at += len(known)
            piece = piece[len(known) :]
        if len(piece):
            self._file.write(piece)
            self._at += len(piece)
        return len(data)

    def cut(self) -> None:
        """Remove what follows."""
        self._file.seek(self._at)
        self._file.truncate()
        self._there = self._at
        self._file.flush()

    def flush(self) -> None:
        """To the system."""
        if not self.closed:
            with naming(self._path):
                self._file.flush()

    def close(self) -> None:
        """The file; what is in memory of an event that is not whole is lost."""
        with naming(self._path):
            self._file.close()

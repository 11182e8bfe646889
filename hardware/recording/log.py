"""The log: an append-only MCAP file that can be read even where its writer was killed.

MCAP: mcap.dev/spec. Chunks are closed every half second, so that a crash loses no more than that.
"""

import os
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import IO, Self

from mcap.writer import CompressionType, Writer

from hardware.drivers.clock import ClockModel
from hardware.errors import InputError
from hardware.files import hold, naming
from hardware.recording import ros
from hardware.recording.kinds import Record, kind_of
from hardware.recording.ros import Definition
from hardware.records import SpiRecord
from hardware.records.state import QuaternionPose

_CHUNK_BYTES = 1 << 20


class Log:
    """A file being written, locked meanwhile: `recover` refuses it.

    Writing raises InputError once the file is removed or another is put in its place, closing it
    also where it was moved.

    Parameters
    ----------
    path
        New file. Raises FileExistsError for an existing one.
    flush_s
        Longest time that a message stays in memory, if messages or `tick` follow.
    extrinsics
        Poses of sensors on the rig, by frame: x y z (m), quaternion w x y z. In the tree of
        transforms such a sensor is a child of the rig; others are children of the world.
    file
        Opened at ``path`` for writing in place of a new file.
    about
        Words about the log, by name, which stand at its beginning.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        flush_s: float = 0.5,
        extrinsics: Mapping[str, Sequence[float]] | None = None,
        file: IO[bytes] | None = None,
        about: Mapping[str, str] | None = None,
    ) -> None:
        self._extrinsics = {
            name: _pose(name, values) for name, values in (extrinsics or {}).items()
        }
        self.path = Path(path)
        self._file = self.path.open("xb") if file is None else file
        hold(self._file)
        self._writer = Writer(self._file, _CHUNK_BYTES, CompressionType.ZSTD)
        self._writer.start(profile="ros2", library="ugv")
        if about is not None:
            self._writer.add_metadata("about", dict(about))
        self._flush_s, self._flushed_s = flush_s, time.monotonic()
        self._flushed_bytes = 0
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._sequence: dict[str, int] = {}
        #: Messages of each topic that stand in the file for sure; others may be lost at a fault.
        self.flushed: Mapping[str, int] = {}
        now_ns = time.time_ns()
        for name, pose in self._extrinsics.items():
            fixed = ros.transform(pose, now_ns, "rig", name)
            self.message("/tf_static", ros.TRANSFORMS, fixed, now_ns, now_ns)
        self.flush()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()
        if error is not None and self._sequence.keys() <= {"/tf_static"}:
            self.path.unlink()  # failed before anything came

    def record(
        self,
        topic: str,
        record: Record,
        *,
        host_ns: int | None = None,
        clock: ClockModel | None = None,
        frame: str | None = None,
    ) -> None:
        """Append a record and the poses in it.

        Its publish time is the device's time on the host's clock where ``clock`` is known; that of
        a radar's pose is its burst's middle.
        """
        host_ns = time.time_ns() if host_ns is None else host_ns
        frame = frame or topic.strip("/").split("/")[0]
        begun = record.device_time_ns.reshape(-1)
        stamp = clock.host_ns(int(begun[0])) if clock and begun.size else host_ns
        kind = kind_of(record)
        message = kind.pack(record, stamp, frame, clock)
        self.message(topic, kind.definition, message, host_ns, stamp)
        child = kind.pose_of or frame
        if child in self._extrinsics:  # the rig's pose says it all
            return
        if isinstance(record, SpiRecord):
            poses = [(record.pose, stamp)]
        else:
            middles = map(record.middle_ns, range(len(record.pose)))
            stamps = [clock.host_ns(ns) if clock else host_ns for ns in middles]
            poses = list(zip(record.pose, stamps, strict=True))
        for pose, at_ns in poses:
            moved = ros.transform(pose, at_ns, "world", child)
            self.message("/tf", ros.TRANSFORMS, moved, host_ns, at_ns)

    def message(
        self, topic: str, definition: Definition, message: bytes, log_ns: int, publish_ns: int
    ) -> None:
        """Append a message."""
        if topic not in self._channels:
            self._channels[topic] = self._writer.register_channel(
                topic, "cdr", self._schema(definition)
            )
            self._sequence[topic] = 0
        with naming(self.path):
            self._writer.add_message(
                self._channels[topic],
                log_ns,
                message,
                max(publish_ns, 0),
                self._sequence[topic] % 2**32,
            )
        self._sequence[topic] += 1
        self.tick()

    def tick(self) -> None:
        """Flush if due; call it regularly where no messages arrive."""
        if time.monotonic() - self._flushed_s >= self._flush_s:
            self.flush()

    def flush(self) -> None:
        """Close the chunk and write it to the file."""
        with naming(self.path):
            self._expect_whole()
            self._writer.flush()  # type: ignore[no-untyped-call]
            self._file.flush()
            self._flushed_bytes = self._file.tell()
            if os.fstat(self._file.fileno()).st_nlink == 0:
                raise InputError(
                    f"{self.path}: was removed or replaced while it was written; its messages are "
                    "lost"
                )
        self.flushed, self._flushed_s = dict(self._sequence), time.monotonic()

    def close(self) -> None:
        """Finish the file; any number of times."""
        if self._file.closed:
            return
        with naming(self.path):
            try:
                self._expect_whole()
                self._writer.finish()  # type: ignore[no-untyped-call]
                written = os.fstat(self._file.fileno())
            finally:
                self._file.close()
        self.flushed = dict(self._sequence)
        if not (self.path.exists() and os.path.samestat(written, self.path.stat())):
            raise InputError(f"{self.path}: was moved, removed or replaced while it was written")

    def _expect_whole(self) -> None:
        if os.fstat(self._file.fileno()).st_size < self._flushed_bytes:
            raise InputError(f"{self.path}: was cut short while it was written")

    def _schema(self, definition: Definition) -> int:
        if definition.name not in self._schemas:
            self._schemas[definition.name] = self._writer.register_schema(
                definition.name, "ros2msg", definition.text.encode()
            )
        return self._schemas[definition.name]


def _pose(name: str, values: Sequence[float]) -> QuaternionPose:
    try:
        return QuaternionPose.from_numbers(values)
    except (TypeError, ValueError):
        raise InputError(
            f"extrinsics: {name}: {values}, expected x y z, quaternion w x y z that is not 0"
        ) from None

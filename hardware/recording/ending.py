"""How a log ends: whole, cut off or damaged, and what is lost."""

from dataclasses import dataclass, field
from pathlib import Path

from hardware.formatting import counted

#: Unreadable records that are named one by one.
_MOST_NAMED = 10


@dataclass
class Ending:
    """Completeness of a log, as found while reading.

    Parameters
    ----------
    fault
        First fault; None: none so far.
    lost_bytes
        In broken or truncated chunks, messages, metadata and attachments; the rest is read.
    lost_messages
        In those, as far as the index behind each broken chunk contains their number.
    being_written
        Its writer still had it open when reading began, so that its end is none yet.
    finished
        It has its end, so that a fault is damage.
    n_unreadable, unreadable
        Records that are there, but broken: how many, and names of the first.
    """

    fault: str | None = None
    lost_bytes: int = 0
    lost_messages: int = 0
    being_written: bool = False
    finished: bool = False
    n_unreadable: int = 0
    unreadable: list[str] = field(default_factory=list)

    @property
    def lost(self) -> str:
        """Amount of lost data, in words; empty where nothing is lost."""
        told = []
        if self._has_gaps:
            messages = self.lost_messages or "unknown"
            told.append(f"lost: {self.lost_bytes} bytes, {messages} messages")
        if self.n_unreadable:
            told.append(f"left out: {self.told_unreadable}")
        return "; ".join(told)

    @property
    def told_unreadable(self) -> str:
        """Number of the records that cannot be read, with names of the first."""
        names = "; ".join(self.unreadable) + "; ..." * (self.n_unreadable > _MOST_NAMED)
        return f"{counted(self.n_unreadable, 'unreadable record')} ({names})"

    @property
    def _has_gaps(self) -> bool:
        """Whether data are lost that recovery leaves out; unreadable records it copies."""
        return bool(self.lost_bytes or self.lost_messages)

    def leave_out(self, name: str, why: object) -> None:
        """Count a record that cannot be read."""
        self.fault = self.fault or f"{name}: {why}"
        self.n_unreadable += 1
        if self.n_unreadable <= _MOST_NAMED:
            self.unreadable.append(name)

    def advice(self, path: str | Path) -> str:
        """Fault of the log at a path, and the command that recovers it."""
        if self.lost:
            told = f"damaged: {self.fault}; {self.lost}"
            return f"{told}; `ugv recover {path}` keeps the rest" if self._has_gaps else told
        if self.finished:
            return f"damaged: {self.fault}; nothing is lost, `ugv recover {path}` writes it anew"
        if self.being_written:
            return "still being written: read as far as it was"
        return f"not finished: {self.fault}; `ugv recover {path}` finishes it"

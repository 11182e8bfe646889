"""What `ugv capture` tells of the records of one topic: how many can be processed, and faults."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hardware.recording.kinds import Record

#: Share of a topic's slots, exposures or records.
_WORTH_A_WARNING = 0.01
_FAULTS = ("lost", "overrun", "saturated")
_LATE = (
    ": every slot is overrun, nothing was heard: the bursts reach the radio after their time. Give "
    "the setup more time (schedule: step_period_s, lead_s), or serve a virtual radio with --pace "
    "fast"
)


@dataclass
class _Kind:
    """Records of which the same is told: how many, and what of the first."""

    count: int = 0
    first: str = ""

    def add(self, text: str) -> None:
        """Count one of which something is told."""
        if text:
            self.count += 1
            self.first = self.first or f", the first since: {text}"


@dataclass
class Tally:
    """Of the records of one topic, ``count`` of them; it does not grow with their number.

    ``parts``: slots or exposures; ``flags``: how many of them have each flag, or are at a rail;
    ``faults``, ``silent`` and ``partial``: records that cannot be processed, that hold nothing, and
    of which slots are left out.
    """

    topic: str
    count: int = 0
    parts: str = ""
    n_parts: int = 0
    flags: Counter[str] = field(default_factory=Counter)
    faults: _Kind = field(default_factory=_Kind)
    silent: _Kind = field(default_factory=_Kind)
    partial: int = 0

    def add(self, record: "Record") -> None:
        """Count a record."""
        from hardware.commands.records import flag_counts
        from hardware.records import RadarRecord
        from hardware.usability import usability

        found = usability(record)
        self.count += 1
        self.faults.add(found.fault)
        self.silent.add(found.silence)
        self.partial += not found.whole
        self.parts = "slots" if isinstance(record, RadarRecord) else "exposures"
        self.n_parts += record.flags.size
        self.flags.update(flag_counts(record.flags))
        self.flags["saturated"] += record.n_at_rail

    @property
    def fault(self) -> str:
        """Why none of the records can be processed; empty where one can."""
        if self.faults.count < self.count:
            return ""
        is_late = self.flags["overrun"] == self.n_parts > 0
        why = _LATE if is_late else self.faults.first
        return f"{self.topic}: 0 of {self.count} records can be processed{why}"

    def warnings(self) -> Iterator[str]:
        """What is wrong with a share that is worth a warning."""
        for fault in _FAULTS:
            if self.flags[fault] > _WORTH_A_WARNING * self.n_parts:
                share = 100 * self.flags[fault] / self.n_parts
                yield f"{self.topic}: {share:.3g} % of its {self.n_parts} {self.parts} are {fault}"
        told = (
            ("cannot be processed", self.faults.count, self.faults.first),
            ("hold nothing", self.silent.count, self.silent.first),
            ("are processed in part: slots are lost", self.partial, ""),
        )
        for what, count, first in told:
            if count > _WORTH_A_WARNING * self.count:
                yield f"{self.topic}: {count} of {self.count} records {what}{first}"

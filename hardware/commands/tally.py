"""What `ugv capture` tells of the records of one topic: how many can be processed, and faults."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hardware.recording.kinds import Record
    from hardware.usability import Usability

#: Share of a topic's slots, exposures or records.
_WORTH_A_WARNING = 0.01
_FAULTS = ("lost", "overrun", "saturated")
_LATE = (
    ": every slot is overrun, nothing was heard: the bursts reach the radio after their time. Give "
    "the setup more time (schedule: step_period_s, lead_s), or serve a virtual radio with --pace "
    "fast"
)


@dataclass
class Tally:
    """Of the records of one topic.

    ``parts``: slots or exposures; ``flags``: how many of them have each flag, or are at a rail.
    """

    topic: str
    records: list["Usability"] = field(default_factory=list)
    parts: str = ""
    n_parts: int = 0
    flags: Counter[str] = field(default_factory=Counter)

    def add(self, record: "Record") -> None:
        """Count a record."""
        from hardware.commands.records import flag_counts
        from hardware.records import RadarRecord
        from hardware.usability import usability

        self.records.append(usability(record))
        self.parts = "slots" if isinstance(record, RadarRecord) else "exposures"
        self.n_parts += record.flags.size
        self.flags.update(flag_counts(record.flags))
        self.flags["saturated"] += record.n_at_rail

    @property
    def fault(self) -> str:
        """Why none of the records can be processed; empty where one can."""
        faults = [record.fault for record in self.records]
        if not all(faults):
            return ""
        is_late = self.flags["overrun"] == self.n_parts > 0
        why = _LATE if is_late else f", the first since: {faults[0]}"
        return f"{self.topic}: 0 of {len(faults)} records can be processed{why}"

    def warnings(self) -> Iterator[str]:
        """What is wrong with a share that is worth a warning."""
        for fault in _FAULTS:
            if self.flags[fault] > _WORTH_A_WARNING * self.n_parts:
                share = 100 * self.flags[fault] / self.n_parts
                yield f"{self.topic}: {share:.3g} % of its {self.n_parts} {self.parts} are {fault}"
        told = (
            ("cannot be processed", [one.fault for one in self.records if one.fault]),
            ("hold nothing", [one.silence for one in self.records if one.silence]),
            (
                "are processed in part: slots are lost",
                [one for one in self.records if not one.whole],
            ),
        )
        for what, of in told:
            if len(of) > _WORTH_A_WARNING * len(self.records):
                first = f", the first since: {of[0]}" if isinstance(of[0], str) else ""
                yield f"{self.topic}: {len(of)} of {len(self.records)} records {what}{first}"

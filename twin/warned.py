"""Warnings of a capture: a sentence with its kind, and whether it leaves nothing to look at."""

from collections.abc import Iterable
from typing import Literal, get_args

from twin.errors import InputError

#: What a warning is about, in the order in which they are listed.
#:
#: Of the record: ``saturated`` (upper rail of the converter, or a full well), ``black`` (its lower
#: rail), ``underexposed`` (counts do not move), ``quantisation`` (the converter's step hides what
#: noise would let through), ``lag`` (what the exposure before leaves in the next one), ``overrun``,
#: ``reset`` and ``lost`` (flags of exposures or slots),
#: ``no-light`` and ``no-echo`` (nothing comes back).
#: Of the truth: ``hidden`` (a target out of sight), ``ambiguous`` (beyond what range or rate is
#: unambiguous to).
#: Of the twin: ``design`` (settings that contradict each other or the scene), ``model`` (physics
#: that is left out matters here), ``rendering`` (rays, their rounding or their number leave an
#: error), ``tolerance`` (the error is more than was asked for).
Kind = Literal[
    "saturated",
    "black",
    "underexposed",
    "quantisation",
    "lag",
    "overrun",
    "reset",
    "lost",
    "no-light",
    "no-echo",
    "hidden",
    "ambiguous",
    "design",
    "model",
    "rendering",
    "tolerance",
]
KINDS: tuple[Kind, ...] = get_args(Kind)


class CaptureWarning(str):
    """A sentence for the user; ``kind`` for whoever counts, ``void`` where no result remains."""

    kind: Kind
    void: bool

    def __new__(cls, kind: Kind, text: str, *, void: bool = False) -> "CaptureWarning":
        """Raises InputError for a kind that is none of `KINDS`."""
        if kind not in KINDS:
            raise InputError(f"kind: {kind!r} is none of {', '.join(KINDS)}")
        made = super().__new__(cls, text)
        made.kind, made.void = kind, void
        return made

    def __getnewargs_ex__(self) -> tuple[tuple[Kind, str], dict[str, bool]]:
        """Pickled with its kind."""
        return (self.kind, str(self)), {"void": self.void}


def is_void(warnings: Iterable[CaptureWarning]) -> bool:
    """Whether one of them says that no result remains."""
    return any(warning.void for warning in warnings)

"""Parts to build systems from."""

from pathlib import Path

from pydantic import model_validator

from twin.errors import InputError
from twin.files import catalog_folder
from twin.system.curves import check_curves
from twin.system.detector import Photodetector, Readout
from twin.system.emitter import Emitter
from twin.system.environment import Sky, Weather
from twin.system.optics import Filter, Optics
from twin.toml import Entry, bundled, load_entry

PARTS = catalog_folder() / "parts"
#: Of a system that a part may be of.
SECTIONS = ("emitter", "filter", "optics", "detector", "readout", "sky", "weather")


class Part(Entry):
    """A part one can buy, or one the paper describes: one section of a system."""

    emitter: Emitter | None = None
    """A pattern projector."""
    filter: Filter | None = None
    """A band-pass filter."""
    optics: Optics | None = None
    """A lens."""
    detector: Photodetector | None = None
    """A photodiode or sensor."""
    readout: Readout | None = None
    """An amplifier and converter."""
    sky: Sky | None = None
    """A sun."""
    weather: Weather | None = None
    """A state of the air."""

    @model_validator(mode="after")
    def _is_one_thing(self) -> "Part":
        if len(self._sections()) != 1:
            raise InputError(f"needs exactly one section of {', '.join(SECTIONS)}")
        return self

    @property
    def kind(self) -> str:
        """Name of its section."""
        return self._sections()[0]

    def _sections(self) -> list[str]:
        return [name for name in SECTIONS if getattr(self, name) is not None]


def load_part(name: "str | Path | Part") -> Part:
    """A bundled part by name, or a user's own TOML file.

    Raises InputError naming the file, the field, the value and what was expected; a file of a curve
    that it names is read too.
    """
    part = load_entry(Part, name, "part", PARTS)
    check_curves(part.emitter, part.filter, part.detector)
    return part


def part_names() -> list[str]:
    """Names of the bundled parts."""
    return bundled(PARTS)

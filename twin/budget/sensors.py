"""Sensors of the catalogue: as their data sheets say, and as the paper prints them."""

import math
from pathlib import Path
from typing import Literal

from pydantic import model_validator

from twin.files import catalog_folder
from twin.toml import Count, Entry, NonNegative, Positive, Sourced, Strict, bundled, load_entry


class Sensor(Strict):
    """One pixel, how many there are, and how fast they are read (None: as fast as one likes)."""

    shape: Sourced[Literal["disc", "rectangle"]]
    width_m: Sourced[Positive]
    height_m: Sourced[Positive] | None = None
    pixels: Sourced[Count]
    responsivity_a_per_w: Sourced[Positive]
    dark_current_a: Sourced[NonNegative]
    line_rate_hz: Sourced[Positive] | None = None

    @model_validator(mode="after")
    def _has_its_sides(self) -> "Sensor":
        if (self.shape.value == "rectangle") == (self.height_m is None):
            raise ValueError("a rectangle has width_m and height_m, a disc width_m alone")
        return self

    @property
    def pixel_area_m2(self) -> float:
        """Photosensitive area of one pixel."""
        if self.height_m is None:
            return math.pi / 4 * self.width_m.value**2
        return self.width_m.value * self.height_m.value


class SensorPart(Entry):
    """A sensor one can buy, or one the paper describes."""

    sensor: Sensor


def load_part(name: "str | Path | SensorPart") -> SensorPart:
    """A bundled part by name, or a user's own TOML file.

    Raises InputError naming the file, the field, the value and what was expected.
    """
    return load_entry(SensorPart, name, "part", catalog_folder() / "parts")


def part_names() -> list[str]:
    """Names of the bundled parts."""
    return bundled(catalog_folder() / "parts")

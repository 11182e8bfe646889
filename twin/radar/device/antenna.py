"""The antennas: gain by direction, in closed form or from a pattern file, and where they stand.

Transmit and receive elements are alike, and so is their polarisation: vertical, co-polar. What
an echo turns into the other polarisation is not received.
"""

from pathlib import Path
from typing import Annotated, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from twin.errors import InputError
from twin.radar.device.antenna_pattern_file import Pattern, read_pattern
from twin.toml import Finite, Positive, Sourced, Strict

Array = NDArray[np.float64]
_Coordinate = Annotated[Finite, Field(ge=-10, le=10)]
Place = tuple[_Coordinate, _Coordinate, _Coordinate]
Places = Annotated[tuple[Place, ...], Field(min_length=1, max_length=256)]


class Antenna(Strict):
    """One pattern for transmitting and receiving: a closed form, or a file's."""

    alternatives: ClassVar = (("gain_dbi",), ("pattern_file", "pattern_axis"))

    gain_dbi: Sourced[Annotated[Positive, Field(ge=3.0103, le=60)]] | None = None
    """G0 of a pattern G0 cos^q, zero behind, with G0 = 2 (q + 1)."""
    pattern_file: Sourced[str] | None = None
    """File of a measured or computed pattern, see `twin.radar.device.antenna_pattern_file`."""
    pattern_axis: Sourced[Literal["x", "z"]] | None = None
    """Which axis of the file looks ahead: `x` (default; theta from above, phi from ahead to the
    left) or `z` (theta from ahead, phi from the left upwards). Planet files always look along x.
    """

    @model_validator(mode="after")
    def _is_one_or_the_other(self) -> "Antenna":
        if (self.gain_dbi is None) == (self.pattern_file is None):
            raise InputError("needs either gain_dbi or pattern_file")
        if self.pattern_axis is not None and self.pattern_file is None:
            raise InputError("pattern_axis needs pattern_file")
        if self.pattern_file is not None:
            _ = self.pattern  # its faults are named now
        return self

    @property
    def pattern(self) -> Pattern | None:
        """Content of the file, if there is one."""
        return None if self.pattern_file is None else read_pattern(Path(self.pattern_file.value))

    def gain(self, direction: Array) -> Array:
        """Power gain towards unit vectors (..., 3): x ahead, y left, z up."""
        x, y, z = np.moveaxis(np.asarray(direction, dtype=np.float64), -1, 0)
        pattern = self.pattern
        if pattern is None:
            assert self.gain_dbi is not None
            peak = 10 ** (self.gain_dbi.value / 10)
            return np.asarray(peak * np.maximum(x, 0.0) ** (peak / 2 - 1), dtype=np.float64)
        if self.pattern_axis is not None and self.pattern_axis.value == "z":
            x, y, z = y, z, x
        theta = np.degrees(np.arccos(np.clip(z, -1, 1)))
        return pattern.at(theta, np.degrees(np.arctan2(y, x)))

    @property
    def ahead_dbi(self) -> float:
        """Gain along x."""
        if self.gain_dbi is not None:
            return self.gain_dbi.value
        ahead = float(self.gain(np.array([1.0, 0.0, 0.0])))
        return float(10 * np.log10(ahead)) if ahead > 0 else -np.inf

    def describe(self) -> str:
        """How the gain is had, in words."""
        pattern = self.pattern
        if pattern is None or self.pattern_file is None:
            return "gain G0 cos^q"
        return (
            f"gain from {Path(self.pattern_file.value).name}, which radiates "
            f"{100 * pattern.efficiency:.1f} % of what it is fed"
        )


class Elements(Strict):
    """Phase centres of the antennas: x ahead, y left, z up; transmitters take turns by slot."""

    transmitters_m: Sourced[Places]
    """Phase centres x, y, z of the transmitters, which take turns by slot."""
    receivers_m: Sourced[Places]
    """Phase centres x, y, z of the receivers."""

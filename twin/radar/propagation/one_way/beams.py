"""The antenna's gain on the device: in a direction, and the most within a cone of directions."""

from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from twin.radar.device.antenna import Antenna
from twin.radar.propagation.scene.culling import beam_of
from twin.transfer import aligned

Array = NDArray[np.float64]

_OFF, _AROUND = 721, 361  # samples of a pattern, off its axis and around it
_LEAST = 1e-9  # gain in amplitude that counts as none


@dataclass(frozen=True, eq=False)
class AntennaGain:
    """Gains in amplitude towards unit vectors of the world.

    ``axes``: ahead, left, up. ``exponent`` and ``ahead`` of the closed form; without it a
    ``table`` over angles off the axis and around it. ``bound``: the most at an angle and beyond.
    """

    mi: Any
    axes: tuple[Any, Any, Any]
    exponent: Any | None
    ahead: Any
    table: Any
    bound: Any
    n_bounds: int

    def log(self, direction: Any) -> Any:
        """Natural logarithm of the gain, at least that of what counts as none."""
        x = dr.dot(direction, self.axes[0])
        if self.exponent is not None:
            least = dr.log(_LEAST / self.ahead) / self.exponent
            return dr.log(self.ahead) + self.exponent * dr.log(dr.maximum(x, dr.exp(least)))
        y, z = dr.dot(direction, self.axes[1]), dr.dot(direction, self.axes[2])
        off = dr.safe_acos(x) * ((_OFF - 1) / dr.pi)
        turn = dr.atan2(z, y)
        around = dr.select(turn < 0, turn + 2 * dr.pi, turn) * ((_AROUND - 1) / (2 * dr.pi))
        row, share = _below(self.mi, off, _OFF)
        column, beside = _below(self.mi, around, _AROUND)
        at = [
            dr.gather(self.mi.Float64, self.table, (row + i) * _AROUND + column + j)
            for i in (0, 1)
            for j in (0, 1)
        ]
        near = at[0] + beside * (at[1] - at[0])
        far = at[2] + beside * (at[3] - at[2])
        return dr.log(dr.maximum(near + share * (far - near), _LEAST))

    def most(self, direction: Any, half_width_rad: Any) -> Any:
        """Bound of the gain within a cone about a direction."""
        off = dr.safe_acos(dr.dot(direction, self.axes[0])) - half_width_rad
        step = dr.maximum(off, 0) * ((self.n_bounds - 1) / dr.pi)
        return dr.gather(self.mi.Float64, self.bound, self.mi.UInt32(step))


def antenna_gain(mi: Any, antenna: Antenna, axes: Array) -> AntennaGain:
    """By an antenna whose ``axes`` (3, 3) are rows of the world's coordinates."""
    bound = np.sqrt(beam_of(antenna).gain)
    peak = None if antenna.gain_dbi is None else 10 ** (antenna.gain_dbi.value / 10)
    table = np.zeros(1)
    if peak is None:
        off = np.linspace(0, np.pi, _OFF)[:, None]
        around = np.linspace(0, 2 * np.pi, _AROUND)
        parts = [
            np.cos(off) + 0 * around,
            np.sin(off) * np.cos(around),
            np.sin(off) * np.sin(around),
        ]
        table = np.sqrt(antenna.gain(np.stack(parts, axis=-1)))
    return AntennaGain(
        mi=mi,
        axes=tuple(mi.Vector3d(*(dr.opaque(mi.Float64, float(v)) for v in row)) for row in axes),
        exponent=None if peak is None else dr.opaque(mi.Float64, (peak / 2 - 1) / 2),
        ahead=dr.opaque(mi.Float64, np.sqrt(peak or 1.0)),
        table=mi.Float64(aligned(table)),
        bound=mi.Float64(aligned(bound)),
        n_bounds=len(bound),
    )


def _below(mi: Any, at: Any, count: int) -> tuple[Any, Any]:
    """Row of a table below, and the share of the way to the next one."""
    row = dr.minimum(mi.UInt32(dr.maximum(at, 0)), count - 2)
    return row, dr.clip(at - mi.Float64(row), 0, 1)

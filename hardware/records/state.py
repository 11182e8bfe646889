"""State of a device, as records, drivers and log hold it: pose, shutters, the radar's front end.

Each has one definition, with one order of its numbers; in files they stand as plain arrays.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hardware.errors import InputError, check_between, check_finite

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]

#: Of places: beyond, float64 tells less than 0.1 um.
_FARTHEST_M = 1e9
_LARGEST_QUATERNION = 1e100


class QuaternionPose(NamedTuple):
    """Place and orientation of a rig or an antenna in the world (REP 103: x forward, y left, z up).

    Metres, and the unit quaternion with its real part first: the order of every file and setting.
    The default stands in the origin and looks along x.
    """

    x_m: float = 0.0
    y_m: float = 0.0
    z_m: float = 0.0
    qw: float = 1.0
    qx: float = 0.0
    qy: float = 0.0
    qz: float = 0.0

    @classmethod
    def of(cls, position_m: ArrayLike, rotation: "Rotation") -> "QuaternionPose":
        """A place (3,) and a rotation from the posed frame to the world."""
        x, y, z = np.asarray(position_m, np.float64).tolist()
        qx, qy, qz, qw = rotation.as_quat().tolist()
        return cls(x, y, z, qw, qx, qy, qz)

    @classmethod
    def from_numbers(cls, values: Iterable[float]) -> "QuaternionPose":
        """From x, y, z, qw, qx, qy, qz. Raises InputError unless these are 7 finite numbers, of
        which the place is within 1e9 m of the origin and the quaternion is not 0.
        """
        numbers = tuple(float(value) for value in values)
        if len(numbers) != 7 or not all(map(math.isfinite, numbers)) or not any(numbers[3:]):
            raise InputError(f"{numbers}, expected x y z, quaternion w x y z that is not 0")
        if max(map(abs, numbers[:3])) > _FARTHEST_M:
            raise InputError(f"{numbers}, expected x y z of at most {_FARTHEST_M:g} m")
        # Its squares are summed up to make it of length 1.
        if not 1 / _LARGEST_QUATERNION < math.hypot(*numbers[3:]) < _LARGEST_QUATERNION:
            raise InputError(f"{numbers}, expected a quaternion w x y z of about length 1")
        return cls(*numbers)

    @property
    def position_m(self) -> Array:
        """Place, (3,)."""
        return np.array(self[:3])

    @property
    def rotation(self) -> "Rotation":
        """From the posed frame to the world."""
        return rotations([self])[0]


#: In the world's origin, looking along x.
AT_ORIGIN = QuaternionPose()


def positions(poses: Sequence[QuaternionPose]) -> Array:
    """Places, (n, 3), in metres."""
    return np.array(poses, np.float64).reshape(-1, 7)[:, :3]


def rotations(poses: Sequence[QuaternionPose]) -> "Rotation":
    """Rotations from the posed frames to the world, n of them."""
    from scipy.spatial.transform import Rotation  # takes 0.1 s to import

    return Rotation.from_quat(np.array(poses, np.float64).reshape(-1, 7)[:, [4, 5, 6, 3]])


class Shutter(NamedTuple):
    """When the detector is open during an exposure of a time-of-flight measurement.

    Modulation frequency (Hz) and phase (rad) of a lock-in measurement, or delay after the beginning
    of the light's pulse and width (s) of a gate. The default is always open.
    """

    modulation_hz: float = 0.0
    phase_rad: float = 0.0
    gate_delay_s: float = 0.0
    gate_width_s: float = 0.0

    @classmethod
    def from_numbers(cls, values: Iterable[float]) -> "Shutter":
        """From the four numbers. Raises InputError unless all are finite, none is negative, and
        they are those of a phase or of a gate, not of both.
        """
        numbers = tuple(float(value) for value in values)
        if len(numbers) != 4 or not all(0 <= value < math.inf for value in numbers):
            raise InputError(f"{numbers}, expected four finite numbers, none of them negative")
        if any(numbers[:2]) and any(numbers[2:]):
            raise InputError(
                f"{numbers}, expected modulation and phase, or delay and width of a gate: one "
                "shutter is not both"
            )
        return cls(*numbers)

    @property
    def modulated(self) -> bool:
        """Whether it belongs to a lock-in measurement."""
        return self.modulation_hz > 0

    @property
    def gated(self) -> bool:
        """Whether it is a gate."""
        return self.gate_width_s > 0


#: No time of flight.
ALWAYS_OPEN = Shutter()


def _origin() -> Array:
    return np.zeros((1, 3))


#: Calibration beyond which a number is none.
_LARGEST = {"antenna_gain_dbi": 1000.0, "losses_db": 1000.0, "leakage_delay_s": 1.0}


#: Beyond these a radar's power is none, and single precision does not hold its square.
_POWERS = {"root_watt_per_count": (1e-15, 1e3), "transmit_power_w": (1e-15, 1e12)}


@dataclass(frozen=True, eq=False)
class RadarFrontEnd:
    """A radar between its antennas and its counts, as calibration and mounting tell it.

    Parameters
    ----------
    root_watt_per_count
        One count is this wave amplitude at the antenna's port.
    transmit_power_w
        At the antenna's port.
    antenna_gain_dbi
        Of one transmitter or receiver, along x; NaN when nobody measured it.
    losses_db
        From the antennas' ports on and back, all told (radome, feeds); NaN when unknown.
    leakage_delay_s
        Of the direct way from transmitter to receiver, by calibration; NaN when unknown.
    transmitters_m, receivers_m : (n_transmitters, 3), (n_receivers, 3) float64
        Phase centres in the antenna's frame: x ahead, y left, z up. Ranges are measured from the
        middle of them, see `Detection`.
    """

    root_watt_per_count: float
    transmit_power_w: float
    antenna_gain_dbi: float = math.nan
    losses_db: float = math.nan
    leakage_delay_s: float = math.nan
    transmitters_m: Array = field(default_factory=_origin)
    receivers_m: Array = field(default_factory=_origin)

    def __post_init__(self) -> None:
        for name in ("transmitters_m", "receivers_m"):
            places = getattr(self, name)
            if not isinstance(places, np.ndarray) or places.ndim != 2 or places.shape[1] != 3:
                raise InputError(f"{name}: {places!r:.60}, expected an array (n, 3)")
            if not np.isfinite(places).all():
                raise InputError(f"{name}: a value is no number")
        for name in ("antenna_gain_dbi", "losses_db", "leakage_delay_s"):
            value = getattr(self, name)
            # A pattern may have a null ahead.
            is_null = name == "antenna_gain_dbi" and isinstance(value, float) and value == -math.inf
            is_unknown = isinstance(value, float) and math.isnan(value)
            if not is_null and not is_unknown:
                check_finite(name, value, _LARGEST[name])
        for name, (least, most) in _POWERS.items():
            check_between(name, getattr(self, name), least, most)

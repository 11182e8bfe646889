"""Where the sun stands, how bright it is, and how both change through the day."""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from hardware.formatting import number, quantity_text
from twin.errors import InputError
from twin.scene.clear_sky import clear_sun, spectrum_lx
from twin.scene.limits import BRIGHTEST_LX, LATEST_S, check

Array = NDArray[np.float64]

#: What the sun turns about the pole of the sky in a mean solar day.
TURN_DEG_PER_S = 360.0 / 86400.0
#: Of an illuminance, what it may be off from that of its share.
_ROUNDING = 1e-9


@dataclass(frozen=True)
class Sun:
    """Direction to the sun in world axes, and illuminance on a plane normal to it.

    With a latitude, and the azimuth of true north in the scene, the sun moves: it turns about the
    pole of the sky by 15 degrees in an hour, and shines as in a clear sky, times a share that does
    not change, by default what its illuminance now makes it; below the horizon it is dark. Of the
    course of the year there is nothing: after an hour the direction is off by up to 0.02 degrees,
    after six by 0.11.

    Raises InputError for a value out of its range, one of latitude and north alone, a sun that
    moves and has not risen, one that is beyond all limits in the zenith, and a share that
    contradicts the illuminance.
    """

    azimuth_deg: float
    elevation_deg: float
    illuminance_lx: float
    latitude_deg: float | None = None
    north_azimuth_deg: float | None = None
    clear_sky_share: float | None = None

    def __post_init__(self) -> None:
        check("sun.azimuth_deg", self.azimuth_deg)
        check("sun.elevation_deg", self.elevation_deg, -90.0, 90.0)
        check("sun.illuminance_lx", self.illuminance_lx, 0.0, BRIGHTEST_LX)
        if (self.latitude_deg is None) != (self.north_azimuth_deg is None):
            raise InputError(
                "scene.sun: a sun that moves needs both `latitude_deg` and `north_azimuth_deg`"
            )
        if self.latitude_deg is None:
            if self.clear_sky_share is not None:
                raise InputError("scene.sun.clear_sky_share: belongs to a sun that moves")
            return
        check("sun.latitude_deg", self.latitude_deg, -90.0, 90.0)
        check("sun.north_azimuth_deg", self.north_azimuth_deg)
        if self.clear_sky_share is None:
            self._check_risen()
        self._check_share()

    def _check_risen(self) -> None:
        if self.elevation_deg <= 0:
            raise InputError(
                f"scene.sun.elevation_deg = {self.elevation_deg:g}: expected a number above 0 for "
                "a sun that moves: it says how clear the sky is"
            )

    def _check_share(self) -> None:
        check("sun.clear_sky_share", self.share, 0.0)
        expected_lx = self.share * _clear_lx(self.elevation_deg)
        if abs(self.illuminance_lx - expected_lx) > _ROUNDING * expected_lx:
            raise InputError(
                f"scene.sun.illuminance_lx = {self.illuminance_lx:g}: clear_sky_share = "
                f"{self.share:g} makes it {expected_lx:g}"
            )
        zenith_lx = self.share * _clear_lx(90.0)
        if zenith_lx > BRIGHTEST_LX:
            raise InputError(
                f"scene.sun.illuminance_lx = {self.illuminance_lx:g} at elevation_deg = "
                f"{self.elevation_deg:g}: would be {zenith_lx:.2g} lx in the zenith, expected at "
                f"most {BRIGHTEST_LX:g} of a sun that moves"
            )

    def __str__(self) -> str:
        turn = f"azimuth {number(self.azimuth_deg)} deg, elevation {number(self.elevation_deg)} deg"
        told = f"{turn}, {quantity_text(self.illuminance_lx, 'lx')}"
        if self.latitude_deg is None or self.north_azimuth_deg is None:
            return told
        north = f"north at azimuth {number(self.north_azimuth_deg)} deg"
        return f"{told}; moves as at latitude {number(self.latitude_deg)} deg, {north}"

    @property
    def direction(self) -> Array:
        """Unit vector towards the sun."""
        return _towards(self.azimuth_deg, self.elevation_deg)

    @property
    def declination_deg(self) -> float | None:
        """Elevation above the equator of the sky, of a sun that moves; through the year between
        -23.44 and 23.44.
        """
        if self.latitude_deg is None or self.north_azimuth_deg is None:
            return None
        pole = _towards(self.north_azimuth_deg, self.latitude_deg)
        return math.degrees(math.asin(float(np.clip(self.direction @ pole, -1, 1))))

    @property
    def moves(self) -> bool:
        """Whether it ever does."""
        return self.latitude_deg is not None

    @property
    def has_set(self) -> bool:
        """Whether it moves, and is below the horizon."""
        return self.moves and self.elevation_deg <= 0

    @property
    def share(self) -> float:
        """Illuminance over that of a clear sky; of a sun that moves the same at all times."""
        if self.clear_sky_share is not None:
            return self.clear_sky_share
        return self.illuminance_lx / _clear_lx(self.elevation_deg)

    def after(self, seconds: float) -> "Sun":
        """The sun later, or earlier; the same one where it does not move.

        Raises InputError for what is no time.
        """
        check("sun.after", seconds, -LATEST_S, LATEST_S)
        if self.latitude_deg is None or self.north_azimuth_deg is None or seconds == 0:
            return self
        pole = _towards(self.north_azimuth_deg, self.latitude_deg)
        turn = Rotation.from_rotvec(-math.radians(TURN_DEG_PER_S * seconds) * pole)
        x, y, z = turn.apply(self.direction)
        elevation_deg = math.degrees(math.atan2(z, math.hypot(x, y)))
        return replace(
            self,
            azimuth_deg=math.degrees(math.atan2(y, x)) % 360,
            elevation_deg=elevation_deg,
            illuminance_lx=self.share * _clear_lx(elevation_deg),
            clear_sky_share=self.share,
        )


def _towards(azimuth_deg: float, elevation_deg: float) -> Array:
    azimuth, elevation = math.radians(azimuth_deg), math.radians(elevation_deg)
    flat = math.cos(elevation)
    return np.array([flat * math.cos(azimuth), flat * math.sin(azimuth), math.sin(elevation)])


def _clear_lx(elevation_deg: float) -> float:
    return spectrum_lx(clear_sun(elevation_deg)[1])

"""By which of its measured errors a level of each model is judged, and up to which limit."""

from collections.abc import Callable
from dataclasses import dataclass

from twin.errors import InputError
from twin.fidelity import Tolerance
from twin.trade.measurement import LevelMeasurement, Model


@dataclass(frozen=True)
class Criterion:
    """An error that is measured of a level, and its limit, both in ``unit``.

    ``error``: of a level, NaN where it was not measured.
    """

    limit: float
    unit: str
    error: Callable[[LevelMeasurement], float]

    @property
    def is_over_noise(self) -> bool:
        """Whether it is over the sensor's noise."""
        return self.error is _over_noise


def _over_noise(measurement: LevelMeasurement) -> float:
    return measurement.over_noise


def _over_cells(measurement: LevelMeasurement) -> float:
    return measurement.over_cells


def _over_bodies(measurement: LevelMeasurement) -> float:
    return measurement.over_bodies


def of_noise(share: float) -> Criterion:
    """The error over the sensor's noise."""
    return Criterion(share, "of the sensor's noise", _over_noise)


def criteria_of(
    tolerance: Tolerance | float, bandwidth_hz: float | None = None
) -> dict[Model, Criterion]:
    """The criterion of each model: a share of the sensor's noise, or what the tolerance names in
    place of it. Of light the error of the cells' light, of the radar the largest error of a body's
    echo: a level, or a distance by the radar's bandwidth, bounds that as `Tolerance.knobs` says.

    Raises InputError for scores of an image, and as `Tolerance.knobs` does.

    >>> round(criteria_of(Tolerance(echo_db=0.5))["radar"].limit, 4)
    0.0559
    >>> criteria_of(0.1)["light"].limit
    0.1
    """
    if not isinstance(tolerance, Tolerance):
        return dict.fromkeys(("light", "noise", "radar"), of_noise(tolerance))
    if tolerance.of_scores:
        raise InputError(
            f"tolerance: {tolerance}: of levels no scores of images are measured; `twin run "
            "--tolerance` finds what a score takes"
        )
    light = noise = radar = of_noise(tolerance.noise_share)
    if tolerance.cell_share is not None:
        light = Criterion(tolerance.cell_share, "of a cell's light", _over_cells)
    if tolerance.echo_db is not None or tolerance.distance_m is not None:
        permitted = tolerance.knobs(bandwidth_hz).radar_tolerance
        radar = Criterion(permitted, "of every body's echo", _over_bodies)
    return {"light": light, "noise": noise, "radar": radar}

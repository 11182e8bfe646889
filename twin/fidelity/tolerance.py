"""The error that the model may add, from which the knobs follow; and what is the default."""

import math
import sys
from dataclasses import dataclass
from decimal import ROUND_CEILING, Context, Decimal
from typing import Any

from hardware.errors import check_positive
from hardware.units import quantity
from twin.errors import InputError
from twin.fidelity.knobs import is_number
from twin.fidelity.presets import PRESETS, Fidelity

#: Of the sensor's own noise: an error of a fifth adds 4 % to its power, 0.17 dB.
DEFAULT_SHARE = 0.2
#: Of an echo, relative to itself.
_RADAR = (1e-3, 1.0)
_LIMITS = {
    "noise_share": (1e-4, 10.0),
    "cell_share": (1e-5, 1.0),
    "echo_db": (0.0087, 20.0),  # 0.001 of the echo, rounded up
    "distance_m": (math.ulp(0.0), sys.float_info.max),  # whatever is above 0
    "psnr_db": (1e-3, 20.0),
    "ssim": (1e-4, 1.0),
}
#: What each is called where it is asked for, and how an amount of it is told.
_WORDS = {
    "noise_share": ("a share of the noise", "{} of the noise"),
    "cell_share": ("a share of a cell's light", "{} % of a cell's light"),
    "echo_db": ("a level of an echo", "{} dB of an echo"),
    "distance_m": ("a distance", "{} m of a distance"),
    "psnr_db": ("PSNR", "PSNR {} dB"),
    "ssim": ("SSIM", "SSIM {}"),
}
_SCORES = {"psnr": "psnr_db", "ssim": "ssim"}
_EXPECTED = (
    'expected a share of the noise (0.2), "1 %" of a cell, "0.5 dB" of an echo, "2 mm", '
    '"PSNR 0.1 dB" or "SSIM 0.01"'
)
_SPEED_OF_LIGHT = 299_792_458.0


@dataclass(frozen=True)
class Tolerance:
    """Error that the model may add to what the sensors measure.

    Parameters
    ----------
    noise_share
        As a share of the sensors' own noise, 0.0001 to 10. Light: root mean square over the image,
        of each pixel's noise; and half of it of each exposure's noise between the instants at
        which light is rendered where things move during a frame. Radar: half of it is the error of
        the echo of each body relative to the echo itself, since echoes may stand far above the
        noise, and a model as exact as that would take hours; 1 at most. Less than 0.001, half
        of a share below 0.002, is refused unless `echo_db` or `distance_m` takes its place.
        Reflections are followed as far as bounds of what further ones add ask for, and edges
        diffract where a bound says that they count.
    echo_db
        Of the level of a body's echo, up and down, in place of its share; 0.0087 to 20 dB. It is
        the error that makes an echo weaker by as much; one of equal size in phase with the echo
        makes it stronger by less.
    cell_share
        Of the light of each cell, or of the cells' mean where that is more, in place of a share of
        the noise; 1e-5 to 1.
    distance_m
        Of the distance of a body by its radar echo, in place of its share. An error of the echo
        that grows linearly over the band moves it the most: relative to the echo e rms over a
        bandwidth B, by c e sqrt(12) / (4 pi B). It needs the bandwidth of a radar; where e would
        have to be below 0.001, it is refused.
    psnr_db, ssim
        Of the image's scores, in place of a share of the noise, 0.001 to 20 dB and 0.0001 to 1:
        half the width of their intervals, as far as these are the model's. What light that takes
        depends on scene and system, and is found by `twin.fidelity_for_scores`.

    >>> Tolerance(0.4).knobs().light_tolerance
    0.4
    >>> str(Tolerance.of("0.1, 0.5 dB"))
    '0.1, 0.5 dB'
    """

    noise_share: float = DEFAULT_SHARE
    cell_share: float | None = None
    echo_db: float | None = None
    distance_m: float | None = None
    psnr_db: float | None = None
    ssim: float | None = None

    def __post_init__(self) -> None:
        for name, (low, high) in _LIMITS.items():
            value = getattr(self, name)
            if value is None and name != "noise_share":
                continue
            if not is_number(value) or not low <= value <= high:
                low, high = (_in_its_unit(name, limit) for limit in (low, high))
                within = "above 0, finite" if name == "distance_m" else f"{low:g} to {high:g}"
                raise InputError(f"tolerance: {_told(name, value)}: expected {within}")
            object.__setattr__(self, name, float(value))
        if self.of_scores and self.cell_share is not None:
            raise InputError(f"tolerance: {self}: expected cells or a score, not both")

    @classmethod
    def of(cls, text: str) -> "Tolerance":
        """From text: a number is a share of the noise, one in per cent of a cell's light, one in
        dB of an echo, one in metres of a distance, one after PSNR or SSIM of that score; more than
        one with commas in between.

        Raises InputError.

        >>> Tolerance.of("2 mm").distance_m
        0.002
        >>> Tolerance.of("PSNR 0.1 dB").psnr_db
        0.1
        """
        if not isinstance(text, str):
            raise InputError(f"tolerance: {text!r:.60} is no text; {_EXPECTED}")
        given: dict[str, float] = {}
        for item in text.split(","):
            name, unit = _meant(item.strip())
            try:
                value = quantity(item.strip()[_start(item.strip()) :], unit, bare=unit is None)
            except InputError:
                raise InputError(f"tolerance: {text!r:.60}: {_EXPECTED}") from None
            if name in given:
                raise InputError(f"tolerance: {text!r:.60}: {_WORDS[name][0]} twice; {_EXPECTED}")
            given[name] = value
        return cls(**given)

    def __str__(self) -> str:
        """As `of` reads it.

        >>> str(Tolerance(0.1, echo_db=0.5))
        '0.1, 0.5 dB'
        """
        others = ((self.echo_db, "dB"), (self.distance_m, "m"))
        told = [f"{value!r} {unit}" for value, unit in others if value is not None]
        if self.cell_share is not None:
            told.insert(0, f"{_per_cent(self.cell_share)} %")
        if self.psnr_db is not None:
            told.append(f"PSNR {self.psnr_db!r} dB")
        if self.ssim is not None:
            told.append(f"SSIM {self.ssim!r}")
        return ", ".join([repr(self.noise_share), *told])

    @property
    def of_scores(self) -> bool:
        """Whether a score of the image is to be as exact as asked."""
        return self.psnr_db is not None or self.ssim is not None

    def check_sensors(self, *, camera: bool, radar: bool) -> None:
        """Raise InputError for an error of what a sensor measures that there is not.

        >>> Tolerance.of("0.5 dB").check_sensors(camera=True, radar=False)
        Traceback (most recent call last):
        hardware.errors.InputError: tolerance: 0.5 dB of an echo, without a radar
        """
        if self.echo_db is not None and not radar:
            raise InputError(f"tolerance: {self.echo_db:g} dB of an echo, without a radar")
        if self.distance_m is not None and not radar:
            text = f"{self.distance_m:g} m of a radar's distances, without a radar"
            if camera:
                text += "; a camera's follow from its light: expected a share of its noise (0.05)"
            raise InputError(f"tolerance: {text}")
        if self.of_scores and not camera:
            raise InputError(f"tolerance: {self}: a score of an image, without a camera")
        if self.cell_share is not None and not camera:
            share = 100 * self.cell_share
            raise InputError(f"tolerance: {share:g} % of a cell's light, without a camera")

    def knobs(self, bandwidth_hz: float | None = None) -> Fidelity:
        """The knobs that keep the error within it; ``bandwidth_hz`` is the radar's, None where
        there is none. Raises InputError for what no knob promises of a radar, and for a bandwidth
        that is no number above 0.

        >>> knobs = Tolerance(0.2).knobs()
        >>> knobs.light_tolerance, knobs.radar_tolerance
        (0.2, 0.1)
        >>> round(Tolerance(echo_db=0.5).knobs().radar_tolerance, 4)
        0.0559
        """
        if bandwidth_hz is not None:
            check_positive("bandwidth_hz", bandwidth_hz)
        if self.of_scores:
            raise InputError(
                f"tolerance: {self}: what a score takes depends on the scene: expected one that "
                "twin.fidelity_for_scores, or the command line, has looked at"
            )
        return Fidelity(
            light_tolerance=self.noise_share if self.cell_share is None else None,
            light_tolerance_relative=self.cell_share,
            motion_tolerance=self.noise_share / 2 if self.noise_share > 2e-4 else 1e-4,
            radar="auto",
            radar_tolerance=self._of_echoes(bandwidth_hz),
            radar_bounces=None,
            radar_images=None,
            radar_edges=None,
            radar_shadowed=None,
        )

    def _of_echoes(self, bandwidth_hz: float | None) -> float:
        """Error of a body's echo, relative to itself: the strictest that was asked for."""
        low, high = _RADAR
        errors, least = dict[str, float](), {"noise_share": 2 * low}
        if self.echo_db is not None:
            errors["echo_db"] = 1 - 10 ** (-self.echo_db / 20)
        if self.distance_m is not None and bandwidth_hz is not None:
            steepest = 4 * math.pi * bandwidth_hz / (_SPEED_OF_LIGHT * math.sqrt(12))
            errors["distance_m"] = self.distance_m * steepest
            metres = _SPEED_OF_LIGHT * math.sqrt(12) / (4 * math.pi) / bandwidth_hz
            least["distance_m"] = low * metres
        if not errors:
            errors["noise_share"] = self.noise_share / 2
        asked = min(errors, key=errors.__getitem__)
        if bandwidth_hz is not None and errors[asked] < low:
            raise InputError(
                f"tolerance: {_told(asked, getattr(self, asked))} asks for echoes to less than "
                f"{low:g} of themselves, which cannot be promised: expected "
                f"{_told(asked, _rounded_up(least[asked]))} or more"
            )
        return min(max(errors[asked], low), high)


def _in_its_unit(name: str, value: float) -> float:
    """As it is asked for: of a cell's light in per cent."""
    return 100 * value if name == "cell_share" else value


def _told(name: str, value: Any) -> str:
    """An amount in the words in which it is asked for."""
    amount = _in_its_unit(name, value) if is_number(value) else value
    text = f"{amount:.12g}" if isinstance(amount, float) else f"{amount!r:.60}"
    return _WORDS[name][1].format(text)


def _per_cent(share: float) -> str:
    """A share in per cent with the same digits, of which 100 times the double may have others."""
    digits = f"{Decimal(repr(share)).scaleb(2):f}"
    return digits if "." in digits else f"{digits}.0"


def _rounded_up(value: float) -> float:
    """To three digits."""
    return float(Context(prec=3, rounding=ROUND_CEILING).create_decimal(repr(value)))


def _start(item: str) -> int:
    """Where the amount starts, after the name of a score."""
    return next((len(name) for name in _SCORES if item.lower().startswith(name)), 0)


def _meant(item: str) -> tuple[str, str | None]:
    """The field that an amount is of, and its unit."""
    if start := _start(item):
        name = _SCORES[item[:start].lower()]
        return name, "dB" if name == "psnr_db" else None
    if item.endswith("%"):
        return "cell_share", None
    if item.endswith("dB"):
        return "echo_db", "dB"
    if item[-1:].isalpha():
        return "distance_m", "m"
    return "noise_share", None


#: Of what is computed without being told.
DEFAULT = Tolerance().knobs()

#: What results may be off by: knobs, a preset's name, a tolerance, or a share of the noise.
Accuracy = Fidelity | Tolerance | str | float


def knobs_of(accuracy: Accuracy | None, bandwidth_hz: float | None = None) -> Fidelity:
    """Knobs: those given, those of a preset by name, those that a tolerance asks for, a number
    being a share of the sensors' noise; or `DEFAULT`. What a tolerance says of another sensor is
    left aside, so that `twin.capture` and `twin.radar_capture` can take the same one.

    Raises InputError for a name that is none, and as `Tolerance.knobs` does.
    """
    if isinstance(accuracy, Fidelity):
        return accuracy
    if isinstance(accuracy, str):
        if accuracy not in PRESETS:
            raise InputError(f"fidelity: {accuracy!r} is none of {', '.join(PRESETS)}")
        return PRESETS[accuracy]
    if accuracy is None:
        return DEFAULT
    asked = accuracy if isinstance(accuracy, Tolerance) else Tolerance(accuracy)
    return asked.knobs(bandwidth_hz)


def knobs_of_sensors(
    accuracy: Accuracy | None, *, camera: bool, bandwidth_hz: float | None
) -> Fidelity:
    """Knobs of all sensors that there are, as `knobs_of`; ``bandwidth_hz`` is the radar's, None
    without one.

    Raises InputError as `knobs_of` and `Tolerance.check_sensors` do.

    >>> knobs_of_sensors(Tolerance.of("0.5 dB"), camera=True, bandwidth_hz=None)
    Traceback (most recent call last):
    hardware.errors.InputError: tolerance: 0.5 dB of an echo, without a radar
    """
    if isinstance(accuracy, Tolerance):
        accuracy.check_sensors(camera=camera, radar=bandwidth_hz is not None)
    return knobs_of(accuracy, bandwidth_hz)

"""Protocol of a detector with its electronics, for the bundled photodiode and a user's own.

class Spad:  # and whatever else counts photons
electrons_per_watt, dark_e, electrons_per_count, offset_counts, adc_bits = ...
def expose(self, power_w, *, rng, noise="full"): ...
def mean_e(self, power_w): ...
def noise_budget(self, signal_w, background_w, emitter_noise=0.0): ...

twin.capture(scene, system, detector=Spad(...))
"""

from numbers import Integral, Real
from typing import Any, Literal, Protocol, TypeAlias, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from hardware.records import Flag
from twin.detector.noise import NoiseBudget
from twin.errors import InputError

Array = NDArray[np.float64]
_FLAGS = int(sum(Flag))
#: As `twin.Fidelity` has it.
Noise: TypeAlias = Literal["none", "gaussian", "full"]


@runtime_checkable
class Detector(Protocol):
    """A detector, its amplifier and its converter, over one integration time.

    ``electrons_per_watt`` and ``dark_e`` are the response to weak light. Each count above
    ``offset_counts`` is ``electrons_per_count`` electrons; the highest is 2^``adc_bits`` - 1.
    """

    @property
    def electrons_per_watt(self) -> float:
        """Electrons of one exposure over the power on the photosensitive area, e/W."""

    @property
    def dark_e(self) -> float:
        """Mean electrons of an exposure in the dark, e."""

    @property
    def electrons_per_count(self) -> float:
        """Electrons over one count, e."""

    @property
    def offset_counts(self) -> float:
        """Count without any electron."""

    @property
    def adc_bits(self) -> int:
        """Bits of a count."""

    def expose(
        self, power_w: Array, *, rng: np.random.Generator, noise: Noise = "full"
    ) -> tuple[NDArray[np.int32], NDArray[np.uint8]]:
        """Counts (n_exposures, n_detectors) and flags (n_exposures,), bits of `hardware.Flag`, of
        exposures to a constant power (n_exposures, n_detectors), W.
        """

    def mean_e(self, power_w: Array) -> Array:
        """Mean electrons, as read from the counts, at a power, W, with dark electrons: includes all
        nonlinearity, such as rails and dead time.
        """

    def noise_budget(
        self, signal_w: Array, background_w: float | Array, emitter_noise: float = 0.0
    ) -> NoiseBudget:
        """Budget at the mean of the exposures ``signal_w``, W, and of the background, W;
        ``emitter_noise``: relative fluctuation of the emitter.
        """


#: Kind, least and largest value of a detector's constants; counts are int32.
_CONSTANTS: dict[str, tuple[type, float, float]] = {
    "electrons_per_watt": (Real, 0.0, 1e300),
    "dark_e": (Real, 0.0, 1e300),
    "electrons_per_count": (Real, 1e-300, 1e300),
    "offset_counts": (Real, -1e300, 1e300),
    "adc_bits": (Integral, 1, 31),
}


def checked_exposure(
    detector: Detector, power_w: Array, rng: np.random.Generator, noise: Noise
) -> tuple[NDArray[np.int32], NDArray[np.uint8]]:
    """Counts and flags of a detector at a power. Raises InputError for invalid ones."""
    name, top = type(detector).__name__, 2**detector.adc_bits - 1
    with np.errstate():  # what a user's own may set ends with it, as of `OwnFunction`
        result = detector.expose(power_w, rng=rng, noise=noise)
    if not isinstance(result, tuple) or len(result) != 2:
        raise InputError(
            f"{name}.expose: returned a {type(result).__name__}, expected counts and flags"
        )
    if any(np.ma.is_masked(part) for part in result):
        raise InputError(f"{name}.expose: returned masked values; flags mark what is lost")
    counts, flags = map(np.asarray, result)
    if counts.shape != power_w.shape or counts.dtype.kind not in "iu":
        raise InputError(
            f"{name}.expose: counts {counts.dtype} of shape {counts.shape}, expected whole numbers "
            f"{power_w.shape}"
        )
    if flags.shape != power_w.shape[:1] or flags.dtype.kind not in "iu":
        raise InputError(
            f"{name}.expose: flags {flags.dtype} of shape {flags.shape}, expected whole numbers "
            f"{power_w.shape[:1]}"
        )
    if flags.size and not 0 <= flags.min() <= flags.max() <= _FLAGS:
        raise InputError(
            f"{name}.expose: flags {flags.min()} to {flags.max()}, expected bits of hardware.Flag, "
            f"up to {_FLAGS}"
        )
    if counts.size and not 0 <= counts.min() <= counts.max() <= top:
        raise InputError(
            f"{name}.expose: counts {counts.min()} to {counts.max()}, expected 0 to {top}"
        )
    return counts.astype(np.int32, copy=False), flags.astype(np.uint8, copy=False)


def check_detector(detector: object) -> Detector:
    """The detector. Raises InputError for an object that is none, with the missing attributes, and
    for constants that no detector has.
    """
    if isinstance(detector, Detector):
        for name, (kind, least, most) in _CONSTANTS.items():
            value: Any = getattr(detector, name)
            fits = isinstance(value, kind)
            if not fits or not least <= value <= most:
                raise InputError(
                    f"{type(detector).__name__}.{name} = {value!r:.60}: expected a "
                    f"{'whole number' if kind is Integral else 'number'} from {least:g} to "
                    f"{most:g}"
                )
        return detector
    names = (name for name in vars(Detector) if not name.startswith("_"))
    missing = [name for name in names if not hasattr(detector, name)]
    raise InputError(f"detector: {type(detector).__name__} has no {', '.join(missing)}")

"""Protocol of a detector with its electronics, for the bundled photodiode and a user's own.

class Spad:  # and whatever else counts photons
electrons_per_watt, dark_e, electrons_per_count, offset_counts, adc_bits = ...
def expose(self, power_w, *, rng, noise="full"): ...
def mean_e(self, power_w): ...
def noise_budget(self, signal_w, background_w, emitter_noise=0.0): ...

twin.capture(scene, system, detector=Spad(...))
"""

from typing import Literal, Protocol, TypeAlias, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from twin.detector.noise import NoiseBudget
from twin.errors import InputError

Array = NDArray[np.float64]
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


def checked_exposure(
    detector: Detector, power_w: Array, rng: np.random.Generator, noise: Noise
) -> tuple[NDArray[np.int32], NDArray[np.uint8]]:
    """Counts and flags of a detector at a power. Raises InputError for invalid ones."""
    counts, flags = (np.asarray(part) for part in detector.expose(power_w, rng=rng, noise=noise))
    name, top = type(detector).__name__, 2**detector.adc_bits - 1
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
    if counts.size and not 0 <= counts.min() <= counts.max() <= top:
        raise InputError(
            f"{name}.expose: counts {counts.min()} to {counts.max()}, expected 0 to {top}"
        )
    return counts.astype(np.int32, copy=False), flags.astype(np.uint8, copy=False)


def check_detector(detector: object) -> Detector:
    """The detector. Raises InputError, with the missing attributes, for an object that is none."""
    if isinstance(detector, Detector):
        return detector
    names = (name for name in vars(Detector) if not name.startswith("_"))
    missing = [name for name in names if not hasattr(detector, name)]
    raise InputError(f"detector: {type(detector).__name__} has no {', '.join(missing)}")

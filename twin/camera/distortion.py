"""Systematic distortion of an image: lag between exposures, and clipping."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.patterns import Patterns, RasterScan
from twin.camera.chain import Chain, Powers
from twin.camera.illumination import ideal_signal
from twin.detector.inverse import inverse_image

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Distortion:
    """Error of the mean image, in electrons of the cells.

    ``signal_factor`` (n_detectors,): least-squares factor between the image and the true one.
    ``error_e`` (n_detectors,): root mean square of the residual. ``contrast_e``: standard deviation
    of the true image of all detectors. ``cells_error_e`` (n_detectors, n_cells): of each cell,
    where an exposure's distortion is in its own cell alone, as that of a raster scan; else
    (n_detectors, 1) of all.
    """

    signal_factor: Array
    error_e: Array
    contrast_e: float
    cells_error_e: Array

    def hides(self, noise_e: Array) -> Bools:
        """Detectors whose image is lost: the error is at least the remaining contrast, and larger
        than the noise (n_detectors,).
        """
        contrast_e = np.maximum(self.signal_factor, 0) * self.contrast_e
        return np.asarray((self.error_e > noise_e) & (self.error_e >= contrast_e))

    def over(self, noise_e: Array) -> float:
        """Error over noise, both as root mean square over the detectors."""
        return float(np.sqrt(np.mean(self.error_e**2) / np.mean(noise_e**2)))


@dataclass(frozen=True, eq=False)
class Distortions:
    """Distortion by lag between exposures, by clipping at rails and full well, and by both."""

    lag: Distortion
    clipping: Distortion
    total: Distortion


def distortions(chain: Chain, power: Powers) -> Distortions:
    """Mean image of a camera compared with that of one that switches and settles at once and whose
    converter has no rails; images by inverse transform, of own patterns by least squares.
    """
    patterns, detector, n_shutters = chain.patterns, chain.front_end, len(chain.shutters)

    sun_w = power.sun_by_exposure(patterns)
    unlit_w = np.zeros((patterns.n_exposures, n_shutters, len(power.sun_w)))
    dark_w = chain.exposure_power(unlit_w, sun_w)

    def mean_e(exposed_w: Array) -> Array:
        with np.errstate():  # what a user's own may set ends with it, as of `OwnFunction`
            return detector.mean_e(exposed_w)

    def image(exposed_w: Array, *, cut: bool) -> Array:
        linear = exposed_w * detector.electrons_per_watt + detector.dark_e
        electrons = mean_e(exposed_w) if cut else linear
        if isinstance(patterns, RasterScan):  # the background is known from other gates
            unlit = dark_w * detector.electrons_per_watt + detector.dark_e
            electrons = electrons - (mean_e(dark_w) if cut else unlit)
        summed = electrons.reshape(-1, n_shutters, electrons.shape[-1]).sum(axis=1)
        return _image(summed, patterns)

    ideal_w = chain.exposure_power(ideal_signal(chain.system, power.cells_w), sun_w)
    slow_w = chain.amplifier_output(chain.mean_signal(power), sun_w, power.sun_w)
    true = image(ideal_w, cut=False)
    return Distortions(
        lag=_against(true, image(slow_w, cut=False), patterns),
        clipping=_against(true, image(ideal_w, cut=True), patterns),
        total=_against(true, image(slow_w, cut=True), patterns),
    )


def _image(electrons: Array, patterns: Patterns) -> Array:
    """Measured cells (n_cells, n_detectors) of exposures (n_exposures, n_detectors)."""
    image = inverse_image(electrons, patterns)
    return image if isinstance(patterns, RasterScan) else image[~patterns.unmeasured_cells]


def _against(true: Array, image: Array, patterns: Patterns) -> Distortion:
    power = np.sum(true**2, axis=0)
    kept = np.ones_like(power)
    np.divide(np.sum(true * image, axis=0), power, out=kept, where=power > 0)
    off = image - kept * true
    error = np.sqrt(np.mean(off**2, axis=0))
    own = np.abs(off.T) if isinstance(patterns, RasterScan) else error[:, None]
    return Distortion(kept, error, float(true.std()), own)

"""A reconstruction's method, asked again: of light a little other, and of another record."""

import numpy as np
from numpy.typing import NDArray

from hardware.reconstruction import METHODS, Reconstruction
from hardware.reconstruction.measurements import Measurements, measurements, with_level
from hardware.reconstruction.sensing import Sensing
from twin.camera.acquisition import Capture

Array = NDArray[np.float64]

#: Methods that invert a complete set of Hadamard patterns exactly.
_INVERSES = ("zero-fill", "least-squares")


class Follows:
    """How an image follows errors of its truth: bundled methods are asked, others are taken not to
    follow at all, which bounds what a method that smooths does.
    """

    def __init__(self, capture: Capture, image: Reconstruction) -> None:
        self._image, method = image.image, METHODS.get(image.method)
        self._of_other_paths = capture.model_error.of_exposures is not None
        self._method = None if method is None or method.slow else method
        if self._method is None:
            return
        received = with_level(capture.record.received)
        self._sensing, self._measured = Sensing(received.patterns), measurements(received)
        if self._measured.values.shape[1] != len(self._image):  # complementary
            self._method = None

    @property
    def is_known(self) -> bool:
        """Whether the method is asked."""
        return self._method is not None

    def rest(self, error_e: Array) -> Array:
        """What the image leaves of an error (rows, columns) of the cells, with its sign: what it
        follows less the error. It follows nothing where exposures have light of other paths.
        """
        if self._of_other_paths:
            return -error_e
        if self._method is None or not np.isfinite(error_e).all():
            return -error_e
        if self._is_inverse:
            return np.zeros_like(error_e)
        cells = np.stack(np.hsplit(error_e, len(self._image))).reshape(len(self._image), -1)
        values = self._measured.values + np.stack([self._sensing.forward(x) for x in cells], 1)
        followed = self._solved(values, self._measured.noise_variance) - np.hstack(
            list(self._image)
        )
        return np.asarray(followed - error_e)

    def picture(self, measured: Measurements) -> Array:
        """The image, detectors side by side, by the same method of another record alike, as
        `Reconstruction.picture` has it.
        """
        return self._solved(measured.values, measured.noise_variance)

    def _solved(self, values: Array, noise_variance: Array) -> Array:
        assert self._method is not None
        return np.hstack(
            [
                self._method(y, float(variance), self._sensing)[0].reshape(self._sensing.shape)
                for y, variance in zip(values.T, noise_variance, strict=True)
            ]
        )

    @property
    def _is_inverse(self) -> bool:
        complete = self._sensing.count == self._sensing.n_cells and not self._sensing.is_dense
        return complete and self._method is not None and self._method.name in _INVERSES

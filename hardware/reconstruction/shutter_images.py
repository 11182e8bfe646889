"""Images of all shutters of a record, and how their errors are tied to each other.

Smoothing takes the same detail of all shutters: it draws the distances of neighbours together, and
no shutter's error is independent of the others'. So shutters are first turned into components of
which no two have noise or detail in common (Karhunen-Loeve transform after the noise is made white:
Green, Berman, Switzer and Craig, IEEE Trans. Geosci. Remote Sens. 26, 1988). A linear method gives
the image of each with its error; images of shutters are sums of these, and so are their errors.
Most components hold noise alone, which is smoothed away.
"""

from dataclasses import dataclass

import numpy as np

from hardware.reconstruction.imaging import Reconstruction, reconstruct, solved_image
from hardware.reconstruction.measurements import Measurements, measurements, with_level
from hardware.reconstruction.registry import Array, Method
from hardware.reconstruction.sensing import Mixing, Sensing
from hardware.records import SpiRecord


@dataclass(frozen=True, eq=False)
class ShutterErrors:
    """Errors of the shutters' images: sums of components that are independent of each other.

    ``mix`` (n_detectors, n_shutters, n_components), and the standard error of each component,
    ``components`` (n_components, n_detectors, n_cells).
    """

    mix: Array
    components: Array

    @classmethod
    def independent(cls, errors: Array) -> "ShutterErrors":
        """Of standard errors (n_shutters, n_detectors, ...) that do not depend on each other."""
        each = errors.reshape(*errors.shape[:2], -1)
        return cls(np.broadcast_to(np.eye(len(each)), (each.shape[1], len(each), len(each))), each)

    @property
    def of_shutters(self) -> Array:
        """Standard errors ``(n_shutters, n_detectors * n_cells)``."""
        squares = np.einsum("dkc,cdp->kdp", self.mix**2, self.components**2)
        return np.sqrt(squares.reshape(len(squares), -1))

    def of_sum(self, weights: Array) -> Array:
        """Independent parts of the error of a sum of all shutters with weights (n_shutters,
        n_detectors * n_cells), ``(n_components, n_detectors * n_cells)``.
        """
        each = weights.reshape(len(weights), *self.components.shape[1:])
        parts = np.einsum("dkc,kdp->cdp", self.mix, each) * self.components
        return np.asarray(parts.reshape(len(parts), -1))


def shutter_images(
    record: SpiRecord, solve: Method, mixing: Mixing | None
) -> tuple[Array, ShutterErrors]:
    """Images ``(n_shutters, n_detectors, rows, columns)``, electrons, and their errors, both NaN in
    cells that the patterns do not measure: by components, of a method that is not linear each by
    itself, with errors that count as independent.
    """
    if not solve.linear:
        parts = [reconstruct(part, solve, mixing=mixing) for part in record.by_shutter]
        errors = np.stack([_error(one, record.patterns.count) for one in parts])
        return np.stack([one.image for one in parts]), ShutterErrors.independent(errors)
    received = with_level(record.received)
    sensing = Sensing(received.patterns, mixing)
    components, mix = _components([measurements(part) for part in received.by_shutter], sensing)
    cells, error = solved_image(solve, components, sensing)
    assert error is not None  # linear methods state it
    cells, error = (
        np.where(sensing.measured[:, None], part, np.nan).T.reshape(len(mix), -1, sensing.n_cells)
        for part in (cells, error)
    )
    images = np.einsum("dkc,dcp->kdp", mix, cells)
    tied = ShutterErrors(mix, np.ascontiguousarray(error.swapaxes(0, 1)))
    return images.reshape(*images.shape[:2], *sensing.shape), tied


def _components(shutters: list[Measurements], sensing: Sensing) -> tuple[Measurements, Array]:
    """Components of shutters, those of each detector side by side, and what each shutter has of
    them, ``(n_detectors, n_shutters, n_components)``.
    """
    values = np.stack([one.values for one in shutters])  # (n_shutters, count, n_detectors)
    noise = np.stack([one.noise_variance for one in shutters])
    told = np.all([one.noise_told for one in shutters], axis=0) & (noise > 0).all(axis=0)
    size = np.sqrt(np.where(told, noise, 1.0))
    size /= np.sqrt(np.mean(size**2, axis=0))
    white = values / size[:, None]
    flat = sensing.of_flat
    power = max(float(flat @ flat), np.finfo(float).tiny)
    level = np.tensordot(flat, white, (0, 1)) / power  # (n_shutters, n_detectors)
    detail = white - flat[:, None] * level[:, None]
    _, vectors = np.linalg.eigh(np.einsum("knd,lnd->dkl", detail, detail))
    share = vectors**2 / size.T[..., None] ** 2

    def of(variances: list[Array]) -> Array:
        return np.einsum("dkc,kd->dc", share, np.stack(variances)).ravel()

    every = np.stack([one.most_level for one in shutters])
    components = Measurements(
        values=np.einsum("knd,dkc->ndc", white, vectors).reshape(sensing.count, -1),
        noise_variance=of([one.noise_variance for one in shutters]),
        most_noise_variance=of([one.most_noise_variance for one in shutters]),
        noise_told=np.all([one.noise_told for one in shutters], axis=0).repeat(len(shutters)),
        most_level=np.einsum("dkc,kd->dc", np.sqrt(share), every).ravel(),
        constant_variance=of([one.constant_variance for one in shutters]),
    )
    return components, size.T[..., None] * vectors


def _error(reconstruction: Reconstruction, count: int) -> Array:
    """Standard error of each cell: the method's own, else what noise does to the plain inverse."""
    if reconstruction.standard_error is not None:
        return reconstruction.standard_error
    n_cells = reconstruction.image[0].size
    each = np.hypot(
        reconstruction.most_noise_electrons * np.sqrt(count) / n_cells,
        reconstruction.level_error_electrons,
    )
    return np.broadcast_to(each[:, None, None], reconstruction.image.shape)

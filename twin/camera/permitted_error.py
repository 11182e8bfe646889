"""Error that the light of a cell may have: a share of the noise that the sensor adds to it, or of
the light itself.
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hardware.patterns import PatternSet, fwht
from twin.accuracy import Decision
from twin.camera.cell_noise import cells_noise_e
from twin.camera.chain import Chain, Powers
from twin.camera.illumination import dark_share
from twin.fidelity import LightFidelity

if TYPE_CHECKING:
    from twin.camera.rendered import DetectorLight, RenderedLight

Array = NDArray[np.float64]

#: Error of the image's noise by the sun's light, over that which light may be off by.
SUN_SHARE = 0.025
#: Of the image's root mean square, below which a pixel's noise no longer says what light may be off
#: by: with the default a score's PSNR is then known to 0.2 dB.
IMAGE_SHARE = 0.25


@dataclass(frozen=True, eq=False)
class PermittedError:
    """What the light of cells may be off by.

    Parameters
    ----------
    chain
        To its noise ``light_tolerance`` refers.
    rendered
        With the sun, the truth and, for a system with time of flight, the paths; its light does not
        count. The light of cells is here what all shutters together collect of it (`collected`).
    fidelity
        With `light_tolerance`, `light_tolerance_relative`, or both: then the stricter.
    """

    chain: Chain
    rendered: "RenderedLight"
    fidelity: LightFidelity

    def collected(self, light: "DetectorLight") -> tuple[Array, Array]:
        """Of some light what the shutters collect, and its standard error, (n_detectors, n_cells);
        with time of flight that of the paths.
        """
        return self._of_paths if self._is_timed else (light.cells, light.error)

    def over(self, light: "DetectorLight") -> float:
        """Error of that light over the permitted one, root mean square over the cells."""
        cells, error = self.collected(light)
        return _rms(error / np.maximum(self.of(cells), 1e-150))

    def of(self, cells: Array) -> Array:
        """Permitted error of each cell, for errors that are independent from cell to cell, as those
        of finitely many paths are: in the unit of the light of the cells, (n_detectors, n_cells);
        infinite where no light of a cell passes to the detector and no cell has any.

        An image of M of N patterns has sqrt(M / N) of a full set's noise in a pixel, and holds the
        same share of such errors: compared with its noise they may be larger by sqrt(N / M). But it
        is also compared with the light itself, of which it lacks what the M patterns do not show:
        the error stays a share of that and of the noise together. The smaller of both limits holds.
        """
        return self._permitted(cells, self._noise_of_independent(cells))

    def of_alike(self, cells: Array) -> Array:
        """The same for errors that neighbouring cells share, such as light that is left out."""
        return self._permitted(cells, self.noise(cells))

    def _permitted(self, cells: Array, noise: Array) -> Array:
        share, relative = self.fidelity.light_tolerance, self.fidelity.light_tolerance_relative
        permitted = np.full(cells.shape, np.inf)
        if share is not None:
            # Of a sensor far below its noise the light must still be an image to compare with.
            permitted = share * np.minimum(noise, IMAGE_SHARE * _rms(cells) or np.inf)
        if relative is not None:
            permitted = np.minimum(permitted, relative * np.maximum(cells, cells.mean()))
        return permitted

    def _noise_of_independent(self, cells: Array) -> Array:
        """Noise with which independent errors of the cells compare."""
        noise, patterns = self.noise(cells), self.chain.patterns
        if not isinstance(patterns, PatternSet) or patterns.count == patterns.n_cells:
            return noise
        averaged = noise * math.sqrt(patterns.n_cells / patterns.count)
        return np.minimum(averaged, np.hypot(noise, _not_shown(patterns, cells)))

    def noise(self, cells: Array) -> Array:
        """Noise of each pixel, in the unit of the light of the cells."""
        with np.errstate(divide="ignore"):
            return np.asarray(self.noise_w(cells) / self._watts)

    def noise_w(self, cells: Array) -> Array:
        """The same as power on the detector; asked again of the same array it is not computed
        anew.
        """
        if not (self._last and self._last[0] is cells):
            self._last[:] = cells, self._noise_w(cells)
        return self._last[1]

    @cached_property
    def _last(self) -> list[Array]:
        """Cells, and their noise, W."""
        return []

    def _noise_w(self, cells: Array) -> Array:
        power, chain = self._unit, self.chain
        # Behind shutters that weight paths by their length light is that of the paths.
        lit = power.cells_w if self._is_timed else power.cells_w * cells
        signal = chain.mean_signal(replace(power, cells_w=lit))
        noise_e = cells_noise_e(chain, replace(power, cells_w=lit), signal)
        to_e = chain.front_end.electrons_per_watt * (1 - dark_share(chain.system))
        return np.asarray(noise_e / to_e)

    @property
    def tolerance(self) -> float:
        """The stricter of both."""
        given = (self.fidelity.light_tolerance, self.fidelity.light_tolerance_relative)
        return min(value for value in given if value is not None)

    def tolerance_of(self, cells: Array) -> float:
        """What an image of these cells may be off by, root mean square, in `unit`."""
        unit = self.unit_of(cells)
        lit = np.isfinite(unit)
        return _rms(self.of_alike(cells)[lit] / unit[lit]) if lit.any() else self.tolerance

    def unit_of(self, cells: Array) -> Array:
        """What `unit` names, of each cell, in the unit of the light of the cells."""
        if self.fidelity.light_tolerance is not None:
            return self.noise(cells)
        return np.maximum(cells, cells.mean())

    @property
    def unit(self) -> str:
        """Of the tolerance."""
        return "of a pixel's noise" if self.fidelity.light_tolerance else "of a cell's light"

    def decision(
        self, effect: str, bounds: tuple[float, float], tolerance: float, taken: bool, cost_s: float
    ) -> Decision:
        """Of an effect's bound, and what is permitted, both over a tolerance in `unit`."""
        bound, permitted = (tolerance * value for value in bounds)
        cost_s = cost_s if taken else math.nan
        return Decision("camera", effect, bound, permitted, self.unit, taken, cost_s)

    def sun_error(self, sun: Array, largest: float) -> Array:
        """What the sum of each detector's sunlight may be off by, (n_detectors,), in the unit of
        `RenderedLight.sun`, for the noise of a dark pixel to be off by a share of the tolerance.

        ``sun``: as rendered so far; ``largest``: more than a part of the field can have. Where
        exposures are not subtracted from each other, in which the sun is more than noise, the same
        share of the sun itself. Without limit where the sun does not shine.
        """
        chain, one = self.chain, self.chain.system.n_detectors == 1
        total = sun.sum(keepdims=True).reshape(1) if one else sun.sum(axis=0)
        if not chain.sky.illuminance_lx:
            return np.full(total.shape, np.inf)
        relative = 2 * SUN_SHARE * self.tolerance
        if self.fidelity.light_tolerance is None or chain.system.patterns.mode != "differential":
            return relative * total
        each = sun.size / total.size
        now = self._dark_variance(sun)
        with np.errstate(divide="ignore"):
            return np.asarray(relative * now * each * largest / self._added_by(sun.shape, largest))

    def _added_by(self, shape: tuple[int, ...], largest: float) -> Array:
        """What sunlight of the ``largest`` level everywhere adds to `_dark_variance`; asked again
        it is not computed anew.
        """
        if (asked := (shape, largest)) not in self._added:
            bright, unlit = (self._dark_variance(np.full(shape, x)) for x in (largest, 0.0))
            self._added[asked] = bright - unlit
        return self._added[asked]

    @cached_property
    def _added(self) -> dict[tuple[tuple[int, ...], float], Array]:
        """What `_added_by` found."""
        return {}

    def _dark_variance(self, sun: Array) -> Array:
        """Of exposures of the sun's light alone, by detector."""
        sun_w = self.chain.sun_power(replace(self.rendered, sun=sun))
        dark = np.zeros((1, len(self.chain.shutters), self.chain.system.n_detectors))
        budgets = self.chain.noise_by_detector(dark, sun_w)
        return np.array([budget.total_noise_e**2 for budget in budgets])

    @cached_property
    def _unit(self) -> Powers:
        """Power of cells of light 1."""
        ones = np.ones_like(self.rendered.light.cells)
        light = replace(self.rendered.light, cells=ones)
        return self.chain.powers(replace(self.rendered, light=light))

    @cached_property
    def _of_paths(self) -> tuple[Array, Array]:
        """As `collected` of the paths."""
        power, watts = self._unit, np.where(self._watts > 0, self._watts, np.inf)
        return power.cells_w.sum(axis=0) / watts, power.error_w / watts

    @cached_property
    def _watts(self) -> Array:
        """Power per unit of light, (n_detectors, n_cells)."""
        return self.chain.watts_of(self.rendered)

    @property
    def _is_timed(self) -> bool:
        return self.chain.system.time_of_flight is not None


def _not_shown(patterns: PatternSet, cells: Array) -> Array:
    """Root mean square over the cells of the part of their light that is in no pattern,
    (n_detectors, 1); ``cells`` (n_detectors, n_cells).
    """
    coefficients = fwht(cells.T)
    coefficients[patterns.indices] = 0
    return np.asarray(np.linalg.norm(coefficients, axis=0)[:, None] / patterns.n_cells)


def _rms(values: Array) -> float:
    return math.sqrt(float(np.mean(values**2)))

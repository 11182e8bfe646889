"""Error that the light of a cell may have: a share of the noise that the sensor adds to it."""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from twin.camera.chain import Chain
from twin.camera.illumination import dark_share

if TYPE_CHECKING:
    from twin.camera.light import RenderedLight

Array = NDArray[np.float64]


def permitted_error(chain: Chain, rendered: "RenderedLight", cells: Array, share: float) -> Array:
    """``share`` of the noise of each pixel, in the unit of the light of the cells, (n_detectors,
    n_cells); infinite where no light of a cell passes to the detector.

    ``rendered``: with the sun, the truth and, for a system with time of flight, the paths; in place
    of its light ``cells`` is taken.
    """
    light = replace(rendered.light, cells=cells, error=np.ones_like(cells))
    power = chain.powers(replace(rendered, light=light))
    budgets = chain.noise_by_detector(chain.mean_signal(power), power.sun_w)
    patterns = chain.system.patterns
    noise_e = np.array([budget.cells_noise_e(patterns) for budget in budgets])
    noise_e = noise_e * np.sqrt(len(chain.shutters))
    electrons_per_watt = chain.front_end.electrons_per_watt * (1 - dark_share(chain.system))
    with np.errstate(divide="ignore"):
        return np.asarray(share * noise_e / (electrons_per_watt * power.error_w))

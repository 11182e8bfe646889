"""Noise of a single exposure, to which errors of motion refer."""

import numpy as np

from twin.camera.chain import Chain
from twin.camera.rendered import RenderedLight


def exposure_noise_w(chain: Chain, rendered: RenderedLight) -> float:
    """Noise of an exposure in the middle of the frame, of the detector that has the least."""
    power = chain.powers(rendered)
    budgets = chain.noise_by_detector(chain.mean_signal(power), power.sun_w)
    return min(b.total_noise_e for b in budgets) / chain.front_end.electrons_per_watt


def lit_share(chain: Chain) -> float:
    """Of the cells in an exposure that are lit, the mean over the exposures: as many errors of
    cells add up in a count.
    """
    patterns = chain.patterns
    return float(patterns.signal(np.ones(patterns.n_cells)).mean()) / patterns.n_cells

"""Images of other light between two steps of the converter, where that decides what they show.

Where the converter's step is more than all other noise, and light from exposure to exposure differs
by little, all counts are rounded to the same side. Half a step more of the sun's light makes
another image, and the sun is often not known to half a step.
"""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from hardware.reconstruction import Reconstruction
from twin.camera.acquisition import Capture
from twin.camera.follows import Follows

Array = NDArray[np.float64]

#: Places between two steps, and what light may be off by, over a step, from which on they count.
_PLACES, _LEAST = 8, 0.01
_HALF_WIDTH = 1.96


@lru_cache(maxsize=2)
def pictures_of_other_light(capture: Capture, image: Reconstruction) -> Array:
    """By the same method, without backscatter, (n, rows, columns): of as much more or less light as
    the model's may be off by, up to half a step. None where other noise evens rounding out, nor of
    methods that are not asked again.
    """
    error, step_w = capture.model_error, capture.model_error.uneven_step_w
    none = np.empty((0, *capture.measured_scene_e.shape))
    if not step_w:
        return none
    signal_w = float(capture.signal_w.sum(axis=1).mean())
    off_w = _HALF_WIDTH * np.hypot(error.background_w, error.signal * signal_w)
    off_w += error.background_systematic_w + error.signal_systematic * signal_w
    follows = Follows(capture, image)
    if off_w < _LEAST * step_w or not follows.is_known:
        return none
    reach_w = min(off_w, step_w / 2)
    more_w = np.delete(np.linspace(-reach_w, reach_w, _PLACES + 1), _PLACES // 2)
    records = [capture.noise_draws.in_more_sun(float(w)) for w in more_w]
    return np.stack([follows.picture(each) for each in records]) - capture.backscatter_e

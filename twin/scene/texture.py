"""A reflectance that varies over a surface."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Texture:
    """Reflectance image (rows, columns), looked up by u, v as Mitsuba does.

    ``filter_type`` is ``bilinear`` or ``nearest``, ``wrap_mode`` ``repeat``, ``mirror`` or
    ``clamp``.
    """

    image: NDArray[np.float32]
    filter_type: str = "bilinear"
    wrap_mode: str = "repeat"


#: Reflectance at 1550 nm: one number, or a texture.
Reflectance = float | Texture

"""The test pictures of the reconstruction benchmarks: those that come inside scikit-image.

22 files of ``skimage.data``; colour to grey by ``rgb2gray``, values 0 to 1; the whole picture
resized to the grid by ``skimage.transform.resize`` with its anti-aliasing filter (order 1), aspect
ratio not kept. SSIM: ``structural_similarity`` with data_range 1 and its defaults (7 x 7 uniform
window, K1 0.01, K2 0.03). PSNR: peak 1, mean of the decibels over the pictures.
"""

from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

NAMES = (
    "astronaut.png",
    "brick.png",
    "camera.png",
    "cell.png",
    "chelsea.png",
    "clock_motion.png",
    "coffee.png",
    "coins.png",
    "grass.png",
    "gravel.png",
    "horse.png",
    "hubble_deep_field.jpg",
    "ihc.png",
    "microaneurysms.png",
    "moon.png",
    "motorcycle_left.png",
    "page.png",
    "phantom.png",
    "retina.jpg",
    "rocket.jpg",
    "text.png",
    "color.png",
)


@lru_cache(maxsize=8)
def pictures(rows: int, columns: int) -> tuple[NDArray[np.float64], ...]:
    """All pictures on a grid, ``(rows, columns)`` each."""
    import skimage
    from skimage import color, transform
    from skimage.io import imread

    folder = Path(skimage.__file__).parent / "data"
    found = []
    for name in NAMES:
        picture = imread(folder / name)
        grey = color.rgb2gray(picture[..., :3]) if picture.ndim == 3 else picture / 255.0
        found.append(transform.resize(grey, (rows, columns), anti_aliasing=True))
    return tuple(found)

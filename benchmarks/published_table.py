"""The published figures of block Hadamard imaging, by their protocol, on a folder of test images.

    python -m benchmarks.published_table FOLDER

Source: github.com/amiri56/Real_time_Hadamard_paper, README, table 2, mean over the 11 grey
images of Set11 (academic use; not shipped here): 19.61, 22.21, 24.38 and 27.68 dB at 1, 4, 10
and 25 %.
Protocol: non-overlapping 32 x 32 blocks, Hadamard rows by total sequency (ties by index),
round(1024 ratio) rows kept, noiseless, x = H^T y / 1024, PSNR with peak 255.
"""

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hardware import PatternSet
from hardware.reconstruction import Sensing

PUBLISHED_DB = {0.01: 19.61, 0.04: 22.21, 0.10: 24.38, 0.25: 27.68}
BLOCK = 32


def block_psnr(picture: NDArray[np.floating], ratio: float) -> float:
    """PSNR, dB, of a grey picture (0 to 255) whose sides are multiples of 32."""
    rows, columns = picture.shape
    if rows % BLOCK or columns % BLOCK:
        raise ValueError(f"sides {rows} x {columns} are no multiples of {BLOCK}")
    tiles = picture.reshape(rows // BLOCK, BLOCK, columns // BLOCK, BLOCK).transpose(1, 3, 0, 2)
    cells = tiles.reshape(BLOCK**2, -1).astype(np.float64)
    sensing = Sensing(PatternSet(BLOCK, BLOCK, max(1, round(BLOCK**2 * ratio))))
    found = sensing.adjoint(sensing.forward(cells)) / BLOCK**2
    return float(10 * np.log10(255**2 / np.mean((found - cells) ** 2)))


def main() -> None:
    """Print the table for a folder; exit code 1 where the mean is off by more than 0.02 dB."""
    from skimage import color
    from skimage.io import imread

    if len(sys.argv) != 2 or not Path(sys.argv[1]).is_dir():
        raise SystemExit("usage: python -m benchmarks.published_table FOLDER")
    suffixes = {".png", ".tif", ".tiff", ".bmp", ".pgm", ".jpg"}
    paths = sorted(p for p in Path(sys.argv[1]).iterdir() if p.suffix.lower() in suffixes)
    if not paths:
        raise SystemExit(f"{sys.argv[1]}: no images")
    pictures = []
    for path in paths:
        picture = imread(path)
        pictures.append(picture if picture.ndim == 2 else 255 * color.rgb2gray(picture[..., :3]))
    worst = 0.0
    print(f"{len(pictures)} images; published: 11 of Set11")
    for ratio, published in PUBLISHED_DB.items():
        found = float(np.mean([block_psnr(picture, ratio) for picture in pictures]))
        worst = max(worst, abs(found - published))
        print(f"{ratio:4.0%}  {found:.2f} dB  published {published:.2f}  {found - published:+.2f}")
    raise SystemExit(0 if worst <= 0.02 else 1)


if __name__ == "__main__":
    main()

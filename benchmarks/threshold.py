"""Draw the threshold of range estimation: error over its bound, and outliers, by SNR.

python -m benchmarks.threshold docs/threshold.png
"""

import sys

import numpy as np
from matplotlib.figure import Figure

from benchmarks.radar_processing import WAVEFORMS, rmse

_SNR_DB = (6, 8, 9, 10, 11, 12, 13, 14, 15, 17, 20, 25, 30)
_RUNS = 200


def main() -> None:
    """Monte Carlo over SNR, a curve per radar."""
    figure = Figure((7.4, 3.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    for name, wave in WAVEFORMS.items():
        found = [rmse(wave, snr, _RUNS, np.random.default_rng(int(snr))) for snr in _SNR_DB]
        left.plot(_SNR_DB, [ratios[0] for ratios, _ in found], "o-", ms=3, label=name)
        right.plot(_SNR_DB, [100 * outliers for _, outliers in found], "o-", ms=3, label=name)
        for snr, (ratios, outliers) in zip(_SNR_DB, found, strict=True):
            print(f"{name}, {snr} dB: range {ratios[0]:.3f} of the bound, outliers {outliers:.2%}")
    left.axhline(1, color="grey", lw=0.8, ls="--")
    left.set_ylabel("range RMSE over its bound")
    right.set_ylabel("outliers: more than two cells off (%)")
    for axis in (left, right):
        axis.set_xlabel("SNR after processing (dB)")
        axis.legend()
    figure.savefig(sys.argv[1], dpi=110, metadata={"Software": None})


if __name__ == "__main__":
    main()

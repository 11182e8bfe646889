"""What a capture's record and view tell by themselves: for the page and for its summary."""

import numpy as np

from twin.camera.evaluation import Evaluation
from twin.camera.view import View


def emitter_share(view: View) -> float:
    """Share of the band's light that is the emitter's with all cells lit; the rest is the sun's."""
    return float(view.emitter.sum() / max(view.total.sum(), np.finfo(float).tiny))


def range_used(evaluation: Evaluation) -> float:
    """Share of the converter's range that the patterns move the middle detector's counts by."""
    record = evaluation.capture.record
    counts = record.counts[:, record.counts.shape[1] // 2].astype(np.float64)
    return float(np.ptp(counts) / 2**record.adc_bits)


def noise_found_e(evaluation: Evaluation) -> float:
    """Noise of one exposure as the record tells it, e-; NaN where it does not."""
    found = float(np.sqrt(np.mean(evaluation.reconstructions[0].noise_electrons ** 2)))
    # Noise of a Hadamard measurement over that of one exposure.
    return found / (2**0.5 if evaluation.system.patterns.mode == "differential" else 2.0)

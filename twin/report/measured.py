"""What a capture's record and view tell by themselves: for the page and for its summary."""

import numpy as np

from hardware.reconstruction.measurements import measurements, with_level
from hardware.records import SpiRecord
from twin.accuracy import Interval
from twin.camera.evaluation import Evaluation
from twin.camera.noise_scatter import scatter_over_noise
from twin.camera.view import View


def emitter_share(view: View) -> float:
    """Share of the band's light that is the emitter's with all cells lit; the rest is the sun's."""
    return float(view.emitter.sum() / max(view.total.sum(), np.finfo(float).tiny))


def range_used(evaluation: Evaluation) -> float:
    """Share of the converter's range that the patterns move the middle detector's counts by."""
    record = evaluation.capture.record
    counts = record.counts[:, record.counts.shape[1] // 2].astype(np.float64)
    return float(np.ptp(counts) / 2**record.adc_bits)


def noise_found(evaluation: Evaluation) -> Interval:
    """Noise of one exposure as the record tells it, e-; NaN where it does not."""
    # Noise of a Hadamard measurement over that of one exposure.
    factor = 2**0.5 if evaluation.system.patterns.mode == "differential" else 2.0

    def of_record(record: SpiRecord) -> float:
        return float(np.sqrt(measurements(with_level(record.received)).noise_variance.mean()))

    found = float(np.sqrt(np.mean(evaluation.reconstructions[0].noise_electrons ** 2)))
    if not np.isfinite(found):
        return Interval(np.nan)
    by_noise = scatter_over_noise(evaluation.capture, found, of_record)
    return Interval(found / factor, noise=by_noise / factor)

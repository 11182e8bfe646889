"""How many targets a radar detects, and how far another draw of the noise would change it."""

import numpy as np
from numpy.typing import NDArray
from scipy.special import chndtr, gammainccinv

from hardware.radar.windows import normalised_window
from twin.accuracy import Interval
from twin.radar.evaluation import RadarEvaluation

Array = NDArray[np.float64]

#: Loss of detection beside the ideal detector's.
_MOST_LOST_DB = 3.0


def threshold_db(evaluation: RadarEvaluation) -> float:
    """Power over mean noise that white noise exceeds at the false-alarm probability, for the mean
    of independent channels: a chi-squared variable.
    """
    channels = evaluation.image.n_channels
    level = gammainccinv(channels, evaluation.how.cfar.false_alarm) / channels
    return float(10 * np.log10(level))


def window_loss(evaluation: RadarEvaluation) -> float:
    """Noise gain of the map's windows: product of their mean squares at mean 1."""
    sizes = evaluation.waveform.n_subcarriers, evaluation.waveform.n_slots
    windows = (normalised_window(evaluation.how.window, n) for n in sizes)
    return float(np.prod([np.mean(window**2) for window in windows]))


def targets_detected(evaluation: RadarEvaluation) -> Interval:
    """True targets that are detected.

    A target whose level may fall to the map's noise, as far as the model's error goes, may be
    another one less. By noise each target is detected or missed at its probability of detection
    (noncentral chi-squared: Marcum's function), that of one that is missed by its expected level on
    a map without a window, on which weak echoes are looked for. Of what detection loses beside that
    (cells off the peak, the estimated noise) any amount up to `_MOST_LOST_DB` counts, whichever
    makes most of the scatter. What hides a target in clutter is not counted.
    """
    snr_db, unsure = {}, set()
    rows = zip(evaluation.matches, evaluation.intervals, evaluation.detections, strict=True)
    for target, model, detection in rows:
        if target is not None:
            snr_db[target.name] = detection.snr_db
            if detection.snr_db < model.level_dbm.of_model.half_width:
                unsure.add(target.name)
    n_detected, gain_db = len(snr_db), 10 * np.log10(window_loss(evaluation))
    for target in evaluation.missed:
        if target.visible:
            snr_db[target.name] = evaluation.expected_snr_db(target) + gain_db
    p = _probability(np.array(list(snr_db.values())), evaluation)
    scatter = float(np.sqrt(np.sum((p * (1 - p)).max(axis=0))))
    return Interval(float(n_detected), systematic=float(len(unsure)), noise=scatter)


def _probability(snr_db: Array, evaluation: RadarEvaluation) -> Array:
    """Of detection at SNRs (n_targets,) of a channel, for each loss, (n_losses, n_targets)."""
    if not evaluation.image.noise_w:
        return np.zeros((1, len(snr_db)))  # every draw is the same
    freedom = 2 * evaluation.image.n_channels
    losses_db = np.linspace(0.0, _MOST_LOST_DB, 7)[:, None]
    threshold = 10 ** ((threshold_db(evaluation) + losses_db) / 10)
    return np.asarray(1 - chndtr(freedom * threshold, freedom, freedom * 10 ** (snr_db / 10)))

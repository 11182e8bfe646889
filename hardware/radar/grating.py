"""Grating lobes of a track: where an echo shows again beside itself, for stops too far apart."""

import numpy as np
from numpy.typing import NDArray

from hardware.formatting import si
from hardware.waveform import C_M_PER_S, OfdmWaveform

Array = NDArray[np.float64]

_PER_NULL = 4  # directions from a lobe's middle to its null: its top is met within 0.2 dB
_LOBES = 2  # of the widest gap alone, up to which is looked: stops mostly lie closer
_WORTH_A_WARNING_DB = -10.0  # side lobes of a dense track are 13 dB down


def grating_lobe(
    centres_m: Array, middle_m: Array, waveform: OfdmWaveform
) -> tuple[float, float] | None:
    """Distance in metres and level in dB of the highest lobe beside an echo at the image's middle.

    Parameters
    ----------
    centres_m : (n, 3)
        Middles of transmitter and receiver, of all stops and pairs.
    middle_m : (3,)
        The image's middle.
    waveform
        Of the bursts.

    The image of a point, along the arc about the track's middle through it: the mean over centres
    and frequencies of a wave's turns there and back. None where no gap between centres across the
    view is above half a wavelength, or no lobe within 90 deg of ahead is above -10 dB.
    """
    across = np.unique(centres_m[:, 1])
    gap_m = float(np.diff(across).max(initial=0.0))
    if gap_m <= waveform.wavelength_m / 2:
        return None
    distance_m = float(np.linalg.norm(middle_m[:2]))
    sine = middle_m[1] / distance_m
    null = waveform.wavelength_m / (2 * np.ptp(across))
    reach = _LOBES * waveform.wavelength_m / (2 * gap_m) + null
    count = int(np.ceil(reach / null * _PER_NULL))
    sines: Array = sine + np.arange(-count, count + 1) * (null / _PER_NULL)
    arc = np.stack(
        [distance_m * np.sqrt(np.clip(1 - sines**2, 0, 1)), distance_m * sines, 0 * sines], axis=-1
    )
    total = np.zeros(len(sines), dtype=np.complex128)
    for centre in centres_m:
        delay_s = 2 / C_M_PER_S * np.linalg.norm(arc - centre, axis=-1)
        delay_s -= delay_s[count]
        total += np.sinc(waveform.bandwidth_hz * delay_s) * np.exp(
            2j * np.pi * waveform.carrier_hz * delay_s
        )
    level = np.abs(total) / len(centres_m)
    level[np.abs(sines) > 1] = 0.0
    level[_main_lobe(level, count)] = 0.0
    best = int(np.argmax(level))
    if level[best] < 10 ** (_WORTH_A_WARNING_DB / 20):
        return None
    return float(np.linalg.norm(arc[best] - arc[count])), 20 * float(np.log10(level[best]))


def _main_lobe(level: Array, top: int) -> slice:
    """From minimum to minimum around the top."""
    rises = np.diff(level) > 0
    left = np.flatnonzero(~rises[:top])
    right = np.flatnonzero(rises[top:])
    first = left[-1] + 1 if left.size else 0
    last = top + right[0] if right.size else len(level)
    return slice(int(first), int(last) + 1)


def told(centres_m: Array, middle_m: Array, waveform: OfdmWaveform) -> tuple[str, ...]:
    """A warning of grating lobes, where there are any."""
    found = grating_lobe(centres_m, middle_m, waveform)
    if found is None:
        return ()
    gap_m = float(np.diff(np.unique(centres_m[:, 1])).max())
    return (
        f"stops lie up to {si(gap_m, 'm')} apart across the view, half a wavelength is "
        f"{si(waveform.wavelength_m / 2, 'm')}: at the image's middle each echo shows again "
        f"{si(found[0], 'm')} beside itself, at {found[1]:.1f} dB (grating lobes; the antenna's "
        "beam does not take them away, it only tells where no echo can be)",
    )

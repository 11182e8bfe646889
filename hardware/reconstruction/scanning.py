"""What a raster scan measured of each cell, from raw counts alone.

A cell's exposure holds its light and the background. The next one in the dark takes the background
out, or the gates in which no echo falls do: they are fitted by one echo over a constant.
"""

import numpy as np
from numpy.typing import NDArray

from hardware.patterns import RasterScan
from hardware.reconstruction.gating import Echo, echo
from hardware.reconstruction.noise import NORMAL_MAD
from hardware.records import SpiRecord

Array = NDArray[np.float64]

#: Fewer gates than this do not tell an echo from the background.
_LEAST_GATES = 4
#: Confidence below which the gates of a cell do not hold one echo, and errors of a gate by which it
#: must stand out to be told from none.
_ONE, _BRIGHT = 0.5, 10.0
BACKGROUND_IN_IMAGE = (
    "the background is in the image: a raster scan without dark exposures or gates cannot tell it "
    "from light"
)


def gates_tell_background(record: SpiRecord) -> bool:
    """Whether a record's gates hold the background of every cell."""
    return len(record.shutters) >= _LEAST_GATES and all(one.gated for one in record.shutters)


def images_by_shutter(record: SpiRecord) -> tuple[Array, Array]:
    """Electrons of every cell behind every shutter, and their standard errors, both (n_shutters,
    n_detectors, n_cells); NaN in cells that were not lit. Of plain scans the background is in them.

    The error is the scatter of what holds no echo (dark exposures, or gates about their median) and
    the shot noise of the electrons beyond that: those of a diode without gain.
    """
    scan = record.patterns
    assert isinstance(scan, RasterScan)
    electrons = np.moveaxis(record.electrons_by_shutter, 0, -1)  # (n_shutters, n_detectors, n)
    step_variance = record.electrons_per_count**2 / 12
    if scan.mode == "differential":
        lit, dark = electrons[..., 0::2], electrons[..., 1::2]
        quiet = np.diff(dark, axis=-1) / np.sqrt(2)
        floor = np.median(np.abs(quiet), axis=-1, keepdims=True) if quiet.size else 0.0
        found = lit - dark
        variance = 2 * np.maximum((floor / NORMAL_MAD) ** 2, step_variance) + np.maximum(found, 0)
    else:
        found = electrons
        middle = np.median(found, axis=0, keepdims=True)
        floor = (
            np.median(np.abs(found - middle)) / NORMAL_MAD if len(found) >= _LEAST_GATES else 0.0
        )
        beyond = np.maximum(found - np.median(middle), 0) if len(found) >= _LEAST_GATES else found
        variance = np.maximum(floor**2, step_variance) + np.maximum(beyond, 0)
    whole = np.full((2, *found.shape[:-1], scan.n_cells), np.nan)
    whole[0][..., scan.cells], whole[1][..., scan.cells] = found, np.sqrt(variance)
    return whole[0], whole[1]


def scanned_cells(record: SpiRecord) -> Array:
    """Electrons of every cell, (n_cells, n_detectors), all shutters together: behind gates those of
    its echo, or where no one echo explains them (two surfaces in a cell) all beyond the median of
    its gates. Cells that were not lit have the mean of the others.
    """
    images, errors = images_by_shutter(record)
    if gates_tell_background(record) and record.pulse_width_s > 0:
        found = gated_echo(record, images, errors)
        amplitude, confidence = (
            part.reshape(images.shape[1:]) for part in (found.amplitude, found.confidence)
        )
        background = np.median(images, axis=0) if record.patterns.mode == "plain" else 0.0
        several = (confidence < _ONE) & (amplitude > _BRIGHT * np.median(errors, axis=0))
        cells = np.where(several, (images - background).sum(axis=0), amplitude).T
    else:
        cells = images.sum(axis=0).T
    unlit = record.patterns.unmeasured_cells
    cells[unlit] = cells[~unlit].mean(axis=0)
    return cells


def gated_echo(record: SpiRecord, images: Array, errors: Array) -> Echo:
    """The echo of every cell of every detector, flattened, over its own constant background where
    the scan is plain; of cells that were not lit none.
    """
    gates = np.array([(one.gate_delay_s, one.gate_width_s) for one in record.shutters])
    flat = [
        np.nan_to_num(part.reshape(len(part), -1), nan=fill)
        for part, fill in ((images, 0.0), (errors, 1.0))
    ]
    plain = record.patterns.mode == "plain" and gates_tell_background(record)
    return echo(flat[0], flat[1], gates, record.pulse_width_s, background=plain)

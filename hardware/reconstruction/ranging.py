"""Distance images from a record whose patterns were shown with several shutters.

The image of each shutter is reconstructed by any method, and by linear ones with what its error has
in common with the others' (`hardware.reconstruction.shutter_images`).

Phase shutters of a lock-in measurement: cell by cell the images of one modulation frequency are
b + Re(z exp(j phase)); least squares over the phases gives the phasor z, the phasors of all
frequencies the distance (`hardware.reconstruction.depth`).

Gates: each gate's image is a slice of the scene, as thick as gate and pulse together; what
neighbouring ones hold of a cell tells where in them it lies (`hardware.reconstruction.gating`).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hardware.blas import one_blas_thread
from hardware.described import Described
from hardware.errors import InputError
from hardware.patterns import RasterScan
from hardware.reconstruction.depth import depth
from hardware.reconstruction.gating import Echo, delay_weights, echo
from hardware.reconstruction.imaging import LEVEL_UNKNOWN
from hardware.reconstruction.measurements import measurements, with_level
from hardware.reconstruction.negative_light import negative_light
from hardware.reconstruction.own_method import method_of
from hardware.reconstruction.registry import Method, Solve
from hardware.reconstruction.scanning import gates_tell_background, images_by_shutter
from hardware.reconstruction.sensing import Mixing, Sensing
from hardware.reconstruction.shutter_images import ShutterErrors, shutter_images
from hardware.records import Flag, Shutter, SpiRecord
from hardware.waveform import C_M_PER_S

Array = NDArray[np.float64]


AT_RAIL = "most exposures stand at the converter's rails or are marked saturated: no distance"
ECHO_CUT = (
    "cells of which an exposure is saturated: distances hold to the reach of a gate only, "
    "amplitudes are lower bounds"
)
PHASES_CUT = "cells of which an exposure is saturated: what is left of their phases is no distance"
PULSE_UNKNOWN = (
    "pulse_width_s is not stated: distances from gates hold to half a gate only, for any pulse "
    "up to the gate's length"
)


@dataclass(frozen=True, eq=False, repr=False)
class RangeImage(Described):
    """Amplitude and distance of every cell; arrays ``(n_detectors, rows, columns)``.

    ``amplitude`` in photo-electrons of a cell lit alone for one exposure: of phase shutters, half
    the modulated light (contrast included), mean over the frequencies; of gates, the whole echo.
    ``distance_m`` is half the way from emitter to detector, NaN where no light is. Cells that the
    patterns do not measure have NaN for both.
    Each cell is taken to hold one surface: of several within two gates, or by one frequency,
    the mean by light is told, and nothing contradicts it.
    ``standard_error_m`` holds if the unwrapping, or the choice of the gate, is right. It includes
    by how much ``lmmse`` draws the distances of neighbours together, as of a post and what stands
    behind it; of methods that are not linear the errors of shutters count as independent.
    ``confidence`` is the probability that it is, all distances up to ``longest_m`` being alike
    before. Farther ones repeat, or no gate is open; of phases, what lies nearer to 0 or to
    ``longest_m`` than its error may belong to the other end, and confidence falls to one half.
    An echo that comes back after the next pulse looks nearer too, by what light travels between two
    pulses; a record does not state their rate.
    A detector most of whose exposures are saturated is not confident of anything.
    A saturated exposure cuts off light of its cells, of one of a raster scan or of all of a
    pattern: phases tell nothing then; an echo that the rail cuts off came back while the gate was
    open, and its error is that.
    ``warnings``: what makes distances less sure than they could be.
    """

    method: str
    amplitude: Array
    distance_m: Array
    standard_error_m: Array
    confidence: Array
    longest_m: float
    warnings: tuple[str, ...] = ()


@one_blas_thread()
def range_image(
    record: SpiRecord, method: str | Method | Solve = "lmmse", *, mixing: Mixing | None = None
) -> RangeImage:
    """Amplitude and distance of every cell of a record with phase shutters or gates.

    A raster scan needs no method: the shutters of each cell alone say its distance.

    Raises InputError for a record whose shutter was always open, one with both, a frequency
    whose phases leave its phasor open, and whatever `reconstruct` refuses.

    A record that does not state its pulse (schema version 2 and older) may have had any pulse up to
    the gate's length: the distance is the middle of these, and the error covers them.
    """
    shutters = record.shutters
    modulated = all(shutter.modulated for shutter in shutters)
    gated = all(shutter.gated for shutter in shutters)
    if not (modulated or gated) or any(one.modulated and one.gated for one in shutters):
        raise InputError(
            "shutters: expected the phases of one or more modulation frequencies, or gates"
        )
    if modulated:
        list(_phase_systems(record.shutters))  # refuses what no image could mend
    if isinstance(record.patterns, RasterScan) and mixing is None:
        ranges = _of_scan(record.received)
    else:
        ranges = _of_patterns(record, method_of(method), mixing)
    received = with_level(record.received)
    told = negative_light(received, measurements(received))
    return replace(ranges, warnings=(*ranges.warnings, *told))


def _of_patterns(record: SpiRecord, solve: Method, mixing: Mixing | None) -> RangeImage:
    """From the image of each shutter."""
    sensing = Sensing(with_level(record.received).patterns, mixing)
    images, errors = shutter_images(record, solve, mixing)
    measured = np.isfinite(images[0])
    unsure = measured & np.isnan(errors.components).any(axis=0).reshape(measured.shape)
    known = replace(errors, components=np.nan_to_num(errors.components))
    ranges = _ranges(record, np.nan_to_num(images), known, solve.name)  # no light: no distance
    level = () if sensing.measures_level else (LEVEL_UNKNOWN,)
    saturated: NDArray[np.bool_] = np.any(_saturated(record), axis=0)
    saturated = saturated[:, None, None] & np.ones_like(measured)
    ranges = replace(
        ranges,
        amplitude=np.where(measured, ranges.amplitude, np.nan),
        standard_error_m=np.where(unsure, np.inf, ranges.standard_error_m),
        confidence=np.where(unsure, 0.0, ranges.confidence),
        warnings=(*ranges.warnings, *level),
    )
    return _without_the_saturated(ranges, record, saturated)


def _of_scan(record: SpiRecord) -> RangeImage:
    """Each cell from its own exposures."""
    shape = (len(record.shutters), -1, record.patterns.rows, record.patterns.columns)
    images, errors = (part.reshape(shape) for part in images_by_shutter(record))
    ranges = distances(record, np.nan_to_num(images), np.nan_to_num(errors, nan=1.0), "scan")
    unlit = record.patterns.unmeasured_cells.reshape(shape[2:])
    ranges = replace(
        ranges,
        amplitude=np.where(unlit, np.nan, ranges.amplitude),
        distance_m=np.where(unlit, np.nan, ranges.distance_m),
        standard_error_m=np.where(unlit, np.inf, ranges.standard_error_m),
        confidence=np.where(unlit, 0.0, ranges.confidence),
    )
    return _without_the_saturated(ranges, record, _saturated_cells(record).reshape(shape[1:]))


def _without_the_saturated(
    ranges: RangeImage, record: SpiRecord, saturated: NDArray[np.bool_]
) -> RangeImage:
    """What is left of distances where cells (n_detectors, rows, columns) are ``saturated``."""
    blind = _blind(record)[:, None, None] & np.ones_like(saturated)
    cut, told = saturated & ~blind & np.isfinite(ranges.standard_error_m), ECHO_CUT
    error = ranges.standard_error_m
    unknown = blind
    if all(one.modulated for one in record.shutters):
        told, unknown = PHASES_CUT, blind | cut  # what is left of the phases has another phase
    else:
        cut &= _in_saturated_gates(record, ranges.distance_m)
        error = np.where(cut, np.hypot(error, _reach_m(record)), error)
    said = [warning for warning, where in ((AT_RAIL, blind), (told, cut)) if where.any()]
    return replace(
        ranges,
        standard_error_m=np.where(unknown, np.inf, error),
        confidence=np.where(unknown, 0.0, ranges.confidence),
        warnings=(*ranges.warnings, *said),
    )


def _in_saturated_gates(record: SpiRecord, distance_m: Array) -> NDArray[np.bool_]:
    """Cells whose echo, as it is or a pulse earlier or later, falls in a gate of which an exposure
    of their detector is saturated.
    """
    begins = 2 * distance_m / C_M_PER_S
    found = np.zeros(distance_m.shape, np.bool_)
    by_gate = _saturated(record).reshape(-1, len(record.shutters), len(distance_m))
    saturated: NDArray[np.bool_] = np.any(by_gate, axis=0)
    for gate, cut in zip(record.shutters, saturated, strict=True):
        # A pulse of unknown length is at most as long as the gate.
        pulse = record.pulse_width_s or gate.gate_width_s
        early, late = gate.gate_delay_s - 2 * pulse, gate.gate_delay_s + gate.gate_width_s + pulse
        found |= cut[:, None, None] & (early <= begins) & (begins <= late)
    return found


def _saturated_cells(record: SpiRecord) -> NDArray[np.bool_]:
    """Cells (n_detectors, n_cells) of a raster scan of which an exposure is saturated."""
    scan = record.patterns
    assert isinstance(scan, RasterScan)
    saturated = _saturated(record)
    cells = np.zeros((saturated.shape[1], scan.n_cells), np.bool_)
    cells[:, scan.cells] = saturated.reshape(scan.count, -1, saturated.shape[1]).any(axis=1).T
    return cells


def _saturated(record: SpiRecord) -> NDArray[np.bool_]:
    """Exposures (n, n_detectors) that stand at the converter's top or are marked so."""
    lost = (record.flags & Flag.LOST) != 0
    at_top = _marked(record, record.counts == 2**record.adc_bits - 1)
    return np.asarray(at_top & ~lost[:, None])


def _reach_m(record: SpiRecord) -> float:
    """Standard deviation of a distance of which only the gate is known that took the echo."""
    widest_s = max(shutter.gate_width_s for shutter in record.shutters)
    return float(C_M_PER_S / 2 * (widest_s + record.pulse_width_s) / np.sqrt(12))


def distances(record: SpiRecord, images: Array, errors: Array, method: str = "") -> RangeImage:
    """`range_image` of images that are at hand: electrons by shutter and their standard errors,
    independent of each other, (n_shutters, n_detectors, rows, columns), whatever the record's own
    counts are.
    """
    return _ranges(record, images, ShutterErrors.independent(errors), method)


def _ranges(record: SpiRecord, images: Array, errors: ShutterErrors, method: str) -> RangeImage:
    if all(shutter.modulated for shutter in record.shutters):
        return _from_phases(method, images, errors, list(_phase_systems(record.shutters)))
    return _from_gates(method, images, errors, record)


def _blind(record: SpiRecord) -> NDArray[np.bool_]:
    """Detectors (n_detectors,) of which more than half of the exposures stand at a rail: what is
    left moves with the rail, not with the light.
    """
    at_rail = (record.counts == 2**record.adc_bits - 1) | (record.counts == 0)
    return np.asarray(_marked(record, at_rail).mean(axis=0) > 0.5)


def _marked(record: SpiRecord, at_rail: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Exposures (n, n_detectors) at a rail, with those that are marked saturated: the flag does not
    say whose well is full, so of all detectors where none stands at a rail.
    """
    flagged = (record.flags & Flag.SATURATED) != 0
    return at_rail | (flagged & ~at_rail.any(axis=1))[:, None]


def _phase_systems(
    shutters: Sequence[Shutter],
) -> Iterator[tuple[float, NDArray[np.intp], Array]]:
    """Frequency, the places of its shutters, and the (2, n_phases) matrix that gives Re z and Im z
    of their images by least squares.
    """
    modulation_hz = np.array([shutter.modulation_hz for shutter in shutters])
    phase_rad = np.array([shutter.phase_rad for shutter in shutters])
    for frequency in np.unique(modulation_hz):
        phases = np.flatnonzero(modulation_hz == frequency)
        phase = phase_rad[phases]
        model = np.stack([np.cos(phase), -np.sin(phase), np.ones_like(phase)], axis=1)
        if np.linalg.matrix_rank(model, tol=1e-6) < 3:
            raise InputError(
                f"shutters: phases {phase} at {frequency:.6g} Hz, at least three different ones "
                "are needed"
            )
        yield float(frequency), phases, np.linalg.pinv(model)[:2]


def _from_phases(
    method: str,
    images: Array,
    errors: ShutterErrors,
    systems: list[tuple[float, NDArray[np.intp], Array]],
) -> RangeImage:
    shape, flat = images.shape[1:], images.reshape(len(images), -1)
    phasors, across = [], []
    for _, phases, solve in systems:
        real, imaginary = solve @ flat[phases]
        size = np.maximum(np.hypot(real, imaginary), np.finfo(float).tiny)
        weights = np.zeros_like(flat)  # of the part across the phasor, which turns it
        weights[phases] = np.outer(solve[1], real / size) - np.outer(solve[0], imaginary / size)
        phasors.append(real + 1j * imaginary)
        across.append(errors.of_sum(weights))
    z, frequencies, off = np.stack(phasors), [system[0] for system in systems], np.stack(across)
    depths = depth(z, frequencies, np.sqrt((off**2).sum(axis=1)))
    growth = _growth(z, np.array(frequencies), off)
    return RangeImage(
        method=method,
        amplitude=depths.amplitude.reshape(shape),
        distance_m=depths.distance_m.reshape(shape),
        standard_error_m=(growth * depths.standard_error_m).reshape(shape),
        confidence=depths.confidence.reshape(shape),
        longest_m=depths.longest_m,
    )


def _growth(phasors: NDArray[np.complex128], frequencies: Array, across: Array) -> Array:
    """Error of the mean distance of several frequencies, weighted by precision, over that of
    independent errors; ``across`` (n_frequencies, n_components, n).
    """
    per_m = (np.abs(phasors) * frequencies[:, None])[:, None]
    noise = (across**2).sum(axis=1, keepdims=True)
    weight = np.divide(per_m, noise, out=np.zeros_like(per_m), where=noise > 0)
    alone = (weight * per_m).sum(axis=(0, 1))
    tied = ((weight * across).sum(axis=0) ** 2).sum(axis=0)
    return np.sqrt(np.divide(tied, alone, out=np.ones_like(alone), where=tied > 0))


def _from_gates(method: str, images: Array, errors: ShutterErrors, record: SpiRecord) -> RangeImage:
    shape, flat = images.shape[1:], (images.reshape(len(images), -1), errors.of_shutters)
    gates = np.array([(one.gate_delay_s, one.gate_width_s) for one in record.shutters])
    stated = record.pulse_width_s > 0
    scan = isinstance(record.patterns, RasterScan) and record.patterns.mode == "plain"
    over_background = scan and gates_tell_background(record)
    echoes = (
        echo(*flat, gates, record.pulse_width_s, background=over_background)
        if stated
        else _brightest(*flat, gates)
    )
    if stated:  # that no error depends on another's was taken for granted
        moves = delay_weights(echoes, flat[1], gates, record.pulse_width_s)
        alone = np.sqrt(((moves * flat[1]) ** 2).sum(axis=0))
        tied = np.sqrt((errors.of_sum(moves) ** 2).sum(axis=0))
        growth = np.divide(tied, alone, out=np.ones_like(alone), where=alone > 0)
        echoes = replace(echoes, error_s=growth * echoes.error_s)
    lit = echoes.amplitude > 0
    distance, error, confidence, amplitude = (
        values.reshape(shape)
        for values in (
            np.where(lit, C_M_PER_S / 2 * echoes.delay_s, np.nan),
            np.where(lit, C_M_PER_S / 2 * echoes.error_s, np.inf),
            np.where(lit, echoes.confidence, 0.0),
            echoes.amplitude,
        )
    )
    return RangeImage(
        method=method,
        amplitude=amplitude,
        distance_m=distance,
        standard_error_m=error,
        confidence=confidence,
        longest_m=float(C_M_PER_S / 2 * gates.sum(axis=1).max()),
        warnings=() if stated else (PULSE_UNKNOWN,),
    )


def _brightest(images: Array, errors: Array, gates: Array) -> Echo:
    """The middle of the brightest gate, less half of a pulse of unknown length.

    A gate g takes a pulse w in full or in part over beginnings spread about its middle less w / 2
    with variance (g^2 + w^2) / 12. Of all w from 0 to g: mean g/2 - g/4; g^2 (1/12 + 1/36), and
    g^2/48 for the middles. Confidence: the probability that noise alone did not make it brighter
    than the next one.
    """
    from scipy.special import ndtr  # takes 0.1 s to import

    order = np.argsort(-images, axis=0)
    amplitude, second = np.take_along_axis(images, order[:2], axis=0)[[0, -1]]
    both = np.hypot(*np.take_along_axis(errors, order[:2], axis=0)[[0, -1]])
    lead = amplitude - second if len(images) > 1 else np.maximum(amplitude, 0)
    ratio = np.divide(lead, both, out=np.where(lead > 0, np.inf, 0.0), where=both > 0)
    delay, width = gates[order[0]].T
    spread = width * np.sqrt(1 / 12 + 1 / 36 + 1 / 48)
    return Echo(amplitude, delay + width / 4, spread, ndtr(ratio))

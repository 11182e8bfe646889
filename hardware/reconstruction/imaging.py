"""From a record to an image, by any method."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.blas import one_blas_thread
from hardware.described import Described
from hardware.errors import InputError, check_kind
from hardware.patterns import OwnPatterns, Patterns, PatternSet, RasterScan
from hardware.reconstruction.measurements import Measurements, measurements, with_level
from hardware.reconstruction.motion.compensated import (
    ERRORS_IN_95,
    MovingScene,
    check_known,
    check_reference,
    motion_found,
    moving_scene,
)
from hardware.reconstruction.motion.estimation import Search
from hardware.reconstruction.motion.knobs import STANDARD, Compensation
from hardware.reconstruction.motion.model import Motion
from hardware.reconstruction.negative_light import beyond_all_light, negative_light
from hardware.reconstruction.no_light import without_light
from hardware.reconstruction.noise import errors_in_95_of_noise, finest_patterns, is_full
from hardware.reconstruction.own_method import method_of
from hardware.reconstruction.registry import Array, Method, Solve
from hardware.reconstruction.scanning import BACKGROUND_IN_IMAGE, gates_tell_background
from hardware.reconstruction.sensing import Mixing, Sensing
from hardware.reconstruction.unequal_arms import unequal_arms
from hardware.records import Flag, SpiRecord
from hardware.records.container import unknown_flags

LEVEL_UNKNOWN = (
    "the level of the image is unknown, its mean is set to 0: the pattern that lights all cells "
    "is not among those received"
)
LEVEL_UNMEASURED = (
    "the level of the image is unknown, its mean is set to 0: no pattern tells light of all cells"
)
#: Standard errors of the plain inverse by which smoothing moves a cell of noise in one image of
#: 100 000 with 4096 cells.
_MOVED = 6.0


def fits_in_memory(name: str, patterns: Patterns) -> bool:
    """Whether a method's matrices for a set of patterns fit into memory."""
    from hardware.reconstruction.walsh_blocks import MOST_BYTES, bytes_needed

    if isinstance(patterns, RasterScan):
        return True
    if not isinstance(patterns, PatternSet):  # the matrix, its eigenvectors, both in cells
        return 8 * patterns.count * (3 * patterns.n_cells + 2 * patterns.count) <= MOST_BYTES
    subset = patterns.count < patterns.n_cells
    shape = (patterns.rows, patterns.columns)
    return name != "lmmse" or not subset or bytes_needed(shape, patterns.indices) <= MOST_BYTES


@dataclass(frozen=True, eq=False, repr=False)
class Reconstruction(Described):
    """An image with its uncertainty.

    ``image`` and ``standard_error`` have shape ``(n_detectors, rows, columns)``, in the
    photo-electrons that a cell, lit alone for one exposure, would give; NaN in cells that the
    patterns do not measure (`PatternSet.unmeasured_cells`), of which a warning tells.
    ``standard_error`` is None where the method gives none. Of ``lmmse``, ``zero-fill`` and
    ``least-squares`` it holds noise and what the patterns do not see; about 95 % of the cells lie
    within ``errors_in_95`` of them in the mean over images, 1.96 where errors are normal and many
    values tell them (`hardware.reconstruction.standard_error`); NaN, of which a warning tells,
    where the patterns measure a single sum of the cells. ``noise_electrons`` is the noise of one
    measurement, as found in the record itself; NaN where the record does not tell it from detail
    (`hardware.reconstruction.measurements`). Standard errors hold ``most_noise_electrons``, the
    most that it can be; both are NaN, of which a warning tells, where no two exposures show it.
    ``level_error_electrons``, by detector, is what all cells of an image may be too low by
    together, where no pattern tells their mean; else 0. ``motion`` is what the image was
    compensated for, None where nothing moved.
    """

    method: str
    image: NDArray[np.float64]
    standard_error: NDArray[np.float64] | None
    errors_in_95: float
    noise_electrons: NDArray[np.float64]
    most_noise_electrons: NDArray[np.float64]
    level_error_electrons: NDArray[np.float64]
    warnings: tuple[str, ...]
    motion: Motion | None = None

    @property
    def picture(self) -> NDArray[np.float64]:
        """All detectors' images side by side, ``(rows, n_detectors * columns)``."""
        return np.hstack(list(self.image))


@one_blas_thread()
def reconstruct(
    record: SpiRecord,
    method: str | Method | Solve = "lmmse",
    *,
    mixing: Mixing | None = None,
    motion: Motion | Search | None = None,
    compensation: Compensation = STANDARD,
    reference_ns: int | None = None,
) -> Reconstruction:
    """Reconstruct an image from a record, in one thread unless ``OPENBLAS_NUM_THREADS`` says
    otherwise: those of BLAS wait for each other on a machine with other work.

    Parameters
    ----------
    record
        From the twin or from a device.
    method
        A name in `METHODS`, or a user's own: a function of (values, noise_variance, sensing), or
        ``file.py:function``, see `method_of`. Default: linear minimum mean-square error under a
        1/f^2 prior, noise level taken from the record.
    mixing
        Calibrated map from image cells to emitter elements, where these are no clean grid.
    motion
        How the image moved while it was measured; None: it is taken as at rest. The image is then
        that of the reference time. A `Search`: the shift that the measurements themselves tell,
        none where they tell no more than rest does. ``lmmse`` and ``tv`` solve for the moving image
        itself; other methods take the measurements as they would be at rest
        (`hardware.reconstruction.motion.compensated`).
    compensation
        Knobs of motion compensation.
    reference_ns
        Reference time of the motion on the device's clock; None: the middle of the record.

    Patterns that were lost on their way are left out, as if they had not been asked for. Where the
    one that lights all cells is missing (Hadamard row 0), the level of the image is unknown: its
    mean is 0, a warning says so, and the standard error holds the most that the level can be, all
    light that arrived. Of reference sets the all-lit reference stands for it; plain sets and
    S-matrices need it.

    The same record gives the same bits, as long as BLAS runs with as many threads: how it splits
    sums over them changes LMMSE, and what starts from it (FISTA, TV, patches), by 1e-13 of the
    image's range. ``OPENBLAS_NUM_THREADS=1`` fixes it.

    Raises InputError for an unknown method, a mixing that does not fit, patterns whose matrices
    would not fit into memory, a record in which too much is lost, or a motion that does not fit the
    image or moves it too far.

    A camera of 1 electron a count before one bright cell, in background:

    >>> from hardware.records.state import AT_ORIGIN
    >>> patterns, cells = PatternSet(8, 8, 64), np.zeros(64)
    >>> cells[27] = 1e4
    >>> light, n = 500 + patterns.signal(cells), patterns.n_exposures
    >>> record = SpiRecord(
    ...     counts=np.rint(light)[:, None].astype(np.int32),
    ...     device_time_ns=np.arange(n),
    ...     sequence=np.arange(n, dtype=np.uint32),
    ...     flags=np.zeros(n, np.uint8),
    ...     patterns=patterns,
    ...     integration_time_s=1e-4,
    ...     electrons_per_count=1.0,
    ...     offset_counts=0.0,
    ...     adc_bits=16,
    ...     device="by hand",
    ...     pose=AT_ORIGIN,
    ... )
    >>> found = reconstruct(record, "zero-fill")
    >>> found.image.shape, int(found.image.argmax()), round(float(found.image.max()))
    ((1, 8, 8), 27, 10000)
    """
    check_kind("record", record, SpiRecord, "hardware.read_record")
    check_kind("compensation", compensation, Compensation, "hardware.Compensation()")
    check_reference(record, reference_ns)
    solve = method_of(method)
    received, sensing, measured = measured_part(record, mixing)
    variance, most = measured.noise_variance, measured.most_noise_variance
    moving, told_of_search = None, tuple[str, ...]()
    if motion is not None:
        if not isinstance(motion, Motion | Search):
            raise InputError(
                f"motion: {type(motion).__name__}, expected a motion, Search() to find one in the "
                "measurements, or None"
            )
        check_known(record.patterns, mixing)
        arrived = record.received
        if isinstance(motion, Search):
            motion, told_of_search = motion_found(record, arrived, variance, motion, reference_ns)
    if motion is not None:
        moving = moving_scene(record, arrived, variance, motion, compensation, reference_ns)
    told_of_motion: tuple[str, ...] = ()
    if moving:
        cells, error, told_of_motion = _compensated(solve, moving, measured, sensing)
    else:
        cells, error = _at_rest(solve, measured, sensing)
    error = _of_all_noise(error, measured, sensing)
    shape, told = (-1, *sensing.shape), sensing.measured[:, None]
    return Reconstruction(
        method=solve.name,
        image=np.where(told, cells, np.nan).T.reshape(shape),
        standard_error=None if error is None else np.where(told, error, np.nan).T.reshape(shape),
        errors_in_95=max(
            ERRORS_IN_95 if moving else solve.errors_in_95(sensing),
            errors_in_95_of_noise(received.patterns),
        ),
        noise_electrons=np.sqrt(np.where(measured.noise_told, variance, np.nan)),
        most_noise_electrons=np.sqrt(most),
        level_error_electrons=measured.most_level * (not sensing.measures_level),
        warnings=(
            *_flagged(record),
            *_unmeasured(sensing),
            *_with_background(received),
            *_without_scatter(received, most),
            *without_light(received, sensing, measured),
            *_without_detail(error, most),
            *negative_light(received, measured),
            *beyond_all_light(received, measured),
            *unequal_arms(received, sensing),
            *told_of_search,
            *(told_of_motion if moving else _smoothed(cells, measured, sensing)),
        ),
        motion=moving.motion if moving else None,
    )


def measured_part(
    record: SpiRecord, mixing: Mixing | None = None
) -> tuple[SpiRecord, Sensing, Measurements]:
    """What arrived of a record, which sums of cells it measures, and their values. Raises
    InputError where no cell has a value.
    """
    received = with_level(record.received)
    sensing = Sensing(received.patterns, mixing)
    if not sensing.measured.any():
        raise InputError(
            f"patterns: all alike, no cell has a value: {received.patterns.count} of those shown "
            "arrived"
        )
    return received, sensing, measurements(received)


def solved_image(
    solve: Method, measured: Measurements, sensing: Sensing
) -> tuple[Array, Array | None]:
    """Cells of a scene at rest and their standard errors, which hold the most noise that there can
    be, ``(n_cells, n_images)``.
    """
    cells, error = _at_rest(solve, measured, sensing)
    return cells, _of_all_noise(error, measured, sensing)


def _at_rest(solve: Method, measured: Measurements, sensing: Sensing) -> tuple[Array, Array | None]:
    """`solved_image` with what noise there is in each measurement alone."""
    variance, most = measured.noise_variance, measured.most_noise_variance
    cells, error = _solved(solve, measured.values, variance, sensing)
    if error is not None and (most > variance).any():
        of_most = _solved(solve, measured.values, most, sensing)[1]
        error = _of_unsmoothed(error, of_most, measured, sensing)
    return cells, error


def _of_all_noise(error: Array | None, measured: Measurements, sensing: Sensing) -> Array | None:
    """Standard errors with those of the constant and of the level, NaN where noise is unknown."""
    if error is None:
        return None
    error = np.hypot(error, _error_of_the_constant(measured.constant_variance, sensing))
    if not sensing.measures_level:
        error = np.hypot(error, measured.most_level)
    return np.where(np.isnan(measured.most_noise_variance), np.nan, error)


def _solved(
    solve: Method, values: Array, variance: Array, sensing: Sensing
) -> tuple[Array, Array | None]:
    """Cells and standard errors of all detectors, ``(n_cells, n_detectors)``."""
    if solve.joint:
        return solve(values, variance, sensing)
    solved = [solve(y, float(s), sensing) for y, s in zip(values.T, variance, strict=True)]
    errors = [error for _, error in solved if error is not None]
    cells = np.stack([cells for cells, _ in solved], axis=1)
    return cells, np.stack(errors, axis=1) if errors else None


def _of_unsmoothed(
    error: Array, of_most: Array | None, measured: Measurements, sensing: Sensing
) -> Array | None:
    """Standard errors for the most noise there can be, ``(n_cells, n_detectors)``: those of an
    image that is smoothed for it, ``of_most``; where a full set, or almost, does not tell noise
    from detail, its image is not smoothed, and has all of that noise.
    """
    told, most = measured.noise_variance, measured.most_noise_variance
    if of_most is None or not is_full(sensing.count, sensing.n_cells):
        return of_most
    grown = error * np.sqrt(np.divide(most, told, out=np.ones_like(most), where=told > 0))
    if sensing.count < sensing.n_cells:  # what is unseen does not grow with the noise
        beside = np.hypot(error, np.sqrt(_noise_of_plain_inverse(sensing)[:, None] * most))
        grown = np.where(told > 0, np.fmin(grown, beside), beside)
    return np.where(measured.noise_told, of_most, np.fmax(of_most, grown))


def _noise_of_plain_inverse(sensing: Sensing) -> Array:
    """Variance of each cell, (n_cells,), per variance of a measurement."""
    if not sensing.is_dense:  # rows of length n
        return np.full(sensing.n_cells, sensing.count / sensing.n_cells**2)
    inverse = sensing.pseudo_inverse
    return np.asarray(np.einsum("ij,ij->i", inverse, inverse))


def _compensated(
    solve: Method, moving: MovingScene, measured: Measurements, sensing: Sensing
) -> tuple[Array, Array | None, tuple[str, ...]]:
    """Cells and standard errors of a moving scene, ``(n_cells, n_detectors)``, and warnings."""
    if solve.name == "lmmse":
        return moving.linear(measured.most_noise_variance)
    if solve.name == "tv":
        cells, told = moving.edges()
        return cells, None, told
    values, told = moving.at_rest(sensing.indices)
    cells, _ = _solved(solve, values, measured.noise_variance, sensing)
    return cells, None, told


def _error_of_the_constant(variance: Array, sensing: Sensing) -> Array:
    """What the noise of the constant that is taken from all values adds, ``(n_cells, n_detectors)``
    or 0: through the plain inverse all of it meets the cells on which all patterns agree.

    Of two references it is half the variance of a value; of plain sets and S-matrices that of the
    mean of the finest values, in which each of them is itself, with the detail that they hold.
    """
    patterns = sensing.patterns
    if not isinstance(patterns, PatternSet) or patterns.mode in ("differential", "complementary"):
        return np.zeros((1, 1))
    constant = sensing.adjoint(np.ones(sensing.count)) / sensing.largest_squared
    of_value = constant**2 / 2
    if patterns.mode != "reference":
        finest = finest_patterns(patterns)
        share = np.zeros(sensing.count)
        share[finest] = 1 / max(finest.size, 1)
        own = sensing.adjoint(share) / sensing.largest_squared
        of_value = np.maximum(constant**2 / max(finest.size, 1) - 2 * constant * own, 0.0)
    return np.asarray(np.sqrt(of_value)[:, None] * np.sqrt(variance))


def marked_exposures(record: SpiRecord) -> Iterator[str]:
    """Exposures whose counts are not the light's: marked by the device, or at a rail."""
    n = record.flags.size
    for flag in Flag:
        if flag.name and (bad := int(np.count_nonzero(record.flags & flag))):
            yield f"{bad} of {n} exposures are marked {flag.name.lower()}"
    yield from unknown_flags(record.flags, "exposures")
    if at_rail := record.n_at_rail:
        yield (
            f"{at_rail} of {n} exposures stand at an end of the converter's range, 0 or "
            f"{2**record.adc_bits - 1}, and are not marked saturated"
        )


def _flagged(record: SpiRecord) -> Iterator[str]:
    yield from marked_exposures(record)
    yield from record.time_warnings
    if left_out := record.n_left_out:
        yield (
            f"{left_out} of {record.flags.size + left_out} exposures that the device numbered are "
            "not in the record: the image is right only if their patterns are left out as well"
        )


def _with_background(record: SpiRecord) -> Iterator[str]:
    """Of a plain scan whose gates do not tell it."""
    scan = isinstance(record.patterns, RasterScan) and record.patterns.mode == "plain"
    if scan and not gates_tell_background(record):
        yield BACKGROUND_IN_IMAGE


def _unmeasured(sensing: Sensing) -> Iterator[str]:
    if not sensing.measures_level:
        own = isinstance(sensing.patterns, OwnPatterns)
        yield LEVEL_UNMEASURED if own else LEVEL_UNKNOWN
    if unknown := int(np.count_nonzero(~sensing.measured)):
        lit = "no pattern lights"
        if sensing.patterns.mode == "plain" and isinstance(sensing.patterns, PatternSet):
            lit = "every pattern lights"
        if isinstance(sensing.patterns, OwnPatterns):
            lit = "all patterns light alike"
        yield f"{unknown} of {sensing.n_cells} cells have no value: what {lit} is not measured"


def _without_scatter(record: SpiRecord, most: Array) -> Iterator[str]:
    if np.isnan(most).any():
        yield (
            f"noise and standard errors are unknown: {record.patterns.count} patterns show neither "
            "scatter nor detail"
        )


def _without_detail(error: Array | None, most: Array) -> Iterator[str]:
    """Where noise is known, but not what is unseen."""
    if error is not None and (np.isnan(error).all(axis=0) & ~np.isnan(most)).any():
        yield (
            "standard errors are unknown: the patterns measure a single sum of the cells, which "
            "tells nothing of the detail that they do not see"
        )


def _smoothed(cells: Array, measured: Measurements, sensing: Sensing) -> Iterator[str]:
    """Where smoothing a full set that shows nothing twice took more than noise does."""
    patterns = sensing.patterns
    if isinstance(patterns, RasterScan):
        return
    paired = patterns.mode in ("differential", "complementary")
    if paired or sensing.is_dense or not measured.noise_told.any():
        return
    plain = sensing.adjoint(measured.values) / sensing.n_cells
    noise = np.sqrt(measured.noise_variance / sensing.n_cells)
    shown_apart = sensing.measured & ~patterns.common_cells  # the references' noise is there
    moved = np.abs(cells - plain)[shown_apart] > _MOVED * noise
    if few := int(np.count_nonzero(moved & measured.noise_told)):
        yield (
            f"smoothing moved {few} cells by more than {_MOVED:g} times their noise: detail that "
            "this record does not tell from noise is lost (zero-fill keeps it)"
        )

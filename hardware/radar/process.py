"""From a burst of a record to a point cloud: range, rate, direction, cross-section, and the map."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hardware.blas import one_blas_thread
from hardware.described import Described
from hardware.errors import check_kind
from hardware.radar.ambiguity import resolve_delay_rates
from hardware.radar.angles import direction
from hardware.radar.array_plane import ArrayPlane
from hardware.radar.burst import DemodulatedBurst, demodulate
from hardware.radar.cfar import with_fitted_shape
from hardware.radar.clutter import too_few_slots, without_static
from hardware.radar.demodulation import Complex
from hardware.radar.detection import Detection, detect_echoes, with_cross_section
from hardware.radar.detection_warnings import (
    ambiguous,
    beside_the_reference,
    coupled_ranges,
    left_to_rounding,
    lost_at_rest,
    mixed_directions,
    moving_side_lobes,
    of_the_map,
    scattered_phases,
    shifted_ranges,
    targets_of_two_slots,
    too_many,
    untested_rates,
    without_directions,
)
from hardware.radar.integrity import UnusableBurstError, told_left_out, unusable_bursts
from hardware.radar.k_distribution import ClutterFit, fit
from hardware.radar.leakage_noise import with_noise_of_its_cell
from hardware.radar.measurement import EchoMeasurement
from hardware.radar.moving import moving_echoes, without_static_echoes
from hardware.radar.own_detection import detection_of
from hardware.radar.range_doppler import RangeDopplerMap, range_doppler
from hardware.radar.sensitivity import clutter_between_echoes
from hardware.radar.settings import Processing
from hardware.radar.several_directions import CellTarget, check_per_cell, targets_of_cell
from hardware.radar.slot_phases import (
    beyond_phases,
    most_of_spread,
    with_phases_of_turns,
    with_rate_error,
    with_spread_of_others,
)
from hardware.radar.split_echoes import split_targets
from hardware.radar.stitching import errors_beside_reference
from hardware.radar.windows import noise_gain
from hardware.radar.within_symbols import without_doppler_within_symbols
from hardware.waveform import C_M_PER_S, OfdmWaveform

if TYPE_CHECKING:
    from hardware.records.radar import RadarRecord

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False)
class Frame(Described):
    """Result of one burst: detections, strongest first, the map, and warnings.

    ``middle_ns``: device clock in the middle of what was processed, when targets are where they are
    told.
    ``clutter``: deviation of the map from noise, which thresholds assume unless `Cfar` has a shape.
    ``detection``: name of a user's own detection, with a digest of its source.
    """

    burst: int
    middle_ns: int
    detections: tuple[Detection, ...]
    image: RangeDopplerMap
    waveform: OfdmWaveform
    whole: bool
    warnings: tuple[str, ...]
    clutter: ClutterFit
    detection: str = ""

    @property
    def by(self) -> str:
        """Name of a user's own detection, for messages; empty for the bundled one."""
        return f" by {self.detection}" if self.detection else ""


@one_blas_thread()
def process(
    record: "RadarRecord",
    burst: int = 0,
    how: Processing | None = None,
    *,
    waveform: OfdmWaveform | None = None,
) -> Frame:
    """Detect the targets of one burst.

    ``waveform``: the waveform that the caller expects; InputError when it is not the record's.

    An echo of 20 m, at rest, in noise of 30 counts:

    >>> import numpy as np
    >>> from hardware.records import QuaternionPose, RadarFrontEnd, RadarRecord
    >>> wave = OfdmWaveform(79e9, 256, 4e6, 64, 4e-6, repeats=8, prefix_s=0.5e-6)
    >>> frequency_hz = wave.carrier_hz + wave.frequency_offsets_hz
    >>> channel = np.exp(-2j * np.pi * frequency_hz * 2 * 20.0 / 299_792_458)
    >>> echo = 16 * np.fft.ifft(np.fft.ifftshift(wave.sent() * channel))
    >>> iq = np.random.default_rng(0).normal(0, 30, (1, 1, 64, 1, 256, 2))
    >>> iq += 100 * np.stack([echo.real, echo.imag], axis=-1)
    >>> record = RadarRecord(
    ...     iq=np.rint(iq).astype(np.int16),
    ...     device_time_ns=4000 * np.arange(64).reshape(1, 1, 64),
    ...     flags=np.zeros((1, 1, 64), np.uint8),
    ...     carriers_hz=np.array([wave.carrier_hz]),
    ...     transmitter=np.zeros(64, np.uint8),
    ...     waveform=wave,
    ...     front_end=RadarFrontEnd(root_watt_per_count=1e-9, transmit_power_w=0.01),
    ...     device="by hand",
    ...     pose=(QuaternionPose.from_numbers([0, 0, 0, 1, 0, 0, 0]),),
    ... )
    >>> [detection] = process(record).detections
    >>> f"{detection.range_m:.2f} m, {detection.range_rate_m_per_s:.1f} m/s"
    '20.00 m, 0.0 m/s'
    """
    how = _settings(how)
    interval = demodulate(
        record,
        burst,
        waveform=waveform,
        precision=how.precision,
        leakage=how.leakage,
        reference_delay_s=how.reference_delay_s,
        range_rate_m_per_s=how.range_rate_m_per_s,
    )
    channel = interval.channel
    if how.moving_only:
        if told := too_few_slots(channel.shape[-1]):
            raise UnusableBurstError(f"burst {burst}: {told}")
        channel = without_static(channel)
    image = range_doppler(
        channel,
        interval.waveform,
        how.window,
        oversampling=how.oversampling,
        relative_noise=interval.relative_noise,
    )
    even = image.power_w
    if image.relative_noise is not None:
        even = even / image.relative_noise
    gain = noise_gain(how.window, channel.shape[-2:])
    # Number of correlated cells that exceed a level together: 7 for blackmanharris, 1 without one.
    clutter = fit(even, image.n_channels, gain**1.4)
    own = None if how.detection is None else detection_of(how.detection)
    points: Sequence[Detection]
    if own is None:
        points, warnings = _detections(channel, interval, image, even, clutter, how, burst)
    else:
        points = own(channel, interval.waveform, image)
        warnings = too_many(burst, len(points), how)
        points = points[: how.at_most]
    return Frame(
        burst=burst,
        middle_ns=interval.middle_ns,
        detections=tuple(
            with_cross_section(
                point,
                interval.waveform,
                record.front_end.transmit_power_w,
                record.front_end.antenna_gain_dbi,
                record.front_end.losses_db,
            )
            for point in points
        ),
        image=image,
        waveform=interval.waveform,
        whole=interval.whole,
        warnings=(
            *interval.warnings,
            *left_to_rounding(record, burst, interval, image.noise_w / gain),
            *warnings,
        ),
        clutter=clutter,
        detection=own.name if own else "",
    )


def _settings(how: Processing | None) -> Processing:
    """None: the default. Raises InputError for anything else that is no `Processing`."""
    how = Processing() if how is None else how
    check_kind("how", how, Processing, "hardware.Processing")
    return how


def _detections(
    channel: Complex,
    interval: DemodulatedBurst,
    image: RangeDopplerMap,
    even: NDArray[np.floating],
    clutter: ClutterFit,
    how: Processing,
    burst: int,
) -> tuple[list[Detection], list[str]]:
    """Detections by CFAR and refinement, and warnings."""
    if how.per_cell > 1:
        check_per_cell(how.per_cell, interval)
    echoes, variance, warnings = _echoes(channel, interval, image, even, clutter, how, burst)
    plane = ArrayPlane.of(interval)
    cells = [_points(echo, interval, plane, how.per_cell, variance) for echo in echoes]
    points = [point for cell, _ in cells for point in cell]
    if len(points) > len(cells):
        points.sort(key=lambda point: -point.power_w)
        warnings += too_many(burst, len(points), how)
        points = points[: how.at_most]
    warnings += [
        *(without_directions(interval) if plane is None and points else []),
        *mixed_directions([fits for _, fits in cells], how),
        *shifted_ranges(points, interval.waveform, how),
        *beside_the_reference(points, interval),
        *moving_side_lobes(points, interval, how),
    ]
    return points, [*warnings, *ambiguous(points)]


def _echoes(
    channel: Complex,
    interval: DemodulatedBurst,
    image: RangeDopplerMap,
    even: NDArray[np.floating],
    clutter: ClutterFit,
    how: Processing,
    burst: int,
) -> tuple[list[EchoMeasurement], float, list[str]]:
    """Echoes with their ranges and rates, the variance of the phases of slots, and warnings."""
    cfar = with_fitted_shape(even, how.cfar, image.n_channels)
    if how.cfar.shape == "fitted" and how.window != "boxcar":
        plain = clutter_between_echoes(channel, interval.waveform, image, how.window)
        if not plain.is_noise:
            cfar = replace(cfar, shape=min(cfar.shape, plain.shape))
    # Twice as many, since duplicates are removed afterwards and the limit must still be noticed.
    echoes = detect_echoes(channel, interval.waveform, image, cfar, how.window, 2 * how.at_most)
    n_peaks = len(echoes)
    echoes, variance = beyond_phases(
        echoes, interval, how.cfar.false_alarm, beside_static=how.moving_only
    )
    scattered = scattered_phases(burst, variance, n_peaks - len(echoes))
    noise_w = image.noise_w / noise_gain(how.window, channel.shape[-2:])
    if how.moving_only:  # the mean over slots took as much of the noise as one of them
        noise_w *= channel.shape[-1] / (channel.shape[-1] - 1)
    fastest = _fastest(how)
    if how.moving_only:  # rates are off by up to half a cell until they are measured anew
        fastest += interval.waveform.delay_rate_cell / 2
    echoes = resolve_delay_rates(channel, interval.waveform, echoes, noise_w, fastest)
    warnings = [
        *too_many(burst, len(echoes), how),
        *of_the_map(burst, image, how, clutter),
        *scattered,
    ]
    if echoes:
        warnings += [
            *untested_rates(interval.waveform, how),
            *targets_of_two_slots(interval.waveform, how),
            *coupled_ranges(interval, how),
        ]
    echoes = echoes[: how.at_most]
    echoes, lost = _told_apart(echoes, channel, interval, variance, noise_w, how)
    echoes = with_spread_of_others(echoes, interval, variance, beside_static=how.moving_only)
    return echoes, variance, [*warnings, *lost]


def _told_apart(
    echoes: list[EchoMeasurement],
    channel: Complex,
    interval: DemodulatedBurst,
    variance: float,
    noise_w: float,
    how: Processing,
) -> tuple[list[EchoMeasurement], list[str]]:
    """What moves apart from what rests, and targets of one range cell apart, as far as is asked
    for; and warnings of what is lost.
    """
    false_alarm, fastest = how.cfar.false_alarm, _fastest(how)
    warnings: list[str] = []
    if how.moving_only:
        echoes, n_lost = moving_echoes(
            echoes, channel, interval.waveform, noise_w, false_alarm, fastest=fastest
        )
        warnings = lost_at_rest(n_lost)
    if how.resolve:
        spread = partial(most_of_spread, echoes, interval, variance, false_alarm, how.moving_only)
        echoes = split_targets(
            echoes,
            channel,
            interval.waveform,
            noise_w,
            false_alarm,
            fastest=fastest,
            beside_static=how.moving_only,
            least_at=spread if variance else None,
        )
    if how.moving_only:
        echoes = without_static_echoes(echoes, interval.waveform)
    return echoes, warnings


def _fastest(how: Processing) -> float:
    """Delay rate of the fastest target."""
    return 2 / C_M_PER_S * how.fastest_m_per_s


def frames(
    record: "RadarRecord",
    how: Processing | None = None,
    *,
    waveform: OfdmWaveform | None = None,
) -> Iterator[Frame]:
    """Results of all bursts but the `unusable_bursts`, of which the first warns.

    Raises UnusableBurstError where there is none, and as `process`.
    """
    settings, n_bursts = _settings(how), len(record.iq)
    unusable = unusable_bursts(record, settings.window, moving_only=settings.moving_only)
    if len(unusable) == n_bursts:
        raise UnusableBurstError(unusable.get(0, "iq: no burst in the record"))
    warnings = (told_left_out(unusable, n_bursts),) if unusable else ()
    for burst in (number for number in range(n_bursts) if number not in unusable):
        frame = process(record, burst, how, waveform=waveform)
        yield replace(frame, warnings=(*warnings, *frame.warnings)) if warnings else frame
        warnings = ()


def _points(
    echo: EchoMeasurement,
    interval: DemodulatedBurst,
    plane: ArrayPlane | None,
    per_cell: int,
    variance: float,
) -> tuple[list[Detection], bool]:
    """The detection of an echo with its direction, or several of `targets_of_cell`, and whether
    their directions leave noise alone.

    The array may exclude rates that migration cannot. ``plane``: of the array, None where it tells
    no directions. ``variance``: of the phases of slots.
    """
    echo = with_rate_error(with_noise_of_its_cell(echo, interval), interval, variance)
    if plane is None:
        return [_detection(echo, interval)], True
    measured = not np.isnan(echo.delay_rate)
    rates = (echo.delay_rate if measured else 0.0, *echo.delay_rate_alternatives)
    noise = with_phases_of_turns(echo.noise, echo.amplitude, interval, variance)
    bearing = direction(echo.amplitude, interval, rates, noise, plane)
    if per_cell > 1 and not bearing.fits:
        cell = targets_of_cell(echo.amplitude, interval, rates, noise, per_cell)
        if cell.targets:
            others = tuple(rate for rate in rates if rate != cell.delay_rate)
            point = _detection(_at_rate(echo, cell.delay_rate, others), interval)
            return [_one_of(point, target, echo.power_w) for target in cell.targets], cell.fits
    echo = _at_rate(echo, bearing.delay_rate, bearing.delay_rate_alternatives)
    point = replace(
        _detection(echo, interval),
        azimuth_rad=bearing.azimuth_rad,
        azimuth_error_rad=bearing.azimuth_error_rad,
        elevation_rad=bearing.elevation_rad,
        elevation_error_rad=bearing.elevation_error_rad,
        azimuth_alternatives_rad=tuple(other.azimuth_rad for other in bearing.alternatives),
        elevation_alternatives_rad=tuple(other.elevation_rad for other in bearing.alternatives),
    )
    return [point], bearing.fits


def _at_rate(
    echo: EchoMeasurement, delay_rate: float, alternatives: tuple[float, ...]
) -> EchoMeasurement:
    """An echo with another of its rates, where one is measured."""
    measured = not np.isnan(echo.delay_rate)
    return replace(
        echo,
        delay_rate=delay_rate if measured else float("nan"),
        delay_rate_alternatives=alternatives,
    )


def _detection(echo: EchoMeasurement, interval: DemodulatedBurst) -> Detection:
    """The detection of an echo, without a direction."""
    point = Detection.of(without_doppler_within_symbols(echo, interval.waveform))
    beside_m = beside_w = 0.0
    if not np.isnan(interval.joined_by_s):
        away_s = echo.delay_s - interval.joined_by_s
        cells, share = errors_beside_reference(away_s / interval.waveform.delay_cell_s)
        beside_m, beside_w = cells * interval.waveform.range_cell_m, share * point.power_w
    return replace(
        point,
        range_error_m=float(
            np.linalg.norm([point.range_error_m, interval.range_error_m, beside_m])
        ),
        power_error_w=float(np.hypot(point.power_error_w, beside_w)),
    )


def _one_of(point: Detection, target: CellTarget, power_w: float) -> Detection:
    """One target of a cell whose power is ``power_w`` and whose detection as one is ``point``."""
    share = target.power_w / power_w
    return replace(
        point,
        power_w=share * point.power_w,
        power_error_w=target.power_error_w / power_w * point.power_w,
        snr_db=point.snr_db + 10 * float(np.log10(share)),
        azimuth_rad=target.azimuth_rad,
        azimuth_error_rad=target.azimuth_error_rad,
        azimuth_alternatives_rad=target.alternatives_rad,
        elevation_alternatives_rad=(float("nan"),) * len(target.alternatives_rad),
    )

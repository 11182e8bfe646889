"""From a burst of a record to a point cloud: range, rate, direction, cross-section, and the map."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hardware.radar.ambiguity import unfolded
from hardware.radar.angles import compensated, direction, extents, virtual_places
from hardware.radar.burst import Burst, demodulate
from hardware.radar.cfar import fitted
from hardware.radar.cfar_rule import Cfar
from hardware.radar.clutter import without_static
from hardware.radar.demodulation import Complex, Precision
from hardware.radar.detection import (
    Detection,
    Measured,
    detected,
    distinct,
    with_cross_section,
)
from hardware.radar.k_distribution import ClutterFit, fit
from hardware.radar.music import music
from hardware.radar.own_detection import Detect, OwnDetection, detection_of
from hardware.radar.range_doppler import RangeDopplerMap, range_doppler
from hardware.radar.sensitivity import clutter_between_echoes
from hardware.radar.superresolution import resolve
from hardware.radar.windows import noise_gain
from hardware.waveform import OfdmWaveform

if TYPE_CHECKING:
    from hardware.records.radar import RadarRecord

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Processing:
    """What is done with a burst.

    Parameters
    ----------
    window, oversampling
        See `range_doppler`.
    cfar, at_most
        How detections are told from noise, and how many are kept, strongest first.
    precision
        Of demodulation and map: ``single`` takes half the time, see `Precision`. Ranges, rates
        and phases are found in double precision either way.
    leakage
        Take the record's leakage away, where its delay is known.
    moving_only
        Take everything away that stands still.
    resolve
        Split detections into targets nearer than a cell, see `resolve`.
    per_cell
        Targets of one range and rate that `music` tells apart by angle; 1 is plain beamforming.
    reference_delay_s, range_rate_m_per_s
        For carrier steps, see `stitch`.
    fastest_m_per_s
        Up to which targets may approach or recede; range rates beyond the Doppler ambiguity are
        told apart, or listed, up to there, see `unfolded`. An echo must be found first, on a map
        that does not follow it: what moves n range cells within a burst is 20 log10 n dB weaker
        there than it is measured afterwards, see `OfdmWaveform.migration_gain`.
    detection
        A user's own in place of CFAR and all refinement: a function of (channel, waveform, image),
        ``file.py:function``, or an installed name, see `detection_of`.
    """

    window: str = "blackmanharris"
    oversampling: int = 1
    cfar: Cfar = field(default_factory=Cfar)
    at_most: int = 64
    precision: Precision = "single"
    leakage: bool = True
    moving_only: bool = False
    resolve: bool = False
    per_cell: int = 1
    reference_delay_s: float | None = None
    range_rate_m_per_s: float = 0.0
    fastest_m_per_s: float = 50.0
    detection: str | OwnDetection | Detect | None = None

    def __post_init__(self) -> None:
        if self.detection is not None:
            object.__setattr__(self, "detection", detection_of(self.detection))


@dataclass(frozen=True, eq=False)
class Frame:
    """What one burst showed: detections, strongest first, the map, and what was wrong with it.

    ``clutter`` says how far the map is from noise, which thresholds assume unless `Cfar` says
    otherwise. ``detection`` is the name of a user's own detection, with a digest of its source.
    """

    burst: int
    detections: tuple[Detection, ...]
    image: RangeDopplerMap
    waveform: OfdmWaveform
    whole: bool
    warnings: tuple[str, ...]
    clutter: ClutterFit
    detection: str = ""

    @property
    def by(self) -> str:
        """Whose detections these are, in words; nothing of the bundled ones."""
        return f" by {self.detection}" if self.detection else ""


def process(
    record: "RadarRecord",
    burst: int = 0,
    how: Processing | None = None,
    *,
    waveform: OfdmWaveform | None = None,
) -> Frame:
    """Detect the targets of one burst.

    ``waveform``: what the caller believes was sent; refused when it is not the record's.
    """
    how = how or Processing()
    taken = demodulate(
        record,
        burst,
        waveform=waveform,
        precision=how.precision,
        leakage=how.leakage,
        reference_delay_s=how.reference_delay_s,
        range_rate_m_per_s=how.range_rate_m_per_s,
    )
    channel = without_static(taken.channel) if how.moving_only else taken.channel
    image = range_doppler(
        channel,
        taken.waveform,
        how.window,
        oversampling=how.oversampling,
        relative_noise=taken.relative_noise,
    )
    even = image.power_w
    if image.relative_noise is not None:
        even = even / image.relative_noise
    # Cells that a window makes exceed a level together: 7 for blackmanharris, 1 without one.
    clutter = fit(even, image.n_channels, noise_gain(how.window, channel.shape[-2:]) ** 1.4)
    own = None if how.detection is None else detection_of(how.detection)
    points: Sequence[Detection]
    if own is None:
        points, warnings = _detections(channel, taken, image, even, clutter, how, burst)
    else:
        points = own(channel, taken.waveform, image)
        warnings = _cut(burst, len(points), how)
        points = points[: how.at_most]
    return Frame(
        burst=burst,
        detections=tuple(
            with_cross_section(
                point,
                taken.waveform,
                record.front_end.transmit_power_w,
                record.front_end.antenna_gain_dbi,
                record.front_end.losses_db,
            )
            for point in points
        ),
        image=image,
        waveform=taken.waveform,
        whole=taken.whole,
        warnings=(*taken.warnings, *warnings),
        clutter=clutter,
        detection=own.name if own else "",
    )


def _detections(
    channel: Complex,
    taken: Burst,
    image: RangeDopplerMap,
    even: NDArray[np.floating],
    clutter: ClutterFit,
    how: Processing,
    burst: int,
) -> tuple[list[Detection], list[str]]:
    """Detections by CFAR and refinement, and what of them is not as it should be."""
    cfar = fitted(even, how.cfar, image.n_channels)
    if how.cfar.shape == "fitted" and how.window != "boxcar":
        plain = clutter_between_echoes(channel, taken.waveform, image, how.window)
        if not plain.is_noise:
            cfar = replace(cfar, shape=min(cfar.shape, plain.shape))
    # Twice as many: peaks that turn out to be one must not hide that the cap cuts.
    found = detected(channel, taken.waveform, image, cfar, how.window, 2 * how.at_most)
    noise_w = image.noise_w / noise_gain(how.window, channel.shape[-2:])
    found = unfolded(channel, taken.waveform, found, noise_w, how.fastest_m_per_s)
    warnings = _warnings(burst, len(found), image.n_channels, how, clutter)
    found = found[: how.at_most]
    if how.resolve:
        found = _resolved(found, channel, taken.waveform, noise_w, how.cfar.false_alarm)
    points = [point for one in found for point in _points(one, taken, how.per_cell)]
    return points, [*warnings, *_ambiguous(points)]


def _warnings(
    burst: int, n_found: int, n_channels: int, how: Processing, clutter: ClutterFit
) -> list[str]:
    """What of the detections is not as it should be."""
    told = _cut(burst, n_found, how)
    if not clutter.is_noise and how.cfar.shape == float("inf"):
        told.append(
            f"burst {burst}: the map is no noise: {clutter.exceedance:.2g} times as many cells as "
            f"noise has stand far above their median, as in K-distributed clutter of shape "
            f"{clutter.shape:.2g}; there are "
            f"{clutter.false_alarms(how.cfar.false_alarm, n_channels):.2g} times as many false "
            "alarms as asked for (a CFAR with its shape fitted holds the rate)"
        )
    return told


def _cut(burst: int, n_found: int, how: Processing) -> list[str]:
    if n_found <= how.at_most:
        return []
    return [
        f"burst {burst}: more than {how.at_most} detections; the strongest {how.at_most} are "
        "kept (at_most)"
    ]


def frames(
    record: "RadarRecord",
    how: Processing | None = None,
    *,
    waveform: OfdmWaveform | None = None,
) -> Iterator[Frame]:
    """Every burst in turn, up to and with the first that a gap or an overflow cuts short."""
    for burst in range(len(record.iq)):
        frame = process(record, burst, how, waveform=waveform)
        left = len(record.iq) - burst - 1
        if not frame.whole and left:
            told = f"the {left} bursts after it are left out"
            yield replace(frame, warnings=(*frame.warnings, told))
            return
        yield frame


def _resolved(
    found: list[Measured],
    channel: Complex,
    waveform: OfdmWaveform,
    noise_w: float,
    false_alarm: float,
) -> list[Measured]:
    """Each detection split into its targets, whose range rate is as ambiguous as its own."""
    parts: list[Measured] = []
    for i, (one, _) in enumerate(found):
        others = [other for other, _ in found[:i] + found[i + 1 :]]
        split = resolve(channel, waveform, one, noise_w, false_alarm=false_alarm, others=others)
        alternatives = one.range_rate_alternatives_m_per_s
        parts += [
            (replace(part, range_rate_alternatives_m_per_s=alternatives), amplitude)
            for part, amplitude in split
        ]
    return distinct(parts, waveform, folded=False)


def _points(found: Measured, taken: Burst, per_cell: int) -> list[Detection]:
    """A detection with its direction, or several from `music`.

    The array may tell range rates apart that migration leaves open.
    """
    point, amplitude = found
    if not np.any(extents(virtual_places(taken))[1:] > 0):
        return [point]
    measured = not np.isnan(point.range_rate_m_per_s)
    rates = (point.range_rate_m_per_s if measured else 0.0, *point.range_rate_alternatives_m_per_s)
    way = direction(amplitude, taken, rates, 10 ** (point.snr_db / 10))
    point = replace(
        point,
        range_rate_m_per_s=way.range_rate_m_per_s if measured else float("nan"),
        range_rate_alternatives_m_per_s=way.alternatives_m_per_s,
        azimuth_rad=way.azimuth_rad,
        azimuth_error_rad=way.azimuth_error_rad,
        elevation_rad=way.elevation_rad,
        elevation_error_rad=way.elevation_error_rad,
    )
    if per_cell == 1:
        return [point]
    still = compensated(amplitude, taken, way.range_rate_m_per_s)
    return [replace(point, azimuth_rad=float(a)) for a in music(still, taken, per_cell)]


def _ambiguous(points: list[Detection]) -> list[str]:
    """A warning where range rates are not told apart."""
    count = sum(bool(point.range_rate_alternatives_m_per_s) for point in points)
    if not count:
        return []
    return [f"range rate: ambiguous for {count} of {len(points)} detections, alternatives listed"]

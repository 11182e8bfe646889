"""Back-projection of bursts along a track into an image of down-range and cross-range.

Each cell is the sum over bursts, antenna pairs and frequencies, with the phase of the delay to the
cell compensated. The frequencies of one burst are first compressed to a range profile, which is
interpolated at the delay of each cell: N log N + cells operations instead of N cells.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hardware.described import Described
from hardware.errors import InputError
from hardware.formatting import si
from hardware.radar.burst import DemodulatedBurst, demodulate
from hardware.radar.grating import told as grating_lobes_told
from hardware.radar.integrity import first_loss, silence, told_left_out
from hardware.records.container import Flag
from hardware.records.state import QuaternionPose, positions, rotations
from hardware.waveform import C_M_PER_S

if TYPE_CHECKING:
    from hardware.records.radar import RadarRecord

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: What bursts of one image share: subcarriers, carrier, and number of resets before them.
_Alike = tuple[int, float, int]


@dataclass(frozen=True)
class Wall:
    """A plane slab across the view, ``distance_m`` ahead of the image's origin.

    ``permittivity`` is relative and real; the slab's loss is not compensated.
    """

    distance_m: float
    thickness_m: float
    permittivity: float

    def __post_init__(self) -> None:
        if not (0 <= self.thickness_m < np.inf and 1 <= self.permittivity < np.inf):
            raise InputError(
                f"wall: thickness {self.thickness_m} m and permittivity {self.permittivity}, "
                "expected finite numbers of at least 0 and 1"
            )
        if not 0 <= self.distance_m < np.inf:
            raise InputError(
                f"wall: distance {self.distance_m} m, expected a finite number of at least 0"
            )


@dataclass(frozen=True, eq=False, repr=False)
class RadarImage(Described):
    """Complex image: a point echo of power P that all bursts see shows sqrt(P) at its place.

    ``value`` (n_down, n_cross) at ``down_range_m`` ahead of and ``cross_range_m`` left of the
    antenna's pose in the middle of the track, level with it. Resolution by Eq. 6 and 7 of the
    paper, at the image's middle; across it is infinite where the antenna stands still or moves
    only ahead, as in a single burst.
    """

    value: Complex
    down_range_m: Array
    cross_range_m: Array
    down_resolution_m: float
    cross_resolution_m: float
    n_bursts: int
    n_pairs: int
    warnings: tuple[str, ...]

    @property
    def shows_directions(self) -> bool:
        """Whether cells of one range differ: by a track across the view, or by several antennas."""
        return self.n_pairs > 1 or bool(np.isfinite(self.cross_resolution_m))


def image(
    record: "RadarRecord",
    down_range_m: Array,
    cross_range_m: Array,
    *,
    wall: Wall | None = None,
    tolerance: float = 1e-3,
    leakage: bool = True,
) -> RadarImage:
    """Focus a record on a grid.

    Parameters
    ----------
    record
        Bursts at their poses, of which one that lost slots counts by its longest part without a
        loss; where the radar was reset in between, the most between two resets, whose phases belong
        together, and of carrier steps the most of one band. Where the antenna had moved by more
        than an eighth of a wavelength from its pose to the middle of such a part, the burst is left
        out.
    down_range_m, cross_range_m
        Cells, ahead and to the left of the pose in the middle of the track.
    wall
        Slab through which to focus.
    tolerance
        Bound of the interpolation error, relative to an echo.
    leakage
        Subtract the record's leakage, where its delay is known.

    Raises InputError where no burst can be used, and for cells beyond what subcarriers can
    tell, which show nearer echoes once more.
    """
    used, warnings = _coherent_bursts(record, leakage)
    bursts = list(used.values())
    cells, places, rotations_in_frame = _in_middle_frame(
        [record.pose[number] for number in used], down_range_m, cross_range_m
    )
    _check_range(cells, places, bursts[0].waveform.max_range_m)
    value = np.zeros((len(down_range_m), len(cross_range_m)), dtype=np.complex128)
    for burst, place, turn in zip(bursts, places, rotations_in_frame, strict=True):
        one_way_delay_s: dict[bytes, Array] = {}
        for channel, sender, receiver in zip(
            burst.channel, burst.transmitter_m, burst.receiver_m, strict=True
        ):
            delay = np.zeros_like(value, dtype=np.float64)
            for antenna in (sender, receiver):
                if (key := antenna.tobytes()) not in one_way_delay_s:
                    one_way_delay_s[key] = (
                        one_way_m(place + turn @ antenna, cells, wall) / C_M_PER_S
                    )
                delay += one_way_delay_s[key]
            value += _looked_up(channel.mean(axis=-1), burst, delay, tolerance)
    wave = bursts[0].waveform
    distance = float(np.hypot(np.mean(down_range_m), np.mean(cross_range_m)))
    across_m = cross_resolution_m(distance, wave.wavelength_m, places)
    if across_m > np.ptp(cross_range_m) > 0:
        warnings += (_short_track(len(bursts), len(bursts[0].channel), across_m),)
    middle_m = np.array([np.mean(down_range_m), np.mean(cross_range_m), 0.0])
    warnings += grating_lobes_told(_centres(bursts, places, rotations_in_frame), middle_m, wave)
    return RadarImage(
        value=value / sum(len(burst.channel) for burst in bursts),
        down_range_m=np.asarray(down_range_m, dtype=np.float64),
        cross_range_m=np.asarray(cross_range_m, dtype=np.float64),
        down_resolution_m=wave.range_cell_m,
        cross_resolution_m=across_m,
        n_bursts=len(bursts),
        n_pairs=len(bursts[0].channel),
        warnings=warnings,
    )


def cross_resolution_m(distance_m: float, wavelength_m: float, places_m: Array) -> float:
    """Eq. 6 of the paper: d lambda / (2 L); infinite for a single place."""
    length = float(np.ptp(places_m[:, 1]))
    return distance_m * wavelength_m / (2 * length) if length else float("inf")


def _check_range(cells_m: Array, places_m: Array, max_range_m: float) -> None:
    """Raise InputError where a cell is farther from a place of the track than can be told."""
    corners = cells_m[[0, 0, -1, -1], [0, -1, 0, -1]]
    farthest_m = float(np.linalg.norm(corners[:, None] - places_m, axis=-1).max())
    if farthest_m > max_range_m:
        raise InputError(
            f"image: cells up to {farthest_m:.4g} m away, expected 0 to {max_range_m:.4g}"
        )


def _centres(bursts: list[DemodulatedBurst], places_m: Array, axes: Array) -> Array:
    """Middles of transmitter and receiver of all bursts and pairs, (n, 3)."""
    return np.concatenate(
        [
            place + (burst.transmitter_m + burst.receiver_m) / 2 @ turn.T
            for burst, place, turn in zip(bursts, places_m, axes, strict=True)
        ]
    )


def _short_track(n_bursts: int, n_pairs: int, across_m: float) -> str:
    """What an image shows whose track resolves less than its width."""
    if np.isfinite(across_m):
        return f"the track resolves {across_m:.3g} m across, more than the image's width"
    bursts = "one burst" if n_bursts == 1 else f"{n_bursts} bursts whose antenna does not move"
    shown = (
        f"directions come from the {n_pairs} pairs of antennas alone"
        if n_pairs > 1
        else "the image shows ranges, and the same in every direction"
    )
    return f"{bursts}: {shown}; expected bursts along a track across the view"


def one_way_m(antenna_m: Array, cells_m: Array, wall: Wall | None) -> Array:
    """Optical path from an antenna (3,) to cells (..., 3), through the wall where it lies between.

    The ray is refracted by Snell's law; sin(theta) is the root of the equation for its lateral
    offset.
    """
    way = cells_m - antenna_m
    straight = np.linalg.norm(way, axis=-1)
    if wall is None or wall.thickness_m == 0:
        return straight
    behind = cells_m[..., 0] >= wall.distance_m + wall.thickness_m
    through = behind & (antenna_m[0] <= wall.distance_m)
    depth = way[through, 0]
    across = np.hypot(way[through, 1], way[through, 2])
    d, n2 = wall.thickness_m, wall.permittivity
    air = depth - d
    sine = across / straight[through]
    for _ in range(6):  # quadratic convergence from the straight ray
        cos_air, cos_wall = np.sqrt(1 - sine**2), np.sqrt(n2 - sine**2)
        excess = sine * (air / cos_air + d / cos_wall) - across
        slope = air / cos_air**3 + d * n2 / cos_wall**3
        sine = np.clip(sine - excess / slope, 0, 1 - 1e-12)
    bent = air / np.sqrt(1 - sine**2) + d * n2 / np.sqrt(n2 - sine**2)
    path = straight.copy()
    path[through] = bent
    return path


def _coherent_bursts(
    record: "RadarRecord", leakage: bool
) -> tuple[dict[int, DemodulatedBurst], tuple[str, ...]]:
    """Bursts by their numbers, the most of one band between two resets, and warnings."""
    alike, left_out = dict[_Alike, dict[int, DemodulatedBurst]](), dict[int, str]()
    n_resets = 0
    for number in range(len(record.iq)):
        if (record.flags[number] & Flag.RESET).any():
            n_resets += 1
            left_out[number] = f"burst {number}, {first_loss(record, number)}"
            continue
        try:
            burst = demodulate(record, number, leakage=leakage)
        except InputError as error:
            left_out[number] = str(error)
            continue
        moved_m = 0.0 if burst.whole else _moved_m(record, number, burst.middle_ns)
        if moved_m > burst.waveform.wavelength_m / 8:  # a quarter of it there and back
            left_out[number] = f"{burst.warnings[0]}, {si(moved_m, 'm')} from its pose"
            continue
        wave = burst.waveform
        alike.setdefault((wave.n_subcarriers, wave.carrier_hz, n_resets), {})[number] = burst
    if not alike:
        raise InputError(next(iter(left_out.values()), "iq: no burst in the record"))
    most = max(alike, key=lambda key: (len(alike[key]), key))
    for key, others in alike.items():
        if key != most:
            left_out |= {number: _apart(record, number, key, most) for number in others}
    bursts = alike[most]
    silent = {number: told for number in bursts if (told := silence(record, number))}
    if len(silent) < len(bursts):
        bursts = {number: burst for number, burst in bursts.items() if number not in silent}
        left_out |= silent
    warnings = [text for burst in bursts.values() for text in burst.warnings]
    if left_out:
        warnings.append(told_left_out(dict(sorted(left_out.items())), len(record.iq)))
    return bursts, tuple(warnings)


def _apart(record: "RadarRecord", number: int, own: _Alike, most: _Alike) -> str:
    """Why a burst does not belong to most."""
    if own[2] != most[2]:
        return f"burst {number}: a reset is between it and most"
    loss = first_loss(record, number)
    return f"burst {number}{f', {loss}' if loss else ''}: its band is not that of most"


def _moved_m(record: "RadarRecord", number: int, at_ns: int) -> float:
    """How far a burst's antenna may be from its pose at a time, by the poses beside it."""
    near = range(max(number - 1, 0), min(number + 2, len(record.pose)))
    places_m = positions([record.pose[one] for one in near])
    times_s = 1e-9 * np.array([record.middle_ns(one) for one in near])
    ways_m = np.linalg.norm(np.diff(places_m, axis=0), axis=1)
    speeds_m_per_s = ways_m / np.maximum(np.abs(np.diff(times_s)), 1e-9)
    away_s = 1e-9 * abs(at_ns - record.middle_ns(number))
    return away_s * float(speeds_m_per_s.max(initial=0.0))


def _in_middle_frame(
    poses: Sequence[QuaternionPose], down_range_m: Array, cross_range_m: Array
) -> tuple[Array, Array, Array]:
    """Cells (n_down, n_cross, 3), antenna places (n_bursts, 3) and axes (n_bursts, 3, 3)."""
    middle = len(poses) // 2
    axes, at_m = rotations(poses), positions(poses)
    home = axes[middle].inv()
    places = home.apply(at_m - at_m[middle])
    # Cross-range counts from the middle of the track, between two poses of an even number.
    origin = places.mean(axis=0)
    down, cross = np.meshgrid(down_range_m, cross_range_m, indexing="ij")
    cells = np.stack([down, cross, np.zeros_like(down)], axis=-1)
    return cells, places - origin, np.asarray((home * axes).as_matrix())


def _looked_up(
    spectrum: Complex, burst: DemodulatedBurst, delay_s: Array, tolerance: float
) -> Complex:
    """Mean over frequencies (n,) with the phase of each delay compensated.

    The profile about the middle frequency is band-limited to half a turn per cell; linear
    interpolation between k samples per cell is off by at most (pi / k)^2 / 8.
    """
    from scipy.fft import ifft, next_fast_len

    wave = burst.waveform
    n = wave.n_subcarriers
    length = next_fast_len(int(np.ceil(n * np.pi / np.sqrt(8 * tolerance))))
    padded = np.zeros(length, dtype=np.complex128)
    padded[: n - n // 2] = spectrum[n // 2 :]
    padded[length - n // 2 :] = spectrum[: n // 2]
    profile = ifft(padded) * (length / n)
    at = delay_s * (wave.subcarrier_spacing_hz * length)
    index = np.floor(at).astype(np.intp)
    share = at - index
    index %= length
    low = profile[index]
    low += share * (profile[(index + 1) % length] - low)
    cycles = wave.carrier_hz * delay_s
    low *= np.exp(2j * np.pi * (cycles - np.floor(cycles)))
    return low

"""Estimated error of every body's echo, by the solver itself.

The estimate is based on the root of the sum of squares of all errors that the solver accepts: of
triangles that are not divided further, either within the tolerance or at the deepest division; of
ray tubes; and of faint triangles that are left out. Both directions between two different images,
and reflections within walls, are included. The median error is about half of that sum. But errors
of neighbouring ray tubes and shadows are correlated, and what lies between the rays is not sampled
at all. Therefore the estimate is three times the sum: 95 % of bodies' errors are within it. `python
-m benchmarks radar_estimates` measures that on random scenes.

What was left out takes other paths, with phases of their own: its bound and that estimate add by
their squares.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.constants import speed_of_light

from hardware.waveform import OfdmWaveform
from twin.radar.propagation.facets.band_sums import band_sums
from twin.radar.propagation.facets.body_profile import BodyProfile
from twin.radar.propagation.facets.error_budget import WEAKEST
from twin.radar.synthesis import Contributions

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

_FREQUENCIES = 17  # over the band
_NAMED = 6  # bodies in a remark
_SURE = 6.0  # estimates over the tolerance from which on the error itself most likely exceeds it
WITHIN = 3.0  # over the root of the sum of squares: 95 % of bodies' errors are less
LEAST = 3e-3  # of any echo, by float32 rays and by what contributions are off over the band


@dataclass(frozen=True)
class BodyEcho:
    """Echo of one body, objects that touch and move alike, and the error estimated of it.

    ``objects`` by name; ``level_db``: root mean square over the band, over that of the strongest
    body; ``estimated_error``: within which the error most likely is (95 % of bodies), relative to
    that root mean square, or to the least level that ``fidelity.radar_tolerance`` is relative to;
    ``tolerance``: what was asked for; ``systematic``: the part of it that bounds what was left out
    (`Propagation.decisions`); ``is_bounded``: whether that holds all that was left out, which fixed
    knobs do without a bound. ``amplitude``, ``level_amplitude``: of the echo, and of
    the level that errors are relative to, received over sent. ``ranges_m``,
    ``range_rates_m_per_s``: least and most of its contributions; ``profile``: where between them
    echo and errors are.
    """

    objects: tuple[str, ...]
    level_db: float
    estimated_error: float
    tolerance: float
    systematic: float = 0.0
    amplitude: float = 0.0
    level_amplitude: float = 0.0
    ranges_m: tuple[float, float] = (-np.inf, np.inf)
    range_rates_m_per_s: tuple[float, float] = (-np.inf, np.inf)
    is_bounded: bool = True
    profile: BodyProfile | None = field(default=None, compare=False, repr=False)

    @property
    def name(self) -> str:
        """That of its first object."""
        return label_of(self.objects)

    @property
    def level_over_echo(self) -> float:
        """Of the level that errors are relative to, over the echo: above 1 for faint bodies."""
        if not self.amplitude:
            return 1.0
        return max(self.level_amplitude / self.amplitude, 1.0)

    @property
    def accepted_error(self) -> float:
        """The part of the estimate that is of what was computed; the other one is ``systematic``,
        and both add by their squares.
        """
        return float(np.sqrt(max(self.estimated_error**2 - self.systematic**2, 0.0)))

    def off_by(self, more: float) -> "BodyEcho":
        """The same with an error of the model more, relative and independent of the others."""
        error, systematic = np.hypot([self.estimated_error, self.systematic], more).tolist()
        return replace(self, estimated_error=error, systematic=systematic)

    @property
    def is_within_tolerance(self) -> bool:
        """Whether the estimate is within the tolerance, to two digits, as both are told."""
        return float(percent(self.estimated_error)) <= float(percent(self.tolerance))

    @property
    def is_converged(self) -> bool:
        """Whether the estimate is within six times the tolerance: the median error is a quarter."""
        return self.estimated_error <= _SURE * self.tolerance


def label_of(objects: Sequence[str]) -> str:
    """Name of what consists of these: that of the first one."""
    first, *others = objects
    return f"{first} (of {len(objects)} objects)" if others else first


def percent(share: float) -> str:
    """To two digits, without the sign."""
    return f"{100 * share:.2g}" if share < 1 else f"{100 * share:.0f}"


def of_echo(share: float, level_over_echo: float) -> str:
    """A share of the level that a body's errors are relative to, as per cent of the body's own
    echo; of a faint body with what it is of that level.
    """
    own = f"{percent(share * level_over_echo)} %"
    if level_over_echo <= 1:
        return own
    above_db = 20 * np.log10(level_over_echo)
    return (
        f"{own} ({percent(share)} % of the least level that the tolerance is of, "
        f"{above_db:.2g} dB above it)"
    )


def stated(body: BodyEcho) -> str:
    """The estimated error of a body's echo, relative to that echo."""
    return of_echo(body.estimated_error, body.level_over_echo)


def beyond_tolerance(bodies: Iterable[BodyEcho]) -> str:
    """Which bodies' echoes are stated to more than was asked, the worst first; empty if none is."""
    worst = sorted(
        (body for body in bodies if not body.is_within_tolerance),
        key=lambda body: -body.estimated_error,
    )
    if not worst:
        return ""
    named = ", ".join(f"{body.name} to {stated(body)}" for body in worst[:_NAMED])
    more = f" and {len(worst) - _NAMED} more bodies to less" * (len(worst) > _NAMED)
    return f"stated with 95 % confidence: {named}{more}; {percent(worst[0].tolerance)} % asked"


def worst_by_body(bodies: Iterable[BodyEcho]) -> tuple[BodyEcho, ...]:
    """Of bodies that are told several times, as of several bursts, that of the largest error."""
    worst: dict[tuple[str, ...], BodyEcho] = {}
    for body in bodies:
        if body.estimated_error > worst.setdefault(body.objects, body).estimated_error:
            worst[body.objects] = body
    return tuple(worst.values())


def unconverged(bodies: Iterable[BodyEcho]) -> list[str]:
    """A remark on the bodies that have not converged, if there are any."""
    worst = sorted(
        (body for body in bodies if not body.is_converged), key=lambda body: -body.estimated_error
    )
    if not worst:
        return []
    named = ", ".join(f"{body.name} {stated(body)}" for body in worst[:_NAMED])
    more = len(worst) - _NAMED
    others = f"; {more} more {'body is' if more == 1 else 'bodies are'} off by less" * (more > 0)
    return [
        f"error of the {'echo' if len(worst) == 1 else 'echoes'}, with 95 % confidence: "
        f"{named}{others}; fidelity.radar_tolerance asks for "
        f"{percent(worst[0].tolerance)} %"
    ]


def body_echoes(
    objects: Sequence[tuple[str, ...]],
    echo: Complex,
    error: Array,
    tolerance: float,
    floor: float,
    left_out: Array | None = None,
    spans: Array | None = None,
    profiles: Sequence[BodyProfile] = (),
    *,
    is_bounded: bool = True,
) -> tuple[BodyEcho, ...]:
    """Bodies with an echo, the strongest first.

    Parameters
    ----------
    objects
        Names of what every body consists of.
    echo
        Over the band, (n_bodies, n_frequencies).
    error
        That is accepted of each echo, (n_bodies,).
    tolerance, floor
        Error that was asked for, relative to a body's echo, and amplitude below which none counts.
    left_out
        Bound of what was left out of each echo, relative to the level that errors are relative to.
    spans
        As `spans_by` gives them, where known.
    profiles
        Of every body, where known.
    is_bounded
        Whether ``left_out`` holds all that was left out.
    """
    level = np.sqrt(np.mean(np.abs(echo) ** 2, axis=1))
    strongest = level.max(initial=0.0)
    reference = reference_levels(echo, tolerance, floor)
    systematic = np.zeros(len(level)) if left_out is None else left_out
    if spans is None:
        spans = np.full((len(objects), 2, 2), np.inf) * [-1, 1]
    return tuple(
        BodyEcho(
            objects=objects[i],
            level_db=float(20 * np.log10(level[i] / strongest)),
            estimated_error=float(
                np.hypot(LEAST + WITHIN * error[i] / reference[i], systematic[i])
            ),
            tolerance=tolerance,
            systematic=float(systematic[i]),
            amplitude=float(level[i]),
            level_amplitude=float(reference[i]),
            ranges_m=(float(spans[i, 0, 0]), float(spans[i, 0, 1])),
            range_rates_m_per_s=(float(spans[i, 1, 0]), float(spans[i, 1, 1])),
            is_bounded=is_bounded,
            profile=profiles[i] if profiles else None,
        )
        for i in np.argsort(-level, kind="stable")
        if level[i] > 0
    )


def reference_levels(echo: Complex, tolerance: float, floor: float) -> Array:
    """Levels that errors of echoes (n_bodies, n_frequencies) are relative to: root mean squares
    over the band, at least that of an echo 40 dB below the strongest, or of ``floor``.
    """
    level = np.sqrt(np.mean(np.abs(echo) ** 2, axis=1))
    least = max(WEAKEST * level.max(initial=0.0), floor / tolerance)
    levels: Array = np.maximum(level, least)
    return levels


def spans_by(owner: NDArray[np.integer], count: int, echoes: Contributions) -> Array:
    """Least and most range, m, and range rate, m/s, of the echoes of each owner, (count, 2, 2)."""
    found = np.full((count, 2, 2), np.inf) * [1, -1]
    some = owner >= 0
    for k, values in enumerate((echoes.delay_s, echoes.delay_rate)):
        half_way = speed_of_light / 2 * values[some]
        np.minimum.at(found[:, k, 0], owner[some], half_way)
        np.maximum.at(found[:, k, 1], owner[some], half_way)
    return found


def band_of(wave: OfdmWaveform) -> Array:
    """Equally spaced frequencies at which the echoes of bodies are summed."""
    half = wave.bandwidth_hz / 2
    return wave.carrier_hz + np.linspace(-half, half, _FREQUENCIES)


def summed_by(
    owner: NDArray[np.integer],
    count: int,
    echoes: Contributions,
    carrier_hz: float,
    frequencies_hz: Array,
) -> Complex:
    """Echoes at rest summed by owner, -1 of what counts for none, (count, n_frequencies);
    frequencies equally spaced.
    """
    total = np.zeros((count, len(frequencies_hz)), dtype=np.complex128)
    wave_numbers = 2 * np.pi / speed_of_light * frequencies_hz
    for power in np.unique(echoes.falloff):
        some = np.flatnonzero((echoes.falloff == power) & (owner >= 0))
        length_m = speed_of_light * echoes.delay_s[some]
        sums = band_sums(owner[some], count, echoes.amplitude[some], length_m, wave_numbers)
        total += (carrier_hz / frequencies_hz) ** power * sums
    return total

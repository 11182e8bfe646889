"""Physical optics of a mesh: integrals over its facets, and rays for what they light of others."""

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray
from scipy.constants import speed_of_light

from twin.errors import InputError
from twin.radar.cross_section.aspects import Aspects
from twin.radar.cross_section.facets import direct
from twin.radar.cross_section.rays import Density, Later, later_bounces, spread
from twin.radar.cross_section.subject import is_seen_once, subject_of
from twin.radar.scattering.target import MeshTarget
from twin.radar.scattering.wave import Polarization, Radar

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

_FACETS_AT_ONCE = 2**18  # 200 MB while they are looked at
_MOST_AT_ONCE = 4096  # aspects, whose progress is shown
_SHADED_AT_ONCE = 32  # aspects of a mesh that shades itself: what is divided
# Of rays within a mesh, by what they leave of the echo of a trihedral, 45 / rays, and of a box
# beside a plate, 0.02 over the rays per wavelength.
_RAYS = 50.0
_PER_WAVELENGTH = 0.02
_FEWEST, _MOST = 1.5, 16.0  # per wavelength


@dataclass(frozen=True)
class Quality:
    """Knobs of physical optics, each with the error it bounds.

    tolerance
        Estimated error of the complex echo from each direction, 0.001 to 1, relative to the echo,
        or to one 60 dB below what facets send back out of phase, whichever is larger. To it facets
        are divided where their phase is bent or shadows end on them; rays for further bounces are
        as close as a corner reflector needs. What the estimate misses: bounces between many small
        facets (a person at 79 GHz: 26 % of the echo at 0.02, 6 % at 0.005).
    max_bounces
        What is reflected more often is lost.
    max_rays
        Bounds time. Where it bites, tubes are wider than asked for:
        `ScatteringAmplitudes.undersampling`.
    """

    tolerance: float = 0.005
    max_bounces: int = 8
    max_rays: int = 2**26

    def __post_init__(self) -> None:
        if not 1e-3 <= self.tolerance <= 1:
            raise InputError(f"tolerance: {self.tolerance}: expected 0.001 to 1")
        if self.max_bounces < 1:
            raise InputError(f"max_bounces: {self.max_bounces} is less than 1")
        if self.max_rays < 1:
            raise InputError(f"max_rays: {self.max_rays} is less than 1")

    @property
    def density(self) -> Density:
        """Of rays for further bounces."""
        close = float(np.clip(_PER_WAVELENGTH / self.tolerance, _FEWEST, _MOST))
        return Density(close, min(round(_RAYS / self.tolerance), self.max_rays), self.max_rays)


@dataclass(frozen=True, eq=False)
class ScatteringAmplitudes:
    """Scattered amplitude at each of n aspects, or at one, and what a reader should know about it.

    ``amplitude`` (n, 2) is S in metres for reception in both polarisations, of a wave of amplitude
    1 at the mesh's origin: cross-section 4 pi |S|^2. Of the lit wavefront ``grazing`` (n,) is the
    share that meets its facet within 15 deg of grazing, ``unfinished`` (n,) what is still under way
    after the last bounce. ``undersampling`` (n,) is the factor by which rays are wider apart than
    asked for, ``rays`` (n,) their number, 0 where no facet lights another.
    """

    amplitude: Complex
    grazing: Array
    unfinished: Array
    undersampling: Array
    rays: NDArray[np.int64]


def portions(target: MeshTarget, count: int) -> Iterator[slice]:
    """Slices of so many aspects that fit into memory."""
    at_once = int(np.clip(_FACETS_AT_ONCE // len(target.geometry.faces), 1, _MOST_AT_ONCE))
    if not subject_of(target).is_convex:
        at_once = min(at_once, _SHADED_AT_ONCE)
    yield from (slice(i, min(i + at_once, count)) for i in range(0, count, at_once))


def scattered(
    target: MeshTarget, aspects: Aspects, frequency_hz: float, quality: Quality | None = None
) -> ScatteringAmplitudes:
    """Echoes of the first polarisation sent at each aspect."""
    amplitudes = dyadic(target, aspects, np.array([frequency_hz]), quality)
    return replace(amplitudes, amplitude=amplitudes.amplitude[:, 0, 0])


def dyadic(
    target: MeshTarget, aspects: Aspects, frequency_hz: Array, quality: Quality | None = None
) -> ScatteringAmplitudes:
    """Echoes of all polarisations sent, by several frequencies: amplitude (n, n_frequencies, m, 2).

    Surfaces reflect as at the first frequency; facets are divided for the highest.
    """
    quality = quality or Quality()
    count, sent = len(frequency_hz), aspects.sent.shape[1]
    amplitude, grazing, further = [], [], []
    for rows in portions(target, len(aspects)):
        part = aspects.part(rows)
        later = [Later.none(len(part), sent)] * count
        if quality.max_bounces > 1 and not is_seen_once(target, part):
            later = [
                later_bounces(
                    target,
                    part,
                    speed_of_light / frequency,
                    float(frequency_hz[0]),
                    quality.max_bounces,
                    quality.density,
                )
                for frequency in frequency_hz.tolist()
            ]
        highest = later[int(np.argmax(frequency_hz))]
        facets = direct(
            target,
            part,
            frequency_hz,
            quality.tolerance,
            highest.amplitude,
            float(frequency_hz[0]),
        )
        amplitude.append(facets.amplitude + np.stack([one.amplitude for one in later], axis=1))
        grazing.append(facets.grazing)
        further.append(highest)
    return ScatteringAmplitudes(
        np.concatenate([np.zeros((0, count, sent, 2), np.complex128), *amplitude]),
        np.concatenate([np.zeros(0), *grazing]),
        np.concatenate([np.zeros(0), *(part.unfinished for part in further)]),
        np.concatenate([np.ones(0), *(part.undersampling for part in further)]),
        np.concatenate([np.zeros(0, np.int64), *(part.rays for part in further)]),
    )


def physical_optics(
    target: MeshTarget,
    radar: Radar,
    carrier_hz: float,
    polarization: Polarization = "V",
    quality: Quality | None = None,
) -> ScatteringAmplitudes:
    """Echo of a wave sent in ``polarization`` and received by the same radar in V and H: amplitude
    (2,). `scattered` takes many at once, in much less time.
    """
    amplitudes = scattered(target, Aspects.monostatic([radar], polarization), carrier_hz, quality)
    return ScatteringAmplitudes(
        *(getattr(amplitudes, f.name)[0] for f in fields(ScatteringAmplitudes))
    )


def thinning(target: MeshTarget, frequency_hz: float, quality: Quality) -> float:
    """Factor by which ``max_rays`` sets rays wider apart than asked for; at least 1.

    That of the worst of the three sides of the target's box.
    """
    if subject_of(target).is_convex:
        return 1.0
    sides = Aspects.monostatic([Radar(side) for side in np.eye(3)], "V")
    wavelength = speed_of_light / frequency_hz
    return max(
        spread(target, sides, aspect, wavelength, quality.density).undersampling
        for aspect in range(3)
    )

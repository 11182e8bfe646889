"""Levels of bodies' echoes, which errors and bounds are relative to."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hardware.waveform import OfdmWaveform
from twin.fidelity import Fidelity
from twin.radar.device.design import RadarDesign
from twin.radar.propagation.facets.body_profile import BodyProfile, body_profiles
from twin.radar.propagation.facets.body_scattering import OF_TOLERANCE
from twin.radar.propagation.facets.convergence import (
    BodyEcho,
    band_of,
    body_echoes,
    reference_levels,
    spans_by,
    summed_by,
)
from twin.radar.propagation.facets.errors_by_range import ErrorsByRange
from twin.radar.propagation.physical_optics import Scattered
from twin.radar.propagation.prepared_scene import PreparedScene
from twin.radar.propagation.scene.culling import OF_NOISE, noise_amplitude
from twin.radar.synthesis import Contributions

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class BodyLevels:
    """Bodies by the ``names`` of their objects, their ``echo`` over the band (n_bodies,
    n_frequencies), the levels that errors are relative to, ``reference`` (n_bodies,), and their
    spans in range and rate.
    """

    names: list[tuple[str, ...]]
    of_object: NDArray[np.int32]
    echo: NDArray[np.complex128]
    reference: Array
    tolerance: float
    floor: float
    spans: Array

    @property
    def permitted(self) -> float:
        """Of each effect that is left out."""
        return OF_TOLERANCE * self.tolerance

    def bodies(
        self,
        error: Array,
        left_out: Array,
        profiles: Sequence[BodyProfile],
        *,
        is_bounded: bool,
    ) -> tuple[BodyEcho, ...]:
        """With their errors and bounds of what is left out, the latter relative."""
        return body_echoes(
            self.names,
            self.echo,
            error,
            self.tolerance,
            self.floor,
            left_out,
            self.spans,
            profiles,
            is_bounded=is_bounded,
        )

    def profiles(
        self, echoes: Contributions, errors: ErrorsByRange, wave: OfdmWaveform
    ) -> tuple[BodyProfile, ...]:
        """Where in range and rate the echoes of bodies and their errors are."""
        return body_profiles(self.of_object[echoes.object], len(self.names), echoes, errors, wave)

    def rms_of(self, echoes: Contributions, radar: RadarDesign) -> Array:
        """Amplitude of every body's part of echoes, rms over the band, (n_bodies,)."""
        owner, wave = self.of_object[echoes.object], radar.ofdm
        echo = summed_by(owner, len(self.names), echoes, wave.carrier_hz, band_of(wave))
        level: Array = np.sqrt(np.mean(np.abs(echo) ** 2, axis=1))
        return level

    def with_edges(self, edges: Contributions, wave: OfdmWaveform) -> "BodyLevels":
        """The same with the echoes of sharp edges."""
        owner, count = self.of_object[edges.object], len(self.names)
        echo = self.echo + summed_by(owner, count, edges, wave.carrier_hz, band_of(wave))
        reference = reference_levels(echo, self.tolerance, self.floor)
        more = spans_by(owner, count, edges)
        nearest, farthest = np.moveaxis(np.stack([self.spans, more]), -1, 0)
        spans = np.stack([nearest.min(axis=0), farthest.max(axis=0)], axis=-1)
        return replace(self, echo=echo, reference=reference, spans=spans)


def body_levels(
    prepared: PreparedScene,
    radar: RadarDesign,
    fidelity: Fidelity,
    of_bodies: Scattered,
    surfaces: Contributions,
) -> BodyLevels:
    """Of bodies, with what of ``surfaces``, echoes at the antenna, is theirs."""
    body, wave = of_bodies.body, radar.ofdm
    count = len(of_bodies.error)
    owner = body[surfaces.object]
    echo = summed_by(owner, count, surfaces, wave.carrier_hz, band_of(wave))
    names = [tuple(prepared.items[i].name for i in np.flatnonzero(body == k)) for k in range(count)]
    tolerance, floor = fidelity.radar_tolerance, OF_NOISE * noise_amplitude(radar)
    reference = reference_levels(echo, tolerance, floor)
    spans = spans_by(owner, count, surfaces)
    return BodyLevels(names, body, echo, reference, tolerance, floor, spans)

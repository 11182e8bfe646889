"""Contributions to the channel: the common form of all echoes, from the tracer to the synthesis.

H[n, m] = sum_i a_i (fc / (fc + f_n))^p_i exp(-j 2 pi (fc + f_n) (tau_i + rate_i t_m
+ acceleration_i t_m^2 / 2))

How the amplitude depends on frequency:

- Within the band by ``falloff`` p_i: of a facet's surface it is constant (0), of an edge it falls
as
  1 / f (1), of a corner as 1 / f^2 (2). From one carrier step to the next the same law holds.
- From one carrier step to the next also by ``wavelength_power``: amplitudes of mirror images,
  declared points, sharp edges and scatterers of rough surfaces are proportional to the wavelength
  (1), those of facets and tables are not (0, the default). Within the band this is neglected.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hardware.described import Described

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Numbers = NDArray[np.uint32]

#: Wavefronts over the antennas: spheres around a point half of the way off, or around the
#: antennas' own image in a mirror; planes.
POINT, OWN_IMAGE, PLANE = 0, 1, 2
_NUMBERS = ("object", "source", "receiver", "first", "bounces", "wavefront")


@dataclass(frozen=True, eq=False, repr=False)
class Contributions(Described):
    """Echoes, in order.

    amplitude : (n,), complex
        Received over sent wave, without the phase of the delay; (n_steps, n) if it differs from
        carrier step to carrier step.
    delay_s, delay_rate, delay_acceleration_per_s : (n,)
        Delay in the middle of the interval, at the antenna's origin, in s; its derivatives in s/s
        (positive: receding) and 1/s. A target that crosses at speed v in a distance R has an
        acceleration of 2 v^2 / (R c).
    departure, arrival : (n, 3)
        Unit vectors from the antenna along the start of the forward path and towards the end of the
        return path, in its own axes: x ahead, y left, z up; zero for a path that does not depend on
        the antennas' places, of a `PLANE` wavefront.
    departure_per_s, arrival_per_s : (n, 3)
        Their derivatives in time, 1/s: of a target that crosses, the elements of an array receive
        different Doppler shifts.
    falloff, wavelength_power : (n,)
        Exponents of the frequency dependence, see above; few different values each.
    object, first : (n,)
        Numbers of the last object on the path, and of the first facet.
    bounces : (n,)
        Reflections at bodies' surfaces, where these are echoes of facets; 0 of edges and of waves
        round obstacles.
    source, receiver : (n,)
        Numbers of the images of the forward and of the return path.
    wavefront : (n,)
        `POINT`, `OWN_IMAGE` or `PLANE`.

    From ``departure_per_s`` on all are 0 by default. While echoes are traced, amplitudes are
    without the antenna's gain and the front end's losses, and vectors in the world's axes:
    `physical_optics.at_antenna` makes of these what the synthesis takes.
    """

    amplitude: Complex
    delay_s: Array
    delay_rate: Array
    delay_acceleration_per_s: Array
    departure: Array
    arrival: Array
    departure_per_s: Array = None  # type: ignore[assignment]
    arrival_per_s: Array = None  # type: ignore[assignment]
    falloff: Array = None  # type: ignore[assignment]
    wavelength_power: Array = None  # type: ignore[assignment]
    object: Numbers = None  # type: ignore[assignment]
    source: Numbers = None  # type: ignore[assignment]
    receiver: Numbers = None  # type: ignore[assignment]
    first: Numbers = None  # type: ignore[assignment]
    bounces: Numbers = None  # type: ignore[assignment]
    wavefront: Numbers = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        n = len(self.delay_s)
        for field in fields(self)[6:]:
            if getattr(self, field.name) is None:
                shape = (n, 3) if field.name in ("departure_per_s", "arrival_per_s") else (n,)
                zeros = np.zeros(shape, np.uint32 if field.name in _NUMBERS else np.float64)
                object.__setattr__(self, field.name, zeros)

    def __len__(self) -> int:
        return len(self.delay_s)

    @staticmethod
    def ahead(
        amplitude: Complex,
        delay_s: Array,
        delay_rate: Array,
        delay_acceleration_per_s: Array | None = None,
    ) -> "Contributions":
        """Echoes from straight ahead; without acceleration by default."""
        forward = np.tile([1.0, 0.0, 0.0], (len(delay_s), 1)).reshape(-1, 3)
        faster = np.zeros(len(delay_s))
        if delay_acceleration_per_s is not None:
            faster = delay_acceleration_per_s
        return Contributions(amplitude, delay_s, delay_rate, faster, forward, forward)

    @property
    def moving(self) -> NDArray[np.bool_]:
        """Whether the delay of each changes at all, (n,)."""
        is_moving: NDArray[np.bool_] = (self.delay_rate != 0) | (self.delay_acceleration_per_s != 0)
        return is_moving

    def delays_at(self, time_s: float) -> Array:
        """Delays at a time, (n,)."""
        if time_s == 0:
            return self.delay_s
        moved = (time_s / 2) * self.delay_acceleration_per_s
        moved += self.delay_rate
        moved *= time_s
        moved += self.delay_s
        return moved

    def counted_from(self, time_s: float) -> "Contributions":
        """The same echoes with time counted from this one on."""
        faster = self.delay_acceleration_per_s * time_s
        return replace(
            self,
            delay_s=self.delays_at(time_s),
            delay_rate=self.delay_rate + faster,
            departure=self.departure + self.departure_per_s * time_s,
            arrival=self.arrival + self.arrival_per_s * time_s,
        )

    def in_proportion_to_wavelength(self) -> "Contributions":
        """The same echoes, with amplitudes in proportion to the wavelength of each carrier step."""
        return replace(self, wavelength_power=np.ones(len(self)))

    def and_reversed(self) -> list["Contributions"]:
        """These, and those whose source and receiver differ a second time with both exchanged."""
        back = self.source != self.receiver
        if not back.any():
            return [self]
        some = self.take(back)
        reverse = replace(
            some,
            departure=some.arrival,
            arrival=some.departure,
            departure_per_s=some.arrival_per_s,
            arrival_per_s=some.departure_per_s,
            source=some.receiver,
            receiver=some.source,
        )
        return [self, reverse]

    def take(self, which: Any) -> "Contributions":
        """Only some of them, by index, mask or slice."""
        others = (getattr(self, f.name)[which] for f in fields(Contributions)[1:])
        return Contributions(self.amplitude[..., which], *others)

    @staticmethod
    def none() -> "Contributions":
        """No echo at all."""
        empty = np.zeros(0)
        return Contributions.ahead(empty.astype(np.complex128), empty, empty)

    @staticmethod
    def concatenate(parts: Sequence["Contributions"]) -> "Contributions":
        """Echoes of all parts, one after the other."""
        if len(some := [part for part in parts if len(part)]) == 1:
            return some[0]
        if not parts:
            return Contributions.none()
        amplitude = np.concatenate([part.amplitude for part in parts], axis=-1)
        others = (f.name for f in fields(Contributions) if f.name != "amplitude")
        return Contributions(
            amplitude, *(np.concatenate([getattr(p, name) for p in parts]) for name in others)
        )


def direct_sum(
    contributions: Contributions, frequencies_hz: Array, times_s: Array, carrier_hz: float
) -> Complex:
    """The channel by its definition, in float64, at some frequencies and times: the reference."""
    channel = np.zeros((len(frequencies_hz), len(times_s)), dtype=np.complex128)
    for start in range(0, len(contributions), 4096):
        part = contributions.take(slice(start, start + 4096))
        moved = np.stack([part.delays_at(time) for time in times_s], axis=1)
        for row, frequency in enumerate(frequencies_hz):
            cycles = (carrier_hz + frequency) * moved
            amplitude = part.amplitude * (carrier_hz / (carrier_hz + frequency)) ** part.falloff
            channel[row] += amplitude @ np.exp(-2j * np.pi * (cycles % 1.0))
    return channel

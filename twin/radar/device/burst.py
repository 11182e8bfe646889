"""One burst: carrier steps in time, time-division multiplexed transmitters, receivers side by side.

Each step, transmitter and receiver by itself is a radar with one antenna: what its place and its
time change about an echo's delay goes into the delay, so into the carrier's phase and the envelope
alike, and into its level. Wavefronts over the antennas are spheres: see `wavefronts`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hardware.waveform import C_M_PER_S, OfdmWaveform
from twin.radar.synthesis import Array, Complex, Contributions, demodulated
from twin.radar.synthesis.wavefronts import Gain, level, nearer_m


@dataclass(frozen=True, eq=False)
class Burst:
    """What is sent and where it is received; times count from the burst's middle.

    ``waveform`` is that of the first step, ``carriers_hz`` and ``step_times_s`` (n_steps,) say
    where and when (its middle) each step lies; slot m is sent by transmitter m modulo their number.
    Antennas (n, 3) in metres: x ahead, y left, z up, from the radar's origin. ``gain``: of each
    towards unit vectors (n, 3), in power; None: echoes are as strong at all of them.
    """

    waveform: OfdmWaveform
    carriers_hz: Array
    step_times_s: Array
    transmitters_m: Array
    receivers_m: Array
    gain: Gain | None = None

    @property
    def transmitter(self) -> NDArray[np.uint8]:
        """Who sends in each slot, (n_slots,)."""
        slots = np.arange(self.waveform.n_slots)
        return (slots % len(self.transmitters_m)).astype(np.uint8)

    @property
    def reach_m(self) -> float:
        """How far a transmitter and a receiver are from the origin at most, together."""
        places = self.transmitters_m, self.receivers_m
        return float(sum(np.linalg.norm(each, axis=1).max() for each in places))

    def slots(self, transmitter: int) -> slice:
        """Slots of one transmitter."""
        return slice(transmitter, None, len(self.transmitters_m))

    def waveform_of(self, step: int, transmitter: int) -> OfdmWaveform:
        """What one transmitter sends in one step."""
        return replace(
            self.waveform,
            carrier_hz=float(self.carriers_hz[step]),
            n_slots=len(range(self.waveform.n_slots)[self.slots(transmitter)]),
            slot_period_s=self.waveform.slot_period_s * len(self.transmitters_m),
        )

    def seen(
        self, echoes: Contributions, step: int = 0, transmitter: int = 0, receiver: int = 0
    ) -> Contributions:
        """Echoes as a radar would have them that has this one transmitter and receiver, both in its
        origin, and `waveform_of` them.
        """
        middle = self.step_times_s[step]
        middle += self.waveform.slot_times_s[self.slots(transmitter)].mean()
        sender, listener = self.transmitters_m[transmitter], self.receivers_m[receiver]
        amplitude = echoes.amplitude if echoes.amplitude.ndim == 1 else echoes.amplitude[step]
        is_in_origin = not (sender.any() or listener.any())
        if is_in_origin and middle == 0:
            return replace(echoes, amplitude=amplitude)
        rate, nearer = echoes.delay_rate, np.zeros(len(echoes))
        if not is_in_origin:
            nearer = nearer_m(echoes, sender, listener)
            if self.gain is not None:
                amplitude = amplitude * level(echoes, sender, listener, self.gain)
            # Per second: the path's direction turns, so elements see different rates.
            nearer_m_per_s = echoes.departure_per_s @ sender + echoes.arrival_per_s @ listener
            rate = rate - nearer_m_per_s / C_M_PER_S
        faster = echoes.delay_acceleration_per_s * middle
        moved = (rate + faster / 2) * middle
        return replace(
            echoes,
            amplitude=amplitude,
            delay_s=echoes.delay_s + moved - nearer / C_M_PER_S,
            delay_rate=rate + faster,
        )


def burst_channel(echoes: Contributions, burst: Burst, tolerance: float = 1e-6) -> Complex:
    """Channel of all echoes, ``(n_steps, n_slots, n_receivers, n_subcarriers)``, as it is found
    by division by the sent symbols.

    Parameters
    ----------
    echoes
        Amplitudes (n,), or (n_steps, n) where they depend on the carrier.
    burst
        When, where and at which frequencies it is sampled.
    tolerance
        As of `demodulated`.
    """
    wave = burst.waveform
    shape = (len(burst.carriers_hz), wave.n_slots, len(burst.receivers_m), wave.n_subcarriers)
    channel = np.empty(shape, dtype=np.complex128)
    for step in range(shape[0]):
        for transmitter in range(len(burst.transmitters_m)):
            there, sent = burst.slots(transmitter), burst.waveform_of(step, transmitter)
            for receiver in range(shape[2]):
                seen = burst.seen(echoes, step, transmitter, receiver)
                demodulated(seen, sent, tolerance, out=channel[step, there, receiver].T)
    return channel


def blended_channel(
    parts: Sequence[Contributions],
    instants_s: Sequence[float],
    weight_of: Callable[[Array], Array],
    burst: Burst,
    tolerance: float = 1e-6,
) -> Complex:
    """Channel of echoes that were traced at several instants of the burst, as of `burst_channel`.

    Parameters
    ----------
    parts, instants_s
        Echoes, amplitudes (n_steps, n), and from when on their delays count.
    weight_of
        Weights of all instants at times (n_times,), (n_instants, n_times).
    """
    wave, senders = burst.waveform, len(burst.transmitters_m)
    shape = (len(burst.carriers_hz), wave.n_slots, len(burst.receivers_m), wave.n_subcarriers)
    channel = np.zeros(shape, dtype=np.complex128)
    for step, start_s in enumerate(burst.step_times_s.tolist()):
        times_s = start_s + wave.slot_times_s
        for echoes, instant_s, weight in zip(parts, instants_s, weight_of(times_s), strict=True):
            heard = np.flatnonzero(weight)
            if not len(heard) or not len(echoes):
                continue
            # From a turn of the first transmitter on, to the end of one of the last.
            first, last = heard[0] // senders * senders, -(-(heard[-1] + 1) // senders) * senders
            slots = slice(int(first), min(int(last), wave.n_slots))
            short = replace(
                burst,
                waveform=replace(wave, n_slots=slots.stop - slots.start),
                carriers_hz=burst.carriers_hz[step : step + 1],
                step_times_s=np.zeros(1),
            )
            here = replace(echoes, amplitude=echoes.amplitude[step : step + 1])
            here = here.counted_from(float(times_s[slots].mean()) - instant_s)
            part = burst_channel(here, short, tolerance)[0]
            channel[step, slots] += weight[slots, None, None] * part
    return channel

"""Other draws of the noise of a frame, of the same light: what else the sensor might have read."""

from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hardware.read_only import cached_read_only, read_only
from hardware.reconstruction.measurements import Measurements, measurements, with_level
from hardware.records import SpiRecord
from twin.camera.chain import Chain, Powers
from twin.fidelity import Noise

Array = NDArray[np.float64]

#: Other records of a frame.
N_DRAWS = 32


class NoiseDraws:
    """Draws of the noise of a captured frame, the same ones of the same frame.

    Their ``seed`` comes from the frame's own noise: another capture has other draws, so that a
    standard deviation which so few of them give too small is not that of all captures alike.
    Points of a sweep, whose noise has one seed, have the same draws.
    """

    def __init__(
        self,
        chain: Chain,
        power: Powers,
        record: SpiRecord,
        *,
        noise: Noise,
        seed: int,
        mean_w: Array | None = None,
        sun_w: Array | None = None,
    ) -> None:
        """``mean_w``, ``sun_w``: of light that changes within the frame, as
        `Chain.measure_frame` takes them.
        """
        self._chain, self._power, self._record = chain, power, record
        self._noise, self.seed, self._mean_w, self._sun_w = noise, seed, mean_w, sun_w
        read_only((power, mean_w, sun_w))

    @property
    def has_noise(self) -> bool:
        """Whether one draw differs from another."""
        return self._noise != "none"

    @property
    def fluctuation(self) -> float:
        """Relative standard deviation of the emitter's light in one exposure."""
        spread = self._chain.system.emitter.intensity_noise
        return spread.value if spread and self.has_noise else 0.0

    @cached_read_only
    def records(self) -> tuple[SpiRecord, ...]:
        """`N_DRAWS` records that differ from the frame's in noise alone; none without any."""
        return tuple(self._drawn()) if self.has_noise else ()

    def in_more_sun(self, more_w: float) -> Measurements:
        """What reconstructions take of a record with more sunlight on each detector."""
        rng = np.random.default_rng(self.seed)
        sun_w = (
            self._power.sun_by_exposure(self._chain.patterns)
            if self._sun_w is None
            else self._sun_w
        )
        record = self._record_of(rng, np.maximum(sun_w + more_w, 0.0))
        return measurements(with_level(record.received))

    @cached_read_only
    def measured(self) -> tuple[Measurements, ...]:
        """What reconstructions take of those records: of a scan, the echoes of each."""
        return tuple(measurements(with_level(record.received)) for record in self.records)

    def _drawn(self) -> Iterator[SpiRecord]:
        rng = np.random.default_rng(self.seed)
        for _ in range(N_DRAWS):
            yield self._record_of(rng, self._sun_w)

    def _record_of(self, rng: np.random.Generator, sun_w: Array | None) -> SpiRecord:
        _, counts, flags = self._chain.measure_frame(
            self._power, rng=rng, noise=self._noise, mean_w=self._mean, sun_w=sun_w
        )
        return replace(self._record, counts=counts, flags=flags)

    @cached_property
    def _mean(self) -> Array:
        return self._chain.mean_signal(self._power) if self._mean_w is None else self._mean_w

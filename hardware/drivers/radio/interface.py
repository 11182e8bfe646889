"""Interface of a radio: tune, transmit a burst at a given time, and receive its echoes."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from enum import IntFlag
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from hardware.errors import LinkError

#: Counts of a sample at full scale: 16 bits on the wire, 1.0 in complex64.
FULL_SCALE_COUNTS = 32767


class Fault(IntFlag):
    """Faults of one burst."""

    OVERFLOW = 1  # the host fetched samples too slowly: some are lost
    LATE = 2  # the command came after its time: nothing was sent
    OUT_OF_SEQUENCE = 4  # packets were lost or came in another order
    UNDERFLOW = 8  # the host sent samples too slowly: the burst has holes
    TIMEOUT = 16  # samples did not come in time


class RadioError(LinkError):
    """The radio cannot be found, refuses, or does not answer. One line that names the radio."""


class Tuned(NamedTuple):
    """Carrier to which a radio is tuned, and device time at which the oscillator locked."""

    carrier_hz: float
    locked_ns: int


@dataclass(frozen=True, eq=False)
class Reception:
    """Received samples of one burst.

    Parameters
    ----------
    samples : (n_receivers, n_samples) complex64
        As many as were sent, aligned with them; 1 is full scale, lost ones are 0.
    there : (n_samples,) bool
        False where a sample was lost.
    start_ns
        Device clock at the first sample.
    faults
        Bits of `Fault`.
    """

    samples: NDArray[np.complex64]
    there: NDArray[np.bool_]
    start_ns: int
    faults: Fault

    @staticmethod
    def nothing(n_receivers: int, n_samples: int, start_ns: int, faults: Fault) -> "Reception":
        """A burst without any received sample."""
        samples = np.zeros((n_receivers, n_samples), dtype=np.complex64)
        return Reception(samples, np.zeros(n_samples, dtype=np.bool_), start_ns, faults)


class RadioDriver(ABC):
    """One transmitter and one or more receivers that share a clock and an oscillator.

    ``device`` identifies it; samples run at ``sample_rate_hz`` both ways.
    """

    device: str
    n_receivers: int
    sample_rate_hz: float

    @abstractmethod
    def tune(self, carrier_hz: float) -> Tuned:
        """Tune transmitter and receivers, and wait until the oscillator has locked.

        The phase is different after each call. Raises RadioError.
        """

    @abstractmethod
    def now_ns(self) -> int:
        """Device clock. Raises RadioError."""

    @abstractmethod
    def burst(self, samples: NDArray[np.complex64], start_ns: int) -> Reception:
        """Transmit (n_samples,), at most 1 in modulus, from ``start_ns`` on, and receive meanwhile.

        Faults of the burst are in the result. Raises RadioError where the radio does not answer.
        """

    @abstractmethod
    def close(self) -> None:
        """Release the device."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

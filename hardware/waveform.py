"""The OFDM waveform: subcarriers, slots, and the limits they set.

A slot holds a prefix and several repeats of one symbol without pause; the receiver averages the
repeats. The same symbol goes out in every slot.
"""

from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from hardware.errors import InputError, check_between, check_choice, check_count, check_finite
from hardware.symbols import OwnSymbols, own_symbols

C_M_PER_S = 299_792_458.0
Symbols = Literal["zadoff-chu", "flat"]
#: Beyond these a radar's times and frequencies are none: their products are numbers.
_BETWEEN = {
    "carrier_hz": (1.0, 1e15),
    "subcarrier_spacing_hz": (1e-6, 1e15),
    "slot_period_s": (1e-15, 1e6),
}


@dataclass(frozen=True)
class OfdmWaveform:
    """Parameters of one coherent processing interval.

    Parameters
    ----------
    carrier_hz
        Centre of the band; subcarrier n lies at carrier + (n - N // 2) spacing.
    n_subcarriers, subcarrier_spacing_hz
        N and df: range resolution c / (2 N df), unambiguous range c / (2 df).
    n_slots, slot_period_s
        M and T: velocity resolution lambda / (2 M T), unambiguous to +/- lambda / (4 T).
    repeats
        Symbols per slot that the receiver averages coherently.
    prefix_s
        Cyclic prefix before the first of them; echoes from beyond c prefix / 2 fall out of step.
    symbols
        ``zadoff-chu``: constant modulus, flat envelope. ``flat``: all ones (an impulse in time).
        Or a user's own: an array (n_subcarriers,) of complex numbers of modulus 1, which records
        hold, so that what is divided by is what was sent; ``own`` holds them then.

    >>> wave = OfdmWaveform(79e9, 4096, 250e3, 256, 20e-6, repeats=4, prefix_s=1e-6)
    >>> f"{wave.range_cell_m:.3f} m, up to {wave.max_range_m:.0f} m"
    '0.146 m, up to 600 m'

    Random phases on four subcarriers:

    >>> phases = np.random.default_rng(0).uniform(0, 2 * np.pi, 4)
    >>> wave = OfdmWaveform(79e9, 4, 250e3, 256, 20e-6, 4, 1e-6, symbols=np.exp(1j * phases))
    >>> wave.symbols, bool(np.allclose(np.angle(wave.sent() * np.exp(-1j * phases)), 0))
    ('own', True)
    """

    carrier_hz: float
    n_subcarriers: int
    subcarrier_spacing_hz: float
    n_slots: int
    slot_period_s: float
    repeats: int
    prefix_s: float
    symbols: Symbols | Literal["own"] | OwnSymbols | NDArray[np.complex128] = "zadoff-chu"
    own: OwnSymbols | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.symbols, str):
            object.__setattr__(self, "own", own_symbols(self.symbols))
            object.__setattr__(self, "symbols", "own")
        elif self.symbols != "own":
            object.__setattr__(self, "own", None)
        for name, (least, most) in _BETWEEN.items():
            check_between(name, getattr(self, name), least, most)
        for name in ("n_subcarriers", "n_slots", "repeats"):
            check_count(name, getattr(self, name))
        check_finite("prefix_s", self.prefix_s)
        if self.prefix_s < 0:
            raise InputError(f"prefix_s: {self.prefix_s} is negative")
        busy = self.prefix_s + self.repeats * self.symbol_s
        if busy > self.slot_period_s * (1 + 1e-9):
            raise InputError(
                f"slot_period_s: {self.slot_period_s:g} s is shorter than prefix and repeats "
                f"({busy:g} s)"
            )
        if self.bandwidth_hz >= 2 * self.carrier_hz:
            raise InputError(f"carrier_hz: {self.carrier_hz:g} is less than half the bandwidth")
        if self.own is not None and self.own.values.size != self.n_subcarriers:
            raise InputError(
                f"symbols: {self.own.values.size}, expected one for each of n_subcarriers, "
                f"{self.n_subcarriers}"
            )
        if self.own is None:
            check_choice("symbols", self.symbols, get_args(Symbols))

    @property
    def symbol_s(self) -> float:
        """Length of one symbol without prefix, 1 / df."""
        return 1 / self.subcarrier_spacing_hz

    @property
    def bandwidth_hz(self) -> float:
        """N df."""
        return self.n_subcarriers * self.subcarrier_spacing_hz

    @property
    def wavelength_m(self) -> float:
        """At the carrier."""
        return C_M_PER_S / self.carrier_hz

    @property
    def delay_cell_s(self) -> float:
        """1 / (N df)."""
        return 1 / self.bandwidth_hz

    @property
    def max_delay_s(self) -> float:
        """Unambiguous delay 1 / df."""
        return 1 / self.subcarrier_spacing_hz

    @property
    def delay_rate_cell(self) -> float:
        """1 / (fc M T), in s/s."""
        return 1 / (self.carrier_hz * self.n_slots * self.slot_period_s)

    @property
    def max_delay_rate(self) -> float:
        """Unambiguous to +/- 1 / (2 fc T), in s/s."""
        return 1 / (2 * self.carrier_hz * self.slot_period_s)

    @property
    def range_cell_m(self) -> float:
        """C / (2 N df)."""
        return C_M_PER_S / (2 * self.bandwidth_hz)

    @property
    def max_range_m(self) -> float:
        """Unambiguous range c / (2 df)."""
        return C_M_PER_S / (2 * self.subcarrier_spacing_hz)

    @property
    def velocity_cell_m_per_s(self) -> float:
        """Lambda / (2 M T)."""
        return self.wavelength_m / (2 * self.n_slots * self.slot_period_s)

    @property
    def max_velocity_m_per_s(self) -> float:
        """Unambiguous to +/- lambda / (4 T)."""
        return self.wavelength_m / (4 * self.slot_period_s)

    @property
    def frequency_offsets_hz(self) -> NDArray[np.float64]:
        """Subcarriers relative to the carrier, (n_subcarriers,)."""
        n = np.arange(self.n_subcarriers, dtype=np.float64) - self.n_subcarriers // 2
        return n * self.subcarrier_spacing_hz

    @property
    def slot_times_s(self) -> NDArray[np.float64]:
        """Middle of each slot's averaged part, relative to the interval's middle, (n_slots,)."""
        m = np.arange(self.n_slots, dtype=np.float64)
        return (m - (self.n_slots - 1) / 2) * self.slot_period_s

    def slot_gain(self, doppler_hz: NDArray[np.float64]) -> NDArray[np.float64]:
        """Amplitude that averaging the repeats leaves at a Doppler shift: a Dirichlet kernel."""
        x = np.pi * np.asarray(doppler_hz, dtype=np.float64) * self.symbol_s
        flat = np.abs(np.sin(x)) < 1e-12
        kernel = np.sin(self.repeats * x) / np.where(flat, 1.0, self.repeats * np.sin(x))
        return np.where(flat, 1.0, kernel)

    def migration_gain(self, range_rate_m_per_s: float) -> float:
        """Amplitude that moving through n range cells within the burst leaves of an echo in the
        middle of its smear on a range-Doppler map without a window, over that of one at rest:
        2 Si(pi n / 2) / (pi n), about 1 / n, the integral of exp(j 2 pi n x y) over band and burst.
        """
        from scipy.special import sici

        moved_m = abs(range_rate_m_per_s) * self.n_slots * self.slot_period_s
        x = np.pi / 2 * moved_m / self.range_cell_m
        return float(sici(x)[0] / x) if x else 1.0

    @property
    def digest(self) -> str:
        """SHA-256 of a user's own symbols; empty where their name says them."""
        return self.own.digest if self.own else ""

    @property
    def own_symbols(self) -> NDArray[np.float64] | None:
        """A user's own symbols for a record, (n_subcarriers, 2): real and imaginary parts."""
        return self.own.pairs if self.own else None

    def over(self, carrier_hz: float, n_subcarriers: int) -> "OfdmWaveform":
        """The same over another band, for what is divided by its symbols already."""
        symbols = "flat" if self.own else self.symbols
        return replace(self, carrier_hz=carrier_hz, n_subcarriers=n_subcarriers, symbols=symbols)

    def sent(self) -> NDArray[np.complex128]:
        """Sent symbol per subcarrier, modulus 1, (n_subcarriers,)."""
        if self.own is not None:
            return self.own.values
        if self.symbols == "flat":
            return np.ones(self.n_subcarriers, dtype=np.complex128)
        n = np.arange(self.n_subcarriers, dtype=np.int64)
        length = self.n_subcarriers
        # pi n (n + odd) / N, reduced modulo 2 pi in integers.
        phase = n * (n + length % 2) % (2 * length)
        return np.exp(-1j * np.pi * phase / length)


def waveform_of(
    *,
    symbols: Any,
    digest: str = "",
    own_symbols: NDArray[np.float64] | None = None,
    **fields: Any,
) -> OfdmWaveform:
    """Waveform of the fields of a record. Raises InputError for what does not fit together, and for
    a user's own symbols whose digest is not that of their content.
    """
    if own_symbols is None or symbols != "own":
        return OfdmWaveform(symbols=symbols, **fields)
    waveform = OfdmWaveform(symbols=own_symbols, **fields)  # type: ignore[arg-type]
    if waveform.digest != digest:
        raise InputError(
            f"symbols: their SHA-256 is {waveform.digest}, the record says {digest!r:.70}"
        )
    return waveform

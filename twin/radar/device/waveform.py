"""What the radar sends, as data: the OFDM waveform, the steps of its carrier, the band allowed."""

from functools import cached_property
from typing import Annotated, ClassVar

from pydantic import Field, model_validator

from hardware.symbols import OwnSymbols, own_symbols
from hardware.waveform import OfdmWaveform, Symbols
from twin.files import InputError
from twin.own_parts import OwnCode, own_part
from twin.toml import Count, NonNegative, Positive, Sourced, Strict

_SYMBOLS = ("symbols", "symbols_file", "function")  # fields of which one says what is sent


class Waveform(Strict):
    """See `OfdmWaveform`. Of a radar that steps its carrier, this is the first step's.

    In place of ``symbols``, a user's own: ``symbols_file`` or ``function``.

    >>> import numpy as np
    >>> from twin.radar import load_radar
    >>> def random_phases(waveform):
    ...     rng = np.random.default_rng(0)
    ...     return np.exp(2j * np.pi * rng.random(waveform.n_subcarriers.value))
    >>> radar = load_radar("hybrid-79").with_({"waveform.function": random_phases})
    >>> radar.ofdm.symbols, radar.ofdm.sent().shape
    ('own', (4096,))
    """

    alternatives: ClassVar = (("symbols",), ("symbols_file",), ("function",))

    carrier_hz: Sourced[Annotated[Positive, Field(le=1e13)]]
    """Middle of the band; of a radar that steps its carrier, in the first step."""
    n_subcarriers: Sourced[Count]
    """N: subcarrier n lies at carrier + (n - N // 2) spacing."""
    subcarrier_spacing_hz: Sourced[Positive]
    """df: range resolution c / (2 N df), unambiguous range c / (2 df)."""
    n_slots: Sourced[Count]
    """M: slots that are processed together."""
    slot_period_s: Sourced[Annotated[Positive, Field(ge=1e-9, le=1e3)]]
    """T: velocity resolution lambda / (2 M T), unambiguous to +/- lambda / (4 T)."""
    repeats: Sourced[Count]
    """Symbols per slot that the receiver averages coherently."""
    prefix_s: Sourced[NonNegative]
    """Cyclic prefix before the first of them; echoes from beyond c prefix / 2 fall out of step."""
    symbols: Sourced[Symbols] | None = None
    """`zadoff-chu`: constant modulus, flat envelope; `flat`: all ones, an impulse in time."""
    symbols_file: Sourced[str] | None = None
    """File of a user's own symbols, an array (n_subcarriers,) of complex numbers of modulus 1 as
    `.npy`.
    """
    function: Sourced[OwnCode] | None = None
    """What gives such an array for this section: `file.py:function`, the name of an entry point of
    the group `twin.waveform`, or in Python itself.
    """

    @model_validator(mode="after")
    def _has_one_kind_of_symbols(self) -> "Waveform":
        if [self.symbols, self.symbols_file, self.function].count(None) != 2:
            raise InputError("needs one of symbols, symbols_file and function")
        return self

    @cached_property
    def sent(self) -> Symbols | OwnSymbols:
        """Name of the symbols, or a user's own. Raises InputError."""
        if self.symbols_file is not None:
            try:
                return own_symbols(self.symbols_file.value)
            except (InputError, FileNotFoundError) as error:
                raise InputError(f"waveform.symbols_file: {error}") from error
        if self.function is None:
            assert self.symbols is not None
            return self.symbols.value
        own = own_part("waveform.function", self.function.value)
        try:
            return own_symbols(own(self))
        except InputError as error:
            raise InputError(f"waveform.function: {own.name}: {error}") from error

    @property
    def ofdm(self) -> OfdmWaveform:
        """The waveform with its symbols. Raises InputError."""
        names = [name for name in Waveform.model_fields if name not in _SYMBOLS]
        fields = {name: getattr(self, name).value for name in names}
        return OfdmWaveform(**fields, symbols=self.sent)


class Steps(Strict):
    """A carrier that steps upwards from the waveform's."""

    count: Sourced[Annotated[int, Field(strict=True, ge=1, le=4096)]]
    """Carriers, one after another."""
    spacing_hz: Sourced[Positive]
    """From one carrier to the next: the bandwidth of one step, n_subcarriers x
    subcarrier_spacing_hz, so that the bands of the steps touch.
    """
    settling_s: Sourced[Annotated[NonNegative, Field(le=1e3)]]
    """From the end of one step's slots to the next one's."""
    random_phase: Sourced[bool]
    """Whether the carrier comes back from each retune with a phase of its own."""
    timing_rms_s: Sourced[Annotated[NonNegative, Field(le=1.0)]]
    """Of the delay between sending and sampling, drawn anew at each step."""


class Band(Strict):
    """Where the radar may transmit."""

    low_hz: Sourced[Positive]
    """Lowest frequency that may be sent; below it there is a warning."""
    high_hz: Sourced[Positive]
    """Highest frequency that may be sent; above it there is a warning."""

    @model_validator(mode="after")
    def _ascends(self) -> "Band":
        if self.low_hz.value >= self.high_hz.value:
            raise InputError("low_hz is not below high_hz")
        return self

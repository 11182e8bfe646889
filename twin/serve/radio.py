"""The virtual radio: a radio whose antennas are in the scene."""

import logging
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from hardware.drivers.radio.interface import (
    FULL_SCALE_COUNTS,
    Fault,
    RadioDriver,
    RadioError,
    Reception,
    Tuned,
)
from hardware.drivers.radio.samples import SlotGrid, highest_level, spectrum, symbol
from hardware.drivers.radio.schedule import Schedule
from hardware.records import RadarFrontEnd
from twin import __version__
from twin.files import InputError
from twin.radar import RadarDesign
from twin.serve.clock import DeviceClock
from twin.serve.faults import RadioFaults
from twin.serve.sweeps import RadarSweep
from twin.serve.world import SharedWorld

_log = logging.getLogger(__name__)

_PAUSE_S = 2e-3  # between the bursts of a radar that does not step its carrier
_WAITED_S = 5e-3  # for a sweep, from which on it is late
_LATE_TOLD = 3  # late sweeps until it is said: the first may be chance
_FAR_NS = 60_000_000_000  # nobody means to wait longer for a burst


class VirtualRadio(RadioDriver):
    """The twin as a radio.

    It returns the twin's own counts as samples: a record acquired through it is bit for bit the one
    that the twin makes directly. The samples sent determine the echo: the channel multiplies the
    subcarriers of each symbol, so an echo stays within its symbol (as with a cyclic prefix longer
    than the echo's delay). All repeats of a slot are the same, each with the noise of their mean;
    between slots the samples are 0.

    Sweeps are computed in advance, for the waveform's own samples. The oscillator locks at once,
    except at the beginning of a sweep that is not ready yet: if a scene takes longer than real
    time, sweeps are delayed, but no burst is lost.

    Parameters
    ----------
    radar
        The design.
    sweeps
        The scene's echoes for sweep k over all carriers.
    clock
        Device time.
    faults, seed
        Injected faults, and the seed of their random numbers.
    world, later
        The world that other devices show too, and sweeps from a time of it on: those of a radio
        that is first tuned after another device began.
    """

    def __init__(
        self,
        radar: RadarDesign,
        sweeps: Callable[[int], RadarSweep],
        *,
        clock: DeviceClock,
        faults: RadioFaults | None = None,
        seed: int = 0,
        world: SharedWorld | None = None,
        later: Callable[[float], Callable[[int], RadarSweep]] | None = None,
    ) -> None:
        self.radar, self.clock = radar, clock
        self._world, self._later = world, later
        self._begins_s: float | None = None  # of the world
        self.waveform = radar.ofdm
        self.level = highest_level(self.waveform)
        self.grid = SlotGrid.of(self.waveform)
        self.sample_rate_hz = self.waveform.bandwidth_hz
        self.device = f"twin {__version__}: {radar.name}"
        self._faults, self._rng = faults or RadioFaults(), np.random.default_rng(seed)
        self._sent_spectrum = spectrum(symbol(self.waveform, self.level), self.level)
        self._sweeps = sweeps
        self._next_sweep: RadarSweep | None = sweeps(0)
        self._sweep, self._late = -1, 0
        self._step = 0
        self._begin_sweep()
        if (n := len(self._record.front_end.transmitters_m)) > 1:
            raise InputError(f"radar {radar.name}: {n} transmitters, expected 1 for a radio")
        self.carriers_hz = self._record.carriers_hz
        self.n_receivers = len(self._record.front_end.receivers_m)

    @property
    def n_samples(self) -> int:
        """Of one burst."""
        return self.waveform.n_slots * self.grid.slot

    @property
    def front_end(self) -> RadarFrontEnd:
        """Front end, as a calibration of this radio would measure it."""
        return self._record.front_end

    @property
    def schedule(self) -> Schedule:
        """The design's own schedule, at which the scene moves."""
        burst_s = self.waveform.n_slots * self.waveform.slot_period_s
        starts = self._record.device_time_ns[0, :, 0]
        period = float(starts[1] - starts[0]) / 1e9 if len(starts) > 1 else burst_s + _PAUSE_S
        return Schedule(
            self.waveform,
            tuple(self.carriers_hz.tolist()),
            step_period_s=period,
            settling_s=(period - burst_s) / 10,  # it locks at once: the rest is left to the host
            level=self.level,
        )

    def tune(self, carrier_hz: float) -> Tuned:
        """See `RadioDriver.tune`; refuses what is none of the design's carriers."""
        steps = np.flatnonzero(np.abs(self.carriers_hz - carrier_hz) < 0.5)
        if not steps.size:
            raise RadioError(
                f"{self.device}: {carrier_hz:.0f} Hz is none of its {len(self.carriers_hz)} "
                f"carriers, {self.carriers_hz.min():.0f} to {self.carriers_hz.max():.0f} Hz"
            )
        self._step = int(steps[0])
        self._join_world()
        if self._step in self._played:
            self._await_sweep()
        return Tuned(float(self.carriers_hz[self._step]), self.clock.now_ns())

    def now_ns(self) -> int:
        """See `RadioDriver.now_ns`."""
        return self.clock.now_ns()

    def burst(self, samples: NDArray[np.complex64], start_ns: int) -> Reception:
        """See `RadioDriver.burst`; a burst is as long as the design's."""
        expected = self.n_samples
        if len(samples) != expected:
            raise RadioError(f"{self.device}: burst of {len(samples)} samples, expected {expected}")
        now = self.clock.now_ns()
        if start_ns > now + _FAR_NS:
            raise RadioError(f"{self.device}: burst starts {(start_ns - now) / 1e9:.0f} s ahead")
        if start_ns < now or self._happens(self._faults.late):
            return Reception.nothing(self.n_receivers, expected, start_ns, Fault.LATE)
        heard = Reception(
            self._received_samples(samples), np.ones(expected, dtype=np.bool_), start_ns, Fault(0)
        )
        self.clock.wait_until(start_ns + round(1e9 * expected / self.sample_rate_hz))
        return self._with_faults(heard)

    def close(self) -> None:
        """Nothing to release."""

    def _join_world(self) -> None:
        """Begin with the world, once, with sweeps of what it is like then."""
        if self._world is None or self._begins_s is not None:
            return
        self._begins_s = self._world.begin()
        if self._later is not None:
            try:
                self._sweeps = self._later(self._begins_s)
            except InputError as error:
                self._begins_s = None
                raise RadioError(f"{self.device}: {error}") from error
            self._sweep = -1
            self._await_sweep()
            self._begin_sweep()

    def _tell_behind(self) -> None:
        """Tell once where the world that is shown is more than a sweep older than the others'."""
        if self._world is None or self._begins_s is None:
            return
        lasts_s = self.schedule.sweep_s
        behind_s = self._world.reached(self._begins_s + self._sweep * lasts_s)
        if self.clock.pace == "real" and behind_s > lasts_s and not self._behind_told:
            self._behind_told = True
            _log.warning(
                "%s: sweep %d shows the world of %.3g s ago: the devices of this world share one "
                "instant only as far as sweeps are computed and asked for in time",
                *(self.device, self._sweep, behind_s),
            )

    _behind_told = False

    def _begin_sweep(self) -> None:
        """Begin the next sweep."""
        assert self._next_sweep is not None
        self._echo, self._record = self._next_sweep.echo, self._next_sweep.record
        self._next_sweep = None
        self._sweep, self._begun_s = self._sweep + 1, time.monotonic()
        self._played: set[int] = set()
        shape = (len(self._record.carriers_hz), self.waveform.n_slots, len(self._sent_spectrum))
        self._sent = np.array(np.broadcast_to(self._sent_spectrum, shape))

    def _await_sweep(self) -> None:
        """Wait for the next sweep. Raises RadioError where it fails."""
        if self._next_sweep is not None:
            return
        asked_s, number = time.monotonic(), self._sweep + 1
        try:
            self._next_sweep = self._sweeps(number)
        except Exception as error:  # any engine's: client and operator get one line of it
            line = f"{self.device}: sweep {number}: {' '.join(str(error).split())}"
            _log.error("%s", line)
            raise RadioError(line) from error
        now_s = time.monotonic()
        if self.clock.pace == "real" and now_s - asked_s > _WAITED_S:
            self._warn_late(now_s - self._begun_s)

    def _warn_late(self, took_s: float) -> None:
        self._late += 1
        lasts_s = self.schedule.sweep_s
        if self._late == _LATE_TOLD and took_s > lasts_s:
            _log.warning(
                "%s: slower than real time: a sweep lasts %.3g s, the next was computed after "
                "%.3g s, %.1f times as long; sweeps come later, none is lost",
                *(self.device, lasts_s, took_s, took_s / lasts_s),
            )

    def _received_samples(self, samples: NDArray[np.complex64]) -> NDArray[np.complex64]:
        """Samples (n_receivers, n_samples) received in this step's burst."""
        if self._step in self._played:
            self._await_sweep()
            self._begin_sweep()
            self._tell_behind()
        self._played.add(self._step)
        n_slots, grid = self.waveform.n_slots, self.grid
        repeats = samples.reshape(n_slots, grid.slot)[:, grid.useful]
        repeats = repeats.reshape(n_slots, grid.repeats, grid.symbol)
        symbols = repeats.astype(np.complex128).mean(axis=1).astype(np.complex64)
        sent = spectrum(symbols, self.level)
        if not np.array_equal(sent, self._sent[self._step]):
            self._sent[self._step] = sent
            self._record = self._echo.record(self._sent)
        counts = self._record.iq[0, self._step].astype(np.float64) / FULL_SCALE_COUNTS
        received = (counts[..., 0] + 1j * counts[..., 1]).astype(np.complex64)
        heard = np.zeros((self.n_receivers, n_slots, grid.slot), dtype=np.complex64)
        places = np.arange(-grid.prefix, grid.repeats * grid.symbol) % grid.symbol
        heard[..., : len(places)] = received.transpose(1, 0, 2)[..., places]
        return heard.reshape(self.n_receivers, -1)

    def _with_faults(self, heard: Reception) -> Reception:
        faults = Fault(0)
        for fault, chance in (
            (Fault.OVERFLOW, self._faults.overflow),
            (Fault.OUT_OF_SEQUENCE, self._faults.out_of_sequence),
        ):
            if self._happens(chance):
                faults |= fault
                start, stop = np.sort(self._rng.integers(0, len(heard.there), 2))
                heard.there[start : stop + 1] = False
        if self._happens(self._faults.underflow):
            faults |= Fault.UNDERFLOW
        heard.samples[:, ~heard.there] = 0
        return Reception(heard.samples, heard.there, heard.start_ns, faults)

    def _happens(self, chance: float) -> bool:
        return chance > 0 and bool(self._rng.random() < chance)

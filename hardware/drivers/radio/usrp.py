"""Radios of Ettus over UHD, mainly the B200; RADIO.md lists what has not been tested.

Needs UHD's own Python package `uhd` (Debian's python3-uhd, or the vendor's), imported only here.
"""

import time
from concurrent.futures import ThreadPoolExecutor
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hardware.drivers.radio.interface import Fault, RadioDriver, RadioError, Reception, Tuned

_LOCK_S = 1.0  # within which an oscillator locks, or does not
_RECEIVE_S = 0.5  # beyond the end of a burst, until its last samples are here
_TICKS_HZ = 1e9


class UhdRadio(RadioDriver):
    """A UHD radio: channel 0 transmits, channels 0 to ``n_receivers - 1`` receive.

    Parameters
    ----------
    args
        UHD's device arguments, such as ``type=b200``; empty: the first one found.
    sample_rate_hz
        Both ways.
    n_receivers
        Channels that receive.
    transmit_gain_db, receive_gain_db
        As defined by UHD; a calibration is valid for one pair.
    transmit_antenna, receive_antenna
        Ports, by UHD's names.
    uhd
        The package, in place of the one installed.

    Raises RadioError without UHD, without such a radio, or for an unsupported sample rate.
    """

    def __init__(
        self,
        args: str = "",
        *,
        sample_rate_hz: float,
        n_receivers: int = 1,
        transmit_gain_db: float = 60.0,
        receive_gain_db: float = 40.0,
        transmit_antenna: str = "TX/RX",
        receive_antenna: str = "RX2",
        uhd: ModuleType | Any = None,
    ) -> None:
        self._uhd = uhd or _uhd()
        self.n_receivers = n_receivers
        channels = list(range(n_receivers))
        try:
            usrp = self._uhd.usrp.MultiUSRP(args)
            usrp.set_tx_rate(sample_rate_hz, 0)
            usrp.set_tx_gain(transmit_gain_db, 0)
            usrp.set_tx_antenna(transmit_antenna, 0)
            for channel in channels:
                usrp.set_rx_rate(sample_rate_hz, channel)
                usrp.set_rx_gain(receive_gain_db, channel)
                usrp.set_rx_antenna(receive_antenna, channel)
            self.sample_rate_hz = float(usrp.get_rx_rate(0))
            both = (self.sample_rate_hz, float(usrp.get_tx_rate(0)))
            if not np.allclose(both, sample_rate_hz, rtol=1e-9, atol=0):
                raise RadioError(
                    f"uhd:{args}: {both[0]:g} samples/s in and {both[1]:g} out, "
                    f"asked for {sample_rate_hz:g}"
                )
            usrp.set_time_now(self._uhd.types.TimeSpec(0.0))
            self._transmit = usrp.get_tx_stream(self._stream_args([0]))
            self._receive = usrp.get_rx_stream(self._stream_args(channels))
            self.device = f"uhd:{args} {usrp.get_mboard_name()}"
        except RuntimeError as error:
            raise RadioError(f"uhd:{args}: {_one_line(error)}") from error
        self._usrp = usrp

    def tune(self, carrier_hz: float) -> Tuned:
        """See `RadioDriver.tune`. The B200 has separate oscillators of transmitter and receiver;
        both must lock.

        The front end's oscillator cannot be tuned at a given time (only the digital mixer can,
        whose range is the sample rate), so it is tuned at once, with a wait for settling.
        """
        usrp, request = self._usrp, self._uhd.types.TuneRequest(carrier_hz)
        try:
            usrp.set_tx_freq(request, 0)
            for channel in range(self.n_receivers):
                usrp.set_rx_freq(request, channel)
            until = time.monotonic() + _LOCK_S
            while not all(self._locked()):
                if time.monotonic() > until:
                    raise RadioError(f"{self.device}: no lock at {carrier_hz:.0f} Hz")
                time.sleep(1e-4)
            locked_ns = self.now_ns()
            transmit_hz, receive_hz = float(usrp.get_tx_freq(0)), float(usrp.get_rx_freq(0))
        except RuntimeError as error:
            raise RadioError(f"{self.device}: {_one_line(error)}") from error
        if abs(transmit_hz - receive_hz) > 1:
            raise RadioError(
                f"{self.device}: sends at {transmit_hz:.0f} Hz, receives at {receive_hz:.0f} Hz"
            )
        return Tuned(receive_hz, locked_ns)

    def now_ns(self) -> int:
        """See `RadioDriver.now_ns`."""
        return to_ns(self._usrp.get_time_now())

    def burst(self, samples: NDArray[np.complex64], start_ns: int) -> Reception:
        """See `RadioDriver.burst`."""
        types = self._uhd.types
        start = types.TimeSpec.from_ticks(int(start_ns), _TICKS_HZ)
        command = types.StreamCMD(types.StreamMode.num_done)
        command.num_samps, command.stream_now, command.time_spec = len(samples), False, start
        try:
            with ThreadPoolExecutor(1) as beside:
                self._receive.issue_stream_cmd(command)
                sending = beside.submit(self._send, samples, start)
                reception = self._heard(len(samples), start_ns)
                sending.result()
        except RuntimeError as error:
            raise RadioError(f"{self.device}: {_one_line(error)}") from error
        sent = self._sent()
        return Reception(
            reception.samples, reception.there, reception.start_ns, reception.faults | sent
        )

    def close(self) -> None:
        """See `RadioDriver.close`: UHD releases the device with the last reference."""
        self._transmit = self._receive = self._usrp = None

    def _stream_args(self, channels: list[int]) -> Any:
        args = self._uhd.usrp.StreamArgs("fc32", "sc16")
        args.channels = channels
        return args

    def _locked(self) -> list[bool]:
        """Lock state of every channel that reports one."""
        usrp = self._usrp
        locked = []
        if "lo_locked" in usrp.get_tx_sensor_names(0):
            locked.append(usrp.get_tx_sensor("lo_locked", 0).to_bool())
        for channel in range(self.n_receivers):
            if "lo_locked" in usrp.get_rx_sensor_names(channel):
                locked.append(usrp.get_rx_sensor("lo_locked", channel).to_bool())
        return locked

    def _send(self, samples: NDArray[np.complex64], start: Any) -> None:
        metadata = self._uhd.types.TXMetadata()
        metadata.has_time_spec, metadata.time_spec = True, start
        metadata.start_of_burst = metadata.end_of_burst = True
        ahead_s = (to_ns(start) - self.now_ns()) / _TICKS_HZ
        patience = max(0.0, ahead_s) + len(samples) / self.sample_rate_hz + _RECEIVE_S
        self._transmit.send(np.ascontiguousarray(samples[None]), metadata, patience)

    def _heard(self, n_samples: int, start_ns: int) -> Reception:
        """Received chunks, each placed by its time stamp."""
        reception = Reception.nothing(self.n_receivers, n_samples, start_ns, Fault(0))
        faults = Fault(0)
        size = self._receive.get_max_num_samps()
        buffer = np.empty((self.n_receivers, size), dtype=np.complex64)
        metadata = self._uhd.types.RXMetadata()
        ahead_s = max(0.0, (start_ns - self.now_ns()) / _TICKS_HZ)
        patience, place = ahead_s + size / self.sample_rate_hz + _RECEIVE_S, 0
        while place < n_samples:
            n = self._receive.recv(buffer, metadata, patience)
            faults |= receive_fault(self._uhd, metadata)
            if not n and not faults:  # no error, but no samples either
                faults |= Fault.TIMEOUT
            if metadata.has_time_spec and n:
                since_ns = to_ns(metadata.time_spec) - start_ns
                place = round(since_ns * self.sample_rate_hz / _TICKS_HZ)
            fits = slice(max(place, 0), min(place + n, n_samples))
            if fits.stop > fits.start:
                reception.samples[:, fits] = buffer[:, fits.start - place : fits.stop - place]
                reception.there[fits] = True
            place += n
            if faults & (Fault.LATE | Fault.TIMEOUT) or metadata.end_of_burst:
                break
            patience = _RECEIVE_S
        return Reception(reception.samples, reception.there, start_ns, faults)

    def _sent(self) -> Fault:
        """Faults of the transmitted burst, from messages up to the acknowledgement of its end."""
        types, faults = self._uhd.types, Fault(0)
        metadata = types.TXAsyncMetadata()
        while self._transmit.recv_async_msg(metadata, _RECEIVE_S):
            if metadata.event_code == types.TXMetadataEventCode.burst_ack:
                return faults
            faults |= transmit_fault(self._uhd, metadata)
            if faults & Fault.LATE:
                return faults
        return faults | Fault.TIMEOUT


def to_ns(spec: Any) -> int:
    """UHD's time in whole nanoseconds."""
    return int(spec.to_ticks(_TICKS_HZ))


def receive_fault(uhd: Any, metadata: Any) -> Fault:
    """Fault of a receiver's metadata. Raises RadioError for a fatal one."""
    codes = uhd.types.RXMetadataErrorCode
    code = metadata.error_code
    if code == codes.none:
        return Fault.OUT_OF_SEQUENCE if metadata.out_of_sequence else Fault(0)
    if code == codes.overflow:
        # The same code for samples the host left lying and for packets lost on the way.
        return Fault.OUT_OF_SEQUENCE if metadata.out_of_sequence else Fault.OVERFLOW
    if code == codes.late:
        return Fault.LATE
    if code == codes.timeout:
        return Fault.TIMEOUT
    raise RadioError(f"uhd: {code.name}: {metadata.strerror()}")


def transmit_fault(uhd: Any, metadata: Any) -> Fault:
    """Fault of a transmitter's message; none for an acknowledgement."""
    codes = uhd.types.TXMetadataEventCode
    known = {
        codes.underflow: Fault.UNDERFLOW,
        codes.underflow_in_packet: Fault.UNDERFLOW,
        codes.seq_error: Fault.OUT_OF_SEQUENCE,
        codes.seq_error_in_packet: Fault.OUT_OF_SEQUENCE,
        codes.time_error: Fault.LATE,
    }
    return known.get(metadata.event_code, Fault(0))


def _uhd() -> Any:
    try:
        import uhd
    except (ImportError, AttributeError) as error:
        # Built against another NumPy, it fails with either.
        raise RadioError(
            f"uhd: UHD's Python package cannot be imported ({_one_line(error)}); install Debian's "
            "python3-uhd, or the vendor's, for this Python and this NumPy"
        ) from error
    return uhd


def _one_line(error: Exception) -> str:
    return " ".join(str(error).replace("----->", "").split())

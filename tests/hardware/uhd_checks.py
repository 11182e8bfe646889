"""What the real UHD library says to the driver: run by test_radio_uhd.py under the Python of UHD.

Prints one JSON object; uses nothing that such a Python may lack (pytest, the simulator).
"""

import json
import types

import numpy as np
import uhd

from hardware.drivers.radio import usrp
from hardware.drivers.radio.interface import Fault, RadioError
from hardware.drivers.radio.opening import open_radio

RATE = 20e6


def discovery() -> dict[str, str]:
    """No radio on any bus: one line that names the arguments."""
    said = {}
    for url in ("uhd:type=b200", "uhd:", "uhd:type=b200,serial=FFFFFF"):
        try:
            open_radio(url, sample_rate_hz=RATE)
        except RadioError as error:
            said[url] = str(error)
    return said


def times() -> list[int]:
    """Nanoseconds through UHD's time and back, up to 30 years."""
    some = [0, 1, 49, 50, 999_999_999, 1_000_000_000, 10**18 - 1, 946_684_800_123_456_789]
    back = [usrp.to_ns(uhd.types.TimeSpec.from_ticks(ns, 1e9)) for ns in some]
    return [b - a for a, b in zip(some, back, strict=True)]


def faults() -> dict[str, object]:
    """Every code that UHD knows, with and without packets out of sequence."""
    found: dict[str, object] = {}
    for name, code in uhd.types.RXMetadataErrorCode.__members__.items():
        for out in (False, True):
            told = types.SimpleNamespace(
                error_code=code, out_of_sequence=out, strerror=lambda n=name: f"says {n}"
            )
            try:
                found[f"{name} {out}"] = int(usrp.receive_fault(uhd, told))
            except RadioError as error:
                found[f"{name} {out}"] = str(error)
    for name, code in uhd.types.TXMetadataEventCode.__members__.items():
        fault = usrp.transmit_fault(uhd, types.SimpleNamespace(event_code=code))
        found[f"transmit {name}"] = int(fault)
    return found


class Metadata:
    """UHD's own has no setters."""

    def __init__(self) -> None:
        self.error_code = uhd.types.RXMetadataErrorCode.none
        self.out_of_sequence = self.end_of_burst = self.has_time_spec = False
        self.time_spec = uhd.types.TimeSpec(0.0)
        self.event_code = uhd.types.TXMetadataEventCode.burst_ack

    def strerror(self) -> str:
        return str(self.error_code)


class Streamers:
    """Stands in for both streamers: what is sent comes back halved, in packets, as told."""

    def __init__(self, packets: int, events: tuple[str, ...], script: dict[int, str]) -> None:
        self.packets, self.events, self.script = packets, list(events), script
        self.log: list[object] = []

    def send(self, samples, metadata, timeout):
        assert isinstance(metadata, uhd.types.TXMetadata)
        assert metadata.start_of_burst
        assert metadata.end_of_burst
        self.sent, self.log = samples, [*self.log, ("send", samples.shape, round(timeout, 3))]
        return samples.shape[1]

    def recv_async_msg(self, metadata, timeout):
        if not self.events:
            return False
        metadata.event_code = getattr(uhd.types.TXMetadataEventCode, self.events.pop(0))
        return True

    def get_max_num_samps(self):
        return self.packets

    def issue_stream_cmd(self, command):
        assert isinstance(command, uhd.types.StreamCMD)
        self.command, self.place, self.packet = command, 0, 0
        self.log.append(("stream", command.num_samps, usrp.to_ns(command.time_spec)))

    def recv(self, buffer, metadata, timeout):
        while not hasattr(self, "sent"):
            pass  # the sender has a thread of its own
        codes = uhd.types.RXMetadataErrorCode
        what = self.script.get(self.packet, "")
        metadata.error_code, metadata.out_of_sequence = codes.none, False
        metadata.has_time_spec, self.packet = False, self.packet + 1
        if what in ("late", "timeout"):
            metadata.error_code = getattr(codes, what)
            return 0
        if what == "overflow":
            metadata.error_code = codes.overflow
            self.place += self.packets  # one packet is lost
            return 0
        n = min(self.packets, self.command.num_samps - self.place)
        buffer[:, :n] = 0.5 * self.sent[:, self.place : self.place + n]
        start = usrp.to_ns(self.command.time_spec)
        metadata.has_time_spec = True
        metadata.time_spec = uhd.types.TimeSpec.from_ticks(start + self.place * 50, 1e9)
        self.place += n
        metadata.end_of_burst = self.place >= self.command.num_samps
        return n


class Usrp:
    """Stands in for UHD's MultiUSRP, beneath the real types."""

    def __init__(self, streamers: Streamers) -> None:
        self.streamers, self.calls = streamers, []

    def __getattr__(self, name: str):
        def call(*args):
            self.calls.append(
                (name, *[str(type(a).__name__) if i else "" for i, a in enumerate(args)])
            )
            if name == "get_time_now":
                return uhd.types.TimeSpec(1.0)
            if name in ("get_rx_rate", "get_tx_rate"):
                return RATE
            if name in ("set_rx_freq", "set_tx_freq"):
                assert isinstance(args[0], uhd.types.TuneRequest)
                self.tuned = args[0].target_freq
                return None
            if name in ("get_rx_freq", "get_tx_freq"):
                return self.tuned + 0.25
            if name.endswith("sensor_names"):
                return ["lo_locked"]
            if name.endswith("sensor"):
                return types.SimpleNamespace(to_bool=lambda: True)
            if name.endswith("_stream"):
                assert args[0].cpu_format == "fc32"
                assert args[0].otw_format == "sc16"
                return self.streamers
            return "B200"

        return call


def streams() -> dict[str, object]:
    """A burst of 1000 samples in packets of 300, as it should be and as it should not."""
    found: dict[str, object] = {}
    cases = {
        "good": (("burst_ack",), {}),
        "overflow": (("burst_ack",), {1: "overflow"}),
        "late": (("time_error",), {0: "late"}),
        "timeout": (("burst_ack",), {2: "timeout"}),
        "underflow": (("underflow", "burst_ack"), {}),
        "no acknowledgement": ((), {}),
    }
    sent = np.exp(1j * np.arange(1000)).astype(np.complex64)
    for name, (events, script) in cases.items():
        streamers = Streamers(300, events, script)
        own = types.SimpleNamespace(RXMetadata=Metadata, TXAsyncMetadata=Metadata)
        for kind in ("TimeSpec", "StreamCMD", "StreamMode", "TuneRequest", "TXMetadata"):
            setattr(own, kind, getattr(uhd.types, kind))
        own.RXMetadataErrorCode = uhd.types.RXMetadataErrorCode
        own.TXMetadataEventCode = uhd.types.TXMetadataEventCode
        fake = types.SimpleNamespace(
            types=own,
            usrp=types.SimpleNamespace(
                MultiUSRP=lambda args, s=streamers: Usrp(s), StreamArgs=uhd.usrp.StreamArgs
            ),
        )
        with usrp.UhdRadio("type=b200", sample_rate_hz=RATE, uhd=fake) as radio:
            tuned = radio.tune(2.5e9).carrier_hz
            heard = radio.burst(sent, 1_010_000_000)
            there = heard.there
            found[name] = {
                "device": radio.device,
                "tuned": tuned,
                "now": radio.now_ns(),
                "faults": int(heard.faults),
                "there": int(there.sum()),
                "first_lost": int(np.argmin(there)) if not there.all() else -1,
                "right": bool(np.array_equal(heard.samples[0][there], (0.5 * sent)[there])),
                "silent": not heard.samples[0][~there].any(),
                "log": streamers.log,
            }
    return found


if __name__ == "__main__":
    assert Fault.LATE == 2
    print(
        json.dumps(
            {
                "discovery": discovery(),
                "times": times(),
                "faults": faults(),
                "streams": streams(),
            }
        )
    )

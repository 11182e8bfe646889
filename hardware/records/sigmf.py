"""Radar IQ as SigMF, one capture per burst and carrier step: what tools for radio read."""

from collections.abc import Callable, Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hardware.files import naming
from hardware.records.container import Flag
from hardware.records.radar import RadarRecord

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
#: Transmitters of slots that are told one by one; longer turns are told by their beginning.
_MOST_TURN = 64


def export_sigmf(
    record: RadarRecord, stem: str | Path, host_ns: Callable[[int], int] | None = None
) -> tuple[Path, Path]:
    """Write ``STEM.sigmf-data`` (interleaved 16-bit I and Q) and ``STEM.sigmf-meta``.

    Receivers are the channels, interleaved sample by sample. Slots follow each other without the
    pauses between them: one symbol each, sampled at the bandwidth. A capture begins at the first
    slot of each burst and carrier step; its ``core:global_index`` counts samples from the record's
    first slot by the device's clock, pauses included, and its ``core:datetime`` is there where
    ``host_ns`` tells the host's time of a device time. Slots with flags are annotated. Needs the
    package `sigmf` (``pip install ugv-twin[sigmf]``).

    Both files or none. Raises FileExistsError, before anything is written, where either exists;
    OSError, with the file, where it cannot be written.
    """
    import sigmf

    data, meta = (Path(f"{stem}.sigmf-{kind}") for kind in ("data", "meta"))
    for path in (data, meta):
        if path.exists():
            raise FileExistsError(f"{path}: exists already; a recording is not written over")
    try:
        with naming(data), data.open("wb") as file:
            file.write(np.ascontiguousarray(np.moveaxis(record.iq, 3, 4), dtype="<i2").data)
        described = _described(sigmf, record, data, host_ns)
        with naming(meta):
            described.tofile(str(meta))
    except BaseException:
        for path in (data, meta):
            path.unlink(missing_ok=True)
        raise
    return data, meta


def _described(
    sigmf: Any, record: RadarRecord, data: Path, host_ns: Callable[[int], int] | None
) -> Any:
    """The metadata of a data file, as the library's own object."""
    wave = record.waveform
    n_bursts, n_steps, n_slots, n_receivers = record.iq.shape[:4]
    description = (
        f"OFDM radar, {n_bursts} bursts, {n_steps} carrier steps, {n_slots} slots of "
        f"{wave.slot_period_s:g} s, of which {wave.n_subcarriers} samples each are stored, "
        f"{n_receivers} receivers, {_turns(record)}, symbols {wave.symbols}; "
        f"one count is {record.front_end.root_watt_per_count:g} root watts"
    )
    file = sigmf.SigMFFile(
        data_file=str(data),
        global_info={
            sigmf.DATATYPE_KEY: "ci16_le",
            sigmf.NUM_CHANNELS_KEY: n_receivers,
            sigmf.SAMPLE_RATE_KEY: wave.bandwidth_hz,
            sigmf.HW_KEY: record.device,
            sigmf.DESCRIPTION_KEY: description,
        },
    )
    starts_ns = record.device_time_ns[:, :, 0].reshape(-1).tolist()
    for capture, carrier in enumerate(np.tile(record.carriers_hz, n_bursts).tolist()):
        since_s = (starts_ns[capture] - starts_ns[0]) * 1e-9
        told = {
            sigmf.FREQUENCY_KEY: carrier,
            sigmf.GLOBAL_INDEX_KEY: max(round(since_s * wave.bandwidth_hz), 0),
        }
        if host_ns is not None:
            told[sigmf.DATETIME_KEY] = _utc(host_ns(starts_ns[capture]))
        file.add_capture(capture * n_slots * wave.n_subcarriers, metadata=told)
    for first, count, flags in _flagged(record.flags.reshape(-1)):
        names = ", ".join(flag.name.lower() for flag in Flag(flags) if flag.name)
        file.add_annotation(
            first * wave.n_subcarriers,
            count * wave.n_subcarriers,
            metadata={sigmf.LABEL_KEY: names},
        )
    return file


def _turns(record: RadarRecord) -> str:
    """Which transmitter sends in each slot: the shortest turn that repeats over the slots."""
    senders = record.transmitter
    turn = next(n for n in range(1, len(senders) + 1) if (senders[n:] == senders[:-n]).all())
    shown = ", ".join(map(str, senders[: min(turn, _MOST_TURN)].tolist()))
    return f"transmitters by turns {shown}{', ...' * (turn > _MOST_TURN)}"


def _utc(time_ns: int) -> str:
    """ISO 8601 of a host's time, to the nanosecond."""
    seconds, nanoseconds = divmod(time_ns, 10**9)
    return f"{_EPOCH + timedelta(seconds=seconds):%Y-%m-%dT%H:%M:%S}.{nanoseconds:09d}Z"


def _flagged(flags: NDArray[np.uint8]) -> Iterator[tuple[int, int, int]]:
    """First slot, number and flags of slots that follow each other with the same flags."""
    edges = np.flatnonzero(np.diff(flags, prepend=0, append=0))
    begins = np.unique(np.concatenate([[0], edges, [len(flags)]]))
    for first, stop in zip(begins[:-1].tolist(), begins[1:].tolist(), strict=True):
        if flags[first]:
            yield first, stop - first, int(flags[first])

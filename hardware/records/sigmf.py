"""Radar IQ as SigMF, one capture per burst and carrier step: what tools for radio read."""

from pathlib import Path
from typing import Any

import numpy as np

from hardware.records.radar import RadarRecord


def export_sigmf(record: RadarRecord, stem: str | Path) -> tuple[Path, Path]:
    """Write ``STEM.sigmf-data`` (interleaved 16-bit I and Q) and ``STEM.sigmf-meta``.

    Slots follow each other without the pauses between them: one symbol each, sampled at the
    bandwidth; in each the receivers one after the other. Needs the package `sigmf`
    (``pip install ugv-twin[sigmf]``).

    Both files or none. Raises FileExistsError, before anything is written, where either exists.
    """
    import sigmf

    data, meta = (Path(f"{stem}.sigmf-{kind}") for kind in ("data", "meta"))
    for path in (data, meta):
        if path.exists():
            raise FileExistsError(f"{path}: exists already; a recording is not written over")
    try:
        np.ascontiguousarray(record.iq, dtype="<i2").tofile(data)
        _described(sigmf, record, data).tofile(str(meta))
    except BaseException:
        for path in (data, meta):
            path.unlink(missing_ok=True)
        raise
    return data, meta


def _described(sigmf: Any, record: RadarRecord, data: Path) -> Any:
    """The metadata of a data file, as the library's own object."""
    wave = record.waveform
    n_bursts, n_steps, n_slots, n_receivers = record.iq.shape[:4]
    description = (
        f"OFDM radar, {n_bursts} bursts, {n_steps} carrier steps, {n_slots} slots of "
        f"{wave.slot_period_s:g} s, {n_receivers} receivers, "
        f"{wave.n_subcarriers} samples per slot, symbols {wave.symbols}; "
        f"one count is {record.front_end.root_watt_per_count:g} root watts"
    )
    file = sigmf.SigMFFile(
        data_file=str(data),
        global_info={
            sigmf.DATATYPE_KEY: "ci16_le",
            sigmf.SAMPLE_RATE_KEY: wave.bandwidth_hz,
            sigmf.HW_KEY: record.device,
            sigmf.DESCRIPTION_KEY: description,
        },
    )
    samples = n_slots * n_receivers * wave.n_subcarriers
    for capture, carrier in enumerate(np.tile(record.carriers_hz, n_bursts)):
        file.add_capture(capture * samples, metadata={sigmf.FREQUENCY_KEY: float(carrier)})
    return file

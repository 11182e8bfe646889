"""Radar IQ as SigMF: one capture per carrier step, for every tool that reads radio recordings."""

from pathlib import Path

import numpy as np

from hardware.records.radar import RadarRecord


def export_sigmf(record: RadarRecord, stem: str | Path) -> tuple[Path, Path]:
    """Write ``STEM.sigmf-data`` (interleaved 16-bit I and Q) and ``STEM.sigmf-meta``.

    Slots follow each other without the pauses between them: one symbol each, sampled at the
    bandwidth. Needs the package `sigmf` (``pip install ugv-twin[sigmf]``).
    """
    import sigmf

    data, meta = (Path(f"{stem}.sigmf-{kind}") for kind in ("data", "meta"))
    np.ascontiguousarray(record.iq, dtype="<i2").tofile(data)
    wave = record.waveform
    description = (
        f"OFDM radar, {record.iq.shape[0]} carrier steps, {wave.n_slots} slots of "
        f"{wave.slot_period_s:g} s, {wave.n_subcarriers} samples per slot, symbols {wave.symbols}; "
        f"one count is {record.root_watt_per_count:g} root watts"
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
    samples = record.iq.shape[1] * record.iq.shape[2]
    for step in range(record.iq.shape[0]):
        file.add_capture(step * samples, metadata={sigmf.FREQUENCY_KEY: wave.carrier_hz})
    file.tofile(str(meta))
    return data, meta

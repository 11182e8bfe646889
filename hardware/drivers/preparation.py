"""Preparation of a camera: identity, configuration, pattern table."""

import zlib

from hardware.drivers.messages import (
    MODE_CODES,
    ORDER_CODES,
    PROTOCOL_VERSION,
    UPLOADED,
    Arm,
    Configure,
    Configured,
    Identify,
    Identity,
    Measurement,
    Status,
    Upload,
)
from hardware.drivers.request_client import RequestClient
from hardware.drivers.settings import SpiSettings
from hardware.drivers.table import table_bytes
from hardware.errors import DeviceError

#: Times (s) and counts from here on are invalid in a device's reply.
_MOST = 1e9


def identify(device: RequestClient) -> Identity:
    """Identity of the device. Raises DeviceError for one that this software cannot drive."""
    identity = device.ask(Identify(), Identity)
    if identity.version != PROTOCOL_VERSION:
        raise DeviceError(
            f"{device.url}: protocol version {identity.version}, "
            f"this software speaks {PROTOCOL_VERSION}"
        )
    if not (1 <= identity.adc_bits <= 31 and identity.detectors >= 1):
        raise DeviceError(
            f"{device.url}: {identity.adc_bits} bits of {identity.detectors} detectors"
        )
    return identity


def prepare(device: RequestClient, identity: Identity, settings: SpiSettings) -> Configured:
    """Configure the camera, upload the pattern table unless the camera has it, arm the camera.

    Raises DeviceError where the camera does not support or understand the settings.
    """
    patterns, request = settings.patterns, _request(device, identity, settings)
    if patterns.n_cells > identity.max_cells or identity.detectors % patterns.n_arms:
        raise DeviceError(
            f"{device.url}: {patterns.n_cells} cells in mode {patterns.mode!r}; the device has "
            f"{identity.max_cells} cells and {identity.detectors} detectors"
        )
    table = table_bytes(patterns)
    crc = zlib.crc32(table)
    configured = device.ask(request, Configured)
    if not _possible(
        configured, identity, patterns.n_exposures * len(settings.shutters), len(table)
    ):
        raise DeviceError(f"{device.url}: the device cannot mean {configured}")
    if request.order == UPLOADED:
        _upload(device, table, crc)
    elif configured.table_crc != crc:
        raise DeviceError(
            f"{device.url}: the device's patterns {patterns.order!r} have the CRC-32 "
            f"{configured.table_crc:#010x}, expected {crc:#010x}"
        )
    device.ask(Arm(crc), Status)
    return configured


def _request(device: RequestClient, identity: Identity, settings: SpiSettings) -> Configure:
    """By name where the device knows the order, else for a table that is uploaded."""
    patterns = settings.patterns
    mode = MODE_CODES.index(patterns.mode)
    if not identity.modes >> mode & 1:
        raise DeviceError(f"{device.url}: the device does not know mode {patterns.mode!r}")
    order = UPLOADED
    if not settings.upload and patterns.order in ORDER_CODES:
        code = ORDER_CODES.index(patterns.order)
        order = code if identity.orders >> code & 1 else UPLOADED
    return Configure(
        rows=patterns.rows,
        columns=patterns.columns,
        count=patterns.count,
        order=order,
        mode=mode,
        gain=settings.gain,
        exposures_per_frame=settings.exposures_per_frame,
        integration_time_s=settings.integration_time_s,
        pattern_period_s=settings.pattern_period_s,
        shutters=settings.shutters,
    )


def _possible(configured: Configured, identity: Identity, exposures: int, size: int) -> bool:
    positive = (
        configured.integration_time_s,
        configured.pattern_period_s,
        configured.electrons_per_count,
    )
    return bool(
        configured.exposures == exposures
        and configured.table_bytes == size
        and 1 <= configured.exposures_per_frame <= Measurement.most_exposures(identity.detectors)
        and configured.detectors == identity.detectors
        and all(0 < value < _MOST for value in positive)
        and configured.exposures * configured.pattern_period_s
        < _MOST  # device times are whole ns in 64 bits
        and abs(configured.offset_counts) < _MOST
    )


def _upload(device: RequestClient, table: bytes, crc: int) -> None:
    """Upload the table, unless the device still has it."""
    held = device.status()
    if (held.table_bytes, held.table_crc) == (len(table), crc):
        return
    device.statistics.uploads += 1
    for at in range(0, len(table), Upload.MOST):
        device.ask(Upload(at, table[at : at + Upload.MOST]), Status)

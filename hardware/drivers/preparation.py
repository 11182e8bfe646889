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
from hardware.records.spi import LEAST_NUMBER, MOST_ELECTRONS, MOST_NUMBER


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
    if request.order == UPLOADED and len(table) > identity.max_table_bytes:
        raise DeviceError(
            f"{device.url}: {patterns.n_exposures} patterns take a table of {len(table)} bytes; "
            f"the device holds at most {identity.max_table_bytes}"
        )
    configured = device.ask(request, Configured)
    exposures = patterns.n_exposures * len(settings.shutters)
    if fault := _fault(configured, identity, exposures, len(table)):
        raise DeviceError(f"{device.url}: the device cannot mean {fault}")
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


def _fault(configured: Configured, identity: Identity, exposures: int, size: int) -> str:
    """What a configuration cannot be; empty where it may be."""
    most = Measurement.most_exposures(identity.detectors)
    for name, expected in (
        ("exposures", (exposures, exposures)),
        ("table_bytes", (size, size)),
        ("exposures_per_frame", (1, most)),
        ("detectors", (identity.detectors, identity.detectors)),
        # Device times are whole ns in 64 bits.
        ("pattern_period_s", (LEAST_NUMBER, MOST_NUMBER / max(configured.exposures, 1))),
        ("integration_time_s", (LEAST_NUMBER, configured.pattern_period_s)),
        ("electrons_per_count", (LEAST_NUMBER, MOST_ELECTRONS)),
        ("offset_counts", (-MOST_NUMBER, MOST_NUMBER)),
    ):
        least, largest = expected
        if not least <= (value := getattr(configured, name)) <= largest:
            span = f"{least:g}" if least == largest else f"{least:g} to {largest:g}"
            return f"{name} = {value:g}, expected {span}"
    return ""


def _upload(device: RequestClient, table: bytes, crc: int) -> None:
    """Upload the table, unless the device still has it."""
    held = device.status()
    if (held.table_bytes, held.table_crc) == (len(table), crc):
        return
    device.statistics.uploads += 1
    for at in range(0, len(table), Upload.MOST):
        device.ask(Upload(at, table[at : at + Upload.MOST]), Status)

"""Opens the radio of a URL; its libraries are imported only then."""

import threading
from urllib.parse import urlsplit

from hardware.drivers.radio.interface import RadioDriver
from hardware.errors import InputError


def open_radio(
    url: str, *, sample_rate_hz: float | None = None, over: threading.Event | None = None
) -> RadioDriver:
    """Open a radio.

    Parameters
    ----------
    url
        ``uhd:ARGS`` with UHD's device arguments, such as ``uhd:type=b200``, or
        ``zmq://HOST:PORT``.
    sample_rate_hz
        Of a UHD radio; a radio behind ZeroMQ reports its own.
    over
        Event that ends the wait for an answer, with RadioError. UHD's own waits are short.

    Raises InputError for another URL, RadioError (an OSError) where the radio is not available.
    """
    expected = f"radio: {url!r}, expected uhd:ARGS or zmq://HOST:PORT"
    if url.startswith("uhd:"):
        from hardware.drivers.radio.usrp import UhdRadio

        if sample_rate_hz is None:
            raise InputError(f"radio: {url}: sample_rate_hz is missing")
        return UhdRadio(url.removeprefix("uhd:"), sample_rate_hz=sample_rate_hz)
    try:
        parts = urlsplit(url)
        port = parts.port
    except ValueError as error:
        raise InputError(expected) from error
    if parts.scheme != "zmq" or not parts.hostname or port is None or parts.path.strip("/"):
        raise InputError(expected)
    from hardware.drivers.radio.zeromq import ZeroMqRadio

    return ZeroMqRadio(parts.hostname, port, over=over)

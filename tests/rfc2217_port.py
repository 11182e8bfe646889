"""A serial port behind TCP, as pyserial's own example of a server (RFC 2217) offers it."""

import select
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import serial
from serial.rfc2217 import PortManager


class _Terminal(serial.Serial):
    """A pseudo-terminal has none of the control lines that a server is asked to set and tell."""

    cts = dsr = ri = cd = True

    def _update_dtr_state(self) -> None: ...

    def _update_rts_state(self) -> None: ...


@contextmanager
def behind_rfc2217(path: str, hang_up_after_bytes: int | None = None) -> Iterator[str]:
    """URL at which one host after another reaches a terminal.

    The first host is hung up on once so many bytes of the device have been sent to it.
    """
    over = threading.Event()
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(0.1)
        thread = threading.Thread(target=_serve, args=(server, path, over, hang_up_after_bytes))
        thread.start()
        try:
            yield f"rfc2217://127.0.0.1:{server.getsockname()[1]}"
        finally:
            over.set()
            thread.join()


def _serve(server: socket.socket, path: str, over: threading.Event, most_bytes: int | None) -> None:
    while not over.is_set():
        try:
            host, _ = server.accept()
        except TimeoutError:
            continue
        with host, _Terminal(path, timeout=0) as port:
            _pass(host, port, over, most_bytes)
        most_bytes = None


def _pass(
    host: socket.socket, port: serial.Serial, over: threading.Event, most_bytes: int | None
) -> None:
    """Bytes both ways until the host has gone, or has had ``most_bytes`` of the device."""

    class Connection:
        write = staticmethod(host.sendall)

    manager = PortManager(port, Connection)
    sent_bytes = 0
    while not over.is_set() and (most_bytes is None or sent_bytes < most_bytes):
        ready, _, _ = select.select([host, port], [], [], 0.1)
        try:
            if port in ready:
                data = port.read(4096)
                host.sendall(b"".join(manager.escape(data)))
                sent_bytes += len(data)
            if host in ready:
                if not (data := host.recv(4096)):
                    return
                port.write(b"".join(manager.filter(data)))
        except OSError:
            return

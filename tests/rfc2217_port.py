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
def behind_rfc2217(path: str, cut: threading.Event | None = None) -> Iterator[str]:
    """URL at which one host after another reaches a terminal; ``cut`` hangs up on one."""
    over, cut = threading.Event(), cut or threading.Event()
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(0.1)
        thread = threading.Thread(target=_serve, args=(server, path, over, cut))
        thread.start()
        try:
            yield f"rfc2217://127.0.0.1:{server.getsockname()[1]}"
        finally:
            over.set()
            thread.join()


def _serve(server: socket.socket, path: str, over: threading.Event, cut: threading.Event) -> None:
    while not over.is_set():
        try:
            host, _ = server.accept()
        except TimeoutError:
            continue
        with host, _Terminal(path, timeout=0) as port:
            _pass(host, port, over, cut)


def _pass(
    host: socket.socket, port: serial.Serial, over: threading.Event, cut: threading.Event
) -> None:
    """Bytes both ways until the host has gone or is let go."""

    class Connection:
        write = staticmethod(host.sendall)

    manager = PortManager(port, Connection)
    while not (over.is_set() or cut.is_set()):
        ready, _, _ = select.select([host, port], [], [], 0.1)
        try:
            if port in ready:
                host.sendall(b"".join(manager.escape(port.read(4096))))
            if host in ready:
                if not (data := host.recv(4096)):
                    return
                port.write(b"".join(manager.filter(data)))
        except OSError:
            return
    cut.clear()

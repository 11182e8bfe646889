"""A line to a device that can be cut or spoiled, and messages on it that can be changed."""

import os
import selectors
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager


class Bridge:
    """A TCP port in front of a terminal, which can cut the line or spoil what passes.

    The line is cut wherever the bytes sent to the host, all its connections together, have
    reached the next of ``cuts_bytes``.
    """

    def __init__(self, terminal: str) -> None:
        self.spoil: Callable[[bytes], bytes] = lambda data: data
        self.cuts_bytes: list[int] = []
        self._sent_bytes = 0
        self._terminal = os.open(terminal, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        self._server = socket.create_server(("127.0.0.1", 0))
        self._over = False
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    @property
    def url(self) -> str:
        return f"socket://127.0.0.1:{self._server.getsockname()[1]}"

    def close(self) -> None:
        self._over = True
        socket.create_connection(self._server.getsockname()).close()
        self._thread.join(5)
        self._server.close()
        os.close(self._terminal)

    def _serve(self) -> None:
        while not self._over:
            host, _ = self._server.accept()
            with host, selectors.DefaultSelector() as ready:
                ready.register(host, selectors.EVENT_READ)
                ready.register(self._terminal, selectors.EVENT_READ)
                while not self._over and self._pass(host, ready):
                    pass

    def _pass(self, host: socket.socket, ready: selectors.BaseSelector) -> bool:
        for key, _ in ready.select(0.05):
            try:
                if key.fileobj is host:
                    data = host.recv(4096)
                    os.write(self._terminal, data)
                    if not data:
                        return False
                else:
                    data = os.read(self._terminal, 4096)
                    host.sendall(self.spoil(data))
                    self._sent_bytes += len(data)
            except OSError:
                return False
        if self.cuts_bytes and self._sent_bytes >= self.cuts_bytes[0]:
            del self.cuts_bytes[0]
            return False
        return True


@contextmanager
def bridged(terminal: str) -> Iterator[Bridge]:
    bridge = Bridge(terminal)
    try:
        yield bridge
    finally:
        bridge.close()

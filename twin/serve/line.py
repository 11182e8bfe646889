"""Lines of a virtual camera: a pseudo-terminal, or a TCP port for one host at a time."""

import os
import selectors
import socket
import tty
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from hardware.drivers.framing import Deframer, encode
from hardware.drivers.messages import Refusal, Refused, to_frame
from twin.files import InputError

_CHUNK = 65536
_MOST_REFUSED = 8  # second hosts that are being told


class Terminal:
    """A pseudo-terminal; ``url`` is its path. It stays open when a host closes it."""

    def __init__(self) -> None:
        self._ours, self._theirs = os.openpty()  # theirs stays open: the line never hangs up
        tty.setraw(self._theirs)
        os.set_blocking(self._ours, False)
        self.url = os.ttyname(self._theirs)

    def listen(self) -> None:
        """A terminal is there at once."""

    def register(self, ready: selectors.BaseSelector) -> None:
        """Have reading waited for."""
        ready.register(self._ours, selectors.EVENT_READ)

    def read(self) -> bytes:
        """What has come; nothing where nothing has."""
        try:
            return os.read(self._ours, _CHUNK)
        except BlockingIOError:
            return b""

    def has_new_host(self) -> bool:
        """A terminal does not see who opens it."""
        return False

    def write(self, data: bytes) -> int:
        """Bytes that the line takes now."""
        try:
            return os.write(self._ours, data)
        except BlockingIOError:
            return 0

    def hang_up(self) -> None:
        """A terminal has nobody to hang up on."""

    def close(self) -> None:
        """Close both ends."""
        os.close(self._ours)
        os.close(self._theirs)


class TcpPort:
    """A TCP port; requests of a second host are refused.

    Raises InputError where it cannot be had. Without ``at_once`` connections are refused until
    `listen`: a host that is let in waits for answers.
    """

    def __init__(self, host: str, port: int, *, at_once: bool = True) -> None:
        self._place = f"tcp:{host}:{port}"
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        self._server = socket.socket(family)
        self._server.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        with self._named():
            if family == socket.AF_INET6:  # of this version alone, as `socket.create_server`
                self._server.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
            self._server.bind((host, port))
        if at_once:
            self.listen()
        self._server.setblocking(False)
        self.url = f"socket://{host}:{self._server.getsockname()[1]}"
        self._host: socket.socket | None = None
        self._is_new = False
        self._others: dict[socket.socket, Deframer] = {}

    def listen(self) -> None:
        """Let hosts in. Raises InputError where another program has taken the port meanwhile."""
        with self._named():
            self._server.listen()

    def register(self, ready: selectors.BaseSelector) -> None:
        """Have reading waited for."""
        for known in (self._server, self._host, *self._others):
            if known is not None:
                ready.register(known, selectors.EVENT_READ)

    def read(self) -> bytes:
        """What has come; nothing where nothing has."""
        # First of the host that is known: of one that has left the next takes the place.
        if data := self._received():
            return data
        self._accept()
        for other in list(self._others):
            self._refuse(other)
        return self._received()

    def has_new_host(self) -> bool:
        """Whether another host has come since the last call; what `read` gave last is its."""
        is_new, self._is_new = self._is_new, False
        return is_new

    def _received(self) -> bytes:
        """What has come from the host; one that has left is hung up on."""
        if self._host is None:
            return b""
        try:
            if data := self._host.recv(_CHUNK):
                return data
        except BlockingIOError:
            return b""
        except OSError:
            pass
        self.hang_up()
        return b""

    def write(self, data: bytes) -> int:
        """Bytes that the line takes now; all are lost where nobody listens."""
        if self._host is None:
            return len(data)
        try:
            return self._host.send(data)
        except BlockingIOError:
            return 0
        except OSError:
            self.hang_up()
            return len(data)

    def hang_up(self) -> None:
        """Cut the line to the host."""
        if self._host is not None:
            self._host.close()
            self._host = None

    def close(self) -> None:
        """Cut all lines, and listen no more."""
        self.hang_up()
        for other in self._others:
            other.close()
        self._server.close()

    @contextmanager
    def _named(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            self._server.close()
            raise InputError(f"spi: {self._place}: {error.strerror or error}") from error

    def _accept(self) -> None:
        with suppress(BlockingIOError):
            connection, _ = self._server.accept()
            connection.setblocking(False)
            if self._host is None:
                connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._host, self._is_new = connection, True
            elif len(self._others) < _MOST_REFUSED:
                self._others[connection] = Deframer()
            else:
                connection.close()

    def _refuse(self, other: socket.socket) -> None:
        """Refuse the requests of a second host, then close its connection."""
        try:
            data = other.recv(_CHUNK)
            frames = self._others[other].feed(data)
            for frame in frames:
                refused = Refused(Refusal.BUSY, "another host is connected")
                other.send(encode(to_frame(refused, frame.tag)))
            if data and not frames:
                return
        except BlockingIOError:
            return
        except OSError:
            pass
        del self._others[other]
        other.close()


Line = Terminal | TcpPort

"""The uploaded pattern table of a virtual camera, as defined in PROTOCOL.md."""

from twin.errors import InputError


class UploadedTable:
    """Bytes received, ``data``, out of ``size`` expected ones; 0 where none is expected."""

    def __init__(self) -> None:
        self.data, self.size = bytearray(), 0
        self._kept = False  # of an earlier Configure: the next upload forgets it

    def expect(self, size: int) -> None:
        """Expect a table of this size; a complete one of the same size is kept."""
        self._kept = 0 < size == self.size == len(self.data)
        if not self._kept:
            self.data.clear()
        self.size = size

    def take(self, offset: int, portion: bytes) -> None:
        """Raises InputError for a portion out of place."""
        held = 0 if self._kept else len(self.data)
        if offset > held or offset + len(portion) > self.size:
            raise InputError("Upload: beyond what is here, or beyond the table")
        if self._kept:
            self._kept = False
            self.data.clear()
        self.data[offset : offset + len(portion)] = portion

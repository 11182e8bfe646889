"""Texts of variable length in an HDF5 file, as records had them until their texts had checksums.

They stand in collections ("GCOL", section III.E of the HDF5 file format specification) without a
checksum. The library follows the sizes of their objects one after the other, and where free space
says that it is of size 0 it follows it for ever.
"""

import mmap
from pathlib import Path

#: Signature, version and reserved bytes of a collection.
_COLLECTION = b"GCOL\x01\0\0\0"
_HEADER = 16  # bytes, of a collection and of each of its objects


def has_endless_heap(path: Path) -> bool:
    """Whether a file holds texts in a collection that the HDF5 library would read for ever."""
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        at = content.find(_COLLECTION)
        while at >= 0:
            if _is_endless(content, at):
                return True
            at = content.find(_COLLECTION, at + 1)
    return False


def _is_endless(content: mmap.mmap, begin: int) -> bool:
    place, end = begin + _HEADER, begin + int.from_bytes(content[begin + 8 : begin + 16], "little")
    while place + _HEADER <= min(end, len(content)):
        index = int.from_bytes(content[place : place + 2], "little")
        size = int.from_bytes(content[place + 8 : place + 16], "little")
        if not index and not size:
            return True
        place += _HEADER + -(-size // 8) * 8 if index else size
    return False

"""Files that lie: one line of error, in no more memory than they are worth."""

import tracemalloc
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

#: None of the tests' files is larger; what they promise is 256 MiB and more.
_FILE_BYTES, _MEMORY_BYTES = 1 << 18, 1 << 24


@contextmanager
def refused(path: Path, because: str) -> Iterator[None]:
    """One line that begins with the file and says why, without taking the memory it asks for."""
    assert path.stat().st_size <= _FILE_BYTES
    tracemalloc.start()
    try:
        with pytest.raises(ValueError, match=because) as caught:
            yield
        assert tracemalloc.get_traced_memory()[1] < _MEMORY_BYTES
    finally:
        tracemalloc.stop()
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 400

"""Results on disk, named by all they depend on, made once however many ask: light and echoes of
earlier runs, truth of regression tests.

By hand: in joblib's memory a second process does not wait for the first that makes a result, and
locks of diskcache outlive a process that is killed.
"""

import fcntl
import hashlib
import os
import pickle
import stat
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any, TypeVar

import platformdirs

from hardware.files import place_beside, said
from twin.digest import digest, source_digest, versions
from twin.progress import tell

T = TypeVar("T")

#: Of all results in a folder.
_MOST_BYTES = 2**31
_VARIABLE = "UGV_TWIN_CACHE"
_CHECKSUM_BYTES = hashlib.sha256().digest_size
_TWIN = Path(__file__).parent
_SOURCE = (_TWIN, _TWIN.parent / "hardware")
_OTHERS = (_TWIN / "regression", _TWIN / "commands", _TWIN / "report")


class KeptResults:
    """A folder of results by key: the latest ones, 2 GB of them at most.

    Processes that want the same one wait for whoever makes it, which `twin.progress.listeners` are
    told of. Where the folder can't be written to, or is open to others, nothing is kept.

    Attributes
    ----------
    found
        Kinds of the results asked for that were there.
    problem
        The first reason why a result could not be kept, which is so for later ones too; empty:
        none.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.found: list[str] = []
        self.problem = ""

    @classmethod
    def of_user(cls) -> "KeptResults | None":
        """Those of a user's commands, in the folder that ``UGV_TWIN_CACHE`` names, by default in
        the system's own for such files, ``~/.cache/ugv-twin``; None where that is set to nothing.
        """
        folder = os.environ.get(_VARIABLE, platformdirs.user_cache_dir("ugv-twin", False))
        return cls(Path(folder).expanduser()) if folder else None

    def add(self, other: "KeptResults") -> None:
        """What another process found in the same folder, and its problem."""
        self.found += other.found
        self.problem = self.problem or other.problem

    def get(
        self,
        kind: str,
        content: Sequence[Any],
        make: Callable[[], T],
        mark: Callable[[T], T] = lambda kept: kept,
    ) -> T:
        """A result of some kind, made when there is none.

        ``content`` is all that it is made of, see `digest`, to the last bit and word. The versions
        of what computes it count too, and the project's own source, a change of which makes it
        anew. ``mark`` tells one that is there already from one that is made.
        """
        variant = os.environ.get("TWIN_VARIANT", "")
        source = source_digest(*_SOURCE, without=_OTHERS)
        name = digest(content, versions(), source, variant, exact=True)
        path = self._folder / f"{kind}-{name}.pickle"
        with self._locked(path) as is_usable:
            if not is_usable:
                return make()
            kept = self._read(path)
            if kept is not None:
                self.found.append(kind)
                return mark(kept[0])
            made = make()
            try:
                # What can't be pickled is made anew the next time.
                with suppress(pickle.PicklingError, AttributeError, TypeError):
                    self._write(path, made)
            except OSError as error:
                self._note(said(error))
            return made

    def _note(self, words: str) -> None:
        """Store the first of several problems."""
        self.problem = self.problem or words

    @contextmanager
    def _locked(self, path: Path) -> Iterator[bool]:
        """With a lock of this name, freed even by kill -9; whether there can be one."""
        try:
            self._folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            folder = self._folder.stat()
            is_own = folder.st_uid == os.getuid() and not folder.st_mode & stat.S_IWOTH
            lock = path.with_suffix(".lock").open("w") if is_own else None
        except OSError as error:
            self._note(said(error))
            yield False
            return
        if lock is None:
            self._note(f"{self._folder}: is another user's, or others may write to it")
            yield False
            return
        with lock:
            try:
                _wait_for(lock)
            except OSError as error:  # of a file system without locks
                self._note(f"{lock.name}: {error.strerror}")
                yield False
                return
            yield True

    def _read(self, path: Path) -> tuple[Any] | None:
        """What is kept there, if it is whole, and this user's: what is read is run."""
        with suppress(OSError):
            # Neither a link nor a pipe, which would be waited for.
            opened = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
            with os.fdopen(opened, "rb") as file:
                own = os.fstat(file.fileno())
                if own.st_uid != os.getuid() or not stat.S_ISREG(own.st_mode):
                    return None
                checksum, pickled = file.read(_CHECKSUM_BYTES), file.read()
            if _checksum(path, pickled) == checksum:
                os.utime(path)  # the oldest go first
                return (pickle.loads(pickled),)
        return None

    def _write(self, path: Path, made: Any) -> None:
        pickled = pickle.dumps(made, protocol=pickle.HIGHEST_PROTOCOL)
        if len(pickled) > _MOST_BYTES:
            return
        with place_beside(path) as partial:
            partial.write_bytes(_checksum(path, pickled) + pickled)
            os.replace(partial, path)  # whatever is there, a pipe too, which would be waited for
        self._forget_oldest()

    def _forget_oldest(self) -> None:
        left = _MOST_BYTES
        for path in sorted(self._folder.glob("*.pickle"), key=_age, reverse=True):
            left -= _size(path)
            if left < 0:
                for file in (path, path.with_suffix(".lock")):
                    with suppress(OSError):  # a folder of somebody's own, say
                        file.unlink()


def _wait_for(lock: IO[str]) -> None:
    """Take a lock, and tell of the time that another process held it."""
    began_s = time.perf_counter()
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        fcntl.flock(lock, fcntl.LOCK_EX)
        tell("waiting for another run", time.perf_counter() - began_s)


def _checksum(path: Path, pickled: bytes) -> bytes:
    """Of a result under its own name."""
    found = hashlib.sha256(path.name.encode())
    found.update(pickled)
    return found.digest()


def _age(path: Path) -> float:
    """When it was used; one of the future, by a clock since set back, counts as old."""
    with suppress(OSError):
        used_s = path.stat().st_mtime
        return used_s if used_s <= time.time() + 1.0 else 0.0
    return 0.0


def _size(path: Path) -> int:
    with suppress(OSError):
        return path.stat().st_size
    return 0

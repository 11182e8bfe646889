"""A user's own functions in place of bundled ones: given as an object, as ``file.py:function``, or
by the name under which an installed package offers them.
"""

import functools
import importlib.util
import inspect
import pickle
import sys
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from types import CodeType, FunctionType, MethodType, ModuleType
from typing import Any

import numpy as np

from hardware.errors import HardwareError, InputError


class OwnFunctionError(InputError):
    """A user's own function is missing, takes other arguments, or returns what cannot be used."""


@dataclass(frozen=True)
class OwnFunction:
    """A function with its name and the SHA-256 of its source.

    Of a function from a file the digest is that of the file and of the modules beside it that its
    import statements name; of an object see `digest_of`.
    """

    function: Callable[..., Any]
    name: str
    digest: str

    def __call__(self, *arguments: Any) -> Any:
        """Its result; what it tells NumPy to do about floating-point errors (`numpy.seterr`) ends
        with it. Raises OwnFunctionError, with the line, for whatever it raises itself, an end of
        the program by ``sys.exit`` too; errors of this package as they are.
        """
        try:
            with np.errstate():
                return self.function(*arguments)
        except HardwareError:
            raise
        except (Exception, SystemExit) as error:  # a user's function may fail in any way
            raise OwnFunctionError(f"{self.name}: {told_of(error)}") from error

    @property
    def label(self) -> str:
        """Name and digest: what results of this function are called."""
        return f"{self.name}-{self.digest[:8]}"


def told_of(error: BaseException) -> str:
    """An error of a user's own code in one line: its kind, text, and where it was raised.

    >>> told_of(SystemExit(3))
    'SystemExit: 3'
    """
    frames = [one for one in traceback.extract_tb(error.__traceback__) if one.filename != __file__]
    where = f" ({frames[-1].filename}, line {frames[-1].lineno})" if frames else ""
    return f"{type(error).__name__}: {error}{where}"


def is_file_function(text: str) -> bool:
    """Whether a text has the form ``file.py:function``."""
    path, colon, name = text.rpartition(":")
    return bool(colon) and path.endswith(".py") and name.isidentifier()


def own_function(
    given: str | Callable[..., Any],
    arguments: tuple[str, ...],
    *,
    group: str = "",
    folder: Path | None = None,
) -> OwnFunction:
    """The function that a user gave.

    Parameters
    ----------
    given
        A callable; ``file.py:function``; a name in an entry-point group.
    arguments
        Names of what it will be called with, all by position.
    group
        The entry-point group.
    folder
        What a relative path starts from; default the working directory.

    Raises OwnFunctionError for a file or function that does not exist, a file that cannot be
    imported, or a function that does not take these arguments.

    >>> def brightest(values, noise_variance, sensing):
    ...     return values
    >>> own_function(brightest, ("values", "noise_variance", "sensing")).name
    'brightest'
    """
    if callable(given):
        own = OwnFunction(given, _name(given), digest_of(given))
    elif not isinstance(given, str):
        raise OwnFunctionError(f"{given!r:.60}: expected file.py:function, or a callable")
    elif is_file_function(given):
        own = _from_file(given, folder or Path())
    else:
        own = _installed(given, group)
    try:
        inspect.signature(own.function).bind(*arguments)
    except TypeError:
        name = given if isinstance(given, str) else own.name
        raise OwnFunctionError(
            f"{name}: takes {inspect.signature(own.function)}, expected a function of "
            f"({', '.join(arguments)})"
        ) from None
    except ValueError:  # a compiled function that does not say what it takes
        pass
    return own


def digest_of(function: Callable[..., Any]) -> str:
    """SHA-256 of a callable's source, code, defaults, enclosed values, and of what it names of its
    module: constants (numbers, text, arrays, tuples of them), and functions, classes and modules of
    its own folder. Lists, dictionaries and other objects, which may change as it runs, do not
    count, nor does what is imported by any other way than an import statement.
    """
    digest = sha256()
    for piece in _pieces(function, set()):
        digest.update(len(piece).to_bytes(8, "little") + piece)
    return digest.hexdigest()


def digest_of_given(given: str | Callable[..., Any]) -> str:
    """`digest_of` a callable, or the digest of the source that ``file.py:function`` names."""
    if callable(given):
        return digest_of(given)
    if is_file_function(given):
        return _from_file(given, Path()).digest
    return sha256(given.encode()).hexdigest()


def _pieces(value: Any, seen: set[int]) -> Iterator[bytes]:
    if id(value) in seen:
        return
    if isinstance(value, functools.partial):
        yield b"partial"
        for part in (value.func, *value.args, *sorted(value.keywords.items())):
            yield from _pieces(part, seen)
    elif isinstance(value, MethodType):
        yield from _pieces(value.__func__, seen)
        yield from _pieces(value.__self__, seen)
    elif isinstance(value, FunctionType):
        seen.add(id(value))
        yield _source(value)
        yield from _code(value.__code__)
        for part in (
            *_enclosed(value),
            *(value.__defaults__ or ()),
            *(value.__kwdefaults__ or {}).items(),
            *_named(value),
        ):
            yield from _pieces(part, seen)
    elif isinstance(value, ModuleType):
        for file in sorted(_files(Path(str(value.__file__))).values()):
            yield file.read_bytes()
    elif isinstance(value, tuple):
        for part in value:
            yield from _pieces(part, seen)
    else:
        if callable(value):
            yield _source(value if isinstance(value, type) else type(value))
        try:
            yield pickle.dumps(value, protocol=5)
        except Exception:  # any class may refuse in any way
            yield type(value).__qualname__.encode()


def _code(code: CodeType) -> Iterator[bytes]:
    """What a function does, where its source cannot be had; not where it stands."""
    yield code.co_code
    yield repr(code.co_names).encode()
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _code(constant)
        elif not isinstance(constant, frozenset):  # whose order is not fixed
            yield repr(constant).encode()


def _named(function: FunctionType) -> Iterator[tuple[str, Any]]:
    """Constants of its module that a function names, and code of its folder, see `digest_of`."""
    for name in sorted(set(_names(function.__code__)) & function.__globals__.keys()):
        value = function.__globals__[name]
        if isinstance(value, FunctionType | ModuleType | type):
            if _folder(value) == _folder(function) is not None:
                yield name, value
        elif _is_constant(value):
            yield name, value


def _names(code: CodeType) -> Iterator[str]:
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _names(constant)


def _is_constant(value: Any) -> bool:
    if isinstance(value, tuple):
        return all(map(_is_constant, value))
    return isinstance(value, int | float | complex | str | bytes | np.generic | np.ndarray | None)


def _folder(code: Any) -> Path | None:
    """Where code stands; of what stands in no file, such as a notebook's, nowhere but there."""
    try:
        return Path(inspect.getfile(code)).resolve().parent
    except (OSError, TypeError):
        return None


def _enclosed(function: FunctionType) -> Iterator[Any]:
    for cell in function.__closure__ or ():
        with suppress(ValueError):  # not assigned yet
            yield cell.cell_contents


def _source(value: Any) -> bytes:
    try:
        return inspect.getsource(value).encode()
    except (OSError, TypeError):
        return getattr(value, "__qualname__", type(value).__qualname__).encode()


def _name(function: Callable[..., Any]) -> str:
    if isinstance(function, functools.partial):
        return _name(function.func)
    name = getattr(function, "__name__", type(function).__name__)
    return name.strip("<>")


def _from_file(given: str, folder: Path) -> OwnFunction:
    text, _, name = given.rpartition(":")
    path = (folder / text).resolve()
    if not path.is_file():
        raise OwnFunctionError(f"{given}: {path} does not exist")
    try:
        files = _files(path)
        source = sha256()
        for other in sorted(files.values()):
            source.update(sha256(other.read_bytes()).digest())
        module = _module(path, files, source.hexdigest())
    except (Exception, SystemExit) as error:  # a user's file may fail in any way
        raise OwnFunctionError(f"{path}: {type(error).__name__}: {error}") from error
    function = getattr(module, name, None)
    if not callable(function):
        offered = [n for n, f in vars(module).items() if isinstance(f, FunctionType)]
        raise OwnFunctionError(
            f"{given}: {path} has no function {name!r}, only {', '.join(offered) or 'none'}"
        )
    return OwnFunction(function, name, source.hexdigest())


def _files(path: Path) -> dict[str, Path]:
    """The file itself and what it imports from beside it, by module name."""
    from modulefinder import ModuleFinder

    finder = ModuleFinder(path=[str(path.parent)])
    finder.run_script(str(path))
    return {
        name: Path(file)
        for name, item in finder.modules.items()
        if (file := getattr(item, "__file__", None))
    }


def _module(path: Path, files: dict[str, Path], digest: str) -> ModuleType:
    """The file as a module of a name that no other file or version has; imported once."""
    name = f"{path.stem}_{sha256(str(path).encode()).hexdigest()[:8]}_{digest[:16]}"
    if name in sys.modules:
        return sys.modules[name]
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    code = compile(path.read_bytes(), str(path), "exec")
    beside = {other: file for other, file in files.items() if other != "__main__"}
    with _importing_from(path.parent, beside):
        sys.modules[name] = module
        try:
            exec(code, module.__dict__)
        except BaseException:
            del sys.modules[name]
            raise
    return module


@contextmanager
def _importing_from(folder: Path, beside: dict[str, Path]) -> Iterator[None]:
    """Modules of a folder are found first, and read anew; afterwards names are whose they were."""
    before = {name: sys.modules.pop(name) for name in beside if name in sys.modules}
    for file in beside.values():
        with suppress(OSError):  # bytecode is told apart by seconds and size alone
            Path(importlib.util.cache_from_source(str(file))).unlink(missing_ok=True)
    importlib.invalidate_caches()
    sys.path.insert(0, str(folder))
    try:
        yield
    finally:
        with suppress(ValueError):
            sys.path.remove(str(folder))
        if str(folder) not in sys.path:
            sys.path.append(str(folder))  # for what a function imports when it is called
        for name in beside:
            sys.modules.pop(name, None)
        sys.modules.update(before)


def _installed(given: str, group: str) -> OwnFunction:
    from importlib.metadata import entry_points

    points = entry_points(group=group) if group else ()
    for point in points:
        if point.name == given:
            function = point.load()
            return OwnFunction(function, given, digest_of(function))
    names = sorted(point.name for point in points)
    raise OwnFunctionError(
        f"{given!r}: is unknown, expected file.py:function"
        + (f" or a name in the entry-point group {group}" if group else "")
        + (f" ({', '.join(names)})" if names else "")
    )

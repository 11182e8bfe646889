"""What a command tells and where: ``--quiet``, ``--verbose``, ``--json``, the same for all."""

import inspect
import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import wraps
from pathlib import Path
from typing import Annotated, Any, TextIO

import typer

from hardware.formatting import json_text

_QUIET = Annotated[
    bool, typer.Option("--quiet", "-q", help="Only the verdict, warnings and errors.")
]
_VERBOSE = Annotated[
    bool, typer.Option("--verbose", "-v", help="What is done, with times, on stderr.")
]
_JSON = Annotated[
    bool, typer.Option("--json", help="One JSON document on stdout; all else goes to stderr.")
]


#: What a shell gives for a program that ended by SIGPIPE, as usual tools do.
CLOSED_PIPE = 141


def reader_left(error: BaseException) -> bool:
    """Whether a command ended because nobody reads its output any more (`| head`).

    Then what is still to be written goes nowhere, without a word. Typer and Rich exit with 1 at it.
    """
    if not any(isinstance(each, BrokenPipeError) for each in (error, error.__context__)):
        return False
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, sys.__stdout__.fileno() if sys.__stdout__ else 1)
    return True


class Output:
    """Verdict, lines, warnings and times of a command, as its options ask for them.

    Parameters
    ----------
    command
        Its name, as the document says it.
    quiet, verbose, json
        The options.

    A document has ``command``, ``warnings``, ``written`` (files) and what the command adds; numbers
    that are none or infinite are null.
    """

    def __init__(
        self, command: str, *, quiet: bool = False, verbose: bool = False, json: bool = False
    ) -> None:
        self.quiet, self.verbose, self.json = quiet, verbose, json
        self._begun_s = time.perf_counter()
        self._warnings: list[str] = []
        self._written: list[str] = []
        self.document: dict[str, Any] = {"command": command}

    @property
    def stream(self) -> TextIO:
        """Where lines go."""
        return sys.stderr if self.json else sys.stdout

    def verdict(self, text: object) -> None:
        """What a quiet command tells too."""
        if not (self.json and self.quiet):
            print(text, file=self.stream, flush=True)

    def line(self, text: object) -> None:
        """What a quiet command leaves out."""
        if not self.quiet:
            print(text, file=self.stream, flush=True)

    def warn(self, text: object) -> None:
        """A warning, on stderr and in the document; a quiet command tells it too, since a verdict
        without its warnings would say more than the record does.
        """
        self._warnings.append(str(text))
        print(f"warning: {text}", file=sys.stderr)

    def written(self, path: str | Path, remark: str = "", *, name: str = "written") -> None:
        """A file or folder that is there now."""
        self._written.append(str(path))
        self.line(f"{name}: {path}{remark}")

    def step(self, text: str) -> None:
        """What has been done, and the time since the command began."""
        if self.verbose:
            since_s = time.perf_counter() - self._begun_s
            print(f"{since_s:9.3f} s  {text}", file=sys.stderr, flush=True)

    def add(self, **content: Any) -> None:
        """Put content into the document."""
        self.document |= content

    def finish(self) -> None:
        """Print the document."""
        if self.json:
            ends = {"warnings": self._warnings, "written": self._written}
            print(json_text(self.document | ends), flush=True)


def result_file(record: Path, ending: str, out: Path | None, png: Path | None) -> Path:
    """Where a command writes its result: ``out``, or beside its record by this ending.

    Raises OSError or InputError, before the command's work, where that or its picture can't be
    written.
    """
    from hardware.files import expect_writable

    target = out or record.with_name(f"{record.stem}{ending}")
    expect_writable(target)
    if png:
        from hardware.png import expect_png

        expect_png(png)
        expect_writable(png)
    return target


def with_output(
    function: Callable[..., None],
    command: str,
    *,
    has_json: bool = True,
    during: Callable[[Output], AbstractContextManager[object]] = nullcontext,
) -> Callable[..., None]:
    """A command with the options, which takes an `Output` in front of its own arguments.

    ``has_json``: False of commands that print no table and no verdict. ``during``: what surrounds
    each call.
    """
    signature = inspect.signature(function)
    own = list(signature.parameters.values())[1:]
    added = {"quiet": _QUIET, "verbose": _VERBOSE} | ({"json": _JSON} if has_json else {})
    options = [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=False, annotation=kind)
        for name, kind in added.items()
    ]

    @wraps(function)
    def called(**given: Any) -> None:
        asked = {name: given.pop(name) for name in added}
        if asked["quiet"] and asked["verbose"]:
            raise typer.BadParameter("--quiet, --verbose: expected one of them")
        say = Output(command, **asked)
        with _document_at_the_end(say), during(say):
            function(say, **given)

    parameters = [*own, *options]
    called.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    called.__annotations__ = {each.name: each.annotation for each in parameters}
    return called


@contextmanager
def _document_at_the_end(say: Output) -> Iterator[None]:
    """The document of a command that ends, also where its exit status says that data are lost."""
    try:
        yield
    except typer.Exit:
        say.finish()
        raise
    say.finish()


def version_option(program: str, version: Callable[[], str]) -> Any:
    """Type of the option ``--version``."""

    def show(asked: bool) -> None:
        if asked:
            print(f"{program} {version()}")
            raise typer.Exit

    return Annotated[
        bool, typer.Option("--version", callback=show, is_eager=True, help="Print the version.")
    ]

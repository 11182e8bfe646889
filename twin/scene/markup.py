"""A scene file before Mitsuba's parser sees it: XML it is, not too deep, and in a known encoding.

Mitsuba's parser and what walks its nodes are recursive: a file that is nested deeply enough ends
the process.
"""

from pathlib import Path
from xml.parsers import expat

from twin.files import InputError

#: Elements within elements. The deepest of real scenes (a texture in a BSDF in wrappers in a shape)
#: have about ten.
_DEEPEST = 64
#: Files that include each other.
_DEEPEST_INCLUDES = 15
_LONGEST_ID = 200


def check_markup(path: Path) -> None:
    """Raise InputError unless a file and all that it includes can be given to Mitsuba's parser."""
    _check(path, {}, ())


def _check(path: Path, defaults: dict[str, str], within: tuple[Path, ...]) -> None:
    if path.resolve() in within:
        raise InputError(f"{path}: includes itself")
    if len(within) > _DEEPEST_INCLUDES:
        raise InputError(f"{path}: included more than {_DEEPEST_INCLUDES} levels deep")
    reader = expat.ParserCreate()
    depth, included = 0, list[str]()

    def place() -> str:
        return f"{path}: line {reader.CurrentLineNumber}, column {reader.CurrentColumnNumber + 1}"

    def begin(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth > _DEEPEST:
            raise InputError(f"{place()}: elements are nested more than {_DEEPEST} deep")
        if len(attributes.get("id", "")) > _LONGEST_ID:
            raise InputError(f"{place()}: id is longer than {_LONGEST_ID} characters")
        if tag == "default":
            defaults.setdefault(attributes.get("name", ""), attributes.get("value", ""))
        elif tag == "include":
            included.append(attributes.get("filename", ""))

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1

    reader.StartElementHandler, reader.EndElementHandler = begin, end
    try:
        reader.Parse(path.read_bytes(), True)
    except InputError:
        raise
    except (expat.ExpatError, LookupError, ValueError) as error:  # the latter two: its encoding
        raise InputError(f"{path}: no valid XML: {error}") from error
    except OSError as error:
        raise InputError(f"{path}: can't be read ({error.strerror})") from error
    for name in included:
        for key in sorted(defaults, key=len, reverse=True):
            name = name.replace(f"${key}", defaults[key])
        # Beside the file, or from where the command was started: Mitsuba looks in both.
        for found in {path.parent / name, Path(name)}:
            if found.is_file():
                _check(found, defaults, (*within, path.resolve()))

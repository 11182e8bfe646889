"""Pages of the commands, with all their options."""

import inspect
import re
from typing import Any

import typer
from tables import table

_INTRODUCTIONS = {
    "twin": "The simulator. Errors are one line and exit code 2; nothing half-written stays.",
    "ugv": "The vehicle's software: it knows nothing of the simulator. Errors are one line and "
    "exit code 2.",
}


def commands_page(name: str, app: typer.Typer) -> str:
    """Every command of one program."""
    group: Any = typer.main.get_command(app)
    text = f"# The command `{name}`\n\n{_INTRODUCTIONS[name]}\n"
    options = [p for p in group.params if p.param_type_name == "option"]
    if options:
        text += "\nOptions of the program itself:\n\n" + _options(options)
    for command in sorted(group.commands):
        text += _command(f"{name} {command}", group.commands[command])
    return text


def _command(name: str, command: Any) -> str:
    arguments = [p for p in command.params if p.param_type_name == "argument"]
    options = [p for p in command.params if p.param_type_name == "option"]
    words = [f"[{p.name.upper()}]" if not p.required else p.name.upper() for p in arguments]
    usage = " ".join([name, *words, *(["[OPTIONS]"] if options else [])])
    help_ = inspect.cleandoc(command.help or "").replace("\f", "").replace("``", "`")
    text = f"\n## `{name}`\n\n```text\n{usage}\n```\n\n{_plain(help_)}\n\n"
    text += table(
        ("argument", "default", "meaning"),
        ((f"`{p.name.upper()}`", _default(p), p.help or "") for p in arguments),
    )
    return text + ("\n" if arguments else "") + _options(options)


def _options(options: list[Any]) -> str:
    return table(
        ("option", "value", "default", "meaning"),
        (
            (
                ", ".join(f"`{o}`" for o in (*p.opts, *p.secondary_opts)),
                "" if p.is_flag else p.type.name.lower() + (", several" if p.multiple else ""),
                _default(p),
                p.help or "",
            )
            for p in options
        ),
    )


def _default(parameter: Any) -> str:
    if parameter.required:
        return "required"
    value = parameter.default
    if value is None or value is False or value == () or callable(value):
        return ""
    if "UNSET" in repr(value):
        return ""
    return f"`{value}`"


def _plain(text: str) -> str:
    """A docstring as Markdown: what stands for itself in it is no mark."""
    return re.sub(r"([*_<>])", r"\\\1", text) if "`" not in text else text.replace("<", r"\<")

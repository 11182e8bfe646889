"""Options that are numbers with a unit: ``--distance 2``, ``--distance "200 cm"``."""

from collections.abc import Callable

import typer

from hardware.errors import InputError


def quantity_of(unit: str | None) -> Callable[[str | float], float]:
    """Parser of an option that is a number in ``unit``, or text with a unit of its dimension; None:
    a pure number, or per cent.
    """

    def parse(given: str | float) -> float:
        from hardware.units import quantity

        if not isinstance(given, str):
            return given
        try:
            return quantity(given, unit, bare=True)
        except InputError as error:
            raise typer.BadParameter(f"{given!r:.60}: {error}") from None

    parse.__name__ = unit or "number"
    return parse

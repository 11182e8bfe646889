"""Options that ``ugv detect`` and ``ugv process`` share: how a radar's records are processed."""

import inspect
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import wraps
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hardware.commands.quantities import quantity_of
from hardware.errors import InputError

if TYPE_CHECKING:
    from hardware.radar.settings import Processing

_FalseAlarm = Annotated[
    float | None, typer.Option(help="Probability of a false alarm per cell; default 1e-8.")
]
_CfarMethod = Annotated[str | None, typer.Option("--cfar", help="Kind of CFAR: ca, go or os.")]
_ClutterShape = Annotated[
    str | None,
    typer.Option(
        help="Shape of K-distributed clutter, or `fitted` to each map; default inf: noise."
    ),
]
_Detection = Annotated[
    str | None, typer.Option(help="Your own detection in place of CFAR: file.py:function.")
]
_Window = Annotated[str | None, typer.Option(help="Window, by its name in scipy.signal.")]
_Resolve = Annotated[bool, typer.Option(help="Separate targets within one cell.")]
MovingOnly = Annotated[bool, typer.Option(help="Leave out static targets.")]
_PerCell = Annotated[
    int | None, typer.Option(help="Targets of one range and rate to tell by angle; default 1.")
]
_Fastest = Annotated[
    float | None,
    typer.Option(
        help="Highest speed up to which ambiguous range rates are resolved, m/s; default 50.",
        parser=quantity_of("m/s"),
    ),
]
_RangeRate = Annotated[
    float | None,
    typer.Option(
        help="At which targets move from one carrier step to the next, m/s; default 0.",
        parser=quantity_of("m/s"),
    ),
]


def with_processing(function: Callable[..., None]) -> Callable[..., None]:
    """A command with these options in place of its argument ``how``."""
    options = inspect.signature(_processing).parameters
    own = dict(inspect.signature(function).parameters)
    del own["how"]

    @wraps(function)
    def called(*arguments: Any, **given: Any) -> None:
        how = _processing(**{name: given.pop(name) for name in options})
        function(*arguments, how=how, **given)

    parameters = [*own.values(), *options.values()]
    called.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    return called


def _processing(
    *,
    false_alarm: _FalseAlarm = None,
    cfar: _CfarMethod = None,
    clutter_shape: _ClutterShape = None,
    window: _Window = None,
    resolve: _Resolve = False,
    moving_only: MovingOnly = False,
    per_cell: _PerCell = None,
    fastest: _Fastest = None,
    range_rate: _RangeRate = None,
    detection: _Detection = None,
) -> "Processing":
    """None stands for the default."""
    from hardware.radar.settings import Processing

    rule = {"false_alarm": false_alarm, "method": cfar, "shape": _shape(clutter_shape)}
    settings = {
        "window": window,
        "resolve": resolve,
        "moving_only": moving_only,
        "per_cell": per_cell,
        "fastest_m_per_s": fastest,
        "range_rate_m_per_s": range_rate,
        "detection": detection,
    }
    return Processing(cfar=replace(Processing().cfar, **_given(rule)), **_given(settings))


def _given(values: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in values.items() if value is not None}


def _shape(asked: str | None) -> float | str | None:
    """Value of ``--clutter-shape``."""
    try:
        return asked if asked in (None, "fitted") else float(asked)
    except ValueError:
        raise InputError(
            f"--clutter-shape: {asked!r}, expected a positive number or 'fitted'"
        ) from None

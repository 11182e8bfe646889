"""The system that measures as a host asks of a virtual camera, or why the camera refuses."""

from contextlib import suppress
from dataclasses import replace
from typing import NoReturn

import numpy as np
from pydantic import ValidationError

from hardware.drivers.messages import MODE_CODES, ORDER_CODES, UPLOADED, Configure, Refusal
from hardware.drivers.settings import SpiSettings
from hardware.drivers.table import patterns_in, table_bytes
from hardware.patterns import Mode, OwnPatterns, Patterns, PatternSet
from twin.files import InputError
from twin.serve.configuration import configure_system
from twin.system import System

#: Bits of the modes that a camera has: all but complementary, which takes a second detector behind
#: a mirror.
MODES = sum(1 << code for code, mode in enumerate(MODE_CODES) if mode != "complementary")
_ENOUGH_PATTERNS = 8  # patterns that tell most orders apart


class RefusedError(Exception):
    """Refusal of a request: its code and reason."""


def requested_system(
    own: System, request: Configure, uploaded: OwnPatterns | None = None
) -> System:
    """A camera's ``own`` system, configured by a request, with the patterns of an ``uploaded``
    table. Before the upload, patterns of the same size stand in for them.

    Raises RefusedError for what the camera cannot do.
    """
    _check(request, own.patterns)
    try:
        settings = SpiSettings(
            _patterns(request, own.patterns, uploaded),
            request.integration_time_s,
            request.pattern_period_s,
            gain=request.gain,
            shutters=request.shutters,
        )
        return configure_system(own, settings)
    except (InputError, ValidationError) as error:
        _refuse(" ".join(str(error).split())[:150], error)


def uploaded_system(own: System, request: Configure, table: bytes) -> System:
    """The system that shows an uploaded table: by name where it is that of a named order.

    Raises RefusedError for a table that is not as the request says.
    """
    mode = MODE_CODES[request.mode]
    with suppress(InputError):  # cells that are no power of two have no named order
        for code, name in enumerate(ORDER_CODES):
            patterns = PatternSet(request.rows, request.columns, request.count, name, mode)
            first = patterns.take(np.arange(request.count) < _ENOUGH_PATTERNS)
            if table.startswith(table_bytes(first)) and table == table_bytes(patterns):
                return requested_system(own, replace(request, order=code))
    try:
        uploaded = patterns_in(table, request.rows, request.columns, mode)
    except InputError as error:
        raise RefusedError(Refusal.TABLE, f"Arm: {error}"[:150]) from error
    return requested_system(own, request, uploaded)


def _check(request: Configure, own: Patterns) -> None:
    """Raises RefusedError for patterns that the camera cannot show."""
    if (request.rows, request.columns) != (own.rows, own.columns):
        _refuse(f"rows, columns: the emitter has {own.rows} x {own.columns} cells")
    if request.order >= len(ORDER_CODES) and request.order != UPLOADED:
        _refuse("order: this camera does not know it")
    if request.mode >= len(MODE_CODES) or not MODES >> request.mode & 1:
        _refuse("mode: this camera does not know it")
    if not 1 <= request.count <= own.n_cells:
        _refuse(f"count: {request.count} is not between 1 and {own.n_cells}")


def _patterns(request: Configure, own: Patterns, uploaded: OwnPatterns | None) -> Patterns:
    mode: Mode = MODE_CODES[request.mode]
    if request.order != UPLOADED:
        order = ORDER_CODES[request.order]
        return PatternSet(own.rows, own.columns, request.count, order, mode)
    if uploaded is not None:
        return uploaded
    if mode == "s-matrix":
        return PatternSet(own.rows, own.columns, request.count, "natural", mode)
    dark = np.zeros((request.count, own.rows, own.columns), np.uint16)
    return OwnPatterns(dark, mode)


def _refuse(reason: str, cause: Exception | None = None) -> NoReturn:
    raise RefusedError(Refusal.UNSUPPORTED, reason) from cause

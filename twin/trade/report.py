"""Results as a table for terminal and README, as JSON, CSV, and a plot of the Pareto front."""

import csv
import math
import os
import platform
from collections.abc import Iterator
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, LogLocator, NullFormatter
from rich.console import Console
from rich.table import Table

from hardware.formatting import json_text, number, si
from twin import __version__
from twin.fidelity import Fidelity, Tolerance
from twin.report.style import BLUE, GREY, ORANGE, new_figure, wrapped
from twin.trade.measurement import LevelMeasurement, Model, front
from twin.trade.result import Trade

_MODELS: dict[Model, str] = {
    "light": "light: paths per cell, bounces",
    "noise": "noise of an exposure",
    "radar": "radar: paths and their synthesis",
}
_DEPTH_COLORS = {1: GREY, 2: ORANGE, 4: BLUE}
_SMALLEST = 1e-9  # what a logarithmic axis shows of an error of 0
_TITLE = 55  # letters of a line above a panel


def write_trade(trade: Trade, folder: Path) -> None:
    """``trade.json``, ``trade.csv`` of all levels, ``trade.md`` with the front, ``trade.png``."""
    (folder / "trade.json").write_text(json_text(trade_content(trade)))
    (folder / "trade.md").write_text("\n".join(markdown(trade)) + "\n")
    rows = [_csv_row(trade, m) for m in trade.measurements]
    with (folder / "trade.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, list(dict.fromkeys(key for row in rows for key in row)))
        writer.writeheader()
        writer.writerows(rows)
    plot_trade(trade).savefig(folder / "trade.png", metadata={"Software": None})


def print_trade(trade: Trade, console: Console) -> None:
    """The rows of ``trade.md``, the independent check, and the level chosen."""
    table = Table(
        "",
        "time",
        "peak memory",
        "error, rms",
        "rms / noise",
        "median / noise",
        "leaves out",
        box=None,
    )
    table.title = f"{trade.scene}, {trade.system}, {trade.radar or 'no radar'}"
    for model, title in _MODELS.items():
        if model in trade.choices:
            table.add_row(f"[bold]{title}")
            for m in _table_levels(trade, model):
                table.add_row(*_cells(trade, m), style="bold" if _is_choice(trade, m) else None)
    console.print(table)
    bodies = _bodies(trade)
    if bodies:
        errors = Table(*bodies[0], box=None)
        for row in bodies[1:]:
            errors.add_row(*row)
        console.print(errors)
    if trade.agreement:
        console.print(str(trade.agreement), highlight=False, markup=False)
    for model, choice in trade.choices.items():
        line = f"{model}: {choice.measurement.name}: {choice.reason}"
        console.print(line, highlight=False, markup=False)
    for line in _brute_force_lines(trade):
        console.print(line.removeprefix("- "), highlight=False, markup=False)


def markdown(trade: Trade) -> Iterator[str]:
    """Lines of a table for a README: the front, the presets, and levels for comparison."""
    radar = f", radar `{trade.radar}`" if trade.radar else ""
    yield (
        f"`twin trade {trade.scene}`: system `{trade.system}` (noise of a pixel "
        f"{number(trade.pixel_noise_e)} e-){radar}. Times are medians of warm runs, in brackets "
        f"over one complex FFT of 2^20 points ({si(trade.fft_s, 's')}); in bold the level chosen "
        f"for {_asked(trade)}. {len(trade.measurements)} levels were "
        "measured; these are the fastest for their error, the presets and the references."
    )
    for model, title in _MODELS.items():
        if model not in trade.choices:
            continue
        yield ""
        last = "leaves out" if model == "radar" else "median / noise"
        yield f"| {title} | time | peak memory | error, rms | rms / noise | {last} |"
        yield "|---|---|---|---|---|---|"
        for m in _table_levels(trade, model):
            *cells, median, leaves_out = _cells(trade, m)
            cells.append(leaves_out if model == "radar" else median)
            if _is_choice(trade, m):
                cells[0] = f"**{cells[0]}**"
            yield f"| {' | '.join(cells)} |"
    yield ""
    if bodies := _bodies(trade):
        yield f"| {' | '.join(bodies[0])} |"
        yield "|---" * len(bodies[0]) + "|"
        for row in bodies[1:]:
            yield f"| {' | '.join(row)} |"
        yield ""
    if trade.agreement:
        yield f"{str(trade.agreement).capitalize()}."
        yield ""
    for model, choice in trade.choices.items():
        yield f"- {model}: {choice.measurement.name}: {choice.reason}"
    yield from _brute_force_lines(trade)
    yield f"- in all: `{as_code(trade.fidelity)}`"
    for warning in trade.warnings:
        yield f"- warning: {warning}"


def _bodies(trade: Trade) -> list[tuple[str, ...]]:
    """Errors of the radar's bodies by tolerance, with a head; empty where nothing scatters."""
    levels = {m.name.rsplit(",", 1)[0]: m for m in trade.of("radar") if m.bodies}
    if not levels:
        return []
    head = (
        "body within 40 dB: error, rms",
        "echo",
        *levels,
        "against",
    )
    columns = [m.bodies for m in levels.values()]
    rows = [
        (
            row[0].body,
            f"{row[0].level_db:.0f} dB",
            *(
                f"{number(100 * e.error)} %{'' if e.is_converged else ', not converged'}"
                for e in row
            ),
            row[0].reference,
        )
        for row in zip(*columns, strict=True)
    ]
    return [head, *rows]


def _brute_force_lines(trade: Trade) -> Iterator[str]:
    """Cost of rendering every pattern by itself, compared with the level chosen."""
    choice = trade.choices["light"].measurement
    for m in trade.of("light"):
        if m.fidelity is None:
            yield (
                f"- {m.name} takes {number(m.cost.seconds / choice.cost.seconds)} times as long "
                f"as {choice.name}, for {number(m.over_noise)} of the sensor's noise ({m.note})"
            )


def as_code(fidelity: Fidelity) -> str:
    """Fidelity as Python code: the settings that differ from the default."""
    knobs = [
        f"{f.name}={getattr(fidelity, f.name)!r}"
        for f in fields(Fidelity)
        if getattr(fidelity, f.name) != f.default
    ]
    return f"Fidelity({', '.join(knobs)})"


def plot_trade(trade: Trade) -> Figure:
    """Error over the sensor's noise against time; the front, the tolerance, the level chosen."""
    drawn: list[Model] = [model for model in ("light", "radar") if model in trade.choices]
    figure = new_figure((5.4 * len(drawn), 3.9))
    for axis, model in zip(figure.subplots(1, len(drawn), squeeze=False)[0], drawn, strict=True):
        _scatter(axis, trade, model)
        _annotate(axis, trade, model)
    return figure


def _scatter(axis: Any, trade: Trade, model: Model) -> None:
    for m in trade.of(model):
        label, color, marker = _marker(m)
        seen = axis.get_legend_handles_labels()[1]
        axis.plot(
            m.cost.seconds,
            max(m.over_noise, _SMALLEST),
            marker,
            color=color,
            ms=5,
            label=None if label in seen else label,
        )


def _marker(m: LevelMeasurement) -> tuple[str, str, str]:
    """Label, colour and marker of a level."""
    if m.fidelity is None:
        return m.name, "black", "x"
    if m.model == "radar":
        from twin.radar.propagation.solvers import solver_of  # brings the tracers along

        solver = solver_of(m.fidelity)
        marker = {"targets": "s", "optics": "^"}.get(str(m.fidelity.radar), "o")
        return solver.label, BLUE if solver.has_tolerance else GREY, marker
    if m.name.startswith("reference"):
        return "one render of the reference", "black", "D"
    if m.fidelity.light_tolerance is not None:
        return "to a tolerance, all bounces", "black", "*"
    depth = m.fidelity.max_depth
    label = {1: "direct light"}.get(depth, f"{depth} bounces")
    marker = "o"
    if m.fidelity.start != "auto":
        label += f", {m.fidelity.start}"
        marker = {"dual": "o", "scatter": "^"}[m.fidelity.start]
    return label, _DEPTH_COLORS[depth], marker


def _asked(trade: Trade) -> str:
    """What levels were chosen for."""
    if isinstance(trade.tolerance, Tolerance) and trade.within_s is None:
        return f"a tolerance of {trade.tolerance}"
    if trade.within_s is None:
        return f"{trade.tolerance:g} of the sensor's noise"
    return f"a frame of {si(trade.within_s, 's')}"


def _annotate(axis: Any, trade: Trade, model: Model) -> None:
    best, choice = front(trade.of(model)), trade.choices[model].measurement
    times = [m.cost.seconds for m in best]
    errors = [max(m.over_noise, _SMALLEST) for m in best]
    axis.plot(times, errors, color=BLUE, lw=0.8, zorder=0, drawstyle="steps-post")
    if trade.criteria[model].is_over_noise:
        _draw_limit(axis, trade.criteria[model].limit)
    place = (choice.cost.seconds, max(choice.over_noise, _SMALLEST))
    axis.plot(*place, "o", mfc="none", mec=ORANGE, ms=12, mew=1.6, label="to take", ls="none")
    axis.set_xscale("log")
    axis.set_yscale("log")
    narrow = axis.get_xlim()[1] < 100 * axis.get_xlim()[0]
    axis.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5) if narrow else (1,)))
    axis.xaxis.set_major_formatter(EngFormatter(unit="s"))
    axis.xaxis.set_minor_formatter(NullFormatter())
    axis.set_xlabel("time, warm")
    unit = "a pixel's noise" if model == "light" else "the noise of a map cell"
    axis.set_ylabel(f"error, rms, over {unit}")
    axis.set_title(_title(trade, model), loc="left")
    axis.legend(frameon=False, fontsize=7.5, loc="best")


def _draw_limit(axis: Any, limit: float) -> None:
    """The line of a tolerance of the sensor's noise."""
    axis.axhline(limit, color=GREY, lw=0.8, ls="--")
    axis.text(
        1.0,
        limit,
        "the sensor's noise hides what is below ",
        transform=axis.get_yaxis_transform(),
        ha="right",
        va="top",
        fontsize=7.5,
        color="#55595f",
    )


def _title(trade: Trade, model: Model) -> str:
    choice = trade.choices[model]
    measurement = choice.measurement
    end = "enough" if choice.within else "not enough, and the most accurate"
    time = si(measurement.cost.seconds, "s")
    error = number(measurement.over_noise, 2)
    first = wrapped(f"{model}: {measurement.name}: {end}", _TITLE)
    return f"{first}\n{error} of the noise in {time}"


def _table_levels(trade: Trade, model: Model) -> list[LevelMeasurement]:
    """The front, presets, references, and the level chosen, by time; all of a few levels."""
    levels = trade.of(model)
    best = front(levels)
    kept = [
        m for m in levels if len(levels) <= 6 or m in best or _is_named(m) or _is_choice(trade, m)
    ]
    return sorted(kept, key=lambda m: m.cost.seconds)


def _is_named(m: LevelMeasurement) -> bool:
    """A preset, the default, the reference, or something for comparison."""
    if m.fidelity is not None and m.model == "radar" and m.fidelity.radar_edges is None:
        return True
    return m.fidelity is None or m.name.startswith("reference") or m.name.endswith(")")


def _is_choice(trade: Trade, m: LevelMeasurement) -> bool:
    return trade.choices[m.model].measurement is m


def _cells(trade: Trade, m: LevelMeasurement) -> tuple[str, ...]:
    error = f"{number(m.error, 3)} {m.unit}"
    if m.model == "light":
        error += f", {si(m.detail['error_w'], 'W')}"
        if "relative" in m.detail:
            error += f", {number(100 * m.detail['relative'])} %"
    elif m.model == "radar":
        error += f", {m.detail['error_db']:.0f} dB"
    median = m.detail.get("median_over_noise")
    scaled = " (scaled)" if "scaled" in m.note else ""
    return (
        m.name,
        f"{si(m.cost.seconds, 's')} ({number(m.cost.seconds / trade.fft_s)}){scaled}",
        f"{m.cost.peak_bytes / 2**20:.0f} MiB",
        error,
        number(m.over_noise),
        "" if median is None else number(median, 2),
        m.leaves_out,
    )


def _or_none(error: float) -> float | None:
    """None of what was not measured."""
    return None if math.isnan(error) else error


def _csv_row(trade: Trade, m: LevelMeasurement) -> dict[str, Any]:
    """One row of the CSV."""
    return {
        "model": m.model,
        "level": m.name,
        "taken": int(_is_choice(trade, m)),
        "on_front": int(m in front(trade.of(m.model))),
        "seconds": m.cost.seconds,
        "seconds_low": m.cost.low_s,
        "seconds_high": m.cost.high_s,
        "runs": m.cost.runs,
        "peak_bytes": m.cost.peak_bytes,
        "error": m.error,
        "unit": m.unit,
        "error_over_noise": m.over_noise,
        "error_over_cells": _or_none(m.over_cells),
        "error_over_bodies": _or_none(m.over_bodies),
        **m.detail,
        **m.knobs,
        "leaves_out": m.leaves_out,
        "note": m.note,
        "not_converged": "; ".join(e.body for e in m.bodies if not e.is_converged),
    }


def trade_content(trade: Trade) -> dict[str, Any]:
    """Everything that was measured, for JSON."""
    agreement = trade.agreement
    return {
        "scene": trade.scene,
        "system": trade.system,
        "radar": trade.radar,
        "tolerance": str(trade.tolerance)
        if isinstance(trade.tolerance, Tolerance)
        else trade.tolerance,
        "criteria": {
            model: {"limit": criterion.limit, "unit": criterion.unit}
            for model, criterion in trade.criteria.items()
        },
        "within_s": trade.within_s,
        "seed": trade.seed,
        "version": __version__,
        "machine": {"cores": os.cpu_count(), "machine": platform.machine()},
        "fft_2_20_s": trade.fft_s,
        "pixel_noise_e": trade.pixel_noise_e,
        "agreement": {**asdict(agreement), "holds": agreement.holds} if agreement else None,
        "fidelity": trade.fidelity.said(),
        "choices": {
            model: {"level": c.measurement.name, "within": c.within, "reason": c.reason}
            for model, c in trade.choices.items()
        },
        "warnings": trade.warnings,
        "measurements": [_csv_row(trade, m) for m in trade.measurements],
        "bodies": [
            {"level": m.name, **asdict(error)} for m in trade.measurements for error in m.bodies
        ],
    }

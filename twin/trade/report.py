"""The trade as a table for terminal and README, as JSON and CSV, and as a picture of the front."""

import csv
import json
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

from twin import __version__
from twin.fidelity import Fidelity
from twin.report.style import BLUE, GREY, ORANGE, new_figure, si
from twin.trade.measurement import Ladder, Measurement, front
from twin.trade.result import Trade

_LADDERS: dict[Ladder, str] = {
    "light": "light: paths per cell, bounces",
    "noise": "noise of an exposure",
    "radar": "radar: paths and their synthesis",
}
_DEPTH_COLORS = {1: GREY, 2: ORANGE, 4: BLUE}
_SMALLEST = 1e-9  # what a logarithmic axis shows of an error of 0


def write_trade(found: Trade, folder: Path) -> None:
    """``trade.json``, ``trade.csv`` with every rung, ``trade.md`` with the front, ``trade.png``."""
    content = json.dumps(_finite(_content(found)), indent=1, allow_nan=False)
    (folder / "trade.json").write_text(content)
    (folder / "trade.md").write_text("\n".join(markdown(found)) + "\n")
    rows = [_flat(found, m) for m in found.measurements]
    with (folder / "trade.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, list(dict.fromkeys(key for row in rows for key in row)))
        writer.writeheader()
        writer.writerows(rows)
    plot_trade(found).savefig(folder / "trade.png", metadata={"Software": None})


def print_trade(found: Trade, console: Console) -> None:
    """The same rows as in ``trade.md``, the check, and what one would take."""
    table = Table(
        "", "time", "peak memory", "error, rms", "rms / noise", "median / noise", box=None
    )
    table.title = f"{found.scene}, {found.system}, {found.radar or 'no radar'}"
    for ladder, title in _LADDERS.items():
        if ladder in found.choices:
            table.add_row(f"[bold]{title}")
            for m in _shown(found, ladder):
                table.add_row(*_cells(found, m), style="bold" if _taken(found, m) else None)
    console.print(table)
    bodies = _bodies(found)
    if bodies:
        errors = Table(*bodies[0], box=None)
        for row in bodies[1:]:
            errors.add_row(*row)
        console.print(errors)
    if found.agreement:
        console.print(str(found.agreement), highlight=False, markup=False)
    for ladder, choice in found.choices.items():
        line = f"{ladder}: {choice.taken.name}: {choice.reason}"
        console.print(line, highlight=False, markup=False)
    for line in _by_force(found):
        console.print(line.removeprefix("- "), highlight=False, markup=False)
    console.print(f"take: {spelled(found.fidelity)}", highlight=False, markup=False)


def markdown(found: Trade) -> Iterator[str]:
    """Lines of a table for a README: the front, the presets, what is for comparison."""
    radar = f", radar `{found.radar}`" if found.radar else ""
    yield (
        f"`twin trade {found.scene}`: system `{found.system}` (noise of a pixel "
        f"{found.pixel_noise_e:.3g} e-){radar}. Times are medians of warm runs, in brackets over "
        f"one complex FFT of 2^20 points ({si(found.fft_s, 's')}); in bold what one would take "
        f"below {found.tolerance:g} of the sensor's noise. {len(found.measurements)} rungs were "
        "measured; these are the fastest for their error, the presets and the references."
    )
    for ladder, title in _LADDERS.items():
        if ladder not in found.choices:
            continue
        yield ""
        yield f"| {title} | time | peak memory | error, rms | rms / noise | median / noise |"
        yield "|---|---|---|---|---|---|"
        for m in _shown(found, ladder):
            cells = list(_cells(found, m))
            if _taken(found, m):
                cells[0] = f"**{cells[0]}**"
            yield f"| {' | '.join(cells)} |"
    yield ""
    if bodies := _bodies(found):
        yield f"| {' | '.join(bodies[0])} |"
        yield "|---" * len(bodies[0]) + "|"
        for row in bodies[1:]:
            yield f"| {' | '.join(row)} |"
        yield ""
    if found.agreement:
        yield f"{str(found.agreement).capitalize()}."
        yield ""
    for ladder, choice in found.choices.items():
        yield f"- {ladder}: {choice.taken.name}: {choice.reason}"
    yield from _by_force(found)
    yield f"- in all: `{spelled(found.fidelity)}`"
    for warning in found.warnings:
        yield f"- warning: {warning}"


def _bodies(found: Trade) -> list[tuple[str, ...]]:
    """Errors of the radar's bodies by tolerance, with a head; empty where nothing scatters."""
    rungs = {m.name.rsplit(",", 1)[0]: m for m in found.of("radar") if m.bodies}
    if not rungs:
        return []
    head = (
        "body within 40 dB: error, rms",
        "echo",
        *rungs,
        "against",
    )
    columns = [m.bodies for m in rungs.values()]
    rows = [
        (
            row[0].body,
            f"{row[0].level_db:.0f} dB",
            *(
                f"{_number(100 * e.error)} %{'' if e.is_converged else ', not converged'}"
                for e in row
            ),
            row[0].reference,
        )
        for row in zip(*columns, strict=True)
    ]
    return [head, *rows]


def _by_force(found: Trade) -> Iterator[str]:
    """What rendering every pattern by itself would cost, beside the rung taken."""
    taken = found.choices["light"].taken
    for m in found.of("light"):
        if m.fidelity is None:
            yield (
                f"- {m.name} takes {_number(m.cost.seconds / taken.cost.seconds)} times as long as "
                f"{taken.name}, for {_number(m.over_noise)} of the sensor's noise ({m.note})"
            )


def spelled(fidelity: Fidelity) -> str:
    """As one would type it: the knobs that differ from the default."""
    knobs = [
        f"{f.name}={getattr(fidelity, f.name)!r}"
        for f in fields(Fidelity)
        if getattr(fidelity, f.name) != f.default
    ]
    return f"Fidelity({', '.join(knobs)})"


def plot_trade(found: Trade) -> Figure:
    """Error over the sensor's noise against time; the front, the tolerance, the rung taken."""
    drawn: list[Ladder] = [ladder for ladder in ("light", "radar") if ladder in found.choices]
    figure = new_figure((5.4 * len(drawn), 3.9))
    for axis, ladder in zip(figure.subplots(1, len(drawn), squeeze=False)[0], drawn, strict=True):
        _scatter(axis, found, ladder)
        _decorate(axis, found, ladder)
    return figure


def _scatter(axis: Any, found: Trade, ladder: Ladder) -> None:
    for m in found.of(ladder):
        label, color, marker = _look(m)
        seen = axis.get_legend_handles_labels()[1]
        axis.plot(
            m.cost.seconds,
            max(m.over_noise, _SMALLEST),
            marker,
            color=color,
            ms=5,
            label=None if label in seen else label,
        )


def _look(m: Measurement) -> tuple[str, str, str]:
    """Label, colour and marker of a rung."""
    if m.fidelity is None:
        return m.name, "black", "x"
    if m.ladder == "radar":
        known = {
            "targets": ("declared targets", GREY, "s"),
            "paths": ("traced paths", GREY, "o"),
            "optics": ("physical optics", BLUE, "^"),
        }
        return known[str(m.fidelity.radar)]
    if m.name.startswith("reference"):
        return "one render of the reference", "black", "D"
    depth = m.fidelity.max_depth
    label = {1: "direct light"}.get(depth, f"{depth} bounces")
    marker = "o"
    if m.fidelity.start != "auto":
        label += f", {m.fidelity.start}"
        marker = {"dual": "o", "scatter": "^"}[m.fidelity.start]
    return label, _DEPTH_COLORS[depth], marker


def _decorate(axis: Any, found: Trade, ladder: Ladder) -> None:
    best, taken = front(found.of(ladder)), found.choices[ladder].taken
    times = [m.cost.seconds for m in best]
    errors = [max(m.over_noise, _SMALLEST) for m in best]
    axis.plot(times, errors, color=BLUE, lw=0.8, zorder=0, drawstyle="steps-post")
    axis.axhline(found.tolerance, color=GREY, lw=0.8, ls="--")
    axis.text(
        1.0,
        found.tolerance,
        "the sensor's noise hides what is below ",
        transform=axis.get_yaxis_transform(),
        ha="right",
        va="top",
        fontsize=7.5,
        color="#55595f",
    )
    place = (taken.cost.seconds, max(taken.over_noise, _SMALLEST))
    axis.plot(*place, "o", mfc="none", mec=ORANGE, ms=12, mew=1.6, label="to take", ls="none")
    axis.set_xscale("log")
    axis.set_yscale("log")
    narrow = axis.get_xlim()[1] < 100 * axis.get_xlim()[0]
    axis.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5) if narrow else (1,)))
    axis.xaxis.set_major_formatter(EngFormatter(unit="s"))
    axis.xaxis.set_minor_formatter(NullFormatter())
    axis.set_xlabel("time, warm")
    unit = "a pixel's noise" if ladder == "light" else "the noise of a map cell"
    axis.set_ylabel(f"error, rms, over {unit}")
    axis.set_title(_finding(found, ladder), loc="left")
    axis.legend(frameon=False, fontsize=7.5, loc="best")


def _finding(found: Trade, ladder: Ladder) -> str:
    choice = found.choices[ladder]
    taken = choice.taken
    end = "enough" if choice.within else "not enough, and the most accurate"
    time = si(taken.cost.seconds, "s")
    return f"{ladder}: {taken.name}: {end}\n{taken.over_noise:.2g} of the noise in {time}"


def _shown(found: Trade, ladder: Ladder) -> list[Measurement]:
    """The front, presets, references, and what is taken; by time. All of a short ladder."""
    rungs = found.of(ladder)
    best = front(rungs)
    kept = [m for m in rungs if len(rungs) <= 6 or m in best or _is_named(m) or _taken(found, m)]
    return sorted(kept, key=lambda m: m.cost.seconds)


def _is_named(m: Measurement) -> bool:
    """A preset, the reference, or something for comparison."""
    return m.fidelity is None or m.name.startswith("reference") or m.name.endswith(")")


def _taken(found: Trade, m: Measurement) -> bool:
    return found.choices[m.ladder].taken is m


def _cells(found: Trade, m: Measurement) -> tuple[str, ...]:
    error = f"{_number(m.error, 3)} {m.unit}"
    if m.ladder == "light":
        error += f", {si(m.detail['error_w'], 'W')}"
        if "relative" in m.detail:
            error += f", {_number(100 * m.detail['relative'])} %"
    elif m.ladder == "radar":
        error += f", {m.detail['error_db']:.0f} dB"
    median = m.detail.get("median_over_noise")
    scaled = " (scaled)" if "scaled" in m.note else ""
    return (
        m.name,
        f"{si(m.cost.seconds, 's')} ({_number(m.cost.seconds / found.fft_s)}){scaled}",
        f"{m.cost.peak_bytes / 2**20:.0f} MiB",
        error,
        _number(m.over_noise),
        "" if median is None else f"{median:.2g}",
    )


def _number(value: float, digits: int = 2) -> str:
    """Significant digits, large numbers without an exponent."""
    return f"{value:,.0f}" if value >= 10**digits else f"{value:.{digits}g}"


def _flat(found: Trade, m: Measurement) -> dict[str, Any]:
    """One row of the CSV."""
    return {
        "ladder": m.ladder,
        "rung": m.name,
        "taken": int(_taken(found, m)),
        "on_front": int(m in front(found.of(m.ladder))),
        "seconds": m.cost.seconds,
        "seconds_low": m.cost.low_s,
        "seconds_high": m.cost.high_s,
        "runs": m.cost.runs,
        "peak_bytes": m.cost.peak_bytes,
        "error": m.error,
        "unit": m.unit,
        "error_over_noise": m.over_noise,
        **m.detail,
        **m.knobs,
        "note": m.note,
        "not_converged": "; ".join(e.body for e in m.bodies if not e.is_converged),
    }


def _content(found: Trade) -> dict[str, Any]:
    agreement = found.agreement
    return {
        "scene": found.scene,
        "system": found.system,
        "radar": found.radar,
        "tolerance": found.tolerance,
        "seed": found.seed,
        "version": __version__,
        "machine": {"cores": os.cpu_count(), "machine": platform.machine()},
        "fft_2_20_s": found.fft_s,
        "pixel_noise_e": found.pixel_noise_e,
        "agreement": {**asdict(agreement), "holds": agreement.holds} if agreement else None,
        "fidelity": found.fidelity.said(),
        "choices": {
            ladder: {"rung": c.taken.name, "within": c.within, "reason": c.reason}
            for ladder, c in found.choices.items()
        },
        "warnings": found.warnings,
        "measurements": [_flat(found, m) for m in found.measurements],
        "bodies": [
            {"rung": m.name, **asdict(error)} for m in found.measurements for error in m.bodies
        ],
    }


def _finite(value: Any) -> Any:
    """JSON knows no infinity: None stands for it."""
    if isinstance(value, dict):
        return {key: _finite(x) for key, x in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(x) for x in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value

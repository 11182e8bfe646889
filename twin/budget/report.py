"""Budgets as tables for a terminal, as JSON, and as a plot: of a system, and the paper's table."""

import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table

from hardware.formatting import json_text, number, quantity_text, si
from twin.budget.design import WallRow
from twin.budget.frame_rate import FrameRate
from twin.budget.table1 import REFLECTANCES, AuditRow
from twin.report.style import BLUE, GREY, ORANGE, new_figure
from twin.system import System


def print_budget(rows: Sequence[AuditRow], rates: Sequence[FrameRate], console: Console) -> None:
    """Table 1 beside the derived values, the elasticities, the frame rates."""
    console.print(_table1(rows))
    for row in rows:
        moves = ", ".join(f"{name} {value:+.2f}" for name, value in row.elasticity.items())
        console.print(f"[bold]{row.sensor}[/], per cent of T per per cent of: {moves}")
    console.print(_rates(rates))


def budget_content(rows: Sequence[AuditRow], rates: Sequence[FrameRate]) -> dict[str, Any]:
    """Every number of the tables, for JSON."""
    return {"table1": rows, "frame_rates": rates}


def write_budget(rows: Sequence[AuditRow], rates: Sequence[FrameRate], folder: Path) -> None:
    """``budget.json`` with every number, ``budget.png`` with times over printed times."""
    (folder / "budget.json").write_text(json_text(budget_content(rows, rates)))
    plot_budget(rows).savefig(folder / "budget.png", metadata={"Software": None})


def print_design(system: System, rows: Sequence[WallRow], console: Console) -> None:
    """A system in front of a wall: electrons, noise, SNR, time and distance for an SNR of 1."""
    columns = (
        "wall at",
        "reflectance",
        "signal, all cells lit",
        "electrons of a mean exposure: signal, sun, dark",
        "noise, most of it",
    )
    table = Table(*columns, "range used", "SNR per pixel", "T for SNR 1", "z for SNR 1", box=None)
    patterns, time = system.patterns, system.acquisition.integration_time_s.value
    table.title = (
        f"{system.name}: a wall square to the rig, one exposure of {si(time, 's')}; "
        f"{patterns.count} patterns of {patterns.columns} x {patterns.rows}, {patterns.mode}, "
        f"{si(system.frame_time_s, 's')} a frame"
    )
    for row in rows:
        noise = row.budget.noise_e
        table.add_row(
            quantity_text(row.distance_m, "m"),
            f"{row.reflectance:.0%}",
            si(row.signal_w, "W"),
            ", ".join(
                map(number, (row.budget.signal_e, row.budget.background_e, row.budget.dark_e))
            ),
            f"{number(row.budget.total_noise_e)}, {max(noise, key=lambda name: noise[name])}",
            f"{row.fill:.0%}",
            "void (saturated)" if row.saturates else number(row.snr_per_pixel),
            _or_none(row.minimum_time_s, "s"),
            _or_none(row.maximum_distance_m, "m"),
        )
    console.print(table)


def design_verdict(system: System, rows: Sequence[WallRow]) -> str:
    """The farthest wall with an SNR per pixel of 1, in words; or why there is none."""
    known = [row.maximum_distance_m for row in rows if not math.isnan(row.maximum_distance_m)]
    if known:
        return f"{system.name}: SNR 1 per pixel at up to {si(max(known), 'm')}"
    tof = system.time_of_flight
    if tof is not None and tof.gate_delays_s is not None:
        return f"{system.name}: no farthest distance for SNR 1: gates are open at some alone"
    return f"{system.name}: saturates at every distance at which the SNR per pixel would reach 1"


def design_content(system: System, rows: Sequence[WallRow]) -> dict[str, Any]:
    """Every number of the table, for JSON."""
    walls = [{**asdict(row), "saturates": row.saturates} for row in rows]
    return {"system": system.name, "frame_time_s": system.frame_time_s, "walls": walls}


def write_design(system: System, rows: Sequence[WallRow], folder: Path) -> None:
    """``budget.json`` with every number of a system, null for NaN and infinity; ``budget.png`` with
    the SNR over distance.
    """
    (folder / "budget.json").write_text(json_text(design_content(system, rows)))
    plot_design(system, rows).savefig(folder / "budget.png", metadata={"Software": None})


def plot_design(system: System, rows: Sequence[WallRow]) -> Figure:
    """SNR per pixel over the wall's distance, by reflectance."""
    figure = new_figure((5.2, 3.6))
    axis = figure.subplots()
    for place, rho in enumerate(sorted({row.reflectance for row in rows})):
        of_rho = sorted((r for r in rows if r.reflectance == rho), key=lambda r: r.distance_m)
        axis.loglog(
            [row.distance_m for row in of_rho],
            [row.snr_per_pixel for row in of_rho],
            "os^v"[place % 4] + "-",
            color=(BLUE, ORANGE, GREY)[place % 3],
            label=f"reflectance {rho:g}",
        )
    axis.axhline(1.0, color=GREY, lw=0.8)
    axis.set_xlabel("distance of the wall (m)")
    axis.set_ylabel("signal / noise per pixel")
    axis.set_title(design_verdict(system, rows), fontsize=9, wrap=True)
    axis.legend(frameon=False)
    return figure


def plot_budget(rows: Sequence[AuditRow]) -> Figure:
    """Photon-limited and fitted times over the printed ones, cell by cell."""
    figure = new_figure((1.5 * len(rows) + 2.5, 3.6))
    axis = figure.subplots()
    for column, row in enumerate(rows):
        place = column + np.array([-0.22, 0.0, 0.22])
        axis.plot(place, row.photon_limited_s / row.printed_time_s, "o", color=BLUE)
        axis.plot(place, row.time_s / row.printed_time_s, "s", color=ORANGE, mfc="none")
    axis.axhline(1.0, color=GREY, lw=0.8)
    axis.set_yscale("log")
    axis.set_xticks(range(len(rows)), [row.sensor for row in rows])
    axis.set_ylabel("integration time over Table 1")
    axis.set_title(
        "photons alone (dots) need far less than Table 1; one read noise (squares) fits it"
    )
    return figure


def _table1(rows: Sequence[AuditRow]) -> Table:
    columns = ("sensor", "rho", "printed: z, T", "photons alone", "implied read noise")
    table = Table(
        *columns, "T with the row's", "z with the row's", "sigma of a ToF reading", box=None
    )
    table.title = "Table 1: shortest T for SNR 1 at the printed distance; read noise fitted per row"
    for row in rows:
        for i, rho in enumerate(REFLECTANCES):
            table.add_row(
                row.sensor
                if i == 0
                else f"  read noise {number(row.read_noise_e)} e-"
                if i == 1
                else "",
                f"{rho:.0%}",
                f"{quantity_text(float(row.printed_distance_m[i]), 'm')}, "
                f"{quantity_text(float(row.printed_time_s[i]), 's')}",
                si(float(row.photon_limited_s[i]), "s"),
                f"{number(float(row.implied_read_noise_e[i]))} e-",
                f"{si(float(row.time_s[i]), 's')} ({row.residual[i]:+.0%})",
                si(float(row.distance_m[i]), "m"),
                si(float(row.distance_sigma_m[i]), "m", 2),
            )
    return table


def _rates(rates: Sequence[FrameRate]) -> Table:
    columns = ("sensor", "at", "printed", "plain", "differential", "plain, overlapped")
    table = Table(*columns, "differential, overlapped", box=None)
    table.title = "Frames per second: 64 patterns, 13 ms of processing, in turns or overlapped"
    for rate in rates:
        table.add_row(
            rate.sensor,
            f"{quantity_text(rate.distance_m, 'm')}, {rate.reflectance:.0%}",
            "" if rate.printed is None else f"{rate.printed:g}",
            f"{rate.plain:.1f}",
            f"{rate.differential:.1f}",
            f"{rate.plain_overlapped:.1f}",
            f"{rate.differential_overlapped:.1f}",
        )
    return table


def _or_none(value: float, unit: str) -> str:
    """A time or distance; there is none where the signal is clipped before."""
    return si(value, unit) if math.isfinite(value) else "none"

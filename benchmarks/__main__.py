"""Print the figures that the README quotes, and write them to ``bench.json``."""

import json
import os
import platform
from dataclasses import asdict
from itertools import chain
from typing import Any

from rich.console import Console
from rich.table import Table

from benchmarks import (
    commands,
    optical,
    radar,
    radar_processing,
    radar_scene,
    radar_signal,
    radar_tables,
    rcs,
    reconstruction,
    regression,
    sweep,
    vehicle,
    weather,
)
from benchmarks.timing import Timing, fft_workload

_ROOMS = (
    reconstruction,
    optical,
    weather,
    radar,
    radar_scene,
    radar_signal,
    radar_tables,
    radar_processing,
    rcs,
    regression,
    sweep,
    vehicle,
    commands,
)


def main() -> None:
    unit = fft_workload()
    console = Console(width=150)
    table = Table("figure", "value", "spread (quartiles)", "x FFT 2^20", box=None)
    table.add_row("complex FFT, 2^20, NumPy (the unit)", *_timing(unit, unit))
    found: dict[str, Any] = {"FFT 2^20": asdict(unit)}
    with console.status("measuring"):
        for name, value, what in chain.from_iterable(room.figures() for room in _ROOMS):
            if isinstance(value, Timing):
                table.add_row(name, *_timing(value, unit))
                ratio = value.median_s / unit.median_s
                found[name] = {**asdict(value), "ratio_to_fft": ratio}
            else:
                table.add_row(name, f"{value:.4g} {what}", "", "")
                found[name] = {"value": value, "unit": what}
    console.print(table)
    machine = {"cores": os.cpu_count(), "machine": platform.machine()}
    with open("bench.json", "w") as file:
        json.dump({"machine": machine, "figures": found}, file, indent=1)
    console.print("written: bench.json")


def _timing(value: Timing, unit: Timing) -> tuple[str, str, str]:
    spread = f"{_seconds(value.low_s)} to {_seconds(value.high_s)}, {value.runs} runs"
    note = f" ({value.note})" if value.note else ""
    return _seconds(value.median_s) + note, spread, f"{value.median_s / unit.median_s:.3g}"


def _seconds(value: float) -> str:
    for factor, name in ((1.0, "s"), (1e-3, "ms"), (1e-6, "us")):
        if value >= factor or name == "us":
            return f"{value / factor:.3g} {name}"
    raise AssertionError


main()

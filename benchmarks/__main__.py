"""Print the figures that the README quotes, each as it comes, and write them to ``bench.json``.

``python -m benchmarks`` measures every room, ``python -m benchmarks optical rcs`` those named.
"""

import json
import os
import platform
import sys
from dataclasses import asdict
from importlib import import_module
from typing import Any

from benchmarks.timing import Timing, fft_workload

_ROOMS = (
    "reconstruction",
    "moving_reconstruction",
    "optical",
    "weather",
    "radar",
    "radar_scene",
    "radar_estimates",
    "round_obstacles",
    "behind_fences",
    "large_scenes",
    "radar_signal",
    "radar_tables",
    "sionna_rt",
    "radar_processing",
    "false_alarms",
    "rcs",
    "bodies",
    "regression",
    "sweep",
    "sweep_errors",
    "vehicle",
    "stream",
    "motion",
    "at_rest",
    "gpu",
    "lidar",
    "moved_rig",
    "moving_radar",
    "driving",
    "commands",
    "noise_intervals",
    "several_antennas",
    "stated_errors",
)


def main(rooms: list[str]) -> None:
    if {"-h", "--help"} & set(rooms):
        print(f"{__doc__.strip()}\n\nRooms: {', '.join(_ROOMS)}.")
        return
    if unknown := [name for name in rooms if name not in _ROOMS]:
        sys.exit(f"benchmarks: {', '.join(unknown)}: expected some of {', '.join(_ROOMS)}")
    unit = fft_workload()
    machine = {"cores": os.cpu_count(), "machine": platform.machine()}
    found: dict[str, Any] = {"FFT 2^20": asdict(unit)}
    print("in brackets quartiles, runs, and the ratio to the unit")
    print(f"complex FFT, 2^20, NumPy (the unit): {_timing(unit, unit)}", flush=True)
    for room in rooms or _ROOMS:
        print(f"-- {room}", flush=True)
        for name, value, what in import_module(f"benchmarks.{room}").figures():
            if isinstance(value, Timing):
                print(f"{name}: {_timing(value, unit)}", flush=True)
                found[name] = {**asdict(value), "ratio_to_fft": value.median_s / unit.median_s}
            else:
                print(f"{name}: {value:.4g} {what}", flush=True)
                found[name] = {"value": value, "unit": what}
        with open("bench.json", "w") as file:
            json.dump({"machine": machine, "figures": found}, file, indent=1)
    print("written: bench.json")


def _timing(value: Timing, unit: Timing) -> str:
    spread = f"{_seconds(value.low_s)} to {_seconds(value.high_s)}, {value.runs} runs"
    ratio = f"{value.median_s / unit.median_s:.3g}"
    note = f" ({value.note})" if value.note else ""
    return f"{_seconds(value.median_s)} [{spread}, {ratio}]{note}"


def _seconds(value: float) -> str:
    for factor, name in ((1.0, "s"), (1e-3, "ms"), (1e-6, "us")):
        if value >= factor or name == "us":
            return f"{value / factor:.3g} {name}"
    raise AssertionError


main(sys.argv[1:])

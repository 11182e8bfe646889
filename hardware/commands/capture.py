"""The command ``ugv capture``: the data of sensors into a log."""

import math
import time
from pathlib import Path
from typing import Annotated, Any

import typer

from hardware.commands.output import Output, with_output
from hardware.commands.quantities import quantity_of
from hardware.commands.records import (
    RadarSetup,
    Settings,
    end_early,
    fault_in_brackets,
    log_of,
    settings_of,
    setup_of,
    warn_of_damage,
)
from hardware.commands.tally import Tally
from hardware.errors import InputError


def register(app: typer.Typer) -> None:
    """Add the command to an application."""
    app.command()(with_output(capture, "ugv capture"))


def capture(
    say: Output,
    urls: Annotated[
        list[str],
        typer.Argument(
            help="/dev/ttyACM0, socket:// or zmq://HOST:PORT, uhd:ARGS, replay:FILE, or "
            "twin:SCENE?system=NAME&radar=NAME&seed=N&pace=fast (NAME: also a file, or none) "
            "where the simulator is installed."
        ),
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="New log (MCAP).")],
    settings: Settings = None,
    radar_setup: RadarSetup = None,
    rig: Annotated[
        Path | None, typer.Option(help="TOML file: NAME = [x, y, z, qw, qx, qy, qz] of a sensor.")
    ] = None,
    duration: Annotated[
        float, typer.Option(help="Seconds; default: until Ctrl-C.", parser=quantity_of("s"))
    ] = math.inf,
    records: Annotated[int, typer.Option(min=0, help="So many records; 0: no limit.")] = 0,
) -> None:
    """Record the data of sensors. Exit status 1: everything received was recorded, but a log among
    the sources is damaged, or a signal came before the --records or the --duration asked for.
    """
    from hardware.capture import capture as run
    from hardware.interruption import asked_to_end
    from hardware.recording import Log
    from hardware.recording.ending import Ending
    from hardware.recording.mounting import read_mounting

    if not duration > 0:
        raise InputError(f"--duration: {duration:g} s, expected more than 0 s")
    loaded, setup = settings_of(settings), setup_of(radar_setup)
    extrinsics = read_mounting(rig).poses if rig else {}
    tallies: dict[str, Tally] = {}
    begun = time.monotonic()
    endings: dict[str, Ending] = {}
    limits: dict[str, Any] = {"duration_s": duration, "records": records, "endings": endings}
    with asked_to_end() as over:
        log = Log(out, extrinsics=extrinsics)
        try:
            with log:
                for received in run(urls, log, loaded, setup, over=over, **limits):
                    tally = tallies.setdefault(received.topic, Tally(received.topic))
                    tally.add(received.record)
                    say.step(f"{received.topic}: record {tally.count}")
                if not tallies:
                    within = f" within {duration:g} s" if duration < math.inf else ""
                    why = "".join(fault_in_brackets(ending) for ending in endings.values())
                    raise InputError(f"{', '.join(urls)}: no record came{within}{why}")
        finally:
            if over.is_set():
                say.line("stopped")
            took_s = time.monotonic() - begun
            written = {topic: log.flushed.get(topic, 0) for topic in tallies}
            n = sum(tally.count for tally in tallies.values())
            lost = n - sum(written.values())
            beside = f"; {lost} more had come and may not be in it" if lost else ""
            if out.exists():
                say.verdict(f"{out}: {sum(written.values())} records in {took_s:.1f} s{beside}")
            else:
                say.verdict(f"{out}: not written, nothing came in {took_s:.1f} s")
            say.add(
                log=out if out.exists() else None,
                records=written,
                seconds=took_s,
                stopped=over.is_set(),
            )
    for tally in tallies.values():
        for warning in tally.warnings() if not tally.fault else ():
            say.warn(warning)
    if fault := next((tally.fault for tally in tallies.values() if tally.fault), ""):
        raise InputError(f"{out}: {fault}")
    warn_of_damage(say, {log_of(url): ending for url, ending in endings.items()})
    if over.is_set() and n < records:
        end_early(say, f"{n} of {records} records")
    if over.is_set() and not records and took_s < duration < math.inf:
        end_early(say, f"{took_s:.3g} of {duration:g} s")

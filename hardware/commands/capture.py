"""The command ``ugv capture``: the data of sensors into a log."""

import math
import time
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hardware.commands.output import Output, with_output
from hardware.commands.quantities import quantity_of
from hardware.commands.records import (
    RadarSetup,
    Settings,
    end_early,
    flag_counts,
    log_of,
    settings_of,
    setup_of,
    warn_of_damage,
)
from hardware.errors import InputError

if TYPE_CHECKING:
    from hardware.recording.kinds import Record

#: Share of a topic's slots or exposures.
_WORTH_A_WARNING = 0.01
_FAULTS = ("lost", "overrun", "saturated")


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
    from hardware.recording.mounting import read_mounting
    from hardware.recording.reading import Ending

    if not duration > 0:
        raise InputError(f"--duration: {duration:g} s, expected more than 0 s")
    loaded, setup = settings_of(settings), setup_of(radar_setup)
    extrinsics = read_mounting(rig).poses if rig else {}
    n, begun = Counter[str](), time.monotonic()
    flags: dict[str, Counter[str]] = {}
    endings: dict[str, Ending] = {}
    limits: dict[str, Any] = {"duration_s": duration, "records": records, "endings": endings}
    with asked_to_end() as over:
        log = Log(out, extrinsics=extrinsics)
        try:
            with log:
                for received in run(urls, log, loaded, setup, over=over, **limits):
                    n[received.topic] += 1
                    flags.setdefault(received.topic, Counter()).update(_counted(received.record))
                    say.step(f"{received.topic}: record {n[received.topic]}")
                if not n:
                    within = f" within {duration:g} s" if duration < math.inf else ""
                    raise InputError(f"{', '.join(urls)}: no record came{within}")
        finally:
            if over.is_set():
                say.line("stopped")
            took_s = time.monotonic() - begun
            written = {topic: log.flushed.get(topic, 0) for topic in n}
            lost = n.total() - sum(written.values())
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
    unheard = [
        topic for topic, counted in flags.items() if counted["overrun"] == counted["slots"] > 0
    ]
    for topic, counted in flags.items():
        for fault in _faults(counted) if topic not in unheard else ():
            say.warn(f"{topic}: {fault}")
    for topic in unheard:
        raise InputError(
            f"{out}: {topic}: every slot of its {n[topic]} records is overrun, nothing was "
            "heard: the bursts reach the radio after their time. Give the setup more time "
            "(schedule: step_period_s, lead_s), or serve a virtual radio with --pace fast"
        )
    warn_of_damage(say, {log_of(url): ending for url, ending in endings.items()})
    if over.is_set() and n.total() < records:
        end_early(say, f"{n.total()} of {records} records")
    if over.is_set() and not records and took_s < duration < math.inf:
        end_early(say, f"{took_s:.3g} of {duration:g} s")


def _counted(record: "Record") -> dict[str, int]:
    """Slots or exposures of a record, and those with each flag."""
    from hardware.records import RadarRecord

    what = "slots" if isinstance(record, RadarRecord) else "exposures"
    return {what: record.flags.size, **flag_counts(record.flags)}


def _faults(counted: Counter[str]) -> list[str]:
    """What is wrong with a share of the slots or exposures that is worth a warning."""
    what = "slots" if counted["slots"] else "exposures"
    return [
        f"{100 * counted[flag] / counted[what]:.3g} % of its {counted[what]} {what} are {flag}"
        for flag in _FAULTS
        if counted[flag] > _WORTH_A_WARNING * counted[what]
    ]

"""The commands ``ugv replay``, ``info``, ``recover`` and ``export``: what a log holds."""

import math
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from hardware.commands.output import Output, with_output
from hardware.commands.records import (
    DATA_LOST,
    fault_in_brackets,
    flag_counts,
    warn_of_damage,
)
from hardware.errors import InputError


def register(app: typer.Typer) -> None:
    """Add the commands to an application."""
    for command in (replay, info, recover, export):
        app.command()(with_output(command, f"ugv {command.__name__}"))


def replay(
    say: Output,
    path: Annotated[Path, typer.Argument(help="A log.")],
    speed: Annotated[float, typer.Option(help="Times the recorded pace.")] = 1.0,
) -> None:
    """Replay a log at its recorded pace, with one line for each record."""
    from hardware.recording.ending import Ending
    from hardware.sources import replay as play

    first_ns, ending = None, Ending()
    records: list[dict[str, Any]] = []
    for received in play(path, speed=speed, ending=ending):
        first_ns = received.host_ns if first_ns is None else first_ns
        since_s = (received.host_ns - first_ns) * 1e-9
        flags = flag_counts(received.record.flags)
        say.verdict(f"{since_s:10.3f} s  {received.topic}  {_flags_text(flags)}".rstrip())
        if say.json:
            records.append({"topic": received.topic, "time_s": since_s, "flags": flags})
    if first_ns is None:
        raise InputError(f"{path}: no record in it{fault_in_brackets(ending)}")
    say.add(log=path, records=records)
    warn_of_damage(say, {path: ending})


def info(say: Output, path: Annotated[Path, typer.Argument(help="A log.")]) -> None:
    """Print the contents of a log."""
    from hardware.recording.ending import Ending
    from hardware.recording.reading import read_messages, with_records
    from hardware.records import SpiRecord
    from hardware.records.spi import exposures_between

    ending, counts, types = Ending(), Counter[str](), dict[str, str]()
    flags, devices, times = Counter[str](), set[str](), [math.inf, -math.inf]
    missing, last = Counter[str](), dict[str, SpiRecord]()
    for logged, received in with_records(read_messages(path, ending), ending):
        counts[logged.topic] += 1
        types[logged.topic] = logged.schema.name
        times = [min(times[0], logged.message.log_time), max(times[1], logged.message.log_time)]
        if received:
            record = received.record
            flags.update(flag_counts(record.flags))
            devices.add(record.device)
            if isinstance(record, SpiRecord):
                missing[logged.topic] += exposures_between(last.get(logged.topic), record)
                last[logged.topic] = record
    if ending.fault and not counts:
        raise InputError(f"{path}: no whole message in it: {ending.fault}")
    length_s = max(times[1] - times[0], 0) * 1e-9 if counts else 0.0
    say.verdict(f"{path}: {sum(counts.values())} messages over {length_s:.3f} s")
    for topic, n in sorted(counts.items()):
        say.line(f"  {topic}: {n} x {types[topic]}")
    for device in sorted(devices):
        say.line(f"  device: {device}")
    say.line(f"  flags: {_flags_text(flags) or 'none'}")
    for topic, n in sorted(missing.items()):
        if n:
            say.line(f"  missing: {n} exposures of {topic}, between its records")
    if ending.fault and not ending.lost:
        say.verdict(f"  {ending.advice(path)}")
    say.add(
        log=path,
        duration_s=length_s,
        topics=[
            {"topic": topic, "messages": n, "type": types[topic], "missing": missing[topic]}
            for topic, n in sorted(counts.items())
        ],
        devices=sorted(devices),
        flags=flags,
        fault=ending.fault,
    )
    if ending.lost:
        warn_of_damage(say, {path: ending})


def recover(
    say: Output,
    path: Annotated[Path, typer.Argument(help="A log that was cut short.")],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Instead of in its own place.")
    ] = None,
) -> None:
    """Recover a log whose writer was killed, or that is damaged. Exit status 1: data were lost,
    and the original file is kept beside it, or a record in it cannot be read.
    """
    from hardware.recording import recover as run

    result = run(path, out)
    fault = result.ending.fault
    say.verdict(f"{out or path}: {result.kept} messages; {fault or 'nothing was wrong'}")
    say.add(log=out or path, messages=result.kept, fault=fault, original=result.original)
    if result.original:
        say.line(f"as it was: {result.original}")
    if result.ending.lost:
        say.warn(f"{path}: {result.ending.lost}")
    if result.unreadable:
        say.warn(f"{path}: copied as they are: {result.unreadable}")
    if result.ending.lost or result.unreadable:
        raise typer.Exit(DATA_LOST)


def export(
    say: Output,
    path: Annotated[Path, typer.Argument(help="A log.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the SigMF recordings.")],
) -> None:
    """Write the radar records of a log as SigMF: 16-bit I and Q, receivers interleaved as channels.

    Slots follow each other without the pauses between them. A capture begins with each burst and
    carrier step: its frequency, its time where the log tells the device's clock
    (core:datetime), and its sample among all since the record's first, pauses included
    (core:global_index). Annotations name the flags of slots: saturated, overrun. The turns of the
    transmitters are in the description.
    """
    from hardware.recording import read_records
    from hardware.recording.ending import Ending
    from hardware.records import RadarRecord
    from hardware.records.sigmf import export_sigmf

    if out == Path():
        raise InputError("--out: is empty, or the current folder; expected another to write to")
    n, ending = 0, Ending()
    for received in read_records(path, ending):
        if isinstance(received.record, RadarRecord):
            out.mkdir(parents=True, exist_ok=True)
            host_ns = received.clock.host_ns if received.clock else None
            export_sigmf(received.record, out / f"radar-{n:06d}", host_ns)
            n += 1
    if not n:
        raise InputError(f"{path}: no radar record in it{fault_in_brackets(ending)}")
    say.verdict(f"{out}: {n} recordings")
    say.add(recordings=n, folder=out)
    warn_of_damage(say, {path: ending})


def _flags_text(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{n} {name}" for name, n in counts.items())

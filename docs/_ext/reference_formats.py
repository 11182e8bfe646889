"""Pages of file formats: records, logs, tables of a run."""

import csv
import inspect
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from tables import table

from hardware.recording import ros
from hardware.recording.kinds import KINDS
from hardware.records import radar, spi
from hardware.records.container import Layout
from hardware.units import unit_of
from twin.drive.truth import CLOCK, STATES
from twin.schemas import documented

_TITLES = {"ugv-spi-record": "`record.h5`", "ugv-radar-record": "`radar.h5`"}


def formats_page() -> str:
    """Everything that is written to disk."""
    return "".join(
        [
            "# File formats\n\nFiles of a run are listed in its `run.json`. Records are what a "
            "device sends; they hold no truth.\n",
            _layout(spi.LAYOUT, spi.SpiRecord),
            _layout(radar.LAYOUT, radar.RadarRecord),
            _tables(),
            _log(),
        ]
    )


def _layout(layout: Layout, record: type) -> str:
    """A record's file, from the layout that reads and writes it."""
    meanings = documented_with_shapes(record)
    for part in layout.parts.values():
        meanings |= documented_with_shapes(part)
    group = _group_meanings(layout)
    settings = [
        (f"`{name}`", unit_of(name) or "", _since(layout, name), meanings.get(name, ""))
        for name in layout.settings
    ]
    parameters = [
        (f"`{layout.group}/{name}`", unit_of(name) or "", _since(layout, name), group[name])
        for name in layout.parameters
    ]
    arrays = [
        (f"`{name}`", np.dtype(kind).name, _since(layout, name), meaning)
        for name, (kind, meaning) in layout.arrays.items()
    ]
    arrays += [
        (f"`{layout.group}/{name}`", "int64", _since(layout, name), group[name])
        for name in layout.optional
    ]
    arrays += [
        (f"`{layout.group}/{name}`", np.dtype(kind).name, _since(layout, name), group[name])
        for name, kind in layout.group_arrays.items()
    ]
    since = "since version"
    return (
        f"\n## {_TITLES[layout.format]}\n\nHDF5; attribute `format` is `{layout.format}`, "
        f"`schema_version` {layout.version}; files of all versions from 1 are read. Written by "
        f"`hardware.write_{'radar_' if record is radar.RadarRecord else ''}record`, read by "
        f"`hardware.read_{'radar_' if record is radar.RadarRecord else ''}record`.\n\n"
        "Attributes (texts are UTF-8 of fixed length, in older files of variable length, without a "
        "checksum):\n\n"
        + table(("attribute", "unit", since, "meaning"), settings + parameters)
        + "\nData sets:\n\n"
        + table(("data set", "type", since, "meaning"), arrays)
    )


def documented_with_shapes(kind: type) -> dict[str, str]:
    """What a docstring says of fields, where a name may be followed by its shape and type."""
    text = inspect.getdoc(kind) or ""
    found: dict[str, str] = {}
    names: list[str] = []
    for line in text.splitlines():
        if line.startswith("    ") and names:
            for name in names:
                found[name] = f"{found.get(name, '')} {line.strip()}".strip()
        elif line and not line.startswith((" ", "-")):
            head = line.split(" : ")[0]
            names = (
                [n.strip() for n in head.split(",")]
                if head.replace(", ", "").isidentifier()
                else []
            )
    return found


def _group_meanings(layout: Layout) -> dict[str, str]:
    from hardware.patterns import PatternSet
    from hardware.waveform import OfdmWaveform

    kind = PatternSet if layout.group == "patterns" else OfdmWaveform
    own = {
        "digest": "SHA-256 of a user's own patterns or symbols; empty for bundled ones.",
        "packed": "A user's own binary patterns, eight cells a byte.",
        "grey_levels": "A user's own patterns with grey levels.",
        "own_symbols": "A user's own symbols, real and imaginary part.",
    }
    return own | documented_with_shapes(kind)


def _since(layout: Layout, name: str) -> str:
    return str(layout.added.get(name, 1))


def _tables() -> str:
    from twin.radar.truth import TrueTarget

    detections, truth, paths = _written_columns()
    from hardware.radar.detection import Detection

    known: dict[str, str] = {
        "burst": "Number of the burst, from 0; `ugv detect` alone.",
        "target": "True target that the detection is, if any.",
        "further_echo_of": "True target of which this is a further echo, such as a reflection.",
        **documented(Detection),
    }
    for name in known:
        if "_alternatives_" in name:
            known[name] += " Separated by semicolons."
    for name in detections:
        if name.startswith("model_"):
            part = "Standard error" if name.endswith("standard_error") else "Bound of the error"
            quantity = name.removeprefix("model_").rsplit("_standard_error")[0]
            known[name] = f"{part} of the model in `{quantity.rsplit('_systematic')[0]}`."
    via = {
        "via": "Objects on the way, in order.",
        "range_m": "Half the length of the way.",
        "delay_s": "Out and back.",
        "delay_rate": "Change of the delay with time, s/s.",
        "delay_acceleration_per_s": "Change of the delay's rate with time.",
        "gain_db": "Received over sent power.",
        "phase_rad": "Of the contribution.",
    }
    text = "\n## Tables of a run\n\nCSV with a line of names; what is not known is empty.\n"
    for name, columns, meanings in (
        ("`detections.csv`", ["burst", *detections], known),
        ("`truth.csv`", truth, documented(TrueTarget)),
        ("`paths.csv`, with `--paths`", paths, via),
    ):
        text += f"\n### {name}\n\n" + _columns(columns, meanings)
    return text


def _columns(columns: list[str], meanings: Mapping[str, str]) -> str:
    return table(
        ("column", "unit", "meaning"),
        ((f"`{c}`", "rad" if c.endswith("_rad") else _unit(c), meanings[c]) for c in columns),
    )


def _unit(column: str) -> str:
    plain = column.removesuffix("_standard_error").removesuffix("_systematic")
    return "dBm" if plain.endswith("_dbm") else unit_of(plain) or ""


def _written_columns() -> tuple[list[str], list[str], list[str]]:
    """Columns as a run of nothing writes them: the writers themselves say them."""
    from types import SimpleNamespace

    from twin.radar.evaluation import write_detections, write_paths, write_truth_table

    nothing: Any = SimpleNamespace(detections=(), intervals=(), matches=(), further=())
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "table.csv"
        found = []
        for write, content in (
            (write_detections, nothing),
            (write_truth_table, ()),
            (write_paths, ()),
        ):
            write(content, path)  # type: ignore[operator]
            with path.open(newline="") as file:
                found.append(next(csv.reader(file)))
    return found[0], found[1], found[2]


def _log() -> str:
    topics = [
        ("`/spi/record`", KINDS[0].definition.name, "a camera's record, in the rig's frame"),
        ("`/radar/record`", KINDS[1].definition.name, "a radar's record, in its own frame"),
        ("`/spi/image`", ros.IMAGE.name, "`ugv process`: the image, `32FC1`, e- or reflectance"),
        (
            "`/radar/detections`",
            ros.POINTS.name,
            "`ugv process`: a point for each detection: `x`, `y`, `z` in the antenna's frame (m), "
            "then the numbers of a detection under their own names",
        ),
        (
            "`/radar/tracks`",
            ros.POINTS.name,
            "`ugv process --tracks`: a point for each confirmed track, in the world's frame",
        ),
        ("`/tf`, `/tf_static`", ros.TRANSFORMS.name, "where the rig and the sensors are"),
        ("`/spi/camera_info`", ros.CAMERA_INFO.name, "the camera's cells and field, at the start"),
        ("`/truth/objects`", STATES.name, "`twin drive`: all objects, targets and the rig"),
        ("`/truth/camera/albedo`", ros.IMAGE.name, "`twin drive`: reflectance of each cell"),
        ("`/truth/camera/depth`", ros.IMAGE.name, "`twin drive`: m along the boresight"),
        ("`/truth/clock`", CLOCK.name, "`twin drive`: what is complete, and the devices' clocks"),
    ]
    text = (
        "\n## The log\n\n[MCAP](https://mcap.dev) with ROS 2 messages in CDR, each with its "
        "definition, so that `ros2 bag`, Foxglove and `rosbags` read it. Topics of further "
        "sources of one log begin with `/source2`, `/source3`, ...\n\n"
    )
    text += table(("topic", "message", "what it is"), topics)
    for definition in (*(kind.definition for kind in KINDS), STATES, CLOCK):
        text += _message(definition)
    return text


def _message(definition: ros.Definition) -> str:
    body = definition.text.split("=" * 80)[0].strip()
    return f"\n### `{definition.name}`\n\n```text\n{body}\n```\n"

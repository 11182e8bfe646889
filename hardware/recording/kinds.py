"""Records as messages, whose definition is derived from the record's `Layout`."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, get_origin, get_type_hints

import numpy as np

from hardware.drivers.clock import ClockModel
from hardware.errors import InputError
from hardware.patterns import PatternSet
from hardware.recording.cdr import Reader, Writer
from hardware.recording.ros import HEADER_PARTS, Definition, put_header
from hardware.records import radar, spi
from hardware.records.container import Layout
from hardware.waveform import OfdmWaveform

Record = spi.SpiRecord | radar.RadarRecord

_SCALARS = {float: "float64", int: "int64", str: "string", bool: "bool"}


@dataclass(frozen=True)
class RecordKind:
    """A type of record: its layout, its class, and the class that types its group of parameters.

    ``pose_of`` names the frame whose pose it holds: the rig's, or None: the sensor's own.
    """

    name: str
    layout: Layout
    record: type[Any]
    group: type[Any]
    pose_of: str | None = None

    @cached_property
    def scalars(self) -> dict[str, str]:
        """ROS type of each setting and parameter; parameters carry their group's name."""
        layout, grouped, own = self.layout, get_type_hints(self.group), dict[str, Any]()
        for kind in (self.record, *layout.parts.values()):
            own |= get_type_hints(kind)
        types = {name: _SCALARS.get(own[name], "string") for name in layout.settings}
        for name in layout.parameters:
            hint = grouped.get(name, str)
            types[f"{layout.group}_{name}"] = (
                "string" if get_origin(hint) else _SCALARS.get(hint, "string")
            )
        return types

    @cached_property
    def definition(self) -> Definition:
        """Message type: header, clocks, settings, parameters, lists that may be absent, arrays."""
        layout = self.layout
        lines = [
            "std_msgs/Header header",
            "string format",
            "uint32 schema_version",
            "# Device clock = host + offset + drift (host - reference); error: its bound, or NaN.",
            "int64 clock_reference_ns",
            "int64 clock_offset_ns",
            "float64 clock_drift",
            "float64 clock_error_ns",
        ]
        lines += [f"{kind} {name}" for name, kind in self.scalars.items()]
        for name in layout.optional:
            lines += [f"bool has_{layout.group}_{name}", f"int64[] {layout.group}_{name}"]
        for name, dtype in layout.group_arrays.items():
            lines += [f"uint32[] {layout.group}_{name}_shape"]
            lines += [f"{np.dtype(dtype)}[] {layout.group}_{name}"]
        for name, (dtype, meaning) in layout.arrays.items():
            lines += [f"# {meaning}", f"uint32[] {name}_shape", f"{np.dtype(dtype)}[] {name}"]
        return Definition(f"ugv_msgs/msg/{self.name}", "\n".join(lines) + f"\n{HEADER_PARTS}")

    def pack(self, record: Any, stamp_ns: int, frame: str, clock: ClockModel | None) -> bytes:
        """Message of a record."""
        layout, writer = self.layout, Writer()
        put_header(writer, stamp_ns, frame)
        writer.text(layout.format)
        writer.number("uint32", layout.version)
        clock = clock or ClockModel(0, 0, 0.0, math.nan)
        writer.number("int64", clock.reference_ns)
        writer.number("int64", clock.offset_ns)
        writer.number("float64", clock.drift)
        writer.number("float64", clock.error_ns)
        values = [layout.value(record, name) for name in layout.settings]
        values += [layout.parameter(record, name) for name in layout.parameters]
        for kind, value in zip(self.scalars.values(), values, strict=True):
            writer.text(value) if kind == "string" else writer.number(kind, value)
        for name in layout.optional:
            value = layout.parameter(record, name)
            writer.number("bool", value is not None)
            writer.array(np.asarray(value or (), np.int64))
        for name, dtype in layout.group_arrays.items():
            value = layout.parameter(record, name)
            array = np.asarray(() if value is None else value, dtype)
            writer.array(np.asarray(() if value is None else array.shape, np.uint32))
            writer.array(array)
        for name, (dtype, _) in layout.arrays.items():
            array = np.asarray(layout.value(record, name), dtype)
            writer.array(np.asarray(array.shape, np.uint32))
            writer.array(array)
        return writer.message

    def unpack(self, message: bytes) -> tuple[Any, ClockModel | None]:
        """Record of a message, and the clock; one of an older schema version is read without what
        was added since. Raises InputError where it is none.
        """
        layout, reader = self.layout, Reader(message)
        for kind in ("int32", "uint32"):
            reader.number(kind)
        reader.text()
        form, version = reader.text(), int(reader.number("uint32"))
        if form != layout.format or not 1 <= version <= layout.version:
            raise InputError(
                f"{form} of schema version {version}; this software reads {layout.format} "
                f"of versions 1 to {layout.version}"
            )
        clock = ClockModel(
            int(reader.number("int64")),
            int(reader.number("int64")),
            reader.number("float64"),
            reader.number("float64"),
        )
        if not math.isnan(clock.error_ns) and not -1 < clock.drift < math.inf:
            raise InputError(f"clock_drift: {clock.drift:g}: expected a number above -1")
        values = {
            name: reader.text() if kind == "string" else reader.number(kind)
            for name, kind in self.scalars.items()
            if layout.has(name.removeprefix(f"{layout.group}_"), version)
        }
        fields: dict[str, Any] = {n: values[n] for n in layout.settings if n in values}
        group: dict[str, Any] = {
            name: values[f"{layout.group}_{name}"]
            for name in layout.parameters
            if layout.has(name, version)
        }
        for name in layout.optional:
            is_present, values_here = reader.number("bool"), reader.array("int64")
            group[name] = tuple(values_here.tolist()) if is_present else None
        for name, dtype in layout.group_arrays.items():
            if not layout.has(name, version):
                continue
            shape = reader.array("uint32").tolist()
            array = reader.array(str(np.dtype(dtype)))
            group[name] = array.reshape(shape) if shape else None
        for name, (dtype, _) in layout.arrays.items():
            if not layout.has(name, version):
                continue
            shape = reader.array("uint32").tolist()
            fields[name] = reader.array(str(np.dtype(dtype))).reshape(shape)
        made = {layout.group: layout.make_group(**group)}
        record = self.record(**made, **layout.arguments(fields))
        return record, None if math.isnan(clock.error_ns) else clock


KINDS = (
    RecordKind("SpiRecord", spi.LAYOUT, spi.SpiRecord, PatternSet, "rig"),
    RecordKind("RadarRecord", radar.LAYOUT, radar.RadarRecord, OfdmWaveform),
)
BY_NAME = {kind.definition.name: kind for kind in KINDS}


def kind_of(record: Record) -> RecordKind:
    """Kind of a record. Raises TypeError for anything else."""
    for kind in KINDS:
        if isinstance(record, kind.record):
            return kind
    raise TypeError(f"{type(record).__name__} is no record")

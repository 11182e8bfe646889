"""`twin parts`, `systems`, `schema`: what is bundled, and how one's own is written."""

from pathlib import Path
from typing import Annotated

import typer

from hardware.commands.output import Output
from hardware.formatting import setting_text
from hardware.units import unit_of


def parts(
    say: Output,
    name: Annotated[
        str | None, typer.Argument(help="Bundled part or TOML file; none: list them.")
    ] = None,
    plot: Annotated[Path | None, typer.Option(help="PNG of the part's spectral curve.")] = None,
) -> None:
    """List the catalogue's parts, or one part's values with their sources."""
    from twin.system import load_part, part_names

    if name is None:
        loaded = [(known, load_part(known)) for known in part_names()]
        _list(say, "parts", [(part.kind, known, part.description) for known, part in loaded])
        return
    part = load_part(name)
    say.verdict(f"{part.kind} {part.name}: {part.description}")
    for field, value in part.values():
        origin = f"assumed: {value.assumed}" if value.assumed else value.source
        say.line(f"  {field} = {setting_text(field, value.value)}  ({origin})")
    values = [
        {"name": field, "unit": unit_of(field) or "", **value.model_dump(mode="json")}
        for field, value in part.values()
    ]
    say.add(kind=part.kind, name=part.name, description=part.description, values=values)
    if plot is not None:
        from hardware.files import whole_file
        from twin.report.part_figure import plot_part

        with whole_file(plot) as partial:
            plot_part(part).savefig(partial, format="png")
        say.written(plot)


def _list(say: Output, what: str, rows: list[tuple[str, str, str]]) -> None:
    """Entries of the catalogue: kind, name, description."""
    for kind, name, description in rows:
        say.verdict(f"{kind} {name}: {description}")
    say.add(
        **{what: [dict(zip(("kind", "name", "description"), row, strict=True)) for row in rows]}
    )


def schema(
    kind: Annotated[
        str,
        typer.Argument(help="system, radar, part, scene, materials, study or camera (settings)."),
    ] = "system",
) -> None:
    """Print the JSON Schema of a TOML file, for editors that check while one types."""
    import json

    from twin.schemas import file_schema

    print(json.dumps(file_schema(kind), indent=1))


def systems(say: Output) -> None:
    """List the bundled optical systems and radars."""
    from twin.radar.device.design import load_radar, radar_names
    from twin.system import load_system, system_names

    rows = [("system", name, load_system(name).description) for name in system_names()]
    rows += [("radar", name, load_radar(name).description) for name in radar_names()]
    _list(say, "systems", rows)

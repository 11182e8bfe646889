"""`twin parts`, `systems`, `schema`: what is bundled, and how one's own is written."""

from pathlib import Path
from typing import Annotated

import typer

from hardware.formatting import setting_text


def parts(
    name: Annotated[
        str | None, typer.Argument(help="Bundled part or TOML file; none: list them.")
    ] = None,
    plot: Annotated[Path | None, typer.Option(help="PNG of the part's spectral curve.")] = None,
) -> None:
    """List the catalogue's parts, or one part's values with their sources."""
    from twin.system import load_part, part_names

    if name is None:
        for known in part_names():
            part = load_part(known)
            print(f"{part.kind} {known}: {part.description}")
        return
    part = load_part(name)
    print(f"{part.kind} {part.name}: {part.description}")
    for field, value in part.values():
        origin = f"assumed: {value.assumed}" if value.assumed else value.source
        print(f"  {field} = {setting_text(field, value.value)}  ({origin})")
    if plot is not None:
        from twin.report.part_figure import plot_part

        plot_part(part).savefig(plot, format="png")
        print(f"written: {plot}")


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


def systems() -> None:
    """List the bundled optical systems and radars."""
    from twin.radar.device.design import load_radar, radar_names
    from twin.system import load_system, system_names

    for name in system_names():
        print(f"system {name}: {load_system(name).description}")
    for name in radar_names():
        print(f"radar {name}: {load_radar(name).description}")

"""`twin budget`, `safety`, `rcs`: figures of a design, a lamp, a mesh."""

import sys
from pathlib import Path
from typing import Annotated

import typer


def budget(
    system: Annotated[str, typer.Option(help="Bundled system or TOML file.")] = "paper",
    whole_line: Annotated[
        bool, typer.Option("--whole-line", help="All of the emitter's line passes the filter.")
    ] = False,
    before_lens: Annotated[
        bool, typer.Option("--filter-before-lens", help="The filter shifts with field angle.")
    ] = False,
    out: Annotated[Path | None, typer.Option(help="Folder for budget.json and budget.png.")] = None,
) -> None:
    """Re-derive the paper's Table 1 and frame rates in closed form."""
    from rich.console import Console

    from twin.budget import SENSORS, audit, frame_rates, link_of
    from twin.budget.report import print_budget, write_budget
    from twin.files import InputError, whole_folder
    from twin.system import load_part, load_system

    if out is not None and not str(out).strip("."):
        raise InputError("out: is empty, expected a folder to write to")
    design = load_system(system)
    parts = [load_part(name) for name in SENSORS]
    options = {"whole_line": whole_line, "filter_before_lens": before_lens}
    rows = [audit(link_of(design, part, **options), part) for part in parts]
    rates = [rate for part in parts if "paper" not in part.name for rate in frame_rates(part)]
    print_budget(rows, rates, Console(width=None if sys.stdout.isatty() else 150))
    for name, value in design.values():
        if value.assumed and name.split(".")[0] in ("emitter", "filter", "optics", "sky"):
            print(f"assumed: {name} = {value.value}: {value.assumed}")
    if out is not None:
        with whole_folder(out) as folder:
            write_budget(rows, rates, folder)
        print(f"written: {out / 'budget.json'}")


def safety(
    system: Annotated[str, typer.Option(help="Bundled system or TOML file.")] = "workable",
    out: Annotated[Path | None, typer.Option(help="Folder for safety.json.")] = None,
) -> None:
    """Margin to the exposure limits of the eye, beside the same light at 850 nm."""
    from rich.console import Console

    from twin.budget.safety import assumptions, hazards, print_safety, write_safety
    from twin.files import InputError, whole_folder
    from twin.system import load_system

    if out is not None and not str(out).strip("."):
        raise InputError("out: is empty, expected a folder to write to")
    design = load_system(system)
    try:
        rows = hazards(design)
    except ValueError as error:
        raise InputError(f"{system}: emitter.peak_wavelength_m: {error}") from error
    rows += hazards(design, 850e-9)
    print_safety(design, rows, Console(width=None if sys.stdout.isatty() else 150))
    for line in assumptions(design):
        print(f"assumed: {line}")
    if out is not None:
        with whole_folder(out) as folder:
            write_safety(design, rows, folder)
        print(f"written: {out / 'safety.json'}")


def rcs(
    mesh: Annotated[Path, typer.Argument(help="PLY, OBJ, STL or glTF file.")],
    carrier_hz: Annotated[float, typer.Option("--carrier-hz", help="Carrier frequency.")],
    azimuth: Annotated[
        str, typer.Option(help="START:STOP:STEP in deg, ends included; or one number.")
    ],
    elevation: Annotated[float, typer.Option(help="Of the radar above the xy plane, deg.")] = 0.0,
    polarization: Annotated[str, typer.Option(help="V or H; VH, HV: sent, then received.")] = "V",
    distance: Annotated[
        float | None, typer.Option(help="From the mesh's origin, m; default: far field.")
    ] = None,
    edges: Annotated[bool, typer.Option("--edges", help="Add diffraction at sharp edges.")] = False,
    scale: Annotated[float, typer.Option(help="Metres per unit of the mesh.")] = 1.0,
    permittivity: Annotated[
        str | None, typer.Option(help="Relative, such as 5.3-0.4j; default: a conductor.")
    ] = None,
    thickness: Annotated[
        float | None, typer.Option(help="Of a dielectric sheet, m; default: a solid.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="CSV to write, with a PNG beside; default: print it.")
    ] = None,
) -> None:
    """Radar cross-section of a mesh over azimuth, by physical optics."""
    from twin.rcs import Request, csv_lines, run

    result = run(
        Request(
            mesh,
            carrier_hz,
            azimuth,
            elevation,
            polarization,
            distance,
            edges,
            scale,
            permittivity,
            thickness,
        ),
        out,
    )
    for warning in result.warnings:
        print(f"warning: {warning}", file=sys.stderr)
    if out is None:
        print("\n".join(csv_lines(result)))
    else:
        print(f"written: {out}, {out.with_suffix('.png')}")

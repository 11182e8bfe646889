"""`twin budget`, `safety`, `rcs`: figures of a design, a lamp, a mesh."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hardware.commands.output import Output
from hardware.commands.quantities import quantity_of
from twin.commands import console_of

if TYPE_CHECKING:
    from twin.system import System


def budget(
    say: Output,
    system: Annotated[
        str | None, typer.Option(help="Bundled system or TOML file; none: the paper's Table 1.")
    ] = None,
    distances: Annotated[
        str | None, typer.Option(help="Distances of the wall, m, with commas; default 2,5,10.")
    ] = None,
    reflectances: Annotated[
        str | None, typer.Option(help="Reflectances of the wall, with commas; default 0.2,0.5,0.8.")
    ] = None,
    table_1: Annotated[
        bool, typer.Option("--table-1", help="The paper's sensors in place of the system's own.")
    ] = False,
    whole_line: Annotated[
        bool, typer.Option("--whole-line", help="Table 1: all of the line passes the filter.")
    ] = False,
    before_lens: Annotated[
        bool, typer.Option("--filter-before-lens", help="Table 1: the filter shifts with angle.")
    ] = False,
    out: Annotated[Path | None, typer.Option(help="Folder for budget.json and budget.png.")] = None,
) -> None:
    """Signal, noise and SNR of a system in closed form, or the paper's Table 1 and frame rates."""
    from twin.files import InputError, check_out
    from twin.run_folder import check_figures, figures_folder
    from twin.system import load_system

    check_out(out)
    if out is not None:
        check_figures(out, "budget", "budget.png")
    of_table_1 = table_1 or system is None
    if not of_table_1 and (whole_line or before_lens):
        raise InputError("--whole-line, --filter-before-lens: are of the paper's table: --table-1")
    if of_table_1 and (distances, reflectances) != (None, None):
        raise InputError("--distances, --reflectances: the paper's table has none: --system NAME")
    design = load_system(system or "paper")
    if of_table_1:
        write = _table_1(say, design, whole_line=whole_line, filter_before_lens=before_lens)
        concerned = {"emitter", "filter", "optics", "sky"}
    else:
        z = _numbers("distances", distances or "2,5,10", "m")
        rho = _numbers("reflectances", reflectances or "0.2,0.5,0.8", None, most=1.0)
        write = _own_design(say, design, z, rho)
        concerned = {name.split(".")[0] for name, _ in design.values()}
    assumed = [said for name, said in design.assumed() if name.split(".")[0] in concerned]
    say.add(assumed=assumed)
    for said in assumed:
        say.line(f"assumed: {said}")
    if out is not None:
        with figures_folder(out, "budget", "budget.png") as folder:
            write(folder)
        say.written(out / "budget.json")


def _table_1(say: Output, design: "System", **options: bool) -> "Callable[[Path], None]":
    """Print the paper's table with the emitter, filter and lens of a system; how to write it."""
    from twin.budget import SENSORS, audit, frame_rates, link_of
    from twin.budget.report import budget_content, print_budget, write_budget
    from twin.system import load_part

    parts = [load_part(name) for name in SENSORS]
    rows = [audit(link_of(design, part, **options), part) for part in parts]
    rates = [rate for part in parts if "paper" not in part.name for rate in frame_rates(part)]
    say.add(**budget_content(rows, rates))
    print_budget(rows, rates, console_of(say))
    off = [float(share) for row in rows for share in row.residual]
    verdict = f"one read noise a sensor gives times {min(off):+.0%} to {max(off):+.0%} off Table 1"
    say.add(verdict=verdict)
    say.verdict(verdict)
    return lambda folder: write_budget(rows, rates, folder)


def _own_design(
    say: Output, design: "System", distances_m: list[float], reflectances: list[float]
) -> "Callable[[Path], None]":
    """Print a system's own budget; how to write it."""
    from twin.budget.design import left_out, wall_rows
    from twin.budget.report import design_content, design_verdict, print_design, write_design

    rows = wall_rows(design, distances_m, reflectances)
    if note := design.sampling_note:
        say.line(f"note: {note}")
    missing = left_out(design)
    say.add(**design_content(design, rows), left_out=missing, note=design.sampling_note)
    print_design(design, rows, console_of(say))
    if missing:
        say.line(f"left out: {', '.join(missing)}")
    verdict = design_verdict(design, rows)
    say.add(verdict=verdict)
    say.verdict(verdict)
    return lambda folder: write_design(design, rows, folder)


def _numbers(name: str, text: str, unit: str | None, most: float = math.inf) -> list[float]:
    """Positive numbers between commas, each with a unit or in ``unit``. Raises InputError."""
    from hardware.units import quantity
    from twin.files import InputError

    try:
        found = [quantity(word, unit, bare=True) for word in text.split(",")]
    except InputError as error:
        raise InputError(f"{name}: {text!r}: {error}") from None
    if not all(0 < number <= most and math.isfinite(number) for number in found):
        wanted = "positive numbers" if most == math.inf else f"numbers up to {most:g}"
        raise InputError(f"{name}: {text!r}: expected {wanted} with commas between them")
    return found


def safety(
    say: Output,
    system: Annotated[str, typer.Option(help="Bundled system or TOML file.")] = "workable",
    out: Annotated[Path | None, typer.Option(help="Folder for safety.json.")] = None,
) -> None:
    """Margin to the exposure limits of the eye, compared with the same light at 850 nm."""
    from twin.budget.safety import print_safety, safety_content, safety_verdict, write_safety
    from twin.files import InputError, check_out
    from twin.optics.hazards import assumptions, hazards
    from twin.run_folder import check_figures, figures_folder
    from twin.system import load_system

    check_out(out)
    if out is not None:
        check_figures(out, "safety")
    design = load_system(system)
    try:
        rows = hazards(design)
    except InputError as error:
        raise InputError(f"{system}: emitter.peak_wavelength_m: {error}") from error
    rows += hazards(design, 850e-9)
    say.add(verdict=safety_verdict(rows), **safety_content(design, rows))
    print_safety(design, rows, console_of(say))
    for line in assumptions(design):
        say.line(f"assumed: {line}")
    say.verdict(f"{design.name}: {safety_verdict(rows)}")
    if out is not None:
        with figures_folder(out, "safety") as folder:
            write_safety(design, rows, folder)
        say.written(out / "safety.json")


def rcs(
    say: Output,
    mesh: Annotated[Path, typer.Argument(help="PLY, OBJ, STL or glTF file.")],
    *,
    carrier_hz: Annotated[
        float,
        typer.Option("--carrier-hz", help="Carrier frequency, Hz.", parser=quantity_of("Hz")),
    ],
    azimuth: Annotated[
        str, typer.Option(help="START:STOP:STEP in deg, ends included; or one number.")
    ],
    elevation: Annotated[
        float,
        typer.Option(help="Of the radar above the xy plane, deg.", parser=quantity_of("deg")),
    ] = 0.0,
    polarization: Annotated[str, typer.Option(help="V or H; VH, HV: sent, then received.")] = "V",
    distance: Annotated[
        float | None,
        typer.Option(
            help="From the mesh's origin, m; default: far field.", parser=quantity_of("m")
        ),
    ] = None,
    edges: Annotated[bool, typer.Option("--edges", help="Add diffraction at sharp edges.")] = False,
    scale: Annotated[float, typer.Option(help="Metres per unit of the mesh.")] = 1.0,
    permittivity: Annotated[
        str | None,
        typer.Option(help="Relative, such as 5.3-0.4j, from 1 on; default: a conductor."),
    ] = None,
    thickness: Annotated[
        float | None,
        typer.Option(help="Of a dielectric sheet, m; default: a solid.", parser=quantity_of("m")),
    ] = None,
    tolerance: Annotated[
        float | None,
        typer.Option(
            help="Estimated error of the echo, 0.001 to 1 of it; default: 0.005.",
            parser=quantity_of(None),
        ),
    ] = None,
    up: Annotated[
        str | None, typer.Option(help="The mesh's up axis, y or z; default y for glTF, else z.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="CSV to write, with a PNG beside; default: print it.")
    ] = None,
) -> None:
    """Radar cross-section of a mesh over azimuth, by physical optics.

    Facets count by exact integrals, divided to the tolerance where shadows end on them or the radar
    is near; what they light of each other by rays that are as close as the tolerance asks for.
    """
    from twin.rcs import COLUMNS, Request, csv_lines, rows, run
    from twin.scene.importing import upright

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
            tolerance,
            up,
        ),
        out,
    )
    for warning in result.warnings:
        say.warn(warning)
    axis = upright(mesh, up)[0]
    if axis == "y":  # not on stdout, where the table may be
        say.warn("y is up: the mesh's +y became z and its +z became x; --up z leaves it")
    say.add(up=axis, rows=[dict(zip(COLUMNS, row, strict=True)) for row in rows(result)])
    if out is None:
        say.verdict("\n".join(csv_lines(result)))
    else:
        say.written(out)
        say.written(out.with_suffix(".png"))

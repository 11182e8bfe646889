"""The commands ``ugv detect`` and ``ugv image``: detections and images from a radar's record."""

import sys
from pathlib import Path
from typing import Annotated

import typer

Record = Annotated[Path, typer.Argument(help="Record of a radar (HDF5).")]


def register(app: typer.Typer) -> None:
    """Add the radar's commands."""
    app.command()(detect)
    app.command()(image)


def detect(
    record: Record,
    false_alarm: Annotated[float, typer.Option(help="Probability per cell.")] = 1e-8,
    cfar: Annotated[str, typer.Option(help="ca, go or os.")] = "ca",
    window: Annotated[str, typer.Option(help="SciPy's name of a window.")] = "blackmanharris",
    resolve: Annotated[bool, typer.Option(help="Split targets nearer than a cell.")] = False,
    moving_only: Annotated[bool, typer.Option(help="Leave out what stands still.")] = False,
    out: Annotated[
        Path | None, typer.Option(help="CSV to write; default RECORD-detections.csv.")
    ] = None,
    png: Annotated[
        Path | None, typer.Option(help="PNG of the first range-Doppler map to write.")
    ] = None,
) -> None:
    """Detect targets: range, rate, angle, cross-section, each with its standard error."""
    from hardware.radar.cfar import Cfar
    from hardware.radar.pictures import rows_of, write_detections, write_png
    from hardware.radar.process import Processing, frames
    from hardware.records import read_radar_record

    how = Processing(
        window=window,
        cfar=Cfar(false_alarm, cfar),  # type: ignore[arg-type]
        resolve=resolve,
        moving_only=moving_only,
    )
    found = []
    for frame in frames(read_radar_record(record), how):
        _warn(record, frame.warnings)
        print(f"{record}: burst {frame.burst}: {len(frame.detections)} detections")
        for line in rows_of(frame.detections) if frame.detections else ():
            print(line)
        if png and frame.burst == 0:
            write_png(png, frame.image.power_w)
            print(f"written: {png} (range downwards, rate to the right)")
        found += [(frame.burst, detection) for detection in frame.detections]
    target = out or record.with_name(f"{record.stem}-detections.csv")
    write_detections(target, found)
    print(f"written: {target}")


def image(
    record: Record,
    near: Annotated[float, typer.Option(help="Nearest down-range, m.")] = 0.5,
    far: Annotated[float, typer.Option(help="Farthest down-range, m.")] = 2.5,
    width: Annotated[float, typer.Option(help="Cross-range from edge to edge, m.")] = 2.0,
    cells: Annotated[int, typer.Option(help="Cells along each side.")] = 200,
    wall: Annotated[
        tuple[float, float, float] | None,
        typer.Option(help="Focus through a wall: distance, thickness (m), permittivity."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="CSV to write; default RECORD-image.csv.")
    ] = None,
    png: Annotated[Path | None, typer.Option(help="PNG to write.")] = None,
) -> None:
    """Image a scene from bursts along a track, by back-projection."""
    import numpy as np

    from hardware.radar.imaging import Wall
    from hardware.radar.imaging import image as focus
    from hardware.radar.pictures import write_image, write_png
    from hardware.records import read_radar_record

    if cells < 1 or not near < far or not width > 0:
        raise ValueError(f"image: {cells} cells from {near:g} to {far:g} m, {width:g} m wide")
    focused = focus(
        read_radar_record(record),
        np.linspace(near, far, cells),
        np.linspace(-width / 2, width / 2, cells),
        wall=Wall(*wall) if wall else None,
    )
    _warn(record, focused.warnings)
    power = np.abs(focused.value) ** 2
    down, cross = np.unravel_index(np.argmax(power), power.shape)
    print(
        f"{record}: {focused.n_bursts} bursts; resolution {focused.down_resolution_m:.3g} m "
        f"down-range (Eq. 7), {focused.cross_resolution_m:.3g} m cross-range (Eq. 6)"
    )
    print(
        f"peak {10 * np.log10(1e3 * power.max()) if power.any() else -np.inf:.1f} dBm at "
        f"{focused.down_range_m[down]:.3f} m, {focused.cross_range_m[cross]:+.3f} m to the left"
    )
    target = out or record.with_name(f"{record.stem}-image.csv")
    write_image(target, focused)
    print(f"written: {target}")
    if png:
        # As seen from above: far on top, left on the left.
        write_png(png, power[::-1, ::-1], span_db=25.0)
        print(f"written: {png}")


def _warn(record: Path, warnings: tuple[str, ...]) -> None:
    for warning in warnings:
        print(f"warning: {record}: {warning}", file=sys.stderr)

"""The commands ``ugv reconstruct`` and ``ugv methods``: images from a camera's record."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hardware.commands.output import Output, result_file, with_output
from hardware.errors import InputError
from hardware.formatting import counted, number, quantity_text, si

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from hardware.reconstruction import Mixing, RangeImage, Reconstruction
    from hardware.records import SpiRecord

    Array = NDArray[np.floating]

#: Chance from which on a cell's distance counts as known.
_SURE = 0.95


def register(app: typer.Typer) -> None:
    """Add the camera's commands."""
    for command in (reconstruct, methods):
        app.command()(with_output(command, f"ugv {command.__name__}"))


def reconstruct(
    say: Output,
    record: Annotated[Path, typer.Argument(help="Record of a single-pixel camera (HDF5).")],
    method: Annotated[str, typer.Option(help="See `ugv methods`; or file.py:function.")] = "lmmse",
    mixing: Annotated[
        Path | None,
        typer.Option(help="NumPy file (n_emitters, rows, columns): light of each emitter."),
    ] = None,
    motion: Annotated[
        str | None,
        typer.Option(
            help="How the image moves within the frame: `estimate`, DOWN,RIGHT in cells/s, or a "
            "file: CSV of time_s, down_cells, right_cells; TOML: background_cells_per_s and "
            "[[object]] tables of box_cells (top, left, bottom, right) and cells_per_s; NumPy: "
            "velocities (rows, columns, 2) in cells/s, or a homography's rate (3, 3)."
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="NumPy archive to write; default RECORD-METHOD.npz.")
    ] = None,
    png: Annotated[
        Path | None,
        typer.Option(help="PNG to write: images side by side, square root of the light."),
    ] = None,
) -> None:
    """Reconstruct the image of a record, and distances where it has phase shutters or gates."""
    import time

    import numpy as np

    from hardware import read_record
    from hardware import reconstruct as to_image
    from hardware.commands.motions import motion_of
    from hardware.files import whole_file
    from hardware.png import write_picture
    from hardware.reconstruction import method_of, range_image
    from hardware.records.state import ALWAYS_OPEN
    from hardware.words_of_motion import motion_in_words

    solve, loaded = method_of(method), read_record(record)
    try:
        n_received = loaded.received.patterns.count
    except InputError as fault:
        raise InputError(f"{record}: {fault}") from fault
    target = result_file(record, f"-{solve.name}.npz", out, png)
    moved = motion_of(motion) if motion is not None else None
    start = time.perf_counter()
    say.step(f"read {record}")
    calibrated = _mixing(mixing) if mixing else None
    reconstruction = to_image(loaded, solve, mixing=calibrated, motion=moved)
    if moved and any(shutter != ALWAYS_OPEN for shutter in loaded.shutters):
        raise InputError(f"{record}: distances of what moves are not reconstructed: leave --motion")
    timed = any(shutter != ALWAYS_OPEN for shutter in loaded.shutters)
    ranges = range_image(loaded, solve, mixing=calibrated) if timed else None
    elapsed = time.perf_counter() - start
    say.step(f"reconstructed by {solve.name}")
    for warning in dict.fromkeys((*reconstruction.warnings, *(ranges.warnings if ranges else ()))):
        say.warn(f"{record}: {warning}")
    detectors, rows, columns = reconstruction.image.shape
    patterns, low, high = loaded.patterns, *_extremes(reconstruction.image)
    say.line(
        f"{record}: {n_received} of {patterns.n_cells} patterns "
        f"({patterns.order}, {patterns.mode}), {counted(detectors, 'image')} of "
        f"{rows} x {columns}"
    )
    say.verdict(f"{solve.name}: {si(elapsed, 's')}; cells {number(low)} to {number(high)} e-")
    say.line(f"noise of one measurement: {_noise(reconstruction)}")
    if motion:
        say.line(f"motion within the frame: {motion_in_words(reconstruction.motion)}")
    if reconstruction.standard_error is not None:
        errors = reconstruction.standard_error, reconstruction.errors_in_95
        say.line(f"standard error of a cell: {_standard_error(*errors)}")
    if ranges:
        say.line(_distances(loaded, ranges))
    say.add(
        record=record,
        method=solve.name,
        seconds=elapsed,
        shape=reconstruction.image.shape,
        patterns=n_received,
        figures=[
            dict(zip(("name", "unit", "value"), each, strict=True))
            for each in _figures(reconstruction, ranges)
        ],
    )
    with whole_file(target) as partial, partial.open("wb") as file:
        np.savez(file, **_arrays(reconstruction, ranges))  # type: ignore[arg-type]
    say.written(target)
    if png:
        write_picture(png, reconstruction.picture)
        say.written(png)


def _figures(
    reconstruction: "Reconstruction", ranges: "RangeImage | None"
) -> list[tuple[str, str, float]]:
    """Names, units and values."""
    low, high = _extremes(reconstruction.image)
    figures = [
        ("least cell", "e-", low),
        ("greatest cell", "e-", high),
        ("noise of one measurement, median", "e-", _median(reconstruction.noise_electrons)),
    ]
    if reconstruction.standard_error is not None:
        typical = _median(reconstruction.standard_error)
        figures.append(("standard error of a cell, median", "e-", typical))
    return figures + (_distance_figures(ranges) if ranges else [])


def _arrays(reconstruction: "Reconstruction", ranges: "RangeImage | None") -> "dict[str, Array]":
    """As the archive names them."""
    import numpy as np

    arrays: dict[str, Array] = {
        "image": reconstruction.image,
        "noise_electrons": reconstruction.noise_electrons,
    }
    if reconstruction.standard_error is not None:
        arrays["standard_error"] = reconstruction.standard_error
        arrays["errors_in_95"] = np.array(reconstruction.errors_in_95)
    if ranges:
        arrays |= {
            "amplitude": ranges.amplitude,
            "distance_m": ranges.distance_m,
            "distance_standard_error_m": ranges.standard_error_m,
            "distance_confidence": ranges.confidence,
        }
    return arrays


def _standard_error(errors: "Array", errors_in_95: float) -> str:
    """Of a cell, in words."""
    typical = _median(errors)
    if not math.isfinite(typical):
        return "unknown"
    within = f"about 95 % lie within {number(errors_in_95)} of them"
    return f"{number(typical)} e- (median); {within}"


def _extremes(image: "Array") -> tuple[float, float]:
    import numpy as np

    return float(np.nanmin(image)), float(np.nanmax(image))


def _median(values: "Array") -> float:
    """Of what is known; NaN where nothing is."""
    import numpy as np

    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else float("nan")


def _distance_figures(ranges: "RangeImage") -> list[tuple[str, str, float]]:
    """Of the cells surer than 95 %."""
    import numpy as np

    sure = ranges.confidence > _SURE
    low, high = np.percentile(ranges.distance_m[sure], [5, 95]) if sure.any() else (np.nan, np.nan)
    return [
        ("share of cells surer than 95 %", "", float(sure.mean())),
        ("distance, 5 % of these are nearer", "m", float(low)),
        ("distance, 5 % of these are farther", "m", float(high)),
    ]


def _noise(reconstruction: "Reconstruction") -> str:
    import numpy as np

    if np.isfinite(known := _median(reconstruction.noise_electrons)):
        return f"{number(known)} e- (median)"
    most = float(np.median(reconstruction.most_noise_electrons))
    bound = f", at most {number(most)} e- (median)" if np.isfinite(most) else ""
    return f"not told by this record{bound}"


def methods(say: Output) -> None:
    """List the reconstruction methods."""
    from hardware.reconstruction import METHODS, load_plugins

    load_plugins()
    known = sorted(METHODS.items())
    for name, method in known:
        say.verdict(f"{name}: {method.summary}")
    say.add(methods=[{"name": name, "summary": method.summary} for name, method in known])


def _distances(record: "SpiRecord", ranges: "RangeImage") -> str:
    """One line: method of the distance measurement, and distances of cells above 95 %."""
    import numpy as np

    hz = np.unique([shutter.modulation_hz for shutter in record.shutters])
    how = (
        f"phases at {', '.join(quantity_text(float(f), 'Hz', 6) for f in hz)}"
        if hz.any()
        else "gates"
    )
    head = f"{len(record.shutters)} {how}, distances up to {si(ranges.longest_m, 'm', 4)}"
    sure = ranges.confidence > _SURE
    if not sure.any():
        return f"{head}: none surer than 95 %"
    low, high = np.percentile(ranges.distance_m[sure], [5, 95])
    return (
        f"{head}: {si(low, 'm', 4)} to {si(high, 'm', 4)} (5 to 95 % of the "
        f"{np.count_nonzero(sure)} of {sure.size} cells surer than 95 %), amplitude "
        f"{number(float(np.median(ranges.amplitude[sure])))} e- (median)"
    )


def _mixing(path: Path) -> "Mixing":
    import numpy as np

    from hardware.files import read_array
    from hardware.reconstruction import Mixing

    matrix = read_array(path)
    if matrix.ndim != 3 or matrix.dtype.kind not in "fiu":
        raise InputError(
            f"{path}: {matrix.dtype} of shape {matrix.shape}, expected numbers of (n_emitters, "
            "rows, columns)"
        )
    return Mixing(matrix.reshape(len(matrix), -1).astype(np.float64), *matrix.shape[1:])

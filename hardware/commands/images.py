"""The commands ``ugv reconstruct`` and ``ugv methods``: images from a camera's record."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hardware.errors import InputError
from hardware.formatting import number, quantity_text, si

if TYPE_CHECKING:
    from hardware.reconstruction import Mixing, RangeImage, Reconstruction
    from hardware.records import SpiRecord


def register(app: typer.Typer) -> None:
    """Add the camera's commands."""
    app.command()(reconstruct)
    app.command()(methods)


def reconstruct(
    record: Annotated[Path, typer.Argument(help="Record of a single-pixel camera (HDF5).")],
    method: Annotated[str, typer.Option(help="See `ugv methods`; or file.py:function.")] = "lmmse",
    mixing: Annotated[
        Path | None,
        typer.Option(help="NumPy file (n_emitters, rows, columns): light of each emitter."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="NumPy archive to write; default RECORD-METHOD.npz.")
    ] = None,
) -> None:
    """Reconstruct the image of a record, and distances where it has phase shutters or gates."""
    import time

    import numpy as np

    from hardware import read_record
    from hardware import reconstruct as to_image
    from hardware.reconstruction import method_of, range_image
    from hardware.records.state import ALWAYS_OPEN

    solve, loaded = method_of(method), read_record(record)
    start = time.perf_counter()
    calibrated = _mixing(mixing) if mixing else None
    reconstruction = to_image(loaded, solve, mixing=calibrated)
    timed = any(shutter != ALWAYS_OPEN for shutter in loaded.shutters)
    ranges = range_image(loaded, solve, mixing=calibrated) if timed else None
    elapsed = time.perf_counter() - start
    for warning in dict.fromkeys((*reconstruction.warnings, *(ranges.warnings if ranges else ()))):
        print(f"warning: {record}: {warning}", file=sys.stderr)
    detectors, rows, columns = reconstruction.image.shape
    patterns = loaded.patterns
    print(
        f"{record}: {loaded.received.patterns.count} of {patterns.n_cells} patterns "
        f"({patterns.order}, {patterns.mode}), {detectors} image{'s' if detectors > 1 else ''} of "
        f"{rows} x {columns}"
    )
    print(
        f"{solve.name}: {si(elapsed, 's')}; cells {number(np.nanmin(reconstruction.image))} to "
        f"{number(np.nanmax(reconstruction.image))} e-"
    )
    print(f"noise of one measurement: {_noise(reconstruction)}")
    arrays = {"image": reconstruction.image, "noise_electrons": reconstruction.noise_electrons}
    if reconstruction.standard_error is not None:
        known = reconstruction.standard_error[np.isfinite(reconstruction.standard_error)]
        error = f"{number(float(np.median(known)))} e- (median)" if known.size else "unknown"
        within = f"95 % lie within {number(reconstruction.errors_in_95)} of them"
        print(f"standard error of a cell: {error}; {within}")
        arrays["standard_error"] = reconstruction.standard_error
        arrays["errors_in_95"] = np.array(reconstruction.errors_in_95)
    if ranges:
        print(_distances(loaded, ranges))
        arrays |= {
            "amplitude": ranges.amplitude,
            "distance_m": ranges.distance_m,
            "distance_standard_error_m": ranges.standard_error_m,
            "distance_confidence": ranges.confidence,
        }
    target = out or record.with_name(f"{record.stem}-{solve.name}.npz")
    with target.open("wb") as file:
        np.savez(file, **arrays)  # type: ignore[arg-type]
    print(f"written: {target}")


def _noise(reconstruction: "Reconstruction") -> str:
    import numpy as np

    is_known = np.isfinite(reconstruction.noise_electrons)
    if is_known.any():
        return f"{number(float(np.median(reconstruction.noise_electrons[is_known])))} e- (median)"
    most = float(np.median(reconstruction.most_noise_electrons))
    bound = f", at most {number(most)} e- (median)" if np.isfinite(most) else ""
    return f"not told by this record{bound}"


def methods() -> None:
    """List the reconstruction methods."""
    from hardware.reconstruction import METHODS, load_plugins

    load_plugins()
    for name, method in sorted(METHODS.items()):
        print(f"{name}: {method.summary}")


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
    sure = ranges.confidence > 0.95
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

    from hardware.reconstruction import Mixing

    try:
        # Memory-mapped: a truncated file is refused before memory is allocated.
        matrix = np.load(path, mmap_mode="r")
    except (ValueError, EOFError) as error:
        raise InputError(f"{path}: {error}") from error
    if not isinstance(matrix, np.ndarray) or matrix.ndim != 3 or matrix.dtype.kind not in "fiu":
        shape = getattr(matrix, "shape", "of an archive")
        raise InputError(f"{path}: shape {shape}, expected numbers of (n_emitters, rows, columns)")
    return Mixing(matrix.reshape(len(matrix), -1).astype(np.float64), *matrix.shape[1:])

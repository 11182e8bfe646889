"""The commands ``ugv reconstruct`` and ``ugv methods``: images from a camera's record."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hardware.errors import InputError

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
        typer.Option(help="NumPy file (n_emitters, rows, columns): what each emitter lights."),
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
    found = to_image(loaded, solve, mixing=calibrated)
    timed = any(shutter != ALWAYS_OPEN for shutter in loaded.shutters)
    ranged = range_image(loaded, solve, mixing=calibrated) if timed else None
    elapsed = time.perf_counter() - start
    for warning in dict.fromkeys((*found.warnings, *(ranged.warnings if ranged else ()))):
        print(f"warning: {record}: {warning}", file=sys.stderr)
    detectors, rows, columns = found.image.shape
    patterns = loaded.patterns
    print(
        f"{record}: {loaded.received.patterns.count} of {patterns.n_cells} patterns "
        f"({patterns.order}, {patterns.mode}), {detectors} image{'s' if detectors > 1 else ''} of "
        f"{rows} x {columns}"
    )
    print(
        f"{solve.name}: {1e3 * elapsed:.3g} ms; cells {np.nanmin(found.image):.3g} to "
        f"{np.nanmax(found.image):.3g} e-"
    )
    print(f"noise of one measurement: {_noise(found)}")
    arrays = {"image": found.image, "noise_electrons": found.noise_electrons}
    if found.standard_error is not None:
        known = found.standard_error[np.isfinite(found.standard_error)]
        error = f"{float(np.median(known)):.3g} e- (median)" if known.size else "unknown"
        print(
            f"standard error of a cell: {error}; 95 % lie within {found.errors_in_95:.3g} of them"
        )
        arrays["standard_error"] = found.standard_error
        arrays["errors_in_95"] = np.array(found.errors_in_95)
    if ranged:
        print(_distances(loaded, ranged))
        arrays |= {
            "amplitude": ranged.amplitude,
            "distance_m": ranged.distance_m,
            "distance_standard_error_m": ranged.standard_error_m,
            "distance_confidence": ranged.confidence,
        }
    target = out or record.with_name(f"{record.stem}-{solve.name}.npz")
    with target.open("wb") as file:
        np.savez(file, **arrays)  # type: ignore[arg-type]
    print(f"written: {target}")


def _noise(found: "Reconstruction") -> str:
    import numpy as np

    told = np.isfinite(found.noise_electrons)
    if told.any():
        return f"{float(np.median(found.noise_electrons[told])):.3g} e- (median)"
    most = float(np.median(found.most_noise_electrons))
    bound = f", at most {most:.3g} e- (median)" if np.isfinite(most) else ""
    return f"not told by this record{bound}"


def methods() -> None:
    """List the reconstruction methods."""
    from hardware.reconstruction import METHODS, load_plugins

    load_plugins()
    for name, found in sorted(METHODS.items()):
        print(f"{name}: {found.summary}")


def _distances(record: "SpiRecord", found: "RangeImage") -> str:
    """One line: how distance was measured, and what came out where it is sure."""
    import numpy as np

    hz = np.unique([shutter.modulation_hz for shutter in record.shutters])
    how = f"phases at {', '.join(f'{f / 1e6:g}' for f in hz)} MHz" if hz.any() else "gates"
    head = f"{len(record.shutters)} {how}, distances up to {found.longest_m:.4g} m"
    sure = found.confidence > 0.95
    if not sure.any():
        return f"{head}: none surer than 95 %"
    low, high = np.percentile(found.distance_m[sure], [5, 95])
    return (
        f"{head}: {low:.4g} to {high:.4g} m (5 to 95 % of the {np.count_nonzero(sure)} of "
        f"{sure.size} cells surer than 95 %), amplitude {np.median(found.amplitude[sure]):.3g} e- "
        "(median)"
    )


def _mixing(path: Path) -> "Mixing":
    import numpy as np

    from hardware.reconstruction import Mixing

    try:
        # Mapped: a file that promises more than it holds is refused before memory is taken.
        matrix = np.load(path, mmap_mode="r")
    except (ValueError, EOFError) as error:
        raise InputError(f"{path}: {error}") from error
    if not isinstance(matrix, np.ndarray) or matrix.ndim != 3 or matrix.dtype.kind not in "fiu":
        shape = getattr(matrix, "shape", "of an archive")
        raise InputError(f"{path}: shape {shape}, expected numbers of (n_emitters, rows, columns)")
    return Mixing(matrix.reshape(len(matrix), -1).astype(np.float64), *matrix.shape[1:])

"""The command ``ugv``: what the vehicle does with its records. Errors are one line, exit code 2."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hardware import cli_log

if TYPE_CHECKING:
    from hardware.reconstruction import Mixing

app = typer.Typer(
    name="ugv",
    help="Records from sensors, images and detections from records.",
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)

cli_log.register(app)


@app.callback()
def _ugv() -> None:
    """Records from sensors, images and detections from records."""


@app.command()
def reconstruct(
    record: Annotated[Path, typer.Argument(help="Record of a single-pixel camera (HDF5).")],
    method: Annotated[str, typer.Option(help="See `ugv methods`.")] = "lmmse",
    mixing: Annotated[
        Path | None,
        typer.Option(help="NumPy file (n_emitters, rows, columns): what each emitter lights."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="NumPy archive to write; default RECORD-METHOD.npz.")
    ] = None,
) -> None:
    """Reconstruct the image of a record."""
    import time

    import numpy as np

    from hardware import read_record
    from hardware import reconstruct as to_image

    loaded = read_record(record)
    start = time.perf_counter()
    found = to_image(loaded, method, mixing=_mixing(mixing) if mixing else None)
    elapsed = time.perf_counter() - start
    for warning in found.warnings:
        print(f"warning: {record}: {warning}", file=sys.stderr)
    detectors, rows, columns = found.image.shape
    patterns = loaded.patterns
    print(
        f"{record}: {patterns.count} of {patterns.n_cells} patterns ({patterns.order}, "
        f"{patterns.mode}), {detectors} image{'s' if detectors > 1 else ''} of "
        f"{rows} x {columns}"
    )
    print(
        f"{method}: {1e3 * elapsed:.3g} ms; cells {found.image.min():.3g} to "
        f"{found.image.max():.3g} e-"
    )
    print(f"noise of one measurement: {float(np.median(found.noise_electrons)):.3g} e- (median)")
    arrays = {"image": found.image, "noise_electrons": found.noise_electrons}
    if found.standard_error is not None:
        print(f"standard error of a cell: {float(np.median(found.standard_error)):.3g} e- (median)")
        arrays["standard_error"] = found.standard_error
    target = out or record.with_name(f"{record.stem}-{method}.npz")
    with target.open("wb") as file:
        np.savez(file, **arrays)  # type: ignore[arg-type]
    print(f"written: {target}")


@app.command()
def methods() -> None:
    """List the reconstruction methods."""
    from hardware.reconstruction import METHODS, load_plugins

    load_plugins()
    for name, found in sorted(METHODS.items()):
        print(f"{name}: {found.summary}")


def _mixing(path: Path) -> "Mixing":
    import numpy as np

    from hardware.reconstruction import Mixing

    try:
        matrix = np.load(path)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
    if matrix.ndim != 3:
        raise ValueError(f"{path}: shape {matrix.shape}, expected (n_emitters, rows, columns)")
    return Mixing(matrix.reshape(len(matrix), -1).astype(np.float64), *matrix.shape[1:])


def main() -> None:
    """Entry point: run a command, turn expected errors into one line and exit code 2."""
    try:
        sys.exit(app(sys.argv[1:] or ["--help"], standalone_mode=False))
    except (OSError, ValueError) as error:
        message = str(error)
    except Exception as error:
        if not hasattr(error, "format_message"):  # how usage errors are told from faults
            raise
        message = error.format_message()
    except KeyboardInterrupt:
        print("ugv: interrupted", file=sys.stderr)
        sys.exit(130)
    print(f"ugv: error: {' '.join(message.split())}", file=sys.stderr)
    sys.exit(2)

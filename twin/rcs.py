"""``twin rcs``: the cross-section of a mesh file over azimuth, as a table and as plots."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hardware.units import quantity
from twin.files import InputError, whole_folder
from twin.progress import Stages
from twin.scene.importing import upright

if TYPE_CHECKING:
    from twin.radar.cross_section import Sweep
    from twin.radar.scattering import LayeredSurface, MeshTarget

Array = NDArray[np.float64]

_MOST_ANGLES = 100_000
_POLARIZATIONS = ("V", "H", "VH", "HV")
_HIGHEST_HZ = 1e13  # beyond, no mesh is smooth


@dataclass(frozen=True)
class Request:
    """What to compute, as the user wrote it.

    ``polarization`` names what is sent, and what is received where that differs. ``permittivity``
    and ``thickness_m`` make the mesh of a dielectric: a sheet, or without a thickness a solid that
    lets nothing through. ``up`` is the mesh's up axis, y or z, as of `import_model`. ``tolerance``
    is that of `twin.radar.cross_section.Quality`, None its own.
    Raises InputError naming the option that is wrong.
    """

    mesh: Path
    carrier_hz: float
    azimuth: str
    elevation_deg: float = 0.0
    polarization: str = "V"
    distance_m: float | None = None
    edges: bool = False
    scale: float = 1.0
    permittivity: str | None = None
    thickness_m: float | None = None
    tolerance: float | None = None
    up: str | None = None

    def __post_init__(self) -> None:
        upright(self.mesh, self.up)
        _within("carrier-hz", self.carrier_hz, 0, _HIGHEST_HZ, "Hz")
        _within("scale", self.scale, 0, np.inf, "metres per unit")
        if self.distance_m is not None:
            _within("distance", self.distance_m, 0, np.inf, "m")
        if self.tolerance is not None and not 1e-3 <= self.tolerance <= 1:
            raise InputError(f"tolerance: {self.tolerance}: expected 0.001 to 1")
        if not -90 <= self.elevation_deg <= 90:
            raise InputError(f"elevation: {self.elevation_deg}: expected -90 to 90 deg")
        if self.polarization not in _POLARIZATIONS:
            raise InputError(
                f"polarization: {self.polarization!r}: expected {', '.join(_POLARIZATIONS)}"
            )


def run(request: Request, out: Path | None = None) -> "Sweep":
    """Compute, and write ``out`` with its plot beside it; both appear whole or not at all.

    Raises InputError before any work on what can't be used.
    """
    azimuths = parse_range(request.azimuth, "azimuth")
    surface = _surface(request)
    if out is None:
        return _compute(_load(request, surface), request, azimuths)
    if out.suffix.lower() != ".csv":
        raise InputError(f"out: {str(out)!r}: expected a file that ends in .csv")
    target = _load(request, surface)
    with whole_folder(out.absolute().parent) as folder:
        result = _compute(target, request, azimuths)
        (folder / out.name).write_text("\n".join(csv_lines(result)) + "\n")
        _plot(request, result, folder / out.with_suffix(".png").name)
    return result


def parse_range(text: str, name: str) -> Array:
    """``START:STOP:STEP`` in deg, both ends included, or one number; each may say its unit.

    Raises InputError naming the option.
    """
    wanted = f"{name}: {text!r}: expected START:STOP:STEP in deg, or one number"
    try:
        numbers = [quantity(part, "deg", bare=True) for part in text.split(":")]
    except InputError as error:
        raise InputError(wanted) from error
    if len(numbers) not in (1, 3):
        raise InputError(wanted)
    if len(numbers) == 1:
        return np.array(numbers, dtype=np.float64)
    start, stop, step = numbers
    if step == 0 or (stop - start) * step < 0:
        raise InputError(f"{name}: {text!r}: a step of {step:g} never gets from START to STOP")
    count = np.floor((stop - start) / step * (1 + 1e-12) + 1e-9) + 1
    if count > _MOST_ANGLES:
        raise InputError(f"{name}: {text!r}: {count:g} angles, expected at most {_MOST_ANGLES}")
    angles: Array = start + step * np.arange(int(count), dtype=np.float64)
    return angles


#: Of the table.
COLUMNS = ("azimuth_deg", "elevation_deg", "rcs_dbsm")


def rows(result: "Sweep") -> Iterator[tuple[float, ...]]:
    """Values under `COLUMNS`, an angle each."""
    return zip(
        result.azimuth_deg.tolist(),
        result.elevation_deg.tolist(),
        result.cross_section_dbsm.tolist(),
        strict=True,
    )


def csv_lines(result: "Sweep") -> Iterator[str]:
    """The table, header first."""
    yield ",".join(COLUMNS)
    for azimuth, elevation, value in rows(result):
        yield f"{azimuth:.10g},{elevation:.10g},{value:.4f}"


def _compute(target: "MeshTarget", request: Request, azimuths: Array) -> "Sweep":
    from twin.radar.cross_section import Quality, sweep
    from twin.radar.cross_section.optics import portions

    with Stages(len(list(portions(target, len(azimuths))))) as stages:
        return sweep(
            target,
            request.carrier_hz,
            azimuths,
            request.elevation_deg,
            distance_m=np.inf if request.distance_m is None else request.distance_m,
            transmit="V" if request.polarization[0] == "V" else "H",
            receive="V" if request.polarization[-1] == "V" else "H",
            edges=request.edges,
            quality=None if request.tolerance is None else Quality(request.tolerance),
            stage=stages.stage,
        )


def _load(request: Request, surface: "LayeredSurface") -> "MeshTarget":
    from twin.radar.scattering import MeshTarget
    from twin.scene.meshes import read_mesh

    place = str(request.mesh)
    mesh = read_mesh(request.mesh).without_empty_faces(place)
    turn = upright(request.mesh, request.up)[1]
    scaled = mesh.transformed(np.diag([request.scale] * 3 + [1.0]) @ turn, place)
    kept = scaled.without_empty_faces(place)
    try:
        return MeshTarget(kept, (surface,))
    except InputError as error:
        raise InputError(f"{request.mesh}: {error}; is --scale right?") from error


def _surface(request: Request) -> "LayeredSurface":
    from twin.radar.scattering import PEC, Layer, LayeredSurface

    if request.permittivity is None:
        if request.thickness_m is not None:
            raise InputError("thickness: expected together with a permittivity")
        return PEC
    try:
        value = complex(request.permittivity.replace(" ", ""))
    except ValueError as error:
        raise InputError(
            f"permittivity: {request.permittivity!r}: expected a number such as 5.3-0.4j"
        ) from error
    if value.real < 1:
        raise InputError(
            f"permittivity: {request.permittivity!r}: expected a real part from 1, that of air, on"
        )
    if request.thickness_m is None:
        return LayeredSurface(backing=value)
    return LayeredSurface((Layer(value, request.thickness_m),), backing=1)


def _plot(request: Request, result: "Sweep", path: Path) -> None:
    from twin.report.rcs_figure import plot_rcs

    distance = "far field" if request.distance_m is None else f"at {request.distance_m:g} m"
    title = (
        f"{request.mesh.name}, {request.carrier_hz / 1e9:g} GHz, {request.polarization}, "
        f"elevation {request.elevation_deg:g} deg, {distance}"
        f"{', with edges' if request.edges else ''}"
    )
    plot_rcs(result, title).savefig(path, format="png")


def _within(name: str, value: float, low: float, high: float, unit: str) -> None:
    if not low < value < high:
        above = "" if np.isinf(high) else f" and below {high:g}"
        raise InputError(f"{name}: {value}: expected {unit} above {low:g}{above}")

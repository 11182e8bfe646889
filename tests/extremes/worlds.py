"""Scenes on disk and systems for the extremes: what a user would write, loaded as a user would."""

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ValidationError
from scipy.spatial.transform import Rotation

from twin.camera import Capture, capture
from twin.errors import InputError
from twin.fidelity import Fidelity, Tolerance
from twin.scene import Scene, load_scene
from twin.system import System, load_system
from twin.toml import describe

Array = NDArray[np.float64]
Triangles = tuple[Array, NDArray[np.int64]]
Model = TypeVar("Model", bound=BaseModel)

#: An oblique attitude: nothing lines up with the axes of the world.
YAW, PITCH, ROLL = 33.0, 17.0, 21.0
TURNED = Rotation.from_euler("ZYX", [YAW, PITCH, ROLL], degrees=True)
#: One direct path per sample: the closed forms know no further bounces.
DIRECT = Fidelity(samples=64, max_depth=1)


def square(center: Sequence[float], half: float, normal_to: str = "x") -> Triangles:
    """A square, facing along x (or lying, ``z``), in the rig's frame."""
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half
    flat = {"x": (np.zeros(4), *corners.T), "z": (*corners.T, np.zeros(4))}[normal_to]
    return np.column_stack(flat) + center, np.array([[0, 1, 2], [0, 2, 3]])


def inclined(distance_m: float, incline_deg: float, half: float) -> Triangles:
    """A plane at ``distance_m`` along its normal, which the x axis meets at ``incline_deg``."""
    a = np.radians(incline_deg)
    normal = np.array([np.sin(a), 0, -np.cos(a)])
    along = np.array([np.cos(a), 0, np.sin(a)])
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half
    place = normal * distance_m + corners[:, :1] * along + corners[:, 1:] * [0, 1, 0]
    # Its middle is where the axis meets it.
    return place + along * distance_m / np.tan(a), np.array([[0, 1, 2], [0, 2, 3]])


def mosaic(triangles: Triangles, parts: int) -> Triangles:
    """A square cut into ``parts`` x ``parts``, two triangles each."""
    corners = triangles[0]
    u = np.linspace(0, 1, parts + 1)
    grid = (
        corners[0]
        + u[:, None, None] * (corners[1] - corners[0])
        + u[:, None] * (corners[3] - corners[0])
    )
    index = np.arange((parts + 1) ** 2).reshape(parts + 1, -1)
    a, b, c, d = (
        x.ravel() for x in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:])
    )
    faces = np.vstack([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    return grid.reshape(-1, 3), faces


@contextmanager
def scene(
    *shapes: Triangles,
    reflectance: float = 0.5,
    sun_lx: float = 1e5,
    origin: Sequence[float] = (0.0, 0.0, 0.0),
    turned: bool = False,
    scalar: str = "double",
    radio: str | None = None,
    detector_offset: Sequence[float] = (0.0, 0.0, 0.0),
) -> Iterator[Scene]:
    """Shapes in the rig's frame, written to a folder and loaded; the rig stands at ``origin``.

    The sun stands behind the rig, 30 degrees above its horizon (of the untilted rig).
    """
    attitude = (YAW, PITCH, ROLL) if turned else (0.0, 0.0, 0.0)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        references = []
        for number, (vertices, faces) in enumerate(shapes):
            placed = (TURNED.apply(vertices) if turned else vertices) + np.asarray(origin)
            _write_ply(folder / f"{number}.ply", placed, faces, scalar)
            references.append(
                f'<shape type="ply" id="shape-{number}">'
                f'<string name="filename" value="{number}.ply"/>'
                '<ref id="stuff"/></shape>'
            )
        stuff = '<bsdf type="diffuse" id="stuff"/>'
        xml = f'<scene version="3.0.0">{stuff}{"".join(references)}</scene>'
        (folder / "scene.xml").write_text(xml)
        (folder / "materials.toml").write_text(
            "[stuff.optical]\nreflectance = "
            f'{{ value = {float(reflectance)!r}, assumed = "test" }}\n'
            + (f'[stuff.radio]\nitu = "{radio}"\n' if radio else "")
        )
        x, y, z = (float(p) for p in origin)
        (folder / "scene.toml").write_text(
            f"[rig]\nposition_m = [{x!r}, {y!r}, {z!r}]\n"
            f"yaw_deg = {attitude[0]}\npitch_deg = {attitude[1]}\nroll_deg = {attitude[2]}\n"
            f"[rig.detector]\noffset_m = {[float(d) for d in detector_offset]}\n"
            "[sun]\nazimuth_deg = 180.0\nelevation_deg = 30.0\n"
            f"illuminance_lx = {float(sun_lx)!r}\n"
        )
        yield load_scene(folder)


def _write_ply(path: Path, vertices: Array, faces: NDArray[np.int64], scalar: str) -> None:
    kind = {"double": "<f8", "float": "<f4"}[scalar]
    head = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {len(vertices)}\n"
        + "".join(f"property {scalar} {axis}\n" for axis in "xyz")
        + f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    rows = np.empty(len(faces), dtype=[("n", "u1"), ("f", "<i4", 3)])
    rows["n"], rows["f"] = 3, faces
    path.write_bytes(head.encode() + vertices.astype(kind).tobytes() + rows.tobytes())


def validated(model: type[Model], content: Mapping[str, Any]) -> Model:
    """What a file of this content would be, with the faults as of a file."""
    try:
        return model.model_validate(content)
    except ValidationError as error:
        raise InputError(describe(error, model, content)) from error


def camera(**changes: object) -> System:
    """`workable` with 16 x 16 cells and a filter that does not shift with angle, so that closed
    forms hold; changed by ``section__field``.
    """
    content = load_system("workable").model_dump()
    content["filter"]["effective_index"] = content["filter"]["place"] = None
    content["sky"] = None  # the scene's sun holds
    base = {"emitter__rows": 16, "emitter__columns": 16, "acquisition__n_patterns": 256}
    for name, value in {**base, **changes}.items():
        section, field = name.split("__")
        content[section][field] = value
    return validated(System, content)


def look(world: Scene, system: System, fidelity: Fidelity = DIRECT, seed: int = 1) -> Capture:
    """One frame."""
    return capture(world, system, seed=seed, fidelity=asked(fidelity))


_TOLERANCE: ContextVar[float | None] = ContextVar("tolerance", default=None)


@contextmanager
def under_tolerance(share: float) -> Iterator[None]:
    """Cases run to a tolerance inside, in place of the knobs that they name."""
    token = _TOLERANCE.set(share)
    try:
        yield
    finally:
        _TOLERANCE.reset(token)


def asked(fidelity: Fidelity) -> Fidelity:
    """The knobs of a case, or those of the tolerance that it runs under, with the case's noise."""
    share = _TOLERANCE.get()
    return fidelity if share is None else replace(Tolerance(share).knobs(), noise=fidelity.noise)


def has_tolerance() -> bool:
    """Whether cases run under a tolerance."""
    return _TOLERANCE.get() is not None


def light_stated(taken: Capture, exact: object, of_light: float = 3e-3) -> float:
    """Relative error that is stated of all light of a frame: what direct light is tested to
    everywhere, and under a tolerance five standard errors besides.
    """
    if not has_tolerance():
        return of_light
    error = float(np.sqrt((taken.cells_error_e**2).sum()))
    return of_light + 5 * error / float(exact) if exact else of_light  # type: ignore[arg-type]

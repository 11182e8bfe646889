"""The radar's propagation models: one protocol, the bundled ones by name, and a user's own."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from twin.errors import EngineError, InputError, check_kind, check_seed
from twin.fidelity import Accuracy, Fidelity, knobs_of, own_solver
from twin.radar.device.design import RadarDesign
from twin.radar.propagation.facets.earlier import TracedFrame
from twin.radar.propagation.free_space import straight_paths
from twin.radar.propagation.physical_optics_solver import echoes
from twin.radar.propagation.result import Propagation
from twin.radar.propagation.scene.parts import parted
from twin.radar.propagation.sionna.paths import sionna_paths
from twin.radar.synthesis import Contributions
from twin.scene import Scene


class PropagationModel(Protocol):
    """A propagation model, a user's own among them: from a scene and a radar to echoes.

    It returns `Contributions`, or a whole `Propagation` where it has single paths by name,
    assumptions and warnings to tell. `prepare_scene`, which the bundled models build on, is there
    for it too (`twin.radar.propagation.prepared_scene`).

    >>> import numpy as np
    >>> from twin.radar import load_radar
    >>> from twin.scene import load_scene
    >>> def two_ray(scene, radar, fidelity, seed):
    ...     "A point at 20 m, and its image in the ground, 6 dB fainter and 1 m farther."
    ...     amplitude = 1e-4 * np.array([1, -0.5], complex)
    ...     return Contributions.ahead(amplitude, 2 * np.array([20.0, 21.0]) / 3e8, np.zeros(2))
    >>> found = trace(load_scene("yard"), load_radar("hybrid-79"), fidelity=Fidelity(radar=two_ray))
    >>> len(found.contributions), found.assumptions
    (2, ('echoes by two_ray, a propagation model of the user',))
    """

    def __call__(
        self, scene: Scene, radar: RadarDesign, fidelity: Fidelity, seed: int
    ) -> Contributions | Propagation:
        """Echoes of a scene at the pose of its rig."""


@dataclass(frozen=True)
class Solver:
    """A propagation model with what the rest of the chain must know of it.

    ``label``: in figures. ``assumptions``: what it takes for granted in every scene.
    ``is_seeded``: whether echoes depend on the seed. ``is_float32``: whether its rays may miss what
    is small on large triangles. ``has_tolerance``: whether ``radar_tolerance`` bounds its errors.
    ``reusing``: the same model for frames of which later ones keep a part.
    """

    model: PropagationModel
    label: str
    assumptions: tuple[str, ...] = ()
    is_seeded: bool = True
    is_float32: bool = False
    has_tolerance: bool = False
    reusing: Callable[..., Propagation] | None = None


_POINTS = "declared targets answer with a constant cross-section from one point"
_SCATTERS = (
    "rough surfaces scatter from fixed points of random phase, reached by direct paths alone"
)
_SMOOTH = "surfaces are smooth and large against the Fresnel zone where they reflect"


def _straight(scene: Scene, radar: RadarDesign, fidelity: Fidelity, seed: int) -> Propagation:
    return straight_paths(scene, radar)


def _sionna(scene: Scene, radar: RadarDesign, fidelity: Fidelity, seed: int) -> Propagation:
    return sionna_paths(scene, radar, table_nodes=fidelity.radar_table_nodes, seed=seed)


#: The bundled ones, by what ``Fidelity.radar`` calls them.
SOLVERS: dict[str, Solver] = {
    "targets": Solver(_straight, "declared targets", (_POINTS,), is_seeded=False),
    "paths": Solver(
        _sionna,
        "traced paths",
        (
            _POINTS,
            f"{_SMOOTH}; nothing goes through them; objects that are neither only cast shadows",
        ),
        is_float32=True,
    ),
    "optics": Solver(
        echoes,
        "physical optics",
        (_POINTS, _SMOOTH),
        is_seeded=False,
        has_tolerance=True,
        reusing=echoes,
    ),
    "auto": Solver(
        echoes,
        "physical optics, rough surfaces where they count",
        (_POINTS, _SCATTERS),
        is_seeded=False,
        has_tolerance=True,
        reusing=echoes,
    ),
    "rough": Solver(
        echoes,
        "physical optics, rough surfaces",
        (_POINTS, _SCATTERS),
        is_seeded=False,
        has_tolerance=True,
        reusing=echoes,
    ),
}


def solver_of(fidelity: Fidelity) -> Solver:
    """The bundled solver, or a user's own, that ``fidelity.radar`` names or holds."""
    own = own_solver(fidelity.radar)
    if own is None:
        return SOLVERS[str(fidelity.radar)]
    model: Any = own
    return Solver(model, own.name)


def seen_by(radar: RadarDesign, scene: Scene, fidelity: Fidelity) -> Scene:
    """The scene as a radar meets it: by physical optics what stands in one mesh with a large
    surface is an object of its own (`parted`).
    """
    return parted(scene, radar) if solver_of(fidelity).has_tolerance else scene


def trace(
    scene: Scene,
    radar: RadarDesign,
    *,
    fidelity: Accuracy | None = None,
    seed: int = 0,
    earlier: Propagation | None = None,
    keep: bool = False,
    followed_s: float | None = None,
) -> Propagation:
    """Find the echoes of a scene.

    Parameters
    ----------
    scene, radar
        The scene, and the radar in it.
    fidelity
        Knobs, a preset's name or a `Tolerance`; ``radar`` among them decides which solver finds
        the echoes.
    seed
        Of the rays of ``paths`` that look for surfaces.
    earlier, keep
        Another frame of the same design (but for its name) and ``fidelity.radar``, traced in full
        with ``keep``: of the echoes of meshes' facets those are not found anew on whose paths
        nothing has changed since. `facets.validity` says after which changes all are. That frame
        alone decides with the other parameters what is found, not what was traced in between.

    followed_s
        For how long before and after its own instant the frame is followed: triangles are divided
        until they move as points for so long. Default: half a burst.

    Raises InputError for what is no scene, radar, seed or time, where a material that answers has
    no data at the carrier, where a user's own model gives no echoes, and where ``earlier`` is no
    such frame; EngineError for echoes that are no finite numbers.
    """
    check_kind("scene", scene, Scene, "twin.load_scene")
    check_kind("radar", radar, RadarDesign, "twin.load_radar")
    check_seed(seed)
    if followed_s is not None and not 0 <= followed_s < np.inf:
        raise InputError(f"followed_s: {followed_s!r:.60}: expected a time from 0 s")
    knobs = knobs_of(fidelity, radar.total_bandwidth_hz)
    solver = solver_of(knobs)
    traced = _traced(earlier, radar, knobs, solver)
    scene = seen_by(radar, scene, knobs)
    if solver.reusing is not None:
        found = solver.reusing(scene, radar, knobs, seed, traced, keep=keep, followed_s=followed_s)
        return _finite(found, scene)
    result = solver.model(scene, radar, knobs, seed)
    if isinstance(result, Contributions):
        said = f"echoes by {solver.label}, a propagation model of the user"
        result = Propagation(result, assumptions=(said,))
    if own_solver(knobs.radar) is not None:
        _check(result, solver.label)
    return _finite(result, scene)


def _traced(
    earlier: object, radar: RadarDesign, fidelity: Fidelity, solver: Solver
) -> TracedFrame | None:
    """What may be kept of an earlier frame. Raises InputError where it is none that can be."""
    if earlier is None:
        return None
    if not isinstance(earlier, Propagation):
        raise InputError(
            f"earlier: a {type(earlier).__name__}, expected the propagation of a frame that was "
            "traced with keep=True"
        )
    if earlier.traced is not None:
        earlier.traced.check(radar, str(fidelity.radar))
    elif solver.reusing is not None:
        raise InputError("earlier: traced without keep, expected a frame traced with keep=True")
    return earlier.traced


def _finite(result: Propagation, scene: Scene) -> Propagation:
    """Raises EngineError for echoes that are no numbers, of which the record would be nothing."""
    echoes = result.contributions
    wrong = ~np.isfinite(np.atleast_2d(echoes.amplitude)).all(axis=0)
    wrong |= ~np.isfinite(echoes.delay_s)
    if wrong.any():
        numbers = np.unique(echoes.object[wrong]).tolist()
        names = [result.objects[k] for k in numbers if k < len(result.objects)]
        raise EngineError(
            f"{scene.name}: {np.count_nonzero(wrong)} echoes, of {', '.join(names) or 'paths'}, "
            "are no finite numbers: a fault of the tracer, which an object or a radar moved by "
            "a tenth of a millimetre may avoid"
        )
    return result


def _check(result: Propagation, name: str) -> None:
    """Raises InputError for what are no echoes of a user's own model."""
    if not isinstance(result, Propagation):
        raise InputError(
            f"{name}: returned a {type(result).__name__}, expected Contributions or Propagation"
        )
    values = vars(result.contributions)
    n = len(values["delay_s"])
    for field, array in values.items():
        ends = (n, 3) if field.startswith(("departure", "arrival")) else (n,)
        if np.shape(array)[-len(ends) :] != ends or not np.isfinite(array).all():
            raise InputError(
                f"{name}: {field} of shape {np.shape(array)}, expected finite numbers "
                f"(..., {', '.join(map(str, ends))})"
            )
    if n and np.min(values["delay_s"]) < 0:
        raise InputError(f"{name}: delay_s: {np.min(values['delay_s'])} is negative")
    if len(result.names) > n:
        raise InputError(f"{name}: {len(result.names)} names of {n} contributions")

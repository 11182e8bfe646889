"""The rungs of the radar: who finds a scene's echoes, a user's own model among them."""

from typing import Protocol

import numpy as np

from hardware.own_functions import OwnFunction
from twin.errors import InputError
from twin.fidelity import Fidelity, own_solver
from twin.radar.device.design import RadarDesign
from twin.radar.propagation.by_optics import echoes
from twin.radar.propagation.free_space import straight_paths
from twin.radar.propagation.result import Propagation, contributions_of_paths
from twin.radar.propagation.sionna.paths import sionna_paths
from twin.radar.synthesis import Contributions
from twin.scene import Scene


class PropagationModel(Protocol):
    """A user's own propagation model: from a scene and a radar to echoes.

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
    >>> len(found.echoes.delay_s), found.assumptions
    (2, ('echoes by two_ray, a propagation model of the user',))
    """

    def __call__(
        self, scene: Scene, radar: RadarDesign, fidelity: Fidelity, seed: int
    ) -> Contributions | Propagation:
        """Echoes of a scene at the pose of its rig."""


def trace(
    scene: Scene,
    radar: RadarDesign,
    *,
    fidelity: Fidelity | None = None,
    seed: int = 0,
    earlier: Propagation | None = None,
    keep: bool = False,
) -> Propagation:
    """Find the echoes of a scene.

    Parameters
    ----------
    scene, radar
        What is looked at, and with what.
    fidelity
        Its ``radar`` rung decides who finds them.
    seed
        Of the rays that look for surfaces, and of rough ones.
    earlier, keep
        Another frame, traced in full with ``keep``: of the echoes of meshes' facets those are not
        found anew that nothing that has moved or changed since concerns (`facets.earlier`). It
        alone decides with the other parameters what is found, not what was traced in between.

    Raises InputError where a material that answers has no data at the carrier, and where a user's
    own model gives no echoes.
    """
    fidelity = fidelity or Fidelity()
    if (own := own_solver(fidelity.radar)) is not None:
        return _solved(own, scene, radar, fidelity, seed)
    if fidelity.radar == "targets":
        return straight_paths(scene, radar)
    if fidelity.radar == "paths":
        return sionna_paths(scene, radar, table_nodes=fidelity.radar_table_nodes, seed=seed)
    traced = None if earlier is None else earlier.traced
    return echoes(scene, radar, fidelity, seed, traced, keep=keep)


def _solved(
    own: OwnFunction, scene: Scene, radar: RadarDesign, fidelity: Fidelity, seed: int
) -> Propagation:
    """Echoes by a user's own model. Raises InputError for what are none."""
    found = own.function(scene, radar, fidelity, seed)
    if isinstance(found, Contributions):
        said = f"echoes by {own.name}, a propagation model of the user"
        found = Propagation(paths=(), roles=(), assumptions=(said,), surfaces=found)
    if not isinstance(found, Propagation):
        raise InputError(
            f"{own.name}: returned a {type(found).__name__}, expected Contributions or Propagation"
        )
    parts = (found.surfaces, found.diffuse, contributions_of_paths(found.paths))
    for values in (vars(part) for part in parts):
        n = len(values["delay_s"])
        for name, array in values.items():
            ends = (n, 3) if name.startswith(("departure", "arrival")) else (n,)
            if np.shape(array)[-len(ends) :] != ends or not np.isfinite(array).all():
                raise InputError(
                    f"{own.name}: {name} of shape {np.shape(array)}, expected finite numbers "
                    f"(..., {', '.join(map(str, ends))})"
                )
        if n and np.min(values["delay_s"]) < 0:
            raise InputError(f"{own.name}: delay_s: {np.min(values['delay_s'])} is negative")
    return found

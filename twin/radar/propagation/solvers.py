"""The rungs of the radar: who finds a scene's echoes."""

from twin.fidelity import Fidelity
from twin.radar.device.design import RadarDesign
from twin.radar.propagation.by_optics import echoes
from twin.radar.propagation.free_space import straight_paths
from twin.radar.propagation.result import Propagation
from twin.radar.propagation.sionna.paths import sionna_paths
from twin.scene import Scene


def trace(
    scene: Scene, radar: RadarDesign, *, fidelity: Fidelity | None = None, seed: int = 0
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

    Raises InputError where a material that answers has no data at the carrier.
    """
    fidelity = fidelity or Fidelity()
    if fidelity.radar == "targets":
        return straight_paths(scene, radar)
    if fidelity.radar == "paths":
        return sionna_paths(scene, radar, table_nodes=fidelity.radar_table_nodes, seed=seed)
    return echoes(scene, radar, fidelity, seed)

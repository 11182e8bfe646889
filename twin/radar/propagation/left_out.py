"""What physical optics leaves out of the echoes of meshes, as assumptions of a result."""

from twin.fidelity import Fidelity

_ALWAYS = (
    "meshes scatter by physical optics: no creeping or travelling waves, no resonances, so echoes "
    "of what is smaller than some wavelengths or met at grazing are off"
)


def on_meshes(
    fidelity: Fidelity,
    n_objects: int,
    n_bodies: int,
    without_edges: int,
    without_waves: int,
    too_large: int,
) -> tuple[str, ...]:
    """Whether edges and waves round obstacles are in the echoes of meshes.

    Parameters
    ----------
    fidelity
        ``radar_edges`` and ``radar_shadowed`` of it: 0, and neither is; None, and bounds decided.
    n_objects
        That waves may be hidden by.
    n_bodies
        That scatter.
    without_edges, without_waves
        Bodies whose sharp edges, and to which waves round obstacles, were left out by bounds.
    too_large
        Bodies to which waves round obstacles were not looked for, since there are too many edges.
    """
    if not n_bodies:
        return ()
    several = n_objects > 1
    left_out = {
        "diffraction by edges": fidelity.radar_edges == 0,
        f"edges of {without_edges} of {n_bodies} bodies, within the stated errors": without_edges,
        "waves round obstacles": fidelity.radar_shadowed == 0 and several,
        f"waves round obstacles to {without_waves} of {n_bodies} bodies, within the stated "
        "errors": without_waves,
        f"waves round obstacles to {too_large} of {n_bodies} bodies, which are too large to "
        "compute among so many edges; no stated error holds them": too_large,
        f"waves round obstacles to more than {fidelity.radar_shadowed} parts of bodies": (
            fidelity.radar_shadowed and several
        ),
    }
    told = [effect for effect, is_so in left_out.items() if is_so]
    return (_ALWAYS, *([f"left out of meshes' echoes: {'; '.join(told)}"] if told else []))

"""Echoes of a burst that an earlier process found, where nothing of what they depend on differs."""

from dataclasses import replace

from twin.accuracy import of_earlier_run
from twin.fidelity import Fidelity, RadarFidelity, own_solver
from twin.kept_results import KeptResults
from twin.radar.device.design import RadarDesign
from twin.radar.propagation.interval.instants import traced_interval
from twin.radar.propagation.result import Propagation
from twin.radar.propagation.solvers import solver_of
from twin.scene import Pose, Scene, Sun
from twin.scene.materials import Radio, Surface

_NOWHERE = Pose((0.0, 0.0, 0.0))
_DARK = Sun(0.0, 0.0, 0.0)


def kept_interval(
    scene: Scene, radar: RadarDesign, fidelity: Fidelity, seed: int, kept: KeptResults
) -> Propagation:
    """What `traced_interval` gives, bit for bit; same errors.

    Of a user's own propagation model nothing is kept: it may depend on anything.
    """
    if own_solver(fidelity.radar) is not None:
        return traced_interval(scene, radar, fidelity, seed)
    content = (
        _without_light(scene),
        radar.model_copy(update={"name": "any"}),
        fidelity.part(RadarFidelity),
        seed if solver_of(fidelity).is_seeded else None,
    )
    return kept.get(
        "echoes", content, lambda: traced_interval(scene, radar, fidelity, seed), _of_earlier_run
    )


def _of_earlier_run(echoes: Propagation) -> Propagation:
    return replace(echoes, decisions=of_earlier_run(echoes.decisions))


def _without_light(scene: Scene) -> tuple[Scene, dict[str, tuple[Radio, Surface | None]]]:
    """The scene, at one burst, and its materials without what the camera alone sees: a change of
    that leaves echoes as they are.
    """
    seen = replace(
        scene,
        objects=tuple(replace(item, reflectance=0.0) for item in scene.objects),
        rig=replace(scene.rig, emitter=_NOWHERE, detector=_NOWHERE),
        sun=_DARK,
        track=None,
        materials={},
    )
    return seen, {name: (row.radio, row.surface) for name, row in scene.materials.items()}

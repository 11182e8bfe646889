"""Images of the radar that echoes of a scene are followed over: as many as are given, or as bounds
and the number of paths over pairs of them permit.
"""

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from twin.errors import InputError
from twin.fidelity import Fidelity
from twin.radar.device.design import RadarDesign
from twin.radar.propagation.facets.reflections import LEAST_IMAGES, MOST_IMAGES
from twin.radar.propagation.prepared_scene import FurtherPaths, PreparedScene, prepare_scene
from twin.radar.propagation.scene.image_search import FURTHER, MANY_IMAGES
from twin.radar.propagation.scene.scattering_models import Assignment, ScatteringModel
from twin.scene import Scene

#: Where there are more than `MANY_IMAGES`: paths of facets' echoes by pairs of images, up to which
#: two reflections are followed; some 8 us each, one after the other.
MOST_ECHO_PATHS = 2**20
#: Where the number of reflections is given instead, before they are refused: 7e6 of two reflections
#: in the middle of Munich take 30 s and 1.6 GB; there are 3e7 of three.
#: Where bounds decide on all else, up to six reflections at bodies and edges among it, they are not
#: done after eight minutes: then `MOST_ECHO_PATHS` is the limit.
MOST_PATHS_BY_HAND = 2**24
#: Paths of facets' echoes up to which three reflections are followed, by which a corner of a room
#: returns what comes past a body, and up to which more are.
_THIRD_PATHS, _FURTHER_PATHS = 2**18, 2**16
_MORE_BY_TWO = 8  # times as many by up to two reflections as by one, or more


def with_followed_images(
    scene: Scene,
    radar: RadarDesign,
    roles: Sequence[Assignment],
    fidelity: Fidelity,
    rough: Collection[str],
) -> tuple[PreparedScene, FurtherPaths | None]:
    """With the images that are followed; by bounds also to what there are further ones."""
    if fidelity.radar_images is not None:
        return _with_images(scene, radar, roles, fidelity, rough), None
    # One more reflection, to know whether there is any beyond those that are followed.
    prepared = prepare_scene(scene, radar, roles, MOST_IMAGES + 1, rough=rough, many=MANY_IMAGES)
    orders = [len(image.patches) for image in prepared.images]
    if prepared.has_more_images and max(orders) < LEAST_IMAGES:
        if echo_paths(prepared) <= MOST_ECHO_PATHS / _MORE_BY_TWO:
            further = prepare_scene(scene, radar, roles, LEAST_IMAGES, rough=rough)
            if echo_paths(further) <= MOST_ECHO_PATHS:
                prepared = replace(further, has_more_images=True)
        return prepared.up_to(LEAST_IMAGES)
    # Between mirrors that face each other a flat body may glint in any image.
    for order in range(min(MOST_IMAGES, max(orders)), LEAST_IMAGES, -1):
        fewer, beyond = prepared.up_to(order)
        limit = _THIRD_PATHS if order == LEAST_IMAGES + 1 else _FURTHER_PATHS
        if len(fewer.images) <= FURTHER and echo_paths(fewer) <= limit:
            return fewer, beyond
    return prepared.up_to(LEAST_IMAGES)


def _with_images(
    scene: Scene,
    radar: RadarDesign,
    roles: Sequence[Assignment],
    fidelity: Fidelity,
    rough: Collection[str],
) -> PreparedScene:
    """With all images of as many reflections as are given.

    Raises InputError where echoes over pairs of them take too many paths, before these are traced;
    of more than two reflections before images of still more are looked for.
    """
    most, others = fidelity.radar_images or 0, ("bounces", "edges", "shadowed")
    by_bounds = None in (getattr(fidelity, f"radar_{knob}") for knob in others)
    limit = MOST_ECHO_PATHS if by_bounds else MOST_PATHS_BY_HAND
    for order in range(min(most, 2), most + 1):
        prepared = prepare_scene(scene, radar, roles, order, rough=rough)
        if order > 1 and (paths := echo_paths(prepared)) > limit:
            images = len(prepared.all_images) - 1
            raise InputError(
                f"fidelity.radar_images = {most}: {images} images of the radar by up to {order} "
                f"reflections at large surfaces, and {paths / 1e6:.3g} million paths to facets "
                f"over pairs of them, expected at most {limit / 1e6:.3g} million: set "
                f"fidelity.radar_images = {order - 1}, or leave it to a tolerance "
                "(fidelity.tolerance), which follows as many as count and bounds the rest"
            )
    return prepared


def echo_paths(prepared: PreparedScene) -> int:
    """Pairs of images over which the facets of bodies are lit and seen, those of all facets
    together, as if none faced away.
    """
    images = prepared.worth.sum(axis=0)
    faces = np.array([len(item.geometry.faces) for item in prepared.items], dtype=np.int64)
    is_body = np.array([role is ScatteringModel.OPTICS for role in prepared.roles], dtype=bool)
    return int((faces * images * (images + 1) // 2)[is_body].sum())

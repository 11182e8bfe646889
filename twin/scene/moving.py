"""Objects on their ways: in the world, or within the frame of what carries them.

Axes and points of a motion are those of the scene as its files draw it: what carries an object
moves that drawing, and the object moves within it.
"""

from dataclasses import replace

from scipy.spatial.transform import RigidTransform

from twin.motion import Motion, Parent, Product, Still
from twin.scene.objects import SceneObject


def carrier_of(parent: SceneObject, drawn: RigidTransform | None = None) -> Product:
    """How an object moves the scene as drawn; it stands at ``drawn`` there, by default as now."""
    place = parent.pose if drawn is None else drawn
    return Product((Parent(parent.name, parent.course), Still(place.inv())))


def moving(item: SceneObject, own: Motion, carrier: Product | None = None) -> SceneObject:
    """An object as drawn, moved by a motion of the drawing, within what carries it.

    Raises InputError for a velocity beyond `FASTEST_M_PER_S`, and a time 0 that a trajectory does
    not cover.
    """
    if carrier is None:
        motion = Product((own, Still(item.pose)))
        # What stands is what it would be without a motion.
        return item.following(motion) if motion.moves else replace(item, pose=motion.pose_at(0.0))
    parent = carrier.parts[0]
    assert isinstance(parent, Parent)
    return item.following(Product((*carrier.parts, own, Still(item.pose))), parent.name)

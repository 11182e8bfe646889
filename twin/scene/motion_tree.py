"""Objects and rig of a scene as drawn, put on the motions that ``scene.toml`` gives them."""

from collections.abc import Sequence
from pathlib import Path

from scipy.spatial.transform import RigidTransform, Rotation

from twin.files import InputError
from twin.motion import Motion, Product, Still, Straight
from twin.scene.limits import FASTEST_M_PER_S
from twin.scene.motion_settings import MotionSettings, TrajectorySettings, Vector
from twin.scene.moving import carrier_of, moving
from twin.scene.objects import SceneObject, Target
from twin.scene.rig import Rig
from twin.scene.settings import SceneSettings

IDENTITY = Still(RigidTransform.identity())


class MotionTree:
    """Motions of a scene's file, by the names of its objects. Raises InputError naming the file."""

    def __init__(self, path: Path, objects: Sequence[SceneObject], settings: SceneSettings) -> None:
        self.path, self.settings = path, settings
        self.drawn = {item.name: item for item in objects}
        self.moved: dict[str, SceneObject] = {}
        self.carriers: dict[str, Product] = {}
        self.warnings: list[str] = []

    def objects(self) -> tuple[SceneObject, ...]:
        """All objects where time 0 has them."""
        return tuple(self._object(name, ()) for name in self.drawn)

    def rig(self, rig: Rig) -> Rig:
        """The rig where time 0 has it."""
        given = self.settings.rig
        if given is None or not given.moves:
            return rig
        carrier = self._carrier(given.parent, ("rig",))
        pose = rig.pose.transform
        own = self._own("rig", given.velocity_m_per_s, given.motion, pose, given.parent, carrier)
        parts = () if carrier is None else carrier.parts
        try:
            found = rig.following(Product((*parts, own, Still(pose))))
        except InputError as error:
            raise InputError(f"{self.path}: rig: {error}") from None
        self._check_speed("rig", given.motion, found.course.fastest((0.0, 0.0, 0.0), 0.0))
        return found

    def targets(self, targets: Sequence[Target]) -> tuple[Target, ...]:
        """Targets, carried by their objects."""
        return tuple(
            t
            if t.object is None or self.moved[t.object].motion is None
            else t.carried(self.drawn[t.object], self.moved[t.object])
            for t in targets
        )

    def _object(self, name: str, below: tuple[str, ...]) -> SceneObject:
        if name in below:
            way = " -> ".join((*below[below.index(name) :], name))
            raise InputError(f"{self.path}: objects.{name}.parent: each carries the next: {way}")
        if name not in self.moved:
            self.moved[name] = self._made(name, (*below, name))
        return self.moved[name]

    def _made(self, name: str, below: tuple[str, ...]) -> SceneObject:
        item, given = self.drawn[name], self.settings.objects.get(name)
        if given is None or (given.parent is None and given.motion is None):
            return item
        place = f"objects.{name}"
        carrier = self._carrier(given.parent, below)
        own = self._own(
            place, given.velocity_m_per_s, given.motion, item.pose, given.parent, carrier
        )
        try:
            found = moving(item, own, carrier)
        except InputError as error:
            raise InputError(f"{self.path}: {place}: {error}") from None
        self._check_speed(place, given.motion, found.course.fastest(*item.geometry.sphere))
        return found

    def _check_speed(self, place: str, given: MotionSettings | None, speed_m_per_s: float) -> None:
        """Raise InputError naming the file of the poses, if there is one."""
        if speed_m_per_s > FASTEST_M_PER_S:
            file = given.trajectory.file if given and given.trajectory else None
            path = self.path if file is None else self.path.parent / file
            raise InputError(
                f"{path}: {place}.motion: a point of it moves at {speed_m_per_s:.3g} m/s, "
                f"expected at most {FASTEST_M_PER_S:g} m/s"
            )

    def _carrier(self, parent: str | None, below: tuple[str, ...]) -> Product | None:
        if parent is None:
            return None
        if parent not in self.carriers:
            item = self._object(parent, below)
            self.carriers[parent] = carrier_of(item, self.drawn[parent].pose)
        return self.carriers[parent]

    def _own(
        self,
        place: str,
        velocity: Vector,
        given: MotionSettings | None,
        drawn: RigidTransform,
        parent: str | None,
        carrier: Product | None,
    ) -> Motion:
        """How the drawing of one object moves within what carries it."""
        along = (Straight(velocity),) if any(velocity) else ()
        if given is None:
            return Product((IDENTITY, *along))
        if given.trajectory is not None:
            if along:
                raise InputError(
                    f"{self.path}: {place}.velocity_m_per_s: beside a trajectory, expected none"
                )
            base = RigidTransform.identity() if parent is None else self.drawn[parent].pose
            return self._trajectory(f"{place}.motion.trajectory", given.trajectory, drawn, base)
        if given.rolling is not None:
            if carrier is None and not along:
                raise InputError(
                    f"{self.path}: {place}.motion.rolling: expected a parent or a velocity_m_per_s"
                )
            under = () if carrier is None else carrier.parts
            return Product((*along, given.rolling.make(Product((*under, *along)))))
        kind = given.turning or given.swinging
        assert kind is not None  # one of four is given
        return Product((*along, kind.make()))

    def _trajectory(
        self, place: str, given: TrajectorySettings, drawn: RigidTransform, base: RigidTransform
    ) -> Motion:
        """``base``: where the parent is drawn."""
        turn = Rotation.identity() if given.as_drawn else (base.inv() * drawn).rotation
        label = f"{self.path}: {place}"
        way, warnings = given.make(label, self.path.parent, turn)
        self.warnings += warnings
        try:
            start = way.pose_at(0.0) if given.as_drawn else base.inv() * drawn
        except InputError as error:
            raise InputError(f"{label}: {error}; start_s says when the first pose is") from None
        return Product((Still(base), way, Still((base * start).inv())))

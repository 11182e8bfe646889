"""Truth of a scene, rendered once: light for the camera, paths for the radar."""

from dataclasses import replace

import numpy as np

from twin.camera.light import render
from twin.camera.rendered import RenderedLight
from twin.fidelity import Accuracy, knobs_of
from twin.kept_results import KeptResults
from twin.radar import RadarCapture, RadarDesign, radar_capture
from twin.scene import Scene
from twin.system import System


class Truths:
    """Truths in a store on disk. Same scene, design, fidelity and versions: same bits."""

    def __init__(self, store: KeptResults) -> None:
        self._store = store

    def light(
        self, scene: Scene, system: System, fidelity: Accuracy | None = None
    ) -> RenderedLight:
        """Light of a scene for a system, as `measure` takes it: of the world as it stands, since
        images of a moving one have no truth to compare with.
        """
        knobs = replace(knobs_of(fidelity), motion_tolerance=None)
        return self._store.get(
            "light",
            (scene, system, knobs),
            lambda: render(scene, system, fidelity=knobs, seed=np.random.SeedSequence(0)),
        )

    def echo(
        self, scene: Scene, radar: RadarDesign, fidelity: Accuracy | None = None
    ) -> RadarCapture:
        """A capture of a scene without noise, whose paths give any number of noisy ones."""
        quiet = replace(knobs_of(fidelity, radar.total_bandwidth_hz), noise="none")
        return self._store.get(
            "capture", (scene, radar, quiet), lambda: radar_capture(scene, radar, fidelity=quiet)
        )

"""A method run over seeds of the sensor's noise, on one render."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hardware import SpiRecord, reconstruct
from hardware.radar import Detection
from hardware.radar.process import process
from hardware.reconstruction import METHODS
from hardware.records import RadarRecord
from twin.camera.acquisition import measure
from twin.camera.chain import Chain
from twin.camera.light import Rendered
from twin.fidelity import Noise
from twin.files import InputError
from twin.radar import RadarCapture, RadarDesign
from twin.radar.acquisition import channel as received
from twin.radar.device.front_end import digitize
from twin.radar.evaluation import match_detections
from twin.regression.metrics import Echo, Metric
from twin.scene import Scene
from twin.system import System

Array = NDArray[np.float64]
#: Name of a method on the vehicle, or a function from a record to an image (rows, columns).
Method = str | Callable[[SpiRecord], Any]
#: From a record to detections.
Detector = Callable[[RadarRecord], Sequence[Detection]]


@dataclass(frozen=True, eq=False)
class Outcome:
    """Figures by metric, (n_seeds,) each, with the truth and every seed's result."""

    figures: dict[str, Array]
    truth: Any
    results: list[Any]


def image_method(method: Method) -> Callable[[SpiRecord], Array]:
    """A method as a function from a record to a picture, detectors side by side, in electrons.

    Raises InputError for a name that is no method.
    """
    if isinstance(method, str):
        if method not in METHODS:
            raise InputError(f"method: {method!r} is none of {', '.join(METHODS)}")
        return lambda record: reconstruct(record, method).picture
    return lambda record: np.asarray(getattr(result := method(record), "picture", result))


def records(
    scene: Scene, system: System, light: Rendered, seeds: Sequence[int], noise: Noise = "full"
) -> Iterator[SpiRecord]:
    """One record per seed: what `measure` gives, with everything but the draw worked out once."""
    chain = Chain.of(system, scene.sun)
    power = chain.powers(light)
    for seed in seeds:
        _, counts, flags = chain.take(power, rng=np.random.default_rng(seed), noise=noise)
        yield chain.record(scene.rig.pose, counts, flags)


def true_cells(scene: Scene, system: System, light: Rendered) -> Array:
    """Electrons of every cell, what images are compared with; NaN in cells not measured."""
    rng = np.random.default_rng(0)
    return measure(scene, system, light, rng=rng, noise="none").measured_cells_e


def run_camera(
    scene: Scene,
    system: System,
    light: Rendered,
    method: Method,
    seeds: Sequence[int],
    metrics: Sequence[Metric],
    noise: Noise = "full",
) -> Outcome:
    """A reconstruction over noise seeds. Raises InputError for an image on another grid."""
    solve, truth = image_method(method), true_cells(scene, system, light)
    images = [solve(record) for record in records(scene, system, light, seeds, noise)]
    for image in images:
        if image.shape != truth.shape:
            raise InputError(f"method: gave an image {image.shape}, expected {truth.shape}")
    return Outcome(_figures(metrics, truth, images), truth, images)


def run_radar(
    capture: RadarCapture,
    radar: RadarDesign,
    detector: Detector,
    seeds: Sequence[int],
    metrics: Sequence[Metric],
    nufft_tolerance: float,
) -> Outcome:
    """A detector over noise seeds, judged by the targets that have a direct path."""
    truth = tuple(target for target in capture.truth if target.visible)
    quiet = [received(burst, radar, capture.air, nufft_tolerance) for burst in capture.bursts]
    found = []
    for seed in seeds:
        rng = np.random.default_rng(seed)
        taken = [digitize(burst, radar, rng=rng) for burst in quiet]
        iq, flags = (np.stack([burst[i] for burst in taken]) for i in (0, 1))
        record = replace(capture.record, iq=iq, flags=flags)
        detections = tuple(detector(record))
        matches = match_detections(detections, truth, radar.channel_waveform)
        found.append(Echo(detections, matches, radar.ofdm.range_cell_m))
    return Outcome(_figures(metrics, truth, found), truth, found)


def vehicle_detector(record: RadarRecord) -> list[Detection]:
    """What rides on the vehicle, with its own settings."""
    return list(process(record).detections)


def _figures(metrics: Sequence[Metric], truth: Any, results: Sequence[Any]) -> dict[str, Array]:
    return {m.name: np.array([m.of(truth, result) for result in results]) for m in metrics}

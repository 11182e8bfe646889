"""A method run over seeds of the sensor's noise, on one render."""

import hashlib
import inspect
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hardware import SpiRecord, reconstruct
from hardware.patterns import Patterns
from hardware.radar import Detection
from hardware.radar.burst import demodulate
from hardware.radar.process import process
from hardware.radar.settings import Processing
from hardware.reconstruction import method_of
from hardware.records import RadarRecord
from twin.camera.acquisition import measure
from twin.camera.chain import Chain, Powers
from twin.camera.rendered import RenderedLight
from twin.fidelity import Noise
from twin.files import InputError
from twin.radar import RadarCapture, RadarDesign
from twin.radar.acquisition import channel as received
from twin.radar.device.front_end import digitize
from twin.radar.evaluation import joinable, match_detections
from twin.regression.echoes import strong_echoes
from twin.regression.metrics import Metric, RadarResult
from twin.scene import Scene
from twin.system import System

Array = NDArray[np.float64]
#: What `hardware.reconstruct` takes, or a function from a record to an image (rows, columns).
Method = str | Callable[..., Any]
_NOISE_DRAWS = 4  # of which the noise beside echoes is the mean, of some 50 cells each
#: From a record to detections, or what `hardware.Processing` takes.
RadarDetector = str | Callable[..., Any]


class WrongResultError(InputError):
    """A method or detector gives something else than it should."""


@dataclass(frozen=True, eq=False)
class SeedResults:
    """Figures by metric, (n_seeds,) each, with the first seed's truth and every seed's result.

    ``records`` is a digest of what all records hold.
    """

    figures: dict[str, Array]
    truth: Any
    results: list[Any]
    records: str

    def means(self) -> dict[str, float]:
        """Mean figure of each metric."""
        return {name: float(values.mean()) for name, values in self.figures.items()}


def image_method(method: Method) -> Callable[[SpiRecord], Any]:
    """A method as a function from a record to an image, detectors side by side, in electrons.

    What a function of a record gives is not checked here.

    Raises InputError for what is neither a method of `hardware.reconstruct` nor a function of one
    record.
    """
    if not isinstance(method, str) and _takes_a_record(method):
        return lambda record: getattr(result := method(record), "picture", result)
    solve = method_of(method)
    return lambda record: reconstruct(record, solve).picture


def radar_detector(detector: RadarDetector) -> Callable[[RadarRecord], Sequence[Detection]]:
    """A detector as a function from a record to detections. Raises InputError as `image_method`."""
    if not isinstance(detector, str) and _takes_a_record(detector):
        return detector
    own = Processing(detection=detector)
    return lambda record: process(record, how=own).detections


def _takes_a_record(function: Callable[..., Any]) -> bool:
    """Whether a function takes one argument, a record, and not the three of a method or of a
    detection; one that does not say what it takes does.
    """
    try:
        inspect.signature(function).bind("record")
    except TypeError:
        return False
    except ValueError:
        pass
    return True


def records(
    scene: Scene,
    system: System,
    light: RenderedLight,
    seeds: Sequence[int],
    noise: Noise = "full",
    *,
    mirrored: bool = False,
) -> Iterator[SpiRecord]:
    """One record per seed: what `measure` gives, with everything but the draw worked out once.

    ``mirrored``: records of odd seeds are of the scene's mirror image.
    """
    chain = Chain.of(system, scene.sun)
    power = chain.powers(light)
    powers = [power, _mirror(power, chain.patterns) if mirrored else power]
    for seed in seeds:
        rng = np.random.default_rng(seed)
        _, counts, flags = chain.measure_frame(powers[seed % 2], rng=rng, noise=noise)
        yield chain.record(scene.rig.pose, counts, flags)


def _mirror(power: Powers, patterns: Patterns) -> Powers:
    """Left and right exchanged, of cells and of the detectors side by side."""

    def flipped(cells: Array) -> Array:
        image = cells.reshape(*cells.shape[:-1], patterns.rows, patterns.columns)
        return image[..., ::-1, :, ::-1].reshape(cells.shape)

    return Powers(
        flipped(power.cells_w),
        flipped(power.error_w),
        power.sun_w[::-1],
        flipped(power.backscatter_w),
        flipped(power.left_out_w),
        power.sun_error_w[::-1],
        power.sun_left_out_w[::-1],
    )


def true_cells(
    scene: Scene, system: System, light: RenderedLight, *, mirrored: bool = False
) -> tuple[Array, Array]:
    """Electrons of every cell from the scene, what images are compared with, NaN in cells not
    measured; and from the air, which is taken from an image before.
    """
    found = measure(scene, system, light, rng=np.random.default_rng(0), noise="none")
    if mirrored:
        flipped = {name: np.fliplr(getattr(found, name)) for name in ("cells_e", "backscatter_e")}
        found = replace(found, **flipped)
    return found.measured_scene_e, found.backscatter_e


def run_camera(
    scene: Scene,
    system: System,
    light: RenderedLight,
    method: Method,
    seeds: Sequence[int],
    metrics: Sequence[Metric],
    noise: Noise = "full",
    *,
    mirrored: bool = False,
) -> SeedResults:
    """A reconstruction over noise seeds, odd ones of the scene ``mirrored``: an image that does not
    come from its own record is wrong in half of them.

    Raises InputError for an image on another grid, or not of real numbers.
    """
    solve, straight = image_method(method), true_cells(scene, system, light)
    other = true_cells(scene, system, light, mirrored=True) if mirrored else straight
    truths, images, content = [], [], hashlib.sha256()
    taken = records(scene, system, light, seeds, noise, mirrored=mirrored)
    for seed, record in zip(seeds, taken, strict=True):
        content.update(record.counts.tobytes() + record.flags.tobytes())
        truth, backscatter = (straight, other)[seed % 2]
        images.append(_checked(solve(record), truth.shape) - backscatter)
        truths.append(truth)
    return SeedResults(_figures(metrics, truths, images), straight[0], images, content.hexdigest())


def _checked(image: Any, shape: tuple[int, ...]) -> Array:
    expected = f"expected real numbers, {shape}"
    if np.ma.isMaskedArray(image):
        raise WrongResultError(
            f"method: gave a masked array, whose mask no metric knows; {expected}"
        )
    try:
        array = np.asarray(image)
    except ValueError as error:  # lists of unequal lengths
        raise WrongResultError(
            f"method: gave a {type(image).__name__}: {error}; {expected}"
        ) from error
    if array.ndim == 0 or array.dtype.kind not in "fiu":
        what = f"an image of {array.dtype}" if array.ndim else f"a {type(image).__name__}"
        raise WrongResultError(f"method: gave {what}, {expected}")
    if array.shape != shape:
        raise WrongResultError(f"method: gave an image {array.shape}, expected {shape}")
    return array.astype(np.float64)


def run_radar(
    capture: RadarCapture,
    radar: RadarDesign,
    detector: RadarDetector,
    seeds: Sequence[int],
    metrics: Sequence[Metric],
    nufft_tolerance: float,
) -> SeedResults:
    """A detector over noise seeds, judged by the targets that have a direct path.

    Raises InputError where it gives something other than detections.
    """
    truth = tuple(target for target in capture.truth if target.visible)
    quiet = [received(burst, radar, capture.air, nufft_tolerance) for burst in capture.bursts]
    found, content, detect = [], hashlib.sha256(), radar_detector(detector)

    def drawn(seed: int) -> RadarRecord:
        rng = np.random.default_rng(seed)
        taken = [digitize(burst, radar, rng=rng) for burst in quiet]
        iq, flags = (np.stack([burst[i] for burst in taken]) for i in (0, 1))
        return replace(capture.record, iq=iq, flags=flags)

    echoes = strong_echoes([demodulate(joinable(drawn(seed))) for seed in range(_NOISE_DRAWS)])
    wave = echoes.waveform
    for seed in seeds:
        record = drawn(seed)
        content.update(np.ascontiguousarray(record.iq).tobytes() + record.flags.tobytes())
        detections = _detections(detect(record))
        matches = match_detections(detections, truth, wave)
        undetected = echoes.n_undetected(detections)
        found.append(RadarResult(detections, matches, wave.range_cell_m, undetected))
    figures = _figures(metrics, [truth] * len(found), found)
    return SeedResults(figures, truth, found, content.hexdigest())


def in_turn(
    run: Callable[[int, Sequence[int]], SeedResults], n_views: int, seeds: Sequence[int]
) -> SeedResults:
    """Results of several views as one: seed i is of view i modulo their number, ``run(view,
    seeds)`` gives those of one.
    """
    if n_views == 1:
        return run(0, seeds)
    of_view = [seed % n_views for seed in seeds]
    parts = {k: run(k, [s for s in seeds if s % n_views == k]) for k in sorted(set(of_view))}
    place = [of_view[:i].count(k) for i, k in enumerate(of_view)]
    figures = {
        name: np.array([parts[k].figures[name][i] for k, i in zip(of_view, place, strict=True)])
        for name in next(iter(parts.values())).figures
    }
    results = [parts[k].results[i] for k, i in zip(of_view, place, strict=True)]
    digests = "".join(part.records for part in parts.values())
    first = parts[of_view[0]].truth
    return SeedResults(figures, first, results, hashlib.sha256(digests.encode()).hexdigest())


def repeated(
    run: Callable[[Sequence[int]], SeedResults],
    outcome: SeedResults,
    seeds: Sequence[int],
    times: int,
) -> bool:
    """Whether a method gives the figures of ``outcome``, of seeds from 0 on, again at each of these
    seeds, as many times.
    """
    for _ in range(times if seeds else 0):
        again = run(seeds).figures
        for name, values in outcome.figures.items():
            if not np.allclose(again[name], values[list(seeds)], rtol=1e-9, atol=0, equal_nan=True):
                return False
    return True


def _detections(found: Any) -> tuple[Detection, ...]:
    if not isinstance(found, Iterable):
        raise WrongResultError(f"detector: gave a {type(found).__name__}, expected detections")
    detections = tuple(found)
    for one in detections:
        if not isinstance(one, Detection):
            raise WrongResultError(
                f"detector: gave a {type(one).__name__}, expected hardware's Detection"
            )
    return detections


def vehicle_detector(record: RadarRecord) -> list[Detection]:
    """What rides on the vehicle, with its own settings."""
    return list(process(record).detections)


def _figures(
    metrics: Sequence[Metric], truths: Sequence[Any], results: Sequence[Any]
) -> dict[str, Array]:
    pairs = list(zip(truths, results, strict=True))
    return {m.name: np.array([m.of(truth, result) for truth, result in pairs]) for m in metrics}

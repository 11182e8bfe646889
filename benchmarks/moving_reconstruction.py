"""Motion compensation: what of the loss between a frame at rest and a moving one it regains.

64 x 64 cells, differential patterns, a frame in which the scene moves by 20 cells: 6 down, 19 to
the right. Each method against itself: (PSNR compensated - as static) / (at rest - as static), of
mean decibels, peak 1. Scenes are those of `benchmarks.moving_pictures`, none of them tuned on.
At rest the prior is 1/f^2; that of a moving image is fitted to its measurements, so that more than
all of the loss may be regained: the image with the prior 1/f^2 stands beside it.

Short sets: fewer patterns, coarse ones, at the same rate, so that the scene moves by less within
each; taken as static and compensated, beside whole sets, on all scenes by the linear method. Each
image is compared with the scene at the middle of its own set.

Objects of their own motion: a box of 24 x 24 cells of one picture, which moves by (-4, -12) cells
before another one that moves by (2, 6), by the motion of both, of what is behind alone, and none.

``python -m benchmarks moving_reconstruction`` prints all of it, ``python -m
benchmarks.moving_reconstruction short`` the parts named: known, unknown, short, objects, static.
"""

import sys
import time
from collections.abc import Iterator
from functools import lru_cache

import numpy as np

from benchmarks.moving_pictures import (
    ELECTRONS,
    BoxedScene,
    FineScene,
    dead_leaves,
    held_out_pictures,
    record_of,
)
from benchmarks.timing import Figure, Timing
from hardware import (
    Compensation,
    Layers,
    Motion,
    MovingBox,
    PatternSet,
    Reconstruction,
    Search,
    Shift,
    SpiRecord,
    reconstruct,
)

MOVED = (6.0, 19.0)
NOISE = (0.1, 0.03, 0.01)
SHIFT = Shift(*MOVED)
QUICK = Compensation(error_samples=0)
_FIXED = Compensation(error_samples=0, prior_rows=0)
_SETS = (("interleaved", 4096), ("interleaved", 128), ("sequency", 4096))
_SHORT = (128, 256, 512, 1024)
_LEAVES = 6
#: Scenes of each kind in which motion is looked for, seconds each, and their noise.
_SEARCHED, _SEARCHED_NOISE = 5, (0.1, 0.01)


def figures(*parts: str) -> Iterator[Figure]:
    """Those of the parts named, of all where none is."""
    of_part = {
        "known": _known,
        "unknown": _unknown,
        "short": _short,
        "objects": _objects,
        "static": _static,
    }
    for part in parts or of_part:
        yield from of_part[part]()


@lru_cache(maxsize=4)
def _scenes(kind: str) -> tuple[FineScene, ...]:
    if kind == "pictures":
        return held_out_pictures()
    return tuple(dead_leaves(1000 + k) for k in range(_LEAVES))


@lru_cache(maxsize=512)
def _record(kind: str, scene: int, order: str, count: int, moves: bool, noise: float) -> SpiRecord:
    patterns = PatternSet(64, 64, count, order)  # type: ignore[arg-type]
    moved = MOVED if moves else (0.0, 0.0)
    return record_of(_scenes(kind)[scene], patterns, moved, noise, seed=scene)


def _image(record: SpiRecord, method: str, motion: Motion | Search | None) -> Reconstruction:
    return reconstruct(record, method, motion=motion, compensation=QUICK)


def _decibels(found: Reconstruction, scene: FineScene | BoxedScene) -> float:
    error = found.image[0] / ELECTRONS - scene.cells(0.0, 0.0)
    return float(-10 * np.log10(np.mean(error**2)))


def _known() -> Iterator[Figure]:
    for kind in ("pictures", "dead leaves"):
        for count in (4096, 128):
            for noise in NOISE:
                for method in ("lmmse", "tv"):
                    rows, seconds, plain = [], [], []
                    for k, scene in enumerate(_scenes(kind)):
                        moving, resting = (
                            _record(kind, k, "interleaved", count, moves, noise)
                            for moves in (True, False)
                        )
                        start = time.process_time()
                        found = _image(moving, method, SHIFT)
                        seconds.append(time.process_time() - start)
                        images = (
                            _image(resting, method, None),
                            _image(moving, method, None),
                            found,
                        )
                        rows.append([_decibels(image, scene) for image in images])
                        if method == "lmmse":
                            fixed = reconstruct(moving, motion=SHIFT, compensation=_FIXED)
                            plain.append(_decibels(fixed, scene))
                    label = f"known motion, {kind}, {count} patterns, noise {noise:g}, {method}"
                    yield from _told(label, rows)
                    if plain:
                        rest, static, _ = np.mean(rows, axis=0)
                        share = (np.mean(plain) - static) / (rest - static)
                        yield f"{label}: gap closed with the prior 1/f^2", float(share), ""
                    low, median, high = np.percentile(seconds, [25, 50, 75])
                    took = Timing(float(median), float(low), float(high), len(seconds), "CPU")
                    yield f"{label}: time", took, ""


def _told(label: str, rows: list[list[float]]) -> Iterator[Figure]:
    rest, static, found = np.mean(rows, axis=0)
    yield f"{label}: at rest", float(rest), "dB"
    yield f"{label}: moving, as static", float(static), "dB"
    yield f"{label}: compensated", float(found), "dB"
    yield f"{label}: gap closed", float((found - static) / (rest - static)), ""


def _unknown() -> Iterator[Figure]:
    """The motion is found once, with the linear method, and taken by the other too."""
    for kind in ("pictures", "dead leaves"):
        for noise in _SEARCHED_NOISE:
            for order, count in _SETS:
                rows: dict[str, list[list[float]]] = {"lmmse": [], "tv": []}
                errors = []
                for k, scene in enumerate(_scenes(kind)[:_SEARCHED]):
                    moving, resting = (
                        _record(kind, k, order, count, moves, noise) for moves in (True, False)
                    )
                    found = _image(moving, "lmmse", Search())
                    shift = found.motion if isinstance(found.motion, Shift) else Shift(0.0, 0.0)
                    errors.append(
                        np.hypot(
                            shift.down_cells_per_s - MOVED[0], shift.right_cells_per_s - MOVED[1]
                        )
                    )
                    for method, of_method in rows.items():
                        images = (
                            _image(resting, method, None),
                            _image(moving, method, None),
                            found if method == "lmmse" else _image(moving, method, found.motion),
                        )
                        of_method.append([_decibels(image, scene) for image in images])
                label = f"unknown motion, {kind}, {count} {order}, noise {noise:g}"
                yield f"{label}: median error of the motion", float(np.median(errors)), "cells"
                for method, of_method in rows.items():
                    yield from _told(f"{label}, {method}", of_method)


def _short() -> Iterator[Figure]:
    for kind in ("pictures", "dead leaves"):
        for noise in NOISE:
            rows = [_whole_and_short(kind, k, noise) for k in range(len(_scenes(kind)))]
            for name in rows[0]:
                mean = float(np.mean([row[name] for row in rows]))
                yield f"short sets, {kind}, noise {noise:g}: {name}", mean, "dB"


def _whole_and_short(kind: str, scene: int, noise: float) -> dict[str, float]:
    """Decibels of a whole set's images and of those of short sets, by what they are."""
    truth = _scenes(kind)[scene]
    whole = _record(kind, scene, "interleaved", 4096, True, noise)
    motions = {"as static": None, "known motion": SHIFT, "estimated motion": Search()}
    found = {
        f"whole set, {name}": _decibels(_image(whole, "lmmse", motion), truth)
        for name, motion in motions.items()
    }
    for count in _SHORT:
        moved = (MOVED[0] * count / 4096, MOVED[1] * count / 4096)
        record = record_of(truth, PatternSet(64, 64, count), moved, noise, seed=scene)
        for name, motion in (("as static", None), ("known motion", Shift(*moved))):
            image = _image(record, "lmmse", motion)
            found[f"{count} patterns, {name}"] = _decibels(image, truth)
    return found


def _objects() -> Iterator[Figure]:
    edges = (19.5, 19.5, 43.5, 43.5)
    behind, near = Shift(2.0, 6.0), Shift(-4.0, -12.0)
    motions = {
        "both": Layers(behind, (MovingBox(*edges, near),)),
        "what is behind": behind,
        "none": None,
    }
    pictures = _scenes("pictures")
    for count in (4096, 512):
        patterns = PatternSet(64, 64, count, "interleaved")
        rows = []
        for k in range(_SEARCHED):
            scene = BoxedScene(pictures[k], pictures[k + 1], edges)
            moving = record_of(scene, patterns, (2.0, 6.0), 0.03, seed=k)
            resting = record_of(scene, patterns, (0.0, 0.0), 0.03, seed=k)
            images = [_image(moving, "lmmse", motion) for motion in motions.values()]
            rows.append(
                [_decibels(one, scene) for one in (*images, _image(resting, "lmmse", None))]
            )
        means = np.mean(rows, axis=0)
        for name, value in zip((*motions, "at rest"), means, strict=True):
            told = name if name == "at rest" else f"by the motion of {name}"
            yield f"an object of its own motion, {count} patterns: {told}", float(value), "dB"
        closed = (means[0] - means[2]) / (means[3] - means[2])
        yield f"an object of its own motion, {count} patterns: gap closed", float(closed), ""


def _static() -> Iterator[Figure]:
    losses: list[float] = []
    moved = 0
    for kind in ("pictures", "dead leaves"):
        for order, count in _SETS:
            for noise in _SEARCHED_NOISE:
                for k, scene in enumerate(_scenes(kind)[:_SEARCHED]):
                    resting = _record(kind, k, order, count, False, noise)
                    found = _image(resting, "lmmse", Search())
                    moved += found.motion is not None
                    without = _image(resting, "lmmse", None)
                    losses.append(_decibels(without, scene) - _decibels(found, scene))
    yield "at rest: frames", float(len(losses)), ""
    yield "at rest: frames in which motion was found", float(moved), ""
    yield "at rest: largest loss by the search", float(np.max(losses)), "dB"


if __name__ == "__main__":
    for name, value, unit in figures(*sys.argv[1:]):
        told = f"{value.median_s:.3g} s" if isinstance(value, Timing) else f"{value:.4g} {unit}"
        print(f"{name}: {told}", flush=True)

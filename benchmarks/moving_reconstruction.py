"""Motion compensation: what of the loss between a frame at rest and a moving one it regains.

64 x 64 cells, differential patterns, a frame in which the scene moves by 20 cells: 6 down, 19 to
the right. Each method against itself: (PSNR compensated - as static) / (at rest - as static), of
mean decibels, peak 1. Scenes are those of `benchmarks.moving_pictures`, none of them tuned on.
"""

import time
from collections.abc import Iterator
from functools import lru_cache

import numpy as np

from benchmarks.moving_pictures import (
    ELECTRONS,
    FineScene,
    dead_leaves,
    held_out_pictures,
    record_of,
)
from benchmarks.timing import Figure, Timing
from hardware import Compensation, Motion, PatternSet, Search, Shift, SpiRecord, reconstruct

MOVED = (6.0, 19.0)
NOISE = (0.1, 0.03, 0.01)
SHIFT = Shift(*MOVED)
QUICK = Compensation(error_samples=0)
_STATIC_NOISE = (0.3, *NOISE)
_LEAVES = 6


def figures() -> Iterator[Figure]:
    yield from _known()
    yield from _unknown()
    yield from _static()


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


def _decibels(
    kind: str, order: str, count: int, moves: bool, noise: float, method: str,
    motion: Motion | Search | None,
) -> list[float]:  # fmt: skip
    found = []
    for k, scene in enumerate(_scenes(kind)):
        record = _record(kind, k, order, count, moves, noise)
        image = reconstruct(record, method, motion=motion, compensation=QUICK).image[0] / ELECTRONS
        found.append(-10 * np.log10(np.mean((image - scene.cells(0.0, 0.0)) ** 2)))
    return found


def _known() -> Iterator[Figure]:
    for kind in ("pictures", "dead leaves"):
        for count in (4096, 128):
            for method in ("lmmse", "tv"):
                for noise in NOISE:
                    start = time.process_time()
                    found = _decibels(kind, "interleaved", count, True, noise, method, SHIFT)
                    took = (time.process_time() - start) / len(found)
                    static = _decibels(kind, "interleaved", count, True, noise, method, None)
                    rest = _decibels(kind, "interleaved", count, False, noise, method, None)
                    label = f"known motion, {kind}, {count} patterns, {method}, noise {noise:g}"
                    yield f"{label}: at rest", float(np.mean(rest)), "dB"
                    yield f"{label}: moving, as static", float(np.mean(static)), "dB"
                    yield f"{label}: compensated", float(np.mean(found)), "dB"
                    gap = np.mean(rest) - np.mean(static)
                    yield (
                        f"{label}: gap closed",
                        float((np.mean(found) - np.mean(static)) / gap),
                        "",
                    )
                    yield f"{label}: CPU time", Timing(took, took, took, len(found)), ""


def _unknown() -> Iterator[Figure]:
    for kind in ("pictures", "dead leaves"):
        for noise in NOISE:
            for order, count in (("interleaved", 4096), ("interleaved", 128), ("sequency", 4096)):
                for method in ("lmmse", "tv") if order == "interleaved" else ("lmmse",):
                    if method == "tv" and count == 128:
                        continue
                    found = _decibels(kind, order, count, True, noise, method, Search())
                    static = _decibels(kind, order, count, True, noise, method, None)
                    rest = _decibels(kind, order, count, False, noise, method, None)
                    gap = np.mean(rest) - np.mean(static)
                    label = f"unknown motion, {kind}, {count} {order}, {method}, noise {noise:g}"
                    yield f"{label}: compensated", float(np.mean(found)), "dB"
                    yield (
                        f"{label}: gap closed",
                        float((np.mean(found) - np.mean(static)) / gap),
                        "",
                    )


def _static() -> Iterator[Figure]:
    losses, taken = [], 0
    for kind in ("pictures", "dead leaves"):
        for order, count in (("interleaved", 4096), ("interleaved", 128), ("sequency", 4096)):
            for noise in _STATIC_NOISE:
                found = _decibels(kind, order, count, False, noise, "lmmse", Search())
                without = _decibels(kind, order, count, False, noise, "lmmse", None)
                losses += [a - b for a, b in zip(without, found, strict=True)]
                taken += int(np.count_nonzero(np.abs(losses[-len(found) :]) > 0))
    yield "at rest: frames", float(len(losses)), ""
    yield "at rest: frames in which motion was found", float(taken), ""
    yield "at rest: largest loss by the search", float(np.max(losses)), "dB"

"""Extremes of pattern sets: one pattern, a million, and the largest sums."""

import math

import mpmath as mp
import numpy as np

from hardware import PatternSet, reconstruct
from hardware.patterns import fwht
from tests.extremes import oracle
from tests.extremes.case import Case, Found
from tests.extremes.light import expected_electrons
from tests.extremes.worlds import camera, light_stated, look, scene, square
from twin.fidelity import Fidelity

#: Stated by `fwht`: additions in float64, log2(n) of them one after another.
_EXACT = 20 * 2.0**-53


def _signal(rows: int, columns: int, count: int) -> Found:
    """Light of chosen patterns by exact sums over their lit cells (math.fsum)."""
    patterns = PatternSet(rows, columns, count)
    cells = np.random.default_rng(1).uniform(0, 1e-9, patterns.n_cells)
    found = patterns.signal(cells)
    errors = [0.0]
    for which in sorted({0, 1, 2, 2 * count // 3, 2 * count - 1}):
        if which >= len(found):
            continue
        mask = patterns.masks(slice(which, which + 1)).ravel()
        exact = math.fsum(cells[mask > 0])
        errors.append(abs(found[which] - exact) / math.fsum(cells))
    return Found(max(errors), _EXACT)


def _frame(side: int) -> Found:
    """A frame without noise, reconstructed: total and every pixel as promised.

    Electrons within the closed form; each pixel within what rounding to counts leaves, 6 sigma.
    """
    system = camera(
        emitter__rows=side,
        emitter__columns=side,
        acquisition__n_patterns=side * side,
        readout__adc_offset_v=0.0,
    )
    fidelity = Fidelity(samples=4 if side > 1 else 4096, max_depth=1, noise="none")
    with scene(square((5.0, 0, 0), 10.0), sun_lx=0.0) as world:
        taken = look(world, system, fidelity)
    picture = reconstruct(taken.record, "zero-fill").picture
    step = taken.record.electrons_per_count
    pixel = 6 * np.sqrt(2 / 12) * step / side
    worst = float(np.abs(picture - taken.cells_e).max() / pixel) if side > 1 else 0.0
    exact = expected_electrons(system, 5.0, 0.5)
    error = oracle.relative(float(picture.sum()), exact)
    if worst > 1:
        return Found(worst, 1.0)
    # All of the first pattern's rounding falls on the sum, half a count of each of two exposures.
    stated = light_stated(taken, exact) + float(step / exact)
    return Found(error, stated, warnings=taken.warnings)


def _large_sums(mean: float) -> Found:
    """Sums of 4096 cells of 1e15 electrons against Python's integers."""
    cells = np.random.default_rng(2).integers(0, int(2 * mean), 4096)
    found = fwht(cells)
    exact = [int(x) for x in cells]
    half = 1
    while half < len(exact):
        exact = [
            exact[i - half] - exact[i] if i & half else exact[i] + exact[i + half]
            for i in range(len(exact))
        ]
        half *= 2
    largest = max(abs(x) for x in exact)
    return Found(max(abs(int(f) - x) for f, x in zip(found, exact, strict=True)) / largest, _EXACT)


def _lmmse(side: int, count: int) -> Found:
    patterns = PatternSet(side, side, count)
    from hardware.reconstruction import METHODS, Sensing

    image, _ = METHODS["lmmse"](np.ones(count), 1.0, Sensing(patterns))
    return Found(oracle.relative(float(image.sum()), mp.mpf(1)), 1e-9)


def _bare(side: int) -> Found:
    camera(
        emitter__rows=side,
        emitter__columns=side,
        emitter__projection="none",
        emitter__pitch_m=1e-3,
        emitter__viewing_angle_deg=20.0,
    )
    return Found(0.0, 0.0)


def cases() -> list[Case]:
    """All of this room."""
    return [
        Case("patterns", "one, of one cell", "math.fsum", lambda: _signal(1, 1, 1)),
        Case("patterns", "one, of 4096 cells", "math.fsum", lambda: _signal(64, 64, 1)),
        Case("patterns", "1 048 576", "math.fsum", lambda: _signal(1024, 1024, 2**20)),
        Case("patterns", "1 048 576 in one column", "math.fsum", lambda: _signal(2**20, 1, 2**20),
             slow=True),
        Case("patterns", "one, a whole frame", "mpmath: integral over the field",
             lambda: _frame(1)),
        Case("patterns", "1 048 576, a whole frame", "mpmath: integral over the field",
             lambda: _frame(1024), slow=True),
        Case("patterns", "2 097 152", "-", lambda: _bad_count(), "error", "n_patterns"),
        Case("patterns", "2^18 of 2^20, LMMSE", "-", lambda: _lmmse(1024, 2**18), "error",
             "GiB"),
        Case("patterns", "65 536 bare LEDs", "-", lambda: _bare(256), "error",
             "rows x columns"),
        Case("counts", "1e15 in 4096 cells", "Python's integers", lambda: _large_sums(1e15)),
        Case("counts", "1e11 in 4096 cells", "Python's integers", lambda: _large_sums(1e11)),
    ]  # fmt: skip


def _bad_count() -> Found:
    camera(acquisition__n_patterns=2**21)
    return Found(0.0, 0.0)

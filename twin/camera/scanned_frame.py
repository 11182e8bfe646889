"""Light of a frame in motion of a receiver that is scanned: each cell at its own exposure's time.

A cell's light counts while it is lit, and its sun while it is looked at, so that one render has all
of them: paths of a cell are of times within its own exposure.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hardware.patterns import RasterScan
from twin.camera.chain import Chain
from twin.camera.equal_paths import sun_shape
from twin.camera.exposures import Exposures
from twin.camera.light import render_light
from twin.camera.motion import WorldInMotion
from twin.camera.truth import Truth, depths
from twin.fidelity import Fidelity
from twin.optics.problem import LightProblem

Array = NDArray[np.float64]

#: Times within an exposure: the mean over it is a sum of these.
TIMES = 8


def scanned_light(
    world: WorldInMotion,
    chain: Chain,
    problem: LightProblem,
    fidelity: Fidelity,
    seeds: Sequence[np.random.SeedSequence],
) -> tuple[Array, Array]:
    """Mean signal and sunlight of every exposure, W, as `FrameLight` has them; ``problem``: of the
    start of the frame.
    """
    system, scan = chain.system, chain.patterns
    shape, cell_times = system.image_shape, _times(chain)
    # The emitter's light of cells; the sun's of parts of a field twice as wide, on the same grid.
    of_parts = _of_parts(cell_times.reshape(*shape, TIMES), sun_shape(system))
    scenes = [world.scene_at(times.ravel()) for times in (cell_times, of_parts)]
    sun = world.sun_directions(of_parts.ravel())
    # Of corners and bodies at many times no bounds are known.
    whole = replace(problem, scene=scenes[0], instants=TIMES, corners=None, bodies=None)
    depth = depths(whole.scene, whole.emitter, shape, np.arange(scan.n_cells) * TIMES + TIMES // 2)
    rendered = render_light(
        whole,
        chain,
        Truth(np.zeros(shape), depth),
        fidelity,
        seeds,
        sun_problem=replace(whole, scene=scenes[1], sun_direction=sun),
    )
    power = chain.powers(rendered)
    signal_w = chain.mean_signal(power)
    sun_w = np.broadcast_to(power.sun_by_exposure(scan), signal_w.shape)
    return signal_w, np.array(sun_w)


def _times(chain: Chain) -> Array:
    """Times at which each cell is lit, (n_cells, TIMES), s from the start of the frame; of one that
    never is, the start.
    """
    scan, exposures = chain.patterns, Exposures.of(chain.system)
    assert isinstance(scan, RasterScan)  # all that is scanned
    each = scan.n_exposures // scan.count
    starts = exposures.starts_s.reshape(scan.n_exposures, -1).mean(axis=1)[::each]
    share = (np.arange(TIMES) + 0.5) / TIMES
    times = np.zeros((scan.n_cells, TIMES))
    times[scan.cells] = starts[:, None] + share * exposures.integration_s
    return times


def _of_parts(cell_times: Array, parts: tuple[int, int]) -> Array:
    """The same of the parts of the sun's light, (rows, columns, TIMES): of the cell in the same
    direction, or the nearest.
    """
    (rows, columns), (high, wide) = cell_times.shape[:2], parts
    row = np.clip(np.arange(high) - (high - rows) // 2, 0, rows - 1)
    column = np.clip(np.arange(wide) - (wide - columns) // 2, 0, columns - 1)
    return cell_times[np.ix_(row, column)]

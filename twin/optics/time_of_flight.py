"""Transport with the length of every path: phase and gates from one render.

The response of a modulated emitter and a gated detector to a path depends on its length alone. So
the paths are traced once, and each shutter is a sum over them, in float64.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import drjit as dr
import numpy as np
from numpy.typing import NDArray
from scipy import constants

from twin.optics.paths import TracingQuality
from twin.optics.problem import LightProblem
from twin.optics.ray_sets import strata
from twin.optics.transport import path_moments, variance_of_direct
from twin.optics.unseen import FacetsByLength, missed_facet_variance

Array = NDArray[np.float64]
#: Share of the light that counts, for path lengths in metres (any shape).
Response = Callable[[Array], Array]


@dataclass(frozen=True, eq=False)
class Paths:
    """Every contribution of the cells of an emitter to a detector.

    ``value`` (n_cells, n) in 1/m^2, so that its sum over the last axis is `transport`; ``length_m``
    (n_cells, n), from emitter to detector; ``shape`` (rows, columns) of the cells. ``samples``: of
    paths drawn by chance their number in a cell, of which each bounce is one of ``value``; 0: none
    is. ``facets``: what may be that all paths of a cell missed.
    """

    value: NDArray[np.float32]
    length_m: NDArray[np.float32]
    shape: tuple[int, int]
    samples: int = 0
    facets: FacetsByLength | None = None

    def light(self, response: Response | None = None) -> Array:
        """Light of each cell, (rows, columns), each path weighted by the response to its length."""
        value = self.value.astype(np.float64)
        if response is not None:
            value *= response(self.length_m.astype(np.float64))
        return value.sum(axis=-1).reshape(self.shape)

    @property
    def standard_error(self) -> Array:
        """Of the light without a response, (rows, columns), as that of `twin.optics.transport`, and
        by facets that all paths of a cell may have missed.
        """
        return self._error(self.value.astype(np.float64), 1.0)

    def behind(
        self, responses: Sequence[Response], largest: Callable[[Array, Array], Array]
    ) -> tuple[Array, Array]:
        """Light that each response weights, (n, rows, columns), and the standard error of their
        sum, (rows, columns).

        ``largest`` gives the largest sum of the responses to lengths from some to others, (n,).
        """
        arrives = np.flatnonzero(self.value)  # most paths end without light
        value, length_m = (
            x.ravel()[arrives].astype(np.float64) for x in (self.value, self.length_m)
        )
        cell, light, share = arrives // self.value.shape[1], [], np.zeros_like(value)
        for response in responses:
            weight = response(length_m)
            light.append(np.bincount(cell, value * weight, len(self.value)).reshape(self.shape))
            share += weight
        together = np.zeros(self.value.shape)
        together.ravel()[arrives] = value * share
        of_facets: Array | float = 1.0
        if self.facets is not None:
            of_facets = largest(self.facets.shortest_m, self.facets.longest_m)[:, None, None]
        return np.array(light), self._error(together, of_facets)

    def _error(self, value: Array, of_facets: Array | float) -> Array:
        """Of the light of weighted paths; ``of_facets``: weights of each part of `facets`."""
        if not self.samples:
            return np.zeros(self.shape)
        # Over all bounces of a path.
        paths = value.reshape(len(value), -1, self.samples).sum(axis=1) * self.samples
        wide, _ = strata(self.samples, self.shape[0] / self.shape[1])
        moments = path_moments(paths.ravel(), self.samples, wide)
        mean, scatter = (x.reshape(self.shape) for x in moments)
        variance = variance_of_direct(mean, scatter, self.samples)
        if self.facets is not None:
            brightest = (of_facets * self.facets.light).max(axis=0, initial=0.0)
            variance += missed_facet_variance(brightest, mean, self.samples)
        return np.asarray(np.sqrt(variance))

    def phasor(self, modulation_hz: float) -> NDArray[np.complex128]:
        """Sum of a exp(-2 pi j f L / c), (rows, columns): amplitude and phase of each cell when the
        emitter's power is modulated at f.
        """
        wave = -2 * np.pi * modulation_hz / constants.c * self.length_m.astype(np.float64)
        value = self.value.astype(np.float64)
        real, imaginary = (value * np.cos(wave)).sum(axis=-1), (value * np.sin(wave)).sum(axis=-1)
        return (real + 1j * imaginary).reshape(self.shape)


def trace_paths(
    problem: LightProblem, shape: tuple[int, int], *, quality: TracingQuality, seed: int
) -> Paths:
    """Trace the direct and indirect paths of every cell to the detector, with their lengths.

    Memory: 8 bytes for each of cells x samples x bounces.
    """
    tracer = problem.from_emitter(shape, quality, seed)
    values, lengths = [], []
    for bounce in tracer.bounces((0, tracer.start.rows), 1 / quality.samples):
        dr.eval(bounce.value, bounce.length)
        values.append(np.array(bounce.value).reshape(tracer.start.size, -1))
        lengths.append(np.array(bounce.length).reshape(tracer.start.size, -1))
    value, length_m = (np.concatenate(x, axis=1) for x in (values, lengths))
    return Paths(value, length_m, shape, quality.samples, problem.facets_by_length(shape))


def phase_shutter(modulation_hz: float, phase_rad: float, contrast: float = 1.0) -> Response:
    """One phase of a lock-in measurement: a detector sensitive half of the time, synchronous with
    the modulation, (1 + contrast cos(2 pi f L / c - phase)) / 2.
    """
    k = 2 * np.pi * modulation_hz / constants.c
    return lambda length_m: (1 + contrast * np.cos(k * length_m - phase_rad)) / 2


def gate(pulse_width_s: float, delay_s: float, width_s: float, pulse_rate_hz: float) -> Response:
    """Share of the light of rectangular pulses that returns while a gate is open.

    Each pulse leaves from 0 to ``pulse_width_s``; the gate is open from ``delay_s`` for ``width_s``
    after each, no longer than until the next. An echo that comes back after the next pulse or a
    later one is seen after that.
    """
    period_s = 1 / pulse_rate_hz

    def response(length_m: Array) -> Array:
        delay = length_m / constants.c
        latest = float(np.max(delay, initial=0.0))
        if latest >= period_s:
            delay, latest = delay % period_s, period_s
        share = seen(delay)
        if latest + pulse_width_s - period_s > delay_s:
            # The end of an echo that begins before the next pulse may come back after it.
            share = share + seen(delay - period_s)
        return share

    def seen(delay: Array) -> Array:
        first = np.maximum(delay, delay_s)
        last = np.minimum(delay + pulse_width_s, delay_s + width_s)
        return np.maximum(last - first, 0) / pulse_width_s

    return response

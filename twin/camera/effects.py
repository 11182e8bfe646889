"""Decisions on effects of a camera's light that need no further paths, with their bounds."""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from twin.accuracy import Decision
from twin.camera.air import THIN, scattering_depth
from twin.camera.chain import Chain
from twin.camera.permitted_error import PermittedError
from twin.camera.rendered import RenderedLight
from twin.fidelity import Fidelity
from twin.optics.adaptive import LEFT_OUT
from twin.optics.problem import LightProblem
from twin.optics.radiometry import FAR, collection
from twin.optics.spectra import in_band_fraction
from twin.system import System

Array = NDArray[np.float64]

#: What is always modelled, since it takes no further paths.
_ALWAYS = "always taken, at no cost"
_OF_LIGHT = "of a cell's light"
#: Optical depth of a path from which on all of its light is lost; squares of exp stay finite.
_OPAQUE = 100.0


def decisions_on_effects(
    rendered: RenderedLight,
    problem: LightProblem,
    chain: Chain,
    fidelity: Fidelity,
    air_cost_s: float,
    lost_share: float = 0.0,
) -> tuple[Decision, ...]:
    """On the filter's angle shift, air, the pupil's area, and blur: of those that a system has.

    ``rendered``: with the air's light, which took ``air_cost_s``; ``problem``: with the pupil as it
    was rendered; ``lost_share``: `lost_orders` of the light of surfaces. Effects on the light are
    relative to the noise, as that of the other decisions; with time of flight to the light, root
    mean square over the cells.
    """
    cells = rendered.light.cells
    # The noise of all cells and gates would take seconds, for effects that are taken anyway.
    permitted = None if chain.system.time_of_flight else PermittedError(chain, rendered, fidelity)
    if permitted is None:
        each, tolerance, unit = np.full_like(cells, _rms(cells)), 0.0, _OF_LIGHT
    else:
        tolerance, unit = permitted.tolerance_of(cells), permitted.unit
        each = permitted.unit_of(cells)

    def on_light(effect: str, change: Array, each: Array = each, cost_s: float = 0.0) -> Decision:
        # No change counts nowhere, be it of no light.
        with np.errstate(divide="ignore"):  # any change is too much where none is permitted
            over = _rms(np.divide(change, each, out=np.zeros_like(change), where=change > 0))
        return Decision("camera", effect, over, LEFT_OUT * tolerance, unit, True, cost_s)

    found = [_on_pupil(rendered, problem, chain.system)]
    if chain.system.filter.effective_index is not None and chain.system.emitter.has_lens:
        passed = chain.passed(rendered)
        straight = np.full_like(passed, in_band_fraction(chain.system.emitter, chain.system.filter))
        # As power: through a filter that lets nothing pass at an angle there is no light left to
        # compare with.
        change_w = chain.watts(np.abs(straight - passed)) * cells
        each_w = chain.watts(straight) * each
        if permitted is not None and fidelity.light_tolerance is not None:
            each_w = permitted.noise_w(cells)
        found.append(on_light(f"the filter's shift with angle, {_ALWAYS}", change_w, each_w))
    if (air := problem.air) is not None:
        assert rendered.backscatter is not None  # rendered for a system with air
        depth = scattering_depth(air, rendered.truth.depth_m)
        scatters = depth >= THIN and fidelity.air_orders > 0
        veil, path_m = rendered.backscatter.light, 2 * rendered.half_paths_m().reshape(1, -1)
        if veil.shape == path_m.shape:
            # Where scattering is not traced its forward peak counts as unscattered.
            lost_per_m = air.extinction_per_m if scatters else air.surface_extinction_per_m
            is_seen = np.isfinite(path_m)
            from_surfaces = np.where(is_seen, rendered.light.cells - veil, 0.0)
            path_depth = lost_per_m * np.where(is_seen, path_m, 0.0)
            grown = np.expm1(np.minimum(path_depth, _OPAQUE))
            effect = f"the air's extinction of direct light, {_ALWAYS}"
            found.append(on_light(effect, from_surfaces * grown))
        found.append(on_light("veil of light that the air scatters back", veil, cost_s=air_cost_s))
        effect = "light that the air scatters into other cells"
        if fidelity.air_orders == 0:
            effect += " (fidelity.air_orders = 0)"
        found.append(Decision("camera", effect, depth, THIN, _OF_LIGHT, scatters))
        if lost_share:
            effect = f"light that the air scatters more than {fidelity.air_orders} times"
            beyond = on_light(effect, lost_share * (rendered.light.cells - veil))
            found.append(replace(beyond, taken=False, cost_s=math.nan))
    return (*found, *_on_blur(problem))


def _on_pupil(rendered: RenderedLight, problem: LightProblem, system: System) -> Decision:
    """Of a pupil of radius R at the distance d a point takes (R / d)^2 too much."""
    lens, nearest_m = collection(system), float(rendered.truth.depth_m.min(initial=math.inf))
    with np.errstate(divide="ignore"):
        bound = float((np.float64(lens.pupil_diameter_m / 2) / nearest_m) ** 2)
    detector = problem.detector
    taken = bool(detector.disc_radius_m or detector.pupil_radius_m)
    effect = "the area of the detector's pupil"
    return Decision("camera", effect, bound, FAR**-2, _OF_LIGHT, taken, 0.0 if taken else math.nan)


def _on_blur(problem: LightProblem) -> list[Decision]:
    """Blur and defocus move a point's light to other cells: of what is smaller than a cell there
    may be all of it, so that no bound is known.
    """
    devices = (("emitter", problem.emitter), ("detector", problem.detector))
    blurs = [f"blur of the {name}" for name, device in devices if device.blur_tan]
    if problem.detector.pupil_radius_m:
        blurs.append("defocus of the detector")
    return [
        Decision("camera", f"{blur}, {_ALWAYS}", math.inf, 0.0, _OF_LIGHT, True, 0.0)
        for blur in blurs
    ]


def _rms(values: Array) -> float:
    return math.sqrt(float(np.mean(values**2)))

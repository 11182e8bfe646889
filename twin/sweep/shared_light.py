"""Light of a study's points: rendered once for all that differ only after it.

With a fixed number of paths, what is rendered does not depend on the sensor's noise. To a tolerance
it does: the light is then as fine as the point asks whose noise permits the least, and the sun's as
fine as the point asks to whose noise it adds most. So which points share a render follows from the
study alone, and not from which of them is computed first.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.camera.chain import Chain
from twin.camera.equal_paths import sun_shape
from twin.camera.light import render
from twin.camera.mounting import devices
from twin.camera.permitted_error import PermittedError
from twin.camera.reflectance_rescaling import can_rescale, render_unit_reflectance
from twin.camera.render_warnings import tolerance_warnings
from twin.camera.rendered import DetectorLight, RenderedLight
from twin.camera.truth import Truth
from twin.fidelity import Fidelity
from twin.scene import Sun
from twin.sweep.inputs import ChangedError, Held, Inputs
from twin.sweep.setup import Setup, setup
from twin.sweep.study import Study
from twin.system import System

Array = NDArray[np.float64]
#: What the noise of a point depends on beside the light.
Sensor = tuple[System, Sun]

#: Of points that share light, renders until one is within what all of them permit.
_MOST_RENDERS = 3
#: The light by which sensors are compared before any is rendered: a wall in the sun.
_WALL_M, _WALL_REFLECTANCE = 5.0, 0.5


@dataclass(frozen=True, eq=False)
class _Shared:
    """A render, and of every sensor that it serves its error over the permitted one."""

    rendered: RenderedLight
    over: dict[Sensor, float]

    def of(self, made: Setup) -> RenderedLight:
        """For one of the sensors, with a warning where it is off by more than its tolerance."""
        over = self.over[made.system, made.scene.sun]
        if over <= 1 or len(self.over) == 1:  # a render warns of its own error itself
            return self.rendered
        chain = Chain.of(made.system, made.scene.sun)
        permitted = PermittedError(chain, self.rendered, made.fidelity)
        cells, _ = permitted.collected(self.rendered.light)
        more = tolerance_warnings(over, permitted, cells)
        warnings = (*self.rendered.warnings, *more)
        return replace(self.rendered, warnings=tuple(dict.fromkeys(warnings)))


#: Per process, by content.
_lights, _groups, _strictest, _chains = Held(32), Held(32), Held(256), Held(256)
_devices = Held(1024)


def renders() -> int:
    """How many renders this process has made."""
    return _lights.made


def light_of(study: Study, index: int, made: Setup, inputs: Inputs) -> RenderedLight:
    """Light of a point, whose setup is ``made``.

    Points that differ only later on share one render; with direct light alone also those that
    differ in reflectance. To a tolerance the render is within what each of them permits.
    """
    key = (inputs.stamp, *light_key(made, inputs))
    draw = light_seed(made)
    if can_rescale(made.system, made.fidelity):
        unit = _lights.get(
            key,
            lambda: render_unit_reflectance(
                made.scene, made.system, fidelity=made.fidelity, seed=draw
            ),
        )
        return unit.rescaled(made.scene)
    if not made.fidelity.has_light_tolerance:
        return _lights.get(
            key, lambda: render(made.scene, made.system, fidelity=made.fidelity, seed=draw)
        )
    group = (study.digest, int(study.same_render(index)[0]))
    chains = _chains_sharing(study, index, made, inputs)
    return _lights.get((*group, *key), lambda: _within_all(made, chains)).of(made)


def strictest_sharing(study: Study, index: int, inputs: Inputs) -> Setup:
    """Setup of a point with the sensor, of those that share its light, for which that is rendered:
    whose noise permits the least of a wall's light.
    """
    made = setup(study, study.point(index), inputs)
    if not made.fidelity.has_light_tolerance or can_rescale(made.system, made.fidelity):
        return made
    chains = _chains_sharing(study, index, made, inputs)
    system, sun = tuple(chains)[_strictest_index(made, chains)]
    return replace(made, system=system, scene=replace(made.scene, sun=sun))


def _chains_sharing(
    study: Study, index: int, made: Setup, inputs: Inputs
) -> Mapping[Sensor, Chain]:
    """Of all points that share a point's light."""
    same = study.same_render(index)
    group = (inputs.stamp, study.digest, int(same[0]))
    found = _groups.get(group, lambda: _sensors(study, same, inputs))
    chains: Mapping[Sensor, Chain] = found[light_key(made, inputs)]
    return chains


def light_seed(made: Setup) -> np.random.SeedSequence:
    """Of the paths of light, as `twin.capture` draws it."""
    return np.random.SeedSequence(made.seed).spawn(2)[0]


def light_key(made: Setup, inputs: Inputs) -> tuple[Any, ...]:
    """Tells renders of one study apart."""
    return (
        made.scene_key(reflectances=not can_rescale(made.system, made.fidelity)),
        _devices.get(
            (inputs.stamp, made.scene_values, made.system),
            lambda: tuple(_device_key(d) for d in devices(made.scene, made.system)[:2]),
        ),
        made.system.image_shape,
        made.system.n_detectors,
        made.system.weather,
        made.system.time_of_flight is None,
        # The air's extinction is that at the emitter's wavelength.
        made.system.emitter.peak_wavelength_m.value if made.system.weather else None,
        made.fidelity.quality,
        made.fidelity.start,
        made.fidelity.light_tolerance,
        made.fidelity.light_tolerance_relative,
        made.seed,
    )


def _device_key(device: Any) -> tuple[Any, ...]:
    return tuple(
        value.tobytes() if isinstance(value, np.ndarray) else value
        for value in vars(device).values()
    )


def _sensors(
    study: Study, points: NDArray[np.intp], inputs: Inputs
) -> dict[tuple[Any, ...], dict[Sensor, Chain]]:
    """Sensors of points by the light that they share, in the order of the points; without points
    that fail, which say so when their turn comes.
    """
    found: dict[tuple[Any, ...], dict[Sensor, Chain]] = {}
    for index in points:
        try:
            made = setup(study, study.point(int(index)), inputs)
            sensor = made.system, made.scene.sun
            chain = _chains.get((inputs.stamp, sensor), partial(Chain.of, *sensor))
            found.setdefault(light_key(made, inputs), {})[sensor] = chain
        except ChangedError:
            raise
        except Exception:
            continue
    return found


def _within_all(made: Setup, chains: Mapping[Sensor, Chain]) -> _Shared:
    """A render within what every sensor permits: for the one that permits the least of a wall's
    light, and where another permits less of the scene's, for that one.
    """
    sensors, chosen = tuple(chains), _strictest_index(made, chains)
    best: _Shared | None = None
    for _ in range(_MOST_RENDERS):
        found = _rendered_for(made, sensors[chosen], chains)
        if best is None or max(found.over.values()) < max(best.over.values()):
            best = found
        worst = max(sensors, key=found.over.__getitem__)
        if found.over[worst] <= 1 or worst == sensors[chosen]:
            break
        chosen = sensors.index(worst)
    assert best is not None
    return best


def _rendered_for(made: Setup, sensor: Sensor, chains: Mapping[Sensor, Chain]) -> _Shared:
    system, sun = sensor
    rendered = render(
        replace(made.scene, sun=sun),
        system,
        fidelity=made.fidelity,
        seed=light_seed(made),
        sun_chain=_strictest_by_sun(made, chains),
    )
    over = {one: _over(rendered, chain, made.fidelity) for one, chain in chains.items()}
    return _Shared(rendered, over)


def _strictest_by_sun(made: Setup, chains: Mapping[Sensor, Chain]) -> Chain:
    """The sensor that permits the least error of the sun's light: the one to whose noise a given
    sun adds the largest share, which is the same one in every scene.
    """
    wall = _wall(made)

    def permitted(chain: Chain) -> float:
        error = PermittedError(chain, wall, made.fidelity)
        return float(error.sun_error(wall.sun, float(wall.sun.max())).min())

    return min(chains.values(), key=permitted)


def _strictest_index(made: Setup, chains: Mapping[Sensor, Chain]) -> int:
    return _strictest.get(tuple(chains), lambda: _strictest_by_a_wall(made, chains))


def _strictest_by_a_wall(made: Setup, chains: Mapping[Sensor, Chain]) -> int:
    """Index of the sensor that permits the least error of the light of a wall."""
    if len(chains) == 1 or made.system.time_of_flight:  # a wall has no lengths of paths
        return 0
    wall = _wall(made)
    return int(np.argmax([_over(wall, chain, made.fidelity) for chain in chains.values()]))


def _wall(made: Setup) -> RenderedLight:
    """A wall across the field, with the same error in every cell."""
    emitter, detector, _ = devices(made.scene, made.system)
    shape, n_detectors = made.system.image_shape, made.system.n_detectors
    shape = (shape[0], shape[1] // n_detectors)
    cells = np.ones((n_detectors, shape[0] * shape[1]))
    parts = np.ones(sun_shape(made.system))
    seen = _WALL_REFLECTANCE / np.pi / _WALL_M**2
    light = cells * seen * (2 * emitter.tan_half_field) ** 2 / cells[0].size
    sun = parts * _WALL_REFLECTANCE / np.pi * (2 * detector.tan_half_field) ** 2 / parts.size
    truth = Truth(*(np.full(made.system.image_shape, x) for x in (_WALL_REFLECTANCE, _WALL_M)))
    return RenderedLight(DetectorLight(light, light), sun, truth, emitter, detector)


def _over(rendered: RenderedLight, chain: Chain, fidelity: Fidelity) -> float:
    """Error of the light over the permitted one, root mean square over the cells."""
    return PermittedError(chain, rendered, fidelity).over(rendered.light)

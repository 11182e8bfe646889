"""Points of the closed form, all at once: one pixel's link as arrays.

Fields that enter the link as they are become arrays; what needs a spectrum is integrated once for
every combination of its values.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.budget.link import (
    Link,
    maximum_distance_m,
    minimum_time_s,
    noise_e,
)
from twin.budget.table1 import link_of
from twin.files import InputError
from twin.sweep.inputs import Inputs
from twin.sweep.setup import changed, system_of
from twin.sweep.study import Study, Value
from twin.system import Part, System
from twin.system.optics import FASTEST_F_NUMBER

Array = NDArray[Any]

#: Parameters that are a factor or a term of the link themselves.
_DIRECT = {
    "system.emitter.radiant_intensity_w_per_sr": "radiant_intensity_w_per_sr",
    "system.optics.f_number": "f_number",
    "system.detector.dark_current_a": "dark_current_a",
}
_OF_THE_POINT = (
    "link.distance_m",
    "link.reflectance",
    "system.acquisition.integration_time_s",
    "system.readout.read_noise_e",
)


def closed_form(study: Study, columns: Mapping[str, Array], inputs: Inputs) -> dict[str, Array]:
    """Metrics of points, (n,) each. ``columns``: what is set in the points, by parameter.

    Without ``link.distance_m`` it is 5 m, without ``link.reflectance`` 0.5.
    Raises InputError naming the parameter of a combination that can't be.
    """
    n = len(next(iter(columns.values())))
    free = [name for name in columns if name not in _DIRECT and name not in _OF_THE_POINT]
    inverse, found = _combinations(study, columns, free, n, inputs)
    systems, links = [system for system, _ in found], [link for _, link in found]
    values = {
        name: np.array([getattr(link, name) for link in links])[inverse]
        for name in Link.__dataclass_fields__
    }
    for parameter, field in _DIRECT.items():
        if parameter in columns:
            values[field] = columns[parameter].astype(np.float64)
    _check(columns)
    link = Link(**values)
    distance = columns.get("link.distance_m", np.float64(5.0))
    reflectance = columns.get("link.reflectance", np.float64(0.5))
    time = _own(columns, "system.acquisition.integration_time_s", systems, inverse)
    read = _own(columns, "system.readout.read_noise_e", systems, inverse)
    signal = link.signal_e_per_s(reflectance, distance)
    background = link.background_e_per_s(reflectance)
    shot = {"shot_variance": link.shot_variance}
    results = {
        "signal_e_per_s": signal,
        "background_e_per_s": background,
        "snr": signal * time / noise_e(signal, background, time, read, **shot),
        "minimum_time_s": minimum_time_s(signal, background, read, **shot),
        "maximum_distance_m": maximum_distance_m(
            link.signal_e_per_s(reflectance, 1.0), background, time, read, **shot
        ),
    }
    return {name: np.broadcast_to(results[name], (n,)) for name in study.metrics}


def _combinations(
    study: Study, columns: Mapping[str, Array], names: list[str], n: int, inputs: Inputs
) -> tuple[Array, list[tuple[System, Link]]]:
    """Which system each point has, and the different systems with their links."""
    index = np.zeros(n, dtype=np.int64)
    for name in names:
        _, place = np.unique(columns[name], return_inverse=True)
        index = index * (place.max() + 1) + place
    _, first, inverse = np.unique(index, return_index=True, return_inverse=True)
    return inverse, [
        _link(study, {name: columns[name][i].item() for name in names}, inputs) for i in first
    ]


def _link(study: Study, values: dict[str, Value], inputs: Inputs) -> tuple[System, Link]:
    """System and link. The detector stands alone: one pixel of a line sensor is a pixel too."""
    own = {n: v for n, v in values.items() if n.startswith("system.detector.")}
    system = system_of(study, {n: v for n, v in values.items() if n not in own}, inputs)
    if system.weather is not None:
        raise InputError(
            f"system {system.name}: has weather, of which the closed form knows nothing"
        )
    part = Part(name=system.name, detector=system.detector)
    if own:
        part = changed(part, tuple((n.removeprefix("system."), v) for n, v in own.items()), inputs)
    return system, link_of(system, part)


def _own(
    columns: Mapping[str, Array], parameter: str, systems: list[System], inverse: Array
) -> Array:
    """A parameter's column, or each system's own value."""
    if parameter in columns:
        return columns[parameter].astype(np.float64)
    _, section, field = parameter.split(".")
    return np.array([getattr(getattr(s, section), field).value for s in systems])[inverse]


def _check(columns: Mapping[str, Array]) -> None:
    """Raise ValueError where an array holds what the fields themselves would refuse."""
    for name in (*_DIRECT, *_OF_THE_POINT):
        if name not in columns:
            continue
        column = columns[name]
        may_be_zero = name.endswith(("_e", "_a", "reflectance", "w_per_sr"))
        bad = ~(np.isfinite(column) & ((column >= 0) if may_be_zero else (column > 0)))
        if name == "link.reflectance":
            bad |= column > 1
        if name == "system.optics.f_number":
            bad |= column < FASTEST_F_NUMBER
        if bad.any():
            wanted = {
                "link.reflectance": "0 to 1",
                "system.optics.f_number": f"{FASTEST_F_NUMBER:g} or more",
            }.get(name, "a positive number")
            raise ValueError(f"{name} = {column[bad][0]}: expected {wanted}")

"""Points of the closed form, all at once: one pixel's link as arrays.

Light, noise and the converter's range are those of `twin budget`, of one exposure with all cells
lit; what is left out of a system is told of each point. A system whose swept fields hold one number
per point goes through the same formulas as one that holds a number. Text, and what is integrated
over a vendor's curve, is taken value by value.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import groupby, product
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from twin.budget.design import left_out_of_exposure
from twin.budget.field import field_link
from twin.budget.link import (
    LongerNoise,
    OpticalLink,
    maximum_distance_m,
    minimum_time_s,
    noise_e,
)
from twin.detector import FrontEnd
from twin.files import InputError
from twin.sweep.inputs import Inputs
from twin.sweep.parameters import LINK, check_bounds
from twin.sweep.setup import changed, system_of
from twin.sweep.study import Study, Value
from twin.system import Part, System
from twin.toml import Entry, Sourced

Array = NDArray[Any]
Columns = Mapping[str, Array]
E = TypeVar("E", bound=Entry)

#: Numbers of a system that its link takes as arrays.
_ARRAYS = (
    "system.emitter.radiant_intensity_w_per_sr",
    "system.optics.f_number",
    "system.optics.transmission",
    "system.filter.transmission",
    "system.detector.width_m",
    "system.detector.height_m",
    "system.detector.responsivity_a_per_w",
    "system.detector.dark_current_a",
    "system.detector.gain",
    "system.detector.excess_noise_factor",
    "system.detector.ionisation_ratio",
    "system.sky.illuminance_lx",
    "system.emitter.intensity_noise",
    "system.readout.transimpedance_ohm",
    "system.readout.feedback_capacitance_f",
    "system.readout.full_well_e",
    "system.readout.temperature_k",
    "system.readout.adc_full_scale_v",
    "system.readout.adc_offset_v",
)
#: The same, but where a vendor's curve has to be integrated.
_WAVELENGTHS = (
    "system.emitter.peak_wavelength_m",
    "system.emitter.line_fwhm_m",
    "system.filter.center_wavelength_m",
    "system.filter.width_m",
)
_TIME = "system.acquisition.integration_time_s"
#: Numbers that are no part of the link: whether each may be 0, and the most it may be.
_OF_THE_POINT = LINK | {
    _TIME: (False, np.inf),
    "system.readout.read_noise_e": (True, np.inf),
}


_LONGER = tuple(LongerNoise.__dataclass_fields__)
#: Of the front end, see `_of_front_end`.
_OWN = (
    *("time_s", "read_e", "rounding_e", *_LONGER),
    *("per_electron", "per_rate", "offset", "well"),
)


@dataclass(frozen=True, eq=False)
class ClosedForm:
    """Metrics of points by name, (n,) each, and of each point its ``fill``: all that is collected
    with all cells lit, over the converter's range, or over the well if that is less; what is
    ``left_out`` of its system, in words; and why no system exposes for the time of the point, its
    ``fault``, empty where one does.
    """

    metrics: dict[str, Array]
    fill: Array
    left_out: Array
    fault: Array


def closed_form(study: Study, columns: Columns, inputs: Inputs) -> ClosedForm:
    """Points of a study. ``columns``: what is set in the points, by parameter.

    Without ``link.distance_m`` it is 5 m, without ``link.reflectance`` 0.5.
    Raises InputError naming the parameter of a combination that can't be.
    """
    columns = columns or {"system": np.array([study.system])}  # nothing is set or varied
    n = len(next(iter(columns.values())))
    _check(columns)
    own = {name: np.empty(n) for name in _OWN}
    values = {name: np.empty(n) for name in OpticalLink.__dataclass_fields__}
    left_out, fault = (np.full(n, "", dtype=object) for _ in range(2))
    for points, system, link, faults in _links(study, columns, inputs):
        for name, column in values.items():
            column[points] = getattr(link, name)
        for name, value in _of_front_end(system).items():
            own[name][points] = value
        left_out[points] = "; ".join(left_out_of_exposure(system))
        fault[points] = faults
    link, longer = OpticalLink(**values), LongerNoise(*(own[name] for name in _LONGER))
    time = columns.get(_TIME, own["time_s"])
    read = columns.get("system.readout.read_noise_e", own["read_e"])
    distance = columns.get("link.distance_m", np.float64(5.0))
    reflectance = columns.get("link.reflectance", np.float64(0.5))
    signal = link.signal_e_per_s(reflectance, distance)
    background = link.background_e_per_s(reflectance)
    read = np.hypot(read, own["rounding_e"])
    more: dict[str, Any] = {"shot_variance": link.shot_variance, "longer": longer}
    results = {
        "signal_e_per_s": signal,
        "background_e_per_s": background,
        "snr": signal * time / noise_e(signal, background, time, read, **more),
        "minimum_time_s": minimum_time_s(signal, background, read, **more),
        "maximum_distance_m": maximum_distance_m(
            link.signal_e_per_s(reflectance, 1.0), background, time, read, **more
        ),
    }
    rate = signal + background
    fill = own["offset"] + rate * (own["per_electron"] * time + own["per_rate"])
    fill = np.maximum(fill, rate * time * own["well"])
    return ClosedForm(
        {name: np.broadcast_to(results[name], (n,)) for name in study.metrics},
        np.broadcast_to(fill, (n,)),
        left_out,
        fault,
    )


def _of_front_end(system: System) -> dict[str, Any]:
    """Of the system's own exposure, open all the time: its length and noise; what the offset takes
    of the converter's range, an electron of it or, behind an amplifier that averages, an electron
    per second, and an electron of one pixel's well.
    """
    exposure_s = system.acquisition.integration_time_s.value
    front_end = FrontEnd.of(system.unchecked_copy({"time_of_flight": None}))
    top = 2**front_end.adc_bits - 1
    averages = system.readout.transimpedance_ohm is not None
    fluctuation = system.emitter.intensity_noise
    of_electron = 1 / (front_end.electrons_per_count * top)
    rounding_e = front_end.electrons_per_count / np.sqrt(12)
    return {
        "time_s": exposure_s,
        "read_e": front_end.read_e,
        "rounding_e": 0.0 if averages else rounding_e,
        "e2_per_s": front_end.johnson_e**2 / exposure_s,
        "fluctuation": fluctuation.value if fluctuation else 0.0,
        "e_per_s": rounding_e / exposure_s if averages else 0.0,
        "per_electron": 0.0 if averages else of_electron,
        "per_rate": of_electron * exposure_s if averages else 0.0,
        "offset": front_end.offset_counts / top,
        "well": system.pixels_per_detector / front_end.full_well_e,
    }


def _links(
    study: Study, columns: Columns, inputs: Inputs
) -> Iterator[tuple[Array, System, OpticalLink, Array]]:
    """Points that share all but numbers, their system, their links as one of arrays, and of each
    why the system does not expose for so long.
    """
    free = [name for name in columns if name not in _OF_THE_POINT]
    arrays = [n for n in free if n in (*_ARRAYS, *_WAVELENGTHS) and columns[n].dtype.kind in "if"]
    for points in _alike(columns, [name for name in free if name not in arrays]):
        first = {name: columns[name][points[0]].item() for name in free}
        single = _one_by_one(*_made(study, first, inputs))
        for some in _alike(columns, [name for name in arrays if name in single], points):
            own = {name: columns[name][some] for name in arrays if name not in single}
            first = {name: columns[name][some[0]].item() for name in free}
            system, part = _made(study, first, inputs)
            for corner in _corners(own):
                _made(study, first | corner, inputs)
            of_part = {n: column for n, column in own.items() if _section(n) == "detector"}
            system = _filled(system, {n: own[n] for n in own.keys() - of_part.keys()})
            link = field_link(system, _filled(part, of_part))
            yield some, system, link, _faults(study, first, columns, some, inputs)


def _alike(columns: Columns, names: list[str], points: Array | None = None) -> Iterator[Array]:
    """Indices of points (of ``points``) that have the same values, group by group."""
    if points is None:
        points = np.arange(len(next(iter(columns.values()))))
    if not names:
        yield points
        return
    index = np.zeros(len(points), dtype=np.int64)
    for name in names:
        _, place = np.unique(columns[name][points], return_inverse=True)
        _, index = np.unique(index * (place.max() + 1) + place, return_inverse=True)
    order = np.argsort(index, kind="stable")
    yield from np.split(points[order], np.flatnonzero(np.diff(index[order])) + 1)


def _made(study: Study, values: dict[str, Value], inputs: Inputs) -> tuple[System, Part]:
    """System and detector. The detector stands alone: one pixel of a line sensor is a pixel too."""
    own = {n: v for n, v in values.items() if n.startswith("system.detector.")}
    system = system_of(study, {n: v for n, v in values.items() if n not in own}, inputs)
    if system.weather is not None:
        raise InputError(
            f"system {system.name}: has weather, of which the closed form knows nothing"
        )
    part = Part(name=system.name, detector=system.detector)
    if own:
        part = changed(part, tuple((n.removeprefix("system."), v) for n, v in own.items()), inputs)
    return system, part


def _faults(
    study: Study, values: dict[str, Value], columns: Columns, points: Array, inputs: Inputs
) -> Array:
    """Why a system does not expose for the times of some points, in its own words, or empty. Its
    conditions are bounds: where two times are told the same, so are those between them.
    """
    if _TIME not in columns:
        return np.full(len(points), "", dtype=object)
    times_s, places = np.unique(columns[_TIME][points], return_inverse=True)

    def told(index: int) -> str:
        try:
            _made(study, values | {_TIME: times_s[index].item()}, inputs)
        except InputError as error:
            return str(error)
        return ""

    ends = [(0, len(times_s) - 1)]
    found = {index: told(index) for index in ends[0]}
    faults = np.full(len(times_s), "", dtype=object)
    while ends:
        first, last = ends.pop()
        if found[first] == found[last] or last - first == 1:
            faults[first], faults[first + 1 : last + 1] = found[first], found[last]
            continue
        middle = (first + last) // 2
        found[middle] = told(middle)
        ends += [(first, middle), (middle, last)]
    return np.asarray(faults[places])


def _one_by_one(system: System, part: Part) -> tuple[str, ...]:
    """Of the numbers of a link, those that are taken value by value: over which a vendor's curve is
    integrated.
    """
    files = (system.emitter.spectrum_csv, system.filter.transmission_csv)
    if not any((*files, part.detector is not None and part.detector.responsivity_csv)):
        return ()
    place = system.filter.place
    of_cone = place is not None and place.value == "behind lens"
    return (*_WAVELENGTHS, "system.optics.f_number") if of_cone else _WAVELENGTHS


def _corners(own: Columns) -> Iterator[dict[str, float]]:
    """Smallest and largest of the numbers of each section, in every combination: what a section
    asks of them is linear, so what holds there holds between.
    """
    for _, names in groupby(sorted(own), key=_section):
        ends = {name: sorted({own[name].min().item(), own[name].max().item()}) for name in names}
        for values in product(*ends.values()):
            yield dict(zip(ends, values, strict=True))


def _section(name: str) -> str:
    return name.split(".")[1]


def _filled(entry: E, own: Columns) -> E:
    """An entry whose swept fields hold arrays; those of sections it lacks are left out."""
    sections = {}
    for section, names in groupby(sorted(own), key=_section):
        part = getattr(entry, section, None)
        if part is not None:
            sections[section] = part.unchecked_copy(dict(_fields(names, own)))
    return entry.unchecked_copy(sections)


def _fields(names: Iterable[str], own: Columns) -> Iterator[tuple[str, Any]]:
    for name in names:
        held: Any = Sourced.model_construct(
            value=own[name].astype(np.float64), source=None, assumed="swept"
        )
        yield name.rpartition(".")[2], held


def _check(columns: Columns) -> None:
    """Raise InputError for a number of a point that can't be."""
    for name in columns.keys() & _OF_THE_POINT.keys():
        column = columns[name]
        ends = (column.min(), column.max()) if column.dtype.kind in "if" else column[:1]
        for value in ends:
            check_bounds(name, value.item(), *_OF_THE_POINT[name])

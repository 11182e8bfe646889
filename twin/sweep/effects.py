"""Faults of a whole study: found before its first point, and parameters that moved nothing."""

from collections.abc import Hashable, Iterator
from typing import TYPE_CHECKING

import numpy as np

from twin.files import InputError
from twin.scene.load import scene_file
from twin.sweep.closed_form import closed_form
from twin.sweep.dataset import COARSE, VOID, metrics_of
from twin.sweep.inputs import ChangedError, Inputs, beside
from twin.sweep.setup import setup
from twin.sweep.study import Study
from twin.sweep.values import check_values

if TYPE_CHECKING:
    import xarray

_MOST_TRIED = 4096


def check_points(study: Study, inputs: Inputs) -> None:
    """A fault of the whole study, before any work: raise InputError for a value that no point may
    have (`check_values`), where no point can be set up, a parameter of the sun is overruled in all
    of them, or a closed form, which needs no scene, names one that is not there.

    One point that can be set up is enough: another whose values do not fit together becomes a row
    with its error.
    """
    if study.model == "closed-form" and f"scene {study.scene}" not in inputs.objects:
        scene_file(beside(study.scene, study.folder))
    check_values(study, inputs)
    first: Exception | None = None
    n, most = study.n_points, min(study.n_points, _MOST_TRIED)
    for index in np.linspace(0, n - 1, most).astype(int).tolist():
        try:
            _try(study, index, inputs)
            break
        except ChangedError:
            raise
        except Exception as error:
            first = first or error
    else:
        which = "no point" if most == n else f"none of {most} points"
        raise InputError(f"{which} can be set up: {first}") from first
    lux = "scene.sun.illuminance_lx"
    if lux in study.parameters and all(
        inputs.get("system", str(name)).sky is not None
        for name in study.values_of("system") or [study.system]
    ):
        raise InputError(
            f"{lux}: has no effect here; the system has a sky of its own: system.sky.illuminance_lx"
        )


def _try(study: Study, index: int, inputs: Inputs) -> None:
    if study.model == "closed-form":
        (fault,) = closed_form(study, study.columns(index, index + 1), inputs).fault
        if fault:
            raise InputError(fault)
    else:
        setup(study, study.point(index), inputs)


def without_effect(data: "xarray.Dataset") -> Iterator[str]:
    """Parameters along whose dimension no metric changes, bit for bit, in any point, nor whether
    it is void.

    None where that is not known: where a point has no number of a metric, or an infinite one, and
    where points that differ in the parameter alone were computed to different tolerances.
    """
    beside = (name for name in (COARSE, *VOID.values()) if name in data)
    columns = [*metrics_of(data), *beside]
    for name in data.coords:
        (dimension,) = data[name].dims
        if data.sizes[dimension] > 1 and all(
            _is_constant(data[column].astype(np.float64), dimension) for column in columns
        ):
            yield str(name)


def _is_constant(values: "xarray.DataArray", dimension: Hashable) -> bool:
    along = np.moveaxis(values.to_numpy(), values.dims.index(dimension), 0)
    return bool(np.isfinite(along).all() and (along == along[0]).all())

"""Materials at the carrier: ITU-R P.2040 where its row is valid, cited values elsewhere."""

from functools import lru_cache

import numpy as np
from scipy.constants import epsilon_0

from twin.engine import sionna
from twin.files import InputError
from twin.radar.scattering.surface import PEC, Layer, LayeredSurface
from twin.scene import Scene, SceneObject
from twin.scene.materials import Material

_CONDUCTOR = 1e5  # S/m: from here on a metal reflects all


def radio_properties(
    name: str, material: Material, carrier_hz: float
) -> tuple[float, float, str | None]:
    """Relative permittivity, conductivity in S/m, and why they are assumed (None: cited).

    Raises InputError naming material and carrier where no row holds there.
    """
    radio = material.radio
    if radio.itu is not None:
        try:
            row = _itu(radio.itu, carrier_hz)
        except KeyError as error:
            raise InputError(
                f"material {name!r}: radio.itu = {radio.itu!r} is none of {error.args[0]}"
            ) from error
        if row is not None:
            return *row, None
    for band in radio.cited:
        if band.from_hz <= carrier_hz <= band.to_hz:
            return band.relative_permittivity, band.conductivity_s_per_m, band.assumed
    known = [f"{band.from_hz / 1e9:g}-{band.to_hz / 1e9:g} GHz" for band in radio.cited]
    if radio.itu:
        known.append(f"ITU {radio.itu!r}")
    raise InputError(
        f"material {name!r}: no radio properties at {carrier_hz / 1e9:g} GHz "
        f"(it has {', '.join(known) or 'none'})"
    )


def surface_of(
    item: SceneObject, scene: Scene, carrier_hz: float
) -> tuple[LayeredSurface, str | None]:
    """What an object's facets are made of at the carrier, and why that is assumed."""
    found = radio_properties(item.material, scene.materials[item.material], carrier_hz)
    permittivity, conductivity, assumed = found
    if conductivity >= _CONDUCTOR:
        return PEC, assumed
    epsilon = permittivity - 1j * conductivity / (2 * np.pi * carrier_hz * epsilon_0)
    if item.thickness_m is None:
        return LayeredSurface(backing=epsilon), assumed
    return LayeredSurface((Layer(epsilon, item.thickness_m),), backing=1), assumed


@lru_cache(maxsize=256)
def _itu(name: str, carrier_hz: float) -> tuple[float, float] | None:
    """Relative permittivity and conductivity of an ITU row; None where it does not hold.

    Asked once: Sionna sets the engine's other variant. Raises KeyError with the rows that exist.
    """
    sionna()
    from sionna.rt.radio_materials.itu import ITU_MATERIALS_PROPERTIES, itu_material

    ranges = ITU_MATERIALS_PROPERTIES.get(name)
    if ranges is None:
        raise KeyError(", ".join(ITU_MATERIALS_PROPERTIES))
    if not any(low <= carrier_hz / 1e9 <= high for low, high in ranges):
        return None
    permittivity, conductivity = itu_material(name, carrier_hz)
    return float(permittivity), float(conductivity)

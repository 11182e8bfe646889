"""Materials at the carrier: ITU-R P.2040 where its row is valid, cited values elsewhere."""

import ast
from collections.abc import Container
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from scipy.constants import epsilon_0

from twin.files import InputError
from twin.radar.scattering.surface import PEC, Layer, LayeredSurface
from twin.scene import Scene, SceneObject
from twin.scene.materials import GENERIC, Material

_ITU_TABLE = "ITU_MATERIALS_PROPERTIES"
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
    covered = [f"{band.from_hz / 1e9:g}-{band.to_hz / 1e9:g} GHz" for band in radio.cited]
    if radio.itu:
        covered.append(f"ITU {radio.itu!r}")
    raise InputError(
        f"material {name!r}: no radio properties at {carrier_hz / 1e9:g} GHz "
        f"(it has {', '.join(covered) or 'none'})"
    )


def without_radio_properties(scene: Scene, carrier_hz: float) -> list[str]:
    """Why materials of the scene cannot be had at the carrier, one text for each of them."""
    faults = []
    for name in sorted({item.material for item in scene.objects}):
        try:
            radio_properties(name, scene.materials[name], carrier_hz)
        except InputError as error:
            faults.append(str(error))
    return faults


def with_generic_properties(scene: Scene, names: Container[str]) -> list[str]:
    """On those of the named objects whose material the table does not hold: one text, or none."""
    of_material: dict[str, list[str]] = {}
    for item in scene.objects:
        material = scene.unknown_materials.get(item.name)
        if material is not None and item.material == GENERIC and item.name in names:
            of_material.setdefault(material, []).append(item.name)
    if not of_material:
        return []
    told = "; ".join(f"{name} ({', '.join(items)})" for name, items in of_material.items())
    return [f"materials not in the table, radio properties taken from {GENERIC}: {told}"]


def surface_of(
    item: SceneObject, scene: Scene, carrier_hz: float
) -> tuple[LayeredSurface, str | None]:
    """What an object's facets are made of at the carrier, and why that is assumed."""
    properties = radio_properties(item.material, scene.materials[item.material], carrier_hz)
    permittivity, conductivity, assumed = properties
    if conductivity >= _CONDUCTOR:
        return PEC, assumed
    epsilon = permittivity - 1j * conductivity / (2 * np.pi * carrier_hz * epsilon_0)
    if item.thickness_m is None:
        return LayeredSurface(backing=epsilon), assumed
    return LayeredSurface((Layer(epsilon, item.thickness_m),), backing=1), assumed


def _itu(name: str, carrier_hz: float) -> tuple[float, float] | None:
    """Relative permittivity and conductivity of a row of ITU-R P.2040, equations (28) and (29);
    None where it does not hold. Raises KeyError with the rows that exist.
    """
    rows, ghz = _p2040(), carrier_hz / 1e9
    if name not in rows:
        raise KeyError(", ".join(rows))
    for (low, high), (a, b, c, d) in rows[name].items():
        if low <= ghz <= high:
            return float(a * ghz**b), float(c * ghz**d)
    return None


@lru_cache(maxsize=1)
def _p2040() -> dict[str, dict[tuple[float, float], tuple[float, float, float, float]]]:
    """Sionna's table 3 of ITU-R P.2040, read from its source: Sionna RT takes most of a second to
    import, and sets the engine's other variant.
    """
    engine = find_spec("sionna")
    assert engine is not None
    assert engine.origin is not None
    source = (Path(engine.origin).parent / "rt" / "radio_materials" / "itu.py").read_text()
    table = next(
        statement.value
        for statement in ast.parse(source).body
        if isinstance(statement, ast.Assign) and ast.unparse(statement.targets[0]) == _ITU_TABLE
    )
    rows: dict[str, dict[tuple[float, float], tuple[float, float, float, float]]]
    rows = ast.literal_eval(table)
    return rows

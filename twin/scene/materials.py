"""The table of materials: one row per material, both bands, each value with its source."""

import re
from functools import lru_cache
from pathlib import Path
from typing import Annotated

from pydantic import Field, RootModel, ValidationError, model_validator

from twin.files import InputError, scenes_folder
from twin.toml import NonNegative, Positive, Sourced, Strict, describe, read_toml

#: Row for materials that the table does not hold.
GENERIC = "generic"

Reflectance = Annotated[NonNegative, Field(le=1)]


class Optical(Strict):
    """Lambertian reflectance at 1550 nm."""

    reflectance: Sourced[Reflectance]
    """Lambertian reflectance at 1550 nm."""


class RadioBand(Strict):
    """Permittivity and conductivity, valid between two carrier frequencies."""

    from_hz: Positive
    """Lowest carrier for which the values hold."""
    to_hz: Positive
    """Highest carrier for which the values hold."""
    relative_permittivity: Annotated[Positive, Field(ge=1)]
    """Real part."""
    conductivity_s_per_m: NonNegative
    """From the loss: eps'' f_GHz / 17.98."""
    source: str | None = None
    """Where the values were read."""
    assumed: str | None = None
    """Why these values are assumed."""

    @model_validator(mode="after")
    def _ascends(self) -> "RadioBand":
        if self.from_hz >= self.to_hz:
            raise InputError(f"from_hz = {self.from_hz:g} is not below to_hz, {self.to_hz:g}")
        return self


class Radio(Strict):
    """ITU-R P.2040 name where it is valid at the carrier, cited values elsewhere."""

    itu: str | None = None
    """Row of ITU-R P.2040, used where it is valid at the carrier."""
    cited: tuple[RadioBand, ...] = ()
    """Values for bands of carriers, used where no valid ITU row applies."""


class Surface(Strict):
    """Roughness, and what the radar sees of it."""

    rms_height_m: Sourced[NonNegative]
    """Root mean square height of the surface at scales below its mesh."""
    backscatter_gamma: Sourced[Annotated[NonNegative, Field(le=10)]] | None = None
    """gamma of the radar's backscatter at 24 to 94 GHz: sigma_0 = gamma cos(angle of incidence).
    Default: none.
    """


class Material(Strict):
    """One row of the table."""

    optical: Optical
    """At 1550 nm."""
    radio: Radio = Radio()
    """At the radar's carrier; a radar at a carrier for which nothing is given is an error."""
    surface: Surface | None = None
    """Roughness."""


class MaterialTable(RootModel[dict[str, Material]]):
    """Content of one ``materials.toml``: rows by name."""


def load_materials(path: Path) -> dict[str, Material]:
    """The table in a TOML file. Raises InputError naming row, field and value."""
    try:
        return _table(path, path.read_bytes())
    except OSError as error:
        raise InputError(f"{path}: can't be read ({error.strerror})") from error


@lru_cache(maxsize=8)
def _table(path: Path, content: bytes) -> dict[str, Material]:
    """``content`` of the file is in the key alone: its name stays when it changes."""
    rows = read_toml(path)
    try:
        return MaterialTable.model_validate(rows).root
    except ValidationError as error:
        raise InputError(f"{path}: {describe(error, MaterialTable, rows)}") from error


def materials_of(scene_folder: Path) -> tuple[dict[str, Material], tuple[str, ...]]:
    """The table that holds for a scene, and notes: the bundled one, extended by ``materials.toml``
    of the scene's parent folder, and by that of its own, whose rows take the place of those of the
    same name. Raises as `load_materials`.
    """
    bundled = scenes_folder() / "materials.toml"
    table, notes = dict(load_materials(bundled)), list[str]()
    for folder in (scene_folder.parent, scene_folder):
        path = folder / "materials.toml"
        if not path.is_file() or path.samefile(bundled):
            continue
        rows = load_materials(path)
        replaced = [name for name in rows if name in table and rows[name] != table[name]]
        if replaced:
            notes.append(f"{path}: takes the place of the rows {', '.join(replaced)}")
        table |= rows
    return table, tuple(notes)


def row_of(name: str, table: dict[str, Material]) -> str | None:
    """Row of a BSDF by its id, an ITU name, or an id in the manner of Sionna's scenes.

    Capitals and signs between words do not matter, nor does the number of a copy (``Concrete.001``
    of Blender).
    """
    plain = name.removeprefix("mat-").removeprefix("itu_").replace("-", "_")
    words = re.sub(r"\W+", "_", re.sub(r"\.\d{3}$", "", plain.strip())).lower()
    for candidate in (name, plain, words):
        if candidate in table:
            return candidate
    return next((key for key, row in table.items() if row.radio.itu == plain), None)

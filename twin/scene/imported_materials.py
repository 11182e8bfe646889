"""Materials of an imported model (glTF, OBJ, ...) mapped to the materials table and to BSDFs.

A model gives names, pictures and colours, all of visible light: only names and pictures are used.
"""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np

from twin.scene.materials import Material, row_of
from twin.scene.objects import Array

_WHITE = (1.0, 1.0, 1.0)


@dataclass(frozen=True, eq=False)
class ImportedMaterial:
    """A material of the model. ``image`` is a PIL image or None, ``colour`` linear (r, g, b),
    ``left_out`` what a Lambertian, opaque surface does not hold, in words.
    """

    name: str
    image: Any = None
    colour: tuple[float, float, float] | None = None
    left_out: tuple[str, ...] = ()


@dataclass
class ImportedBsdfs:
    """The BSDFs of a scene file to be written: one for each material and picture.

    Parameters
    ----------
    table
        Rows of the materials table.
    fallback
        Row for names that are none of the table's.
    picture_as_reflectance
        Take a visible picture as the reflectance at 1550 nm.
    """

    table: dict[str, Material]
    fallback: str
    picture_as_reflectance: bool = False
    ids: dict[tuple[str, int | None], str] = field(default_factory=dict)
    pictures: dict[str, Any] = field(default_factory=dict)
    parts: dict[tuple[str, str], list[str]] = field(default_factory=dict)
    notes_of: dict[str, list[str]] = field(default_factory=dict)

    def bsdf(self, material: ImportedMaterial, part: str, has_uv: bool) -> str:
        """Id of the BSDF of a part."""
        row = row_of(material.name, self.table) if material.name else None
        self.parts.setdefault((material.name, row or ""), []).append(part)
        for what in material.left_out:
            self.notes_of.setdefault(what, []).append(part)
        row = row or self.fallback
        picture = None
        if material.image is not None and has_uv:
            picture = id(material.image)
        elif material.colour is not None and material.colour != _WHITE:
            told = ", ".join(f"{c:.2g}" for c in material.colour)
            what = f"visible colour {told} left out: it says nothing about 1550 nm"
            self.notes_of.setdefault(what, []).append(part)
        key = (row, picture)
        if key not in self.ids:
            same = sum(known == row for known, _ in self.ids)
            self.ids[key] = row if not same else f"{row}.{same:03d}"
            if picture is not None:
                self.pictures[self.ids[key]] = coloured(material)
        return self.ids[key]

    def write_pictures(self, folder: Path) -> None:
        """Each picture as ``textures/ID.png``."""
        if self.pictures:
            (folder / "textures").mkdir()
        for name, picture in self.pictures.items():
            picture.save(folder / "textures" / f"{name}.png")

    def xml(self) -> str:
        """BSDF elements of the scene file."""
        return "".join(self._element(row, name) for (row, _), name in self.ids.items())

    def _element(self, row: str, name: str) -> str:
        value = self.table[row].optical.reflectance.value
        plain = f'            <spectrum name="reflectance" value="{value:g}"/>\n'
        if name in self.pictures:
            file = f"textures/{name}.png"
            if self.picture_as_reflectance:
                plain = (
                    '            <texture type="bitmap" name="reflectance">\n'
                    f'                <string name="filename" value="{file}"/>\n'
                    "            </texture>\n"
                )
            else:
                plain += f"            <!-- in visible light: {file} -->\n"
        return (
            f'    <bsdf type="twosided" id={quoteattr(name)}>\n'
            f'        <bsdf type="diffuse">\n{plain}        </bsdf>\n'
            "    </bsdf>\n"
        )

    def notes(self) -> Iterator[str]:
        """One line per thing that was assumed or left out."""
        for (name, row), parts in self.parts.items():
            whose = ", ".join(parts)
            if row:
                yield f"material {name!r} is row {row!r} of the materials table ({whose})"
            else:
                what = f"material {name!r} is not in the materials table" if name else "no material"
                yield f"{what}, {self.fallback!r} is used ({whose})"
        for what, parts in self.notes_of.items():
            yield f"{what} ({', '.join(parts)})"
        for name in self.pictures:
            use = (
                "taken as reflectance at 1550 nm"
                if self.picture_as_reflectance
                else "kept, not used; --texture-as-reflectance takes it as reflectance at 1550 nm"
            )
            yield f"picture of visible light textures/{name}.png {use}"


def imported_material(visual: Any) -> ImportedMaterial:
    """Material of a mesh as trimesh has read it."""
    material = getattr(visual, "material", None)
    if material is None:
        kind = getattr(visual, "kind", None)
        return ImportedMaterial("", left_out=(f"{kind} colours left out",) if kind else ())
    name = str(getattr(material, "name", None) or "")
    image = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
    factor = getattr(material, "baseColorFactor", None)
    if factor is None and image is None:
        factor = getattr(material, "diffuse", None)
    colour, opacity = None, 1.0
    if factor is not None:
        red, green, blue, opacity = (float(value) / 255 for value in (*factor, 255)[:4])
        colour = red, green, blue
    left_out = []
    if getattr(material, "alphaMode", None) in ("MASK", "BLEND") or opacity < 1 or _clear(material):
        left_out.append("transparency: taken as opaque")
    if getattr(material, "metallicFactor", None):
        left_out.append(f"metallic {material.metallicFactor:g}: taken as Lambertian")
    if getattr(material, "normalTexture", None) is not None:
        left_out.append("normal map: taken as flat")
    return ImportedMaterial(name, image, colour, tuple(left_out))


def _clear(material: Any) -> bool:
    """Whether a material of an OBJ has an opacity ``d`` below 1, or one by picture."""
    given = getattr(material, "kwargs", None) or {}
    values = {"d": 1.0, "tr": 0.0}  # of an opaque one: Tr is 1 - d
    for key, opaque in values.items():
        with suppress(IndexError, TypeError, ValueError):
            if float(given.get(key, [opaque])[-1]) != opaque:
                return True
    return "map_d" in given


def coloured(material: ImportedMaterial) -> Any:
    """The picture times the material's colour, which glTF gives for linear light."""
    picture = material.image.convert("RGB")
    if material.colour in (None, _WHITE):
        return picture
    from PIL import Image

    coded = np.asarray(picture, dtype=np.float64) / 255
    linear = np.where(coded <= 0.04045, coded / 12.92, ((coded + 0.055) / 1.055) ** 2.4)
    linear *= material.colour
    coded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return Image.fromarray(np.rint(255 * coded).astype(np.uint8))


def texture_coordinates(visual: Any, n_vertices: int) -> Array | None:
    """Of a mesh as trimesh has read it, for Mitsuba: v runs down the picture, (n_vertices, 2)."""
    uv = getattr(visual, "uv", None)
    if uv is None or np.shape(uv) != (n_vertices, 2) or not np.isfinite(uv).all():
        return None
    return np.asarray(uv, dtype=np.float64) * [1, -1] + [0, 1]

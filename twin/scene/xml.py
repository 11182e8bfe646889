"""Mitsuba's own XML parser, read without instantiating anything: shapes, materials, the camera.

Transforms come in float64. Nothing is loaded or rendered here, so a broken scene can't hurt.
"""

import re
import struct
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hardware.read_only import read_only
from twin.engine import exr_threads, mitsuba
from twin.files import InputError
from twin.scene.markup import check_markup
from twin.scene.texture import Reflectance, Texture

#: Of a texture: 8192 x 8192, 0.7 GB while it is read.
_MOST_PIXELS = 1 << 26
#: OpenEXR: how a file begins, its attribute of 16 bytes with the corners of the pixels, and how far
#: that is looked for.
_EXR_MAGIC = b"\x76\x2f\x31\x01"
_DATA_WINDOW = b"dataWindow\0box2i\0\x10\0\0\0"
_MOST_HEAD_BYTES = 1 << 20
_WRAPPERS = ("twosided", "mask", "bumpmap", "normalmap")
_LAMBERTIAN = ("diffuse", "itu-radio-material", "radio-material", "none")
_LOBES = ("metallic", "roughness", "alpha", "specular", "spec_trans", "clearcoat", "material")
_REFLECTANCES = ("reflectance", "diffuse_reflectance", "base_color", "color")


@dataclass(frozen=True)
class XmlBsdf:
    """A BSDF: its id, plugin, and the reflectance the XML itself gives (number, image or None).

    ``left_out``: what of it a Lambertian, opaque, flat surface does not hold, in words.
    """

    id: str
    plugin: str
    reflectance: Reflectance | None = None
    radio_type: str | None = None
    to_uv: NDArray[np.float64] | None = None
    left_out: tuple[str, ...] = ()

    def placed(self, uv: NDArray[np.float64] | None) -> NDArray[np.float64] | None:
        """Texture coordinates (n, 2) of a mesh as the texture's own transform moves them.

        A translation stands in the fourth column of ``to_uv``, which is 4 x 4: there Mitsuba 3.9
        looks for it, and so drops the one in the third column of a matrix of nine values.
        """
        if uv is None or self.to_uv is None:
            return uv
        return uv @ self.to_uv[:2, :2].T + self.to_uv[:2, 3]


@dataclass(frozen=True)
class XmlShape:
    """A shape: plugin, properties, placement and surface."""

    name: str
    plugin: str
    properties: dict[str, Any]
    to_world: NDArray[np.float64]
    surface: XmlBsdf
    flips_texture: bool


@dataclass(frozen=True)
class Document:
    """What a scene file holds. ``camera`` is the 4x4 pose of its first sensor."""

    shapes: tuple[XmlShape, ...]
    camera: NDArray[np.float64] | None
    emitters: tuple[str, ...] = field(default=())


def read_xml(path: Path) -> Document:
    """Parse a scene file with its includes. Raises InputError naming file and line."""
    check_markup(path)
    mi = mitsuba()
    config = mi.parser.ParserConfig(mi.variant())
    try:
        state = mi.parser.parse_file(config, str(path))
        mi.parser.transform_upgrade(config, state)
        mi.parser.transform_resolve_references(config, state)
    except (RuntimeError, UnicodeDecodeError) as error:  # a name in another encoding than UTF-8
        raise InputError(_readable(path, str(error))) from error
    return _Reader(state, path.parent).document()


class _Reader:
    """Walks the parsed nodes of one document."""

    def __init__(self, state: Any, folder: Path) -> None:
        self.state = state
        self.folder = folder
        self.types = mitsuba().ObjectType

    def document(self) -> Document:
        children = list(self._children(self.state.root))
        camera = next((n for n in children if n.type == self.types.Sensor), None)
        shapes = [n for n in children if n.type == self.types.Shape]
        emitters = [n for n in children if n.type == self.types.Emitter]
        area = [n for s in shapes for n in self._children(s) if n.type == self.types.Emitter]
        return Document(
            shapes=tuple(self._shape(n, number) for number, n in enumerate(shapes)),
            camera=None if camera is None else self._camera(camera),
            emitters=tuple(n.props.plugin_name() for n in [*emitters, *area]),
        )

    def _children(self, node: Any) -> Iterator[Any]:
        for key in node.props.keys():
            value = node.props[key]
            if type(value).__name__ == "ResolvedReference":
                yield self.state.nodes[value.index()]

    def _place(self, node: Any) -> str:
        return str(mitsuba().parser.file_location(self.state, node))

    def _to_world(self, node: Any) -> NDArray[np.float64]:
        if "to_world" not in node.props:
            return np.eye(4)
        return np.array(node.props["to_world"].matrix, dtype=np.float64)

    def _camera(self, node: Any) -> NDArray[np.float64]:
        matrix = self._to_world(node)
        if not (np.isfinite(matrix).all() and abs(np.linalg.det(matrix[:3, :3])) > 1e-12):
            raise InputError(f"{self._place(node)}: sensor: to_world is no pose")
        return matrix

    def _shape(self, node: Any, number: int) -> XmlShape:
        properties = {
            key: node.props[key]
            for key in node.props.keys()
            if key != "to_world" and type(node.props[key]).__name__ != "ResolvedReference"
        }
        surfaces = [n for n in self._children(node) if n.type == self.types.BSDF]
        name = node.props.id() or f"{node.props.plugin_name()}-{number + 1}"
        if "filename" in properties:
            properties["filename"] = self.folder / str(properties["filename"])
        return XmlShape(
            name=name,
            plugin=node.props.plugin_name(),
            properties=properties,
            to_world=self._to_world(node),
            surface=self._surface(surfaces[0]) if surfaces else XmlBsdf("", "none"),
            # Mitsuba turns the textures of OBJ files over unless it is told otherwise.
            flips_texture=bool(
                properties.get("flip_tex_coords", node.props.plugin_name() == "obj")
            ),
        )

    def _surface(self, node: Any) -> XmlBsdf:
        """The BSDF under its wrappers; the outermost id that the author gave is its name."""
        name = node.props.id()
        left_out = []
        while node.props.plugin_name() in _WRAPPERS:
            left_out += self._left_out(node)
            inner = [n for n in self._children(node) if n.type == self.types.BSDF]
            if not inner:
                break
            node = inner[0]
            name = name or node.props.id()
        plugin = node.props.plugin_name()
        surface = XmlBsdf(name, plugin, left_out=(*left_out, *self._left_out(node)))
        if plugin == "itu-radio-material":
            return replace(surface, radio_type=str(node.props["type"]))
        for key in _REFLECTANCES:
            if key in node.props:
                value = node.props[key]
                return replace(
                    surface, reflectance=self._reflectance(value), to_uv=self._to_uv(value)
                )
        return surface

    def _left_out(self, node: Any) -> list[str]:
        plugin = node.props.plugin_name()
        if plugin in ("bumpmap", "normalmap"):
            return [f"{plugin}: taken as flat"]
        if plugin == "mask":
            opacity = self._number(node, "opacity")
            return [] if opacity == "1" else [f"mask, opacity {opacity or 0.5}: taken as opaque"]
        if plugin in (*_WRAPPERS, *_LAMBERTIAN):
            return []
        lobes = [f"{key} {value}" for key in _LOBES if (value := self._number(node, key))]
        return [f"{', '.join([plugin, *lobes])}: taken as Lambertian"]

    def _number(self, node: Any, key: str) -> str | None:
        """A property in words: its number, or that it is an image."""
        if key not in node.props:
            return None
        value = node.props[key]
        if isinstance(value, str):
            return value
        if type(value).__name__ == "ResolvedReference" and (
            self.state.nodes[value.index()].props.plugin_name() == "bitmap"
        ):
            return "of an image"
        found = self._reflectance(value)
        return f"{found:g}" if isinstance(found, float) else str(value)

    def _to_uv(self, value: Any) -> NDArray[np.float64] | None:
        if type(value).__name__ != "ResolvedReference":
            return None
        texture = self.state.nodes[value.index()].props
        return np.array(texture["to_uv"].matrix, np.float64) if "to_uv" in texture else None

    def _reflectance(self, value: Any) -> Reflectance | None:
        kind = type(value).__name__
        if kind == "ResolvedReference":
            texture = self.state.nodes[value.index()]
            if texture.props.plugin_name() != "bitmap":
                return None
            return self._image(texture)
        if kind == "float":
            return float(value)
        if kind == "ScalarColor3d":  # as mono variants read it: luminance
            channels = np.array(value).ravel()
            if not ((channels >= 0) & (channels <= 1)).all():
                return float(channels[(channels < 0) | ~(channels <= 1)][0])  # refused as it is
            return float(np.dot(channels, (0.212671, 0.715160, 0.072169)))
        uniform = re.fullmatch(r"Properties\.Spectrum\[uniform=(.*)\]", str(value))
        return float(uniform[1]) if uniform else None

    def _image(self, texture: Any) -> Texture:
        mi = mitsuba()
        if "filename" not in texture.props:
            raise InputError(f"{self._place(texture)}: bitmap: needs a filename")
        path = self.folder / str(texture.props["filename"])
        _check_size(path)
        try:
            with exr_threads():
                bitmap = mi.Bitmap(str(path))
        except (RuntimeError, OSError) as error:
            raise InputError(f"{path}: texture can't be read") from error
        if texture.props.get("raw", False):
            bitmap.set_srgb_gamma(False)
        if bitmap.pixel_format() == mi.Bitmap.PixelFormat.MultiChannel:
            channels = ", ".join(field.name for field in bitmap.struct_())
            raise InputError(f"{path}: texture of channels {channels}, expected grey or colours")
        grey = bitmap.convert(mi.Bitmap.PixelFormat.Y, mi.Struct.Type.Float32, srgb_gamma=False)
        image = np.array(grey, dtype=np.float32).reshape(bitmap.size()[1], bitmap.size()[0])
        return Texture(
            read_only(image),
            str(texture.props.get("filter_type", "bilinear")),
            str(texture.props.get("wrap_mode", "repeat")),
        )


def _check_size(path: Path) -> None:
    """Few bytes may say many pixels: they are counted before they are decoded."""
    from PIL import Image, UnidentifiedImageError

    kind = "JPEG" if path.suffix.lower() in (".jpg", ".jpeg") else None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            with Image.open(path) as picture:
                pixels, kind = picture.width * picture.height, picture.format
    except (UnidentifiedImageError, OSError):
        pixels = _exr_pixels(path)  # 0: nothing at all, which Mitsuba tells
    except Image.DecompressionBombError:
        pixels = _MOST_PIXELS + 1
    if pixels > _MOST_PIXELS:
        raise InputError(f"{path}: more than {_MOST_PIXELS} pixels, expected a smaller texture")
    if kind == "JPEG":
        _check_jpeg(path)


def _check_jpeg(path: Path) -> None:
    """Decoded once for its faults: Mitsuba's library writes them to the terminal by itself."""
    from PIL import Image

    try:
        with Image.open(path) as picture:
            picture.load()
    except (OSError, SyntaxError) as error:
        raise InputError(f"{path}: texture can't be read ({error!s:.80})") from error


def _exr_pixels(path: Path) -> int:
    """Pixels that an OpenEXR file says it has in its data window; 0 where it is none.

    OpenEXR file layout: magic, version, attributes (name, type, size, value), an empty name.
    """
    try:
        with path.open("rb") as file:
            head = file.read(_MOST_HEAD_BYTES)
    except OSError:
        return 0
    at = head.find(_DATA_WINDOW)
    if not head.startswith(_EXR_MAGIC) or at < 0 or len(head) < at + len(_DATA_WINDOW) + 16:
        return 0
    left, top, right, bottom = struct.unpack_from("<4i", head, at + len(_DATA_WINDOW))
    return max(right - left + 1, 0) * max(bottom - top + 1, 0)


def _readable(path: Path, message: str) -> str:
    """The parser's message on one line, the file first."""
    text = re.sub(r"\[parser\.cpp:\d+\]\s*", "", " ".join(message.split()))
    text = re.sub(r'^Parsing of XML file ".*?" failed: ', "no valid XML: ", text)
    text = re.sub(r"^Error while loading \S*?\.xml ", "", text)
    return f"{path}: {text}"

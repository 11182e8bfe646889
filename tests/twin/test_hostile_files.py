"""Files that lie, in a scene: one line of error each, and the process lives."""

import base64
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from struct import pack
from typing import Any

import numpy as np
import pytest

import twin
from twin.camera.acquisition import capture
from twin.camera.mounting import check_clear, check_rig
from twin.camera.reflectance_rescaling import render_unit_reflectance
from twin.camera.stream import frames
from twin.engine import exr_threads
from twin.fidelity import Fidelity
from twin.files import InputError, new_folder, whole_folder
from twin.radar.device.antenna_pattern_file import read_pattern
from twin.scene import load_scene
from twin.scene.importing import import_model
from twin.scene.meshes import read_mesh
from twin.system import load_system
from twin.system.curves import curves, read_curve
from twin.toml import Sourced, read_toml

HEAD = '<scene version="3.0.0"><bsdf type="diffuse" id="concrete"/>'
WALL = (
    '<shape type="rectangle" id="wall"><transform name="to_world"><scale value="5"/></transform>'
    '<ref id="concrete"/></shape></scene>'
)
TOML = """
[rig]
position_m = [{}, {}, {}]
[sun]
azimuth_deg = 0.0
elevation_deg = 30.0
illuminance_lx = 1e5
"""

LOADER = """
import sys
from pathlib import Path
from twin.files import InputError
from twin.scene import load_scene

for path in sys.argv[1:]:
    try:
        load_scene(path)
    except InputError as error:
        print(error)
"""

SCENES = {
    "deep": (
        HEAD.encode() + b'<bsdf type="twosided">' * 200_000 + b"</bsdf>" * 200_000 + b"</scene>",
        "elements are nested more than 64 deep",
    ),
    "closed never": (b"<scene>" * 200_000, "elements are nested more than 64 deep"),
    "latin": ((HEAD + '<shape type="rectangle" id="wand-süd"/></scene>').encode("latin-1"),
              "no valid XML: not well-formed"),
    "itself": ((HEAD + '<include filename="scene.xml"/></scene>').encode(), "includes itself"),
    "deep include": (
        (HEAD + '<default name="n" value="deep"/><include filename="../$n/scene.xml"/></scene>')
        .encode(), "deep/scene.xml: line 1",
    ),
    "entities": (
        b'<!DOCTYPE l [<!ENTITY a "aaaaaaaaaa">' + b"".join(
            b'<!ENTITY a%d "%b">' % (i, (b"&a%d;" % (i - 1) if i else b"&a;") * 10)
            for i in range(10)
        ) + b"]><scene>&a9;</scene>", "no valid XML: limit on input amplification",
    ),
    "id": ((HEAD + f'<shape type="rectangle" id="{"x" * 10**6}"/></scene>').encode(),
           "id is longer than 200 characters"),
}  # fmt: skip


def test_scene_files_that_would_end_the_process(tmp_path: Path) -> None:
    """Each gets its line, from a process that is there for the next."""
    for name, (content, _) in SCENES.items():
        (tmp_path / name).mkdir()
        (tmp_path / name / "scene.xml").write_bytes(content)
    command = [sys.executable, "-c", LOADER, *(str(tmp_path / name) for name in SCENES)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    lines = done.stdout.splitlines()
    assert len(lines) == len(SCENES)
    for (name, (_, because)), line in zip(SCENES.items(), lines, strict=True):
        assert because in line, name
        assert line.startswith(str(tmp_path))
        assert len(line) < 500


@pytest.mark.parametrize(
    ("position", "touched"),
    [((0, 0, 0), True), ((0, -5, 0), True), ((0, 4.9, 0), True),
     ((0, 20, 0), False), ((0, 0, 1e-3), False)],
)  # fmt: skip
def test_no_light_is_computed_for_a_rig_in_a_surface(
    position: tuple[float, float, float], touched: bool, tmp_path: Path
) -> None:
    """In the wall, whichever way it looks, the way to it is zero long and its light no number;
    beside the wall in the same plane, or a millimetre before it, all is well.
    """
    (tmp_path / "scene.xml").write_text(HEAD + WALL)
    (tmp_path / "scene.toml").write_text(TOML.format(*position))
    scene, system = load_scene(tmp_path), load_system("workable")
    if not touched:
        check_clear(scene)
        return
    with pytest.raises(InputError, match=r"rig: its emitter, at .* in the surface of 'wall'"):
        capture(scene, system)


@pytest.mark.parametrize(
    ("offset", "fits"),
    [((0, 0, 0), False), ((0, 0.1, 0), True), ((-0.1, 0, 0), True), ((1, 0.1, 0), False),
     ((1, 0.2, 0), True)],
)  # fmt: skip
def test_air_wants_the_detector_beside_the_beam(
    offset: tuple[float, float, float], fits: bool, tmp_path: Path
) -> None:
    """Light scattered back right before emitter and detector grows as one over their distance:
    without one, or inside the beam of 20 deg (0.176 m wide on each side after 1 m), it has no
    bound. Air that is not there asks for nothing.
    """
    (tmp_path / "scene.xml").write_text(HEAD + WALL)
    (tmp_path / "scene.toml").write_text(
        TOML.format(0, 0, 1).replace("[sun]", f"[rig.detector]\noffset_m = {list(offset)}\n[sun]")
    )
    (tmp_path / "fog.toml").write_text('base = "workable"\n[weather]\npart = "fog-50m"\n')
    scene, foggy = load_scene(tmp_path), load_system(tmp_path / "fog.toml")
    check_rig(scene, load_system("workable"))
    if fits:
        check_rig(scene, foggy)
        return
    expected = (
        rf"scene.toml: rig\.detector\.offset_m = \[{float(offset[0])}, .* expected a position"
    )
    for refused in (
        lambda: capture(scene, foggy),
        lambda: next(frames(scene, foggy, [scene.rig.pose])),
        lambda: render_unit_reflectance(
            scene, foggy, fidelity=Fidelity(1, 1), seed=np.random.SeedSequence(0)
        ),
    ):
        with pytest.raises(InputError, match=expected) as told:
            refused()
        assert "\n" not in str(told.value)


QUADS = (
    b"ply\nformat ascii 1.0\nelement vertex 8\nproperty float x\nproperty float y\n"
    b"property float z\nelement face 3\nproperty list uchar int vertex_indices\nend_header\n"
    b"0 0 0\n1 0 0\n1 1 0\n0 1 0\n0 0 0\n0 0 1\n1 1 1\n0 1 1\n4 0 3 2 1\n4 4 5 6 7\n4 1 2 6 5\n"
)
BINARY = (
    QUADS[: QUADS.index(b"0 0 0")].replace(b"ascii", b"binary_little_endian")
    + pack("<24f", *range(24))
    + b"".join(pack("<B4i", 4, *face) for face in ((0, 3, 2, 1), (4, 5, 6, 7), (1, 2, 6, 5)))
)
MODELS = {
    "too few.obj": (b"v 0 0 0\nv 1 0\nv 0 1 0\nf 1 2 3\n", "line 2: b'v 1 0'"),
    # As many numbers as whole vertices have, with the second line's end in the third.
    "shifted.obj": (b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 1\nv 1 1 0 1\nf 1 2 3\n", "line 4: b'v 0 1'"),
    "edge.obj": (b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nf 1 2\n", "line 5: b'f 1 2'"),
    "beyond.obj": (b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 99\n", "line 4: vertex 99 of 3"),
    "before.obj": (b"v 0 0 0\nf -1 -2 -3\n", "line 2: vertex -2, of 1 before it"),
    "zero.obj": (b"v 0 0 0\nf 1 0 1\n", "line 2: vertex 0, but OBJ counts from 1"),
    "word.obj": (b"v 0 0 0\nf 1 two 1\n", "line 2: 'two', expected a vertex's number"),
    "number.obj": (b"v 0 O 0\nf 1 1 1\n", "line 1: '0 O 0', expected three numbers"),
    "faces.ply": (QUADS[: QUADS.index(b"4 1 2 6 5")], "2 of the 3 rows of 'face'"),
    "face.ply": (QUADS[:-3], "line 20: '4 1 2 6' is no whole row of 'face'"),
    "vertices.ply": (QUADS[: QUADS.index(b"0 1 1")], "7 of the 8 rows of 'vertex'"),
    "row.ply": (QUADS.replace(b"0 0 1", b"0 0", 1), "line 15: '0 0' is no whole row of 'vertex'"),
    "letters.ply": (QUADS.replace(b"0 0 1", b"0 0 l"), "line 15: '0 0 l' is no whole row"),
    "index.ply": (QUADS.replace(b"4 0 3 2", b"4 0.5 3 2"), "line 18: '4 0.5 3 2 1' is no whole"),
    "more.ply": (QUADS + b"3 0 1 2\n", "12 rows, expected the 11 that its header gives"),
    "header.ply": (QUADS[:100], "PLY without `end_header`: cut short"),
    "element.ply": (QUADS.replace(b"vertex 8", b"vertex"), "PLY header, line 3: 'element vertex'"),
    "kind.ply": (QUADS.replace(b"float z", b"flood z"), "header, line 6: 'property flood z'"),
    "binary.ply": (BINARY[:-1], "cut short: row 2 of the 3 of 'face' goes on"),
    "longer.ply": (BINARY + b"1", f"({len(BINARY) + 1} bytes, expected {len(BINARY)}"),
    "lists.ply": (BINARY[:-17] + b"\xff" + BINARY[-16:], "cut short: row 2 of the 3 of 'face'"),
    "points.ply": (BINARY[:250], f"cut short: 250 bytes, expected {len(BINARY) - 51} and"),
    "deep.gltf": (b"[" * 200_000, "no valid glTF"),
    "cut.glb": (b"glTF" + pack("<III", 2, 2**31, 2**31 - 1) + b"JSON{", "no valid glTF"),
}  # fmt: skip


@pytest.mark.parametrize("name", MODELS)
def test_broken_models_are_told_in_one_line(name: str, tmp_path: Path) -> None:
    content, because = MODELS[name]
    (tmp_path / name).write_bytes(content)
    for read in (
        lambda: read_mesh(tmp_path / name),
        lambda: import_model(tmp_path / name, tmp_path / "scene"),
    ):
        with pytest.raises(InputError) as caught:
            read()
        assert because in str(caught.value)
        assert str(caught.value).startswith(str(tmp_path / name))
        assert "\n" not in str(caught.value)


def test_lines_of_an_obj_may_go_on_in_the_next(tmp_path: Path) -> None:
    (tmp_path / "x.obj").write_bytes(b"v 0 0 0\nv 1 0 \\\n0\nv 0 1 0\nf 1 2 \\\n3\n")
    mesh = read_mesh(tmp_path / "x.obj")
    np.testing.assert_array_equal(mesh.vertices_m, [[0, 0, 0], [1, 0, 0], [0, 1, 0]])
    np.testing.assert_array_equal(mesh.faces, [[0, 1, 2]])


def triangle() -> dict[str, Any]:
    data = pack("<9f", 0, 0, 0, 1, 0, 0, 0, 1, 0) + pack("<3H", 0, 1, 2)
    uri = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
    return {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "buffers": [{"byteLength": len(data), "uri": uri}],
        "bufferViews": [
            {"buffer": 0, "byteLength": 36},
            {"buffer": 0, "byteOffset": 36, "byteLength": 6},
        ],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5123, "count": 3, "type": "SCALAR"},
        ],
    }


def test_a_gltf_promises_no_more_vertices_than_it_has_bytes(tmp_path: Path) -> None:
    """Without a buffer an accessor means zeros: ten thousand million of them in half a kilobyte."""
    (path := tmp_path / "model.gltf").write_text(json.dumps(content := triangle()))
    assert read_mesh(path).faces.shape == (1, 3)
    del content["accessors"][0]["bufferView"]
    content["accessors"][0]["count"] = 10**10
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match="accessor 0: 10000000000 elements in a model of"):
        read_mesh(path)


def sparse(content: dict[str, Any]) -> None:
    content["accessors"][0]["sparse"] = {
        "count": 1,
        "indices": {"bufferView": 1, "componentType": 5123},
        "values": {"bufferView": 0},
    }


def fan_beside(content: dict[str, Any]) -> None:
    parts = content["meshes"][0]["primitives"]
    parts.append(parts[0] | {"mode": 6})


GLTF: dict[str, tuple[Callable[[dict[str, Any]], object], str]] = {
    "sparse": (sparse, "mesh 0, primitive 0: accessor 0 is sparse: export it without"),
    "fan": (fan_beside, r"mesh 0, primitive 1: a triangle fan \(mode 6\): export it as triangles"),
    "weights": (lambda c: c["meshes"][0].update(weights=[0, 0.5]), "meshes 0: weights = .0, 0.5."),
    "weights of a node": (
        lambda c: c["nodes"][0].update(weights=[1]),
        r"nodes 0: weights = .1. of",
    ),
    "corners": (lambda c: c["accessors"][1].update(count=2), "2 corners of triangles, expected"),
    "accessor": (
        lambda c: c["accessors"][0].update(count=4),
        "accessor 0: 4 elements end at byte 48 of 36",
    ),
    "strides": (
        lambda c: c["bufferViews"][0].update(byteStride=16),
        "accessor 0: 3 elements end at byte 44 of 36",
    ),
    "type": (lambda c: c["accessors"][0].update(type="VEC5"), "accessor 0: 'VEC5' of component 51"),
    "view": (
        lambda c: c["bufferViews"][1].update(byteLength=7),
        "bufferView 1: ends at byte 43 of 42",
    ),
    "buffer": (lambda c: c["buffers"][0].update(byteLength=50), "buffer 0: 42 bytes, expected 50"),
}


@pytest.mark.parametrize("name", GLTF)
def test_what_changes_the_triangles_of_a_gltf_and_is_not_read_is_refused(
    name: str, tmp_path: Path
) -> None:
    """Taken without it, the model would have another shape; buffers too short say so."""
    change, told = GLTF[name]
    change(content := triangle())
    (path := tmp_path / "model.gltf").write_text(json.dumps(content))
    with pytest.raises(InputError, match=f"^{path}: .*{told}"):
        read_mesh(path)


def test_strips_and_morphs_at_rest_of_a_gltf_are_read(tmp_path: Path) -> None:
    content = triangle()
    content["meshes"][0] |= {"weights": [0.0]}
    content["meshes"][0]["primitives"][0] |= {"mode": 5, "targets": [{"POSITION": 0}]}
    (path := tmp_path / "model.gltf").write_text(json.dumps(content))
    assert read_mesh(path).areas_m2.sum() == pytest.approx(0.5)
    notes = import_model(path, tmp_path / "scene")
    assert "model.gltf: left out: morph targets (1)" in notes


@pytest.mark.parametrize("name", ["model.obj", "model.ply", "model.glb"])
def test_a_folder_is_no_model(name: str, tmp_path: Path) -> None:
    (tmp_path / name).mkdir()
    for read in (read_mesh, lambda path: import_model(path, tmp_path / "scene")):
        with pytest.raises(InputError, match=f"^{tmp_path / name}: a folder, expected a mesh file"):
            read(tmp_path / name)


@pytest.mark.parametrize(
    ("content", "because"),
    [
        (b"a = " + b"[" * 100_000, "nested too deeply"),
        (b"a = " + b"9" * 5000, "Exceeds the limit"),
        (b'a = "caf\xe9"', "can't decode byte 0xe9"),
    ],
)
def test_toml_is_read_or_told_in_one_line(content: bytes, because: str, tmp_path: Path) -> None:
    (path := tmp_path / "x.toml").write_bytes(content)
    with pytest.raises(InputError, match=f"^{path}: no valid TOML: .*{because}"):
        read_toml(path)


def test_a_byte_order_mark_is_none_of_the_content(tmp_path: Path) -> None:
    """Editors on Windows write it in front of UTF-8."""
    (path := tmp_path / "x.toml").write_text('a = "süd"\n', encoding="utf-8-sig")
    assert path.read_bytes().startswith(b"\xef\xbb\xbf")
    assert read_toml(path) == {"a": "süd"}


def test_a_curve_that_is_none_is_one_line(tmp_path: Path) -> None:
    """A device that never ends, and a field beyond the limit of the csv module (131 072)."""
    (path := tmp_path / "x.csv").write_text("1550,0." + "5" * 200_000 + "\n1551,0.5\n")
    for file, because in ((path, "field larger than"), (Path("/dev/zero"), "a regular file")):
        for read in (read_curve, read_pattern):
            with pytest.raises(InputError, match=f"^{file}: .*{because}"):
                read(file)
    with pytest.raises(InputError, match=r"^/dev/zero: expected a regular file"):
        curves(Sourced[str](value="/dev/zero", assumed="here"))


def textured(folder: Path, picture: str) -> Path:
    """A wall whose reflectance is a picture."""
    text = HEAD.replace("<bsdf", '<texture type="bitmap" id="t"><string name="filename" '
                        f'value="{picture}"/></texture><bsdf', 1)  # fmt: skip
    text = text.replace('id="concrete"/>', 'id="concrete"><ref name="reflectance" id="t"/></bsdf>')
    (folder / "scene.xml").write_text(text + WALL)
    (folder / "scene.toml").write_text(TOML.format(0, 0, -2))
    return folder / "scene.xml"


@pytest.mark.parametrize("name", ["big.png", "big.exr"])
def test_the_pixels_of_a_texture_are_counted_before_they_are_decoded(
    tmp_path: Path, name: str
) -> None:
    """12 000 x 12 000 zeros, 18 MB of bits, in a PNG of few kB, would be 1.4 GB of light; an
    OpenEXR file says its size before anything else, here 100 000 x 100 000 in a file of 4 x 4.
    """
    import mitsuba as mi
    from PIL import Image

    if name == "big.png":
        Image.new("1", (12_000, 12_000)).save(tmp_path / name)
    else:
        with exr_threads():
            mi.Bitmap(np.zeros((4, 4), np.float32)).write(str(tmp_path / name))
        window = b"dataWindow\0box2i\0\x10\0\0\0"
        data = (tmp_path / name).read_bytes()
        small, large = (np.array([0, 0, n - 1, n - 1], "<i4").tobytes() for n in (4, 100_000))
        assert window + small in data
        (tmp_path / name).write_bytes(data.replace(window + small, window + large))
    with pytest.raises(InputError, match=rf"{name}: more than 67108864 pixels"):
        load_scene(textured(tmp_path, name))


@pytest.mark.parametrize("kept", [0, 300, -100])
def test_a_broken_jpeg_is_one_line(
    tmp_path: Path, kept: int, capfd: pytest.CaptureFixture[str]
) -> None:
    """Random bytes, and a picture cut in its header and in its light: libjpeg says nothing of its
    own beside the error.
    """
    from PIL import Image

    path, rng = tmp_path / "wall.jpg", np.random.default_rng(0)
    Image.fromarray(rng.integers(0, 255, (64, 64), np.uint8)).save(path)
    load_scene(textured(tmp_path, path.name))
    path.write_bytes(path.read_bytes()[:kept] if kept else rng.bytes(5000))
    with pytest.raises(InputError, match=r"wall\.jpg: texture can't be read"):
        load_scene(textured(tmp_path, path.name))
    assert capfd.readouterr().err == ""


def test_a_long_curve_takes_the_memory_of_its_numbers(tmp_path: Path) -> None:
    """200 000 rows, 4 MB of text: two columns of float64 are 3.2 MB, sorted once; a list of rows
    and another of pairs took 76 MB.
    """
    import tracemalloc

    nm = np.linspace(1000, 2000, 200_000)
    np.savetxt(path := tmp_path / "x.csv", np.c_[nm, np.full_like(nm, 50)], "%.6f", ",", header="%")
    tracemalloc.start()
    try:
        read, values = read_curve(path)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    np.testing.assert_allclose(read, nm, atol=1e-6)
    assert (values == 0.5).all()
    assert peak < 30e6


def test_a_pattern_of_many_angles_with_few_gains_is_told_at_once(tmp_path: Path) -> None:
    """20 000 thetas and phis, one gain each: 4e8 directions, of which one that lacks is enough."""
    angles = np.linspace(1, 179, 20_000)
    rows = "\n".join(f"{t:.6f},{2 * t:.6f},1" for t in angles)
    (path := tmp_path / "x.csv").write_text(f"theta,phi,gain dBi\n{rows}\n")
    begun = time.process_time()
    with pytest.raises(InputError, match=r"x\.csv: theta 1, phi .* is missing"):
        read_pattern(path)
    assert time.process_time() - begun < 5


@pytest.mark.parametrize(
    ("section", "content", "because"),
    [
        ("filter.transmission_csv", "1500,0\n1550,80\n1600,0\n", "transmission 80"),
        ("filter.transmission_csv", "here,be\ndragons,or\n", "expected two columns"),
        ("emitter.spectrum_csv", "1500,1\n1500,2\n", "a wavelength stands twice"),
        ("detector.responsivity_csv", "1500,9\n1600,9\n", "one electron a photon"),
    ],
)
def test_a_curve_that_can_not_be_used_is_told_with_its_system(
    tmp_path: Path, section: str, content: str, because: str
) -> None:
    """When the system is read, not when light first needs the curve."""
    (tmp_path / "curve.csv").write_text(content)
    part, field = section.split(".")
    (tmp_path / "mine.toml").write_text(f'base = "workable"\n[{part}]\n{field} = "curve.csv"\n')
    with pytest.raises(InputError, match=rf"curve\.csv: .*{because}"):
        load_system(tmp_path / "mine.toml")


def test_a_working_directory_that_is_gone_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "gone").mkdir()
    program = (
        "import os, sys\n"
        f"os.chdir({str(tmp_path / 'gone')!r}); os.rmdir({str(tmp_path / 'gone')!r})\n"
        "sys.argv = ['twin', 'check', 'yard']\n"
        "from twin.cli import main\n"
        "main()\n"
    )
    # The package is found from where it lies: the folder is no place to look in.
    environment = {**os.environ, "PYTHONPATH": str(Path(twin.__file__).parents[1])}
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, capture_output=True, text=True, env=environment)
    assert done.returncode == 2
    assert done.stderr.startswith("twin: error: the working directory is gone")
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize("folder", [whole_folder, new_folder])
def test_a_folder_that_a_kill_left_half_goes_with_the_next(folder: Any, tmp_path: Path) -> None:
    program = (
        "import os, signal\n"
        "from pathlib import Path\n"
        "from twin.files import new_folder, whole_folder\n"
        f"with {folder.__name__}(Path({str(tmp_path / 'out')!r})) as partial:\n"
        "    (partial / 'half').write_text('half')\n"
        "    os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    subprocess.run([sys.executable, "-c", program], check=False)
    (left,) = tmp_path.iterdir()
    assert left.name.endswith(".partial")
    with folder(tmp_path / "out") as partial:
        (partial / "whole").write_text("whole")
    assert os.listdir(tmp_path) == ["out"]
    assert os.listdir(tmp_path / "out") == ["whole"]

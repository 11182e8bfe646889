"""Scenes: what loads, what is defaulted, and what never reaches the renderer."""

import re
import shutil
import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh

from twin.engine import exr_threads, mitsuba
from twin.fidelity import Fidelity
from twin.files import InputError, scenes_folder
from twin.radar import load_radar, radar_capture
from twin.scene import Pose, load_scene, parse_pose
from twin.scene.materials import load_materials
from twin.scene.meshes import read_mesh
from twin.scene.mitsuba import mitsuba_scene

XML = """<scene version="3.0.0">
<bsdf type="twosided" id="{material}"><bsdf type="diffuse">
<spectrum name="reflectance" value="{reflectance}"/></bsdf></bsdf>
<shape type="{plugin}" id="thing">{file}<ref id="{material}"/></shape>
</scene>"""
TOML = """
[rig]
position_m = [0.0, 0.0, 0.0]
[sun]
azimuth_deg = 180.0
elevation_deg = 30.0
illuminance_lx = 1e5
"""
TRIANGLE = np.array([[5, -1, -1], [5, 1, -1], [5, 0, 1]], dtype="<f4")


def ply(path: Path, vertices: np.ndarray = TRIANGLE, faces=((0, 1, 2),)) -> Path:
    """A binary PLY written by hand: trimesh would not write the broken ones."""
    header = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {len(vertices)}\nproperty float x\nproperty float y\nproperty float z\n"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    body = vertices.astype("<f4").tobytes() + b"".join(struct.pack("<B3i", 3, *f) for f in faces)
    path.write_bytes(header.encode() + body)
    return path


def scene(
    folder: Path,
    *,
    material="concrete",
    reflectance="0.36",
    plugin="ply",
    toml: str | None = TOML,
    **mesh,
) -> Path:
    file = '<string name="filename" value="thing.ply"/>' if plugin == "ply" else ""
    text = XML.format(material=material, reflectance=reflectance, plugin=plugin, file=file)
    folder.mkdir(exist_ok=True)
    (folder / "scene.xml").write_text(text)
    if toml is not None:
        (folder / "scene.toml").write_text(toml)
    ply(folder / "thing.ply", **mesh)
    return folder


def assert_refused(folder: Path, *expected: str, **arguments) -> None:
    with pytest.raises(InputError) as caught:
        load_scene(folder, **arguments)
    message = str(caught.value)
    assert "\n" not in message
    for part in expected:
        assert part in message, message


# What loads.


@pytest.mark.parametrize("name", ["yard", "table1"])
def test_bundled_scenes_load_without_warnings(name: str) -> None:
    loaded = load_scene(name)
    assert loaded.warnings == ()
    assert loaded.name == name


def test_the_current_folder_goes_by_its_name(tmp_path: Path, monkeypatch) -> None:
    """Titles, and the folder of a run's results, are of it."""
    scene(tmp_path / "here")
    monkeypatch.chdir(tmp_path / "here")
    assert load_scene(".").name == "here"


@pytest.mark.parametrize("name", ["yard", "table1"])
def test_stock_mitsuba_opens_bundled_scenes_with_the_same_triangles(name: str) -> None:
    stock = mitsuba().load_file(str(scenes_folder() / name / "scene.xml"))
    ours = load_scene(name)
    assert sum(s.face_count() for s in stock.shapes()) == ours.triangles


@pytest.mark.parametrize("name", ["yard", "table1"])
def test_reflectances_of_the_xml_are_those_of_the_table(name: str) -> None:
    """Stock Mitsuba and the twin must see the same scene: the XML repeats the table's values."""
    from twin.scene.xml import read_xml

    table = load_materials(scenes_folder() / "materials.toml")
    for shape in read_xml(scenes_folder() / name / "scene.xml").shapes:
        row = table[shape.surface.id]
        if isinstance(shape.surface.reflectance, float):
            assert shape.surface.reflectance == pytest.approx(row.optical.reflectance.value)


def test_yard_trihedral_is_10_m2_at_79_ghz() -> None:
    """Legs a with sigma = 4 pi a^4 / (3 lambda^2), from the mesh itself."""
    thing = next(o for o in load_scene("yard").objects if o.name == "trihedral")
    (target,) = (t for t in load_scene("yard").targets if t.name == "trihedral")
    apex = np.asarray(target.position_m)
    legs = np.linalg.norm(thing.vertices_m - apex, axis=1).max()
    wavelength = 299_792_458 / 79e9
    assert 4 * np.pi * legs**4 / (3 * wavelength**2) == pytest.approx(target.rcs_m2, rel=0.01)


@pytest.mark.parametrize(
    ("name", "rho", "distance"),
    [("patch_20", 0.2, 2.0), ("patch_50", 0.5, 4.5), ("patch_80", 0.8, 10.0)],
)
def test_table1_patches_stand_where_the_paper_says(name, rho, distance) -> None:
    loaded = load_scene("table1")
    patch = next(o for o in loaded.objects if o.name == name)
    middle = patch.vertices_m.mean(axis=0) - loaded.rig.position_m
    assert np.linalg.norm(middle) == pytest.approx(distance, rel=1e-3)
    assert patch.reflectance == rho


def test_sionnas_street_canyon_runs_with_its_radio_materials_translated() -> None:
    import importlib.util

    spec = importlib.util.find_spec("sionna")  # that of sionna.rt would start it
    path = Path(spec.submodule_search_locations[0]) / "rt/scenes/simple_street_canyon"
    loaded = load_scene(path / "simple_street_canyon.xml")
    assert {o.material for o in loaded.objects} == {"glass", "wood", "marble", "brick", "concrete"}
    assert any("rig placed at" in w for w in loaded.warnings)
    assert any("sun defaulted" in w for w in loaded.warnings)
    world = mitsuba_scene(loaded)
    mi = mitsuba()
    origin, axes = loaded.rig.device("emitter")
    ahead = mi.Ray3f(mi.Point3f(origin), mi.Vector3f(axes[0]))
    distance = float(np.array(world.ray_intersect(ahead).t)[0])
    assert 2 < distance < 30


def test_cornell_box_runs_with_its_own_camera(tmp_path: Path) -> None:
    mi = mitsuba()
    config = mi.parser.ParserConfig(mi.variant())
    state = mi.parser.parse_dict(config, mi.cornell_box())
    mi.parser.write_file(state, str(tmp_path / "cbox.xml"))
    loaded = load_scene(tmp_path / "cbox.xml")
    np.testing.assert_allclose(loaded.rig.position_m, [0, 0, 3.9], atol=1e-6)
    _, axes = loaded.rig.device("emitter")
    np.testing.assert_allclose(axes, [[0, 0, -1], [-1, 0, 0], [0, 1, 0]], atol=1e-6)
    assert any("the XML's camera" in w for w in loaded.warnings)
    assert any("reflectance taken from the XML" in w for w in loaded.warnings)
    luminance = {round(o.reflectance, 2) for o in loaded.objects}
    assert len(luminance) == 3  # white, green and red as a mono variant reads them


@pytest.mark.parametrize("plugin", ["rectangle", "cube", "sphere", "cylinder", "disk"])
def test_primitives_have_mitsubas_area(tmp_path: Path, plugin: str) -> None:
    """Tessellation against the analytic shape of the renderer, within its 0.2 %."""
    loaded = load_scene(scene(tmp_path, plugin=plugin))
    (thing,) = loaded.objects
    area = trimesh.Trimesh(thing.vertices_m, thing.geometry.faces).area
    exact = mitsuba().load_dict({"type": plugin}).surface_area()
    assert area == pytest.approx(float(np.array(exact).ravel()[0]), rel=2e-3)


def test_vertices_keep_float64(tmp_path: Path) -> None:
    """A millimetre at 1e6 m is far below float32's step of 6 cm."""
    folder = scene(tmp_path, toml=TOML.replace("[0.0, 0.0, 0.0]", "[1e6, 0.0, 0.0]"))
    text = (folder / "scene.xml").read_text()
    moved = '<transform name="to_world"><translate x="1000000.001"/></transform><ref'
    (folder / "scene.xml").write_text(text.replace("<ref", moved))
    (thing,) = load_scene(folder).objects
    np.testing.assert_allclose(thing.vertices_m[:, 0], 1000005.001, atol=1e-9)


def test_mirroring_keeps_faces_outward(tmp_path: Path) -> None:
    folder = scene(tmp_path, plugin="cube")
    text = (folder / "scene.xml").read_text()
    mirrored = '<transform name="to_world"><scale x="-1"/></transform><ref'
    (folder / "scene.xml").write_text(text.replace("<ref", mirrored))
    (thing,) = load_scene(folder).objects
    assert trimesh.Trimesh(thing.vertices_m, thing.geometry.faces).volume == pytest.approx(8.0)


def test_zero_area_faces_are_dropped(tmp_path: Path) -> None:
    loaded = load_scene(scene(tmp_path, faces=((0, 1, 2), (0, 0, 1))))
    assert len(loaded.objects[0].geometry.faces) == 1


# Poses.


def test_pose_axes_follow_rep_103() -> None:
    """Yaw turns left, pitch turns the nose down, roll lifts the left side."""
    yaw, pitch, roll = (
        Pose((0, 0, 0), **{f"{name}_deg": 90.0}).rotation.as_matrix()
        for name in ("yaw", "pitch", "roll")
    )
    np.testing.assert_allclose(yaw @ [1, 0, 0], [0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(pitch @ [1, 0, 0], [0, 0, -1], atol=1e-12)
    np.testing.assert_allclose(roll @ [0, 1, 0], [0, 0, 1], atol=1e-12)


def test_pose_from_text_and_axes() -> None:
    pose = parse_pose("1,2,3,90,-10")
    assert pose == Pose((1.0, 2.0, 3.0), 90.0, -10.0, 0.0)
    axes = pose.rotation.as_matrix()
    again = Pose.from_axes(np.array([1.0, 2, 3]), axes[:, 0], axes[:, 2])
    np.testing.assert_allclose(again.rotation.as_matrix(), axes, atol=1e-12)


@pytest.mark.parametrize("text", ["", "1,2", "1,2,3,4,5,6,7", "a,b,c", "1,2,inf"])
def test_bad_poses(text: str) -> None:
    with pytest.raises(InputError, match="expected x,y,z"):
        parse_pose(text)


# What never reaches the renderer.


def test_missing_and_malformed_scenes(tmp_path: Path) -> None:
    assert_refused(tmp_path / "nope", "no such scene", "yard")
    assert_refused(tmp_path, "has no scene.xml")
    (tmp_path / "scene.xml").write_text('<scene version="3.0.0"><shape</scene>')
    assert_refused(tmp_path, "scene.xml", "no valid XML", "line 1")


@pytest.mark.parametrize(
    ("vertices", "faces", "expected"),
    [
        (TRIANGLE, ((0, 1, 9001),), "face 0 refers to vertex 9001 of 3"),
        (TRIANGLE, ((0, 1, 2), (0, -1, 2)), "face 1 refers to vertex -1 of 3"),
        (TRIANGLE * np.array([[1], [np.nan], [1]]), ((0, 1, 2),), "vertex 1 is [nan"),
        (TRIANGLE * np.array([[1], [1], [1e30]]), ((0, 1, 2),), "m from the rig, expected at most"),
        (TRIANGLE, (), "thing.ply"),
        (TRIANGLE, ((0, 0, 1),), "no face has an area"),
    ],
)
def test_broken_meshes_name_file_shape_and_fault(tmp_path, vertices, faces, expected) -> None:
    assert_refused(scene(tmp_path, vertices=vertices, faces=faces), "thing.ply", expected)


def test_missing_truncated_and_foreign_mesh_files(tmp_path: Path) -> None:
    folder = scene(tmp_path)
    whole = (folder / "thing.ply").read_bytes()
    (folder / "thing.ply").write_bytes(whole[:-8])
    assert_refused(folder, "thing.ply")
    (folder / "thing.ply").write_bytes(b"\x00" * 100)
    assert_refused(folder, "thing.ply", "can't be read as a mesh")
    (folder / "thing.ply").unlink()
    assert_refused(folder, "thing.ply", "no such mesh file")


@pytest.mark.parametrize(
    ("name", "content", "told"),
    [
        ("a.stl", b"hello world, this is no mesh", "no STL file: 28 bytes that do not begin with"),
        ("a.stl", bytes(80) + b"\x07\0\0\0" + bytes(90), "174 bytes, expected 434 for the 7 tri"),
        ("a.stl", b"solid a\n facet normal 0 0 1\n", "STL text without `endsolid`: cut short"),
        ("a.obj", b"hello world, this is no mesh\n", "no OBJ file: no line begins with v, f or"),
        ("a.ply", b"hello world, this is no mesh", "first line is not `ply`"),
        *((f"a.{kind}", b"", "the file is empty") for kind in ("stl", "obj", "ply", "glb")),
    ],
)
def test_garbage_is_told_apart_from_a_mesh_without_faces(
    tmp_path: Path, name: str, content: bytes, told: str
) -> None:
    (path := tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=re.escape(f"{path}: can't be read as a mesh (")) as caught:
        read_mesh(path)
    assert told in str(caught.value)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.stl", b"solid a\nendsolid a\n"),
        ("b.stl", bytes(84)),
        ("a.obj", b"# a cloud of points\nv 0 0 0\nv 1 0 0\n"),
    ],
)
def test_a_mesh_that_truly_has_no_faces_says_so(tmp_path: Path, name: str, content: bytes) -> None:
    (path := tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match="has no faces"):
        read_mesh(path)


@pytest.mark.parametrize("value", ["-0.5", "1.5", "nan"])
def test_impossible_reflectances(tmp_path: Path, value: str) -> None:
    assert_refused(scene(tmp_path, reflectance=value), "'thing'", "expected 0 to 1")


MINIMAL = {
    "none": None,
    "empty": "",
    "a description": 'description = "mine"\n',
    "a sun": TOML[TOML.index("[sun]") :],
    "a mount alone": "[rig.detector]\noffset_m = [0.0, -0.1, 0.0]\n",
}


@pytest.mark.parametrize("toml", MINIMAL.values(), ids=MINIMAL.keys())
def test_whatever_scene_toml_leaves_out_is_defaulted_with_a_warning(tmp_path, toml) -> None:
    """As without the file: a material of no row, the rig and the sun; what it says holds."""
    folder = scene(tmp_path, material="unobtainium", reflectance="0.7", toml=toml)
    loaded, bare = load_scene(folder), load_scene(scene(tmp_path / "bare", toml=None))
    assert loaded.objects[0].reflectance == pytest.approx(0.7)
    assert loaded.rig.pose == bare.rig.pose
    told = " ".join(loaded.warnings)
    assert "unobtainium" in told
    assert "rig placed at" in told
    says_sun = toml is not None and "[sun]" in toml
    assert ("sun defaulted" in told) == (not says_sun)
    assert (loaded.sun == bare.sun) == (not says_sun)
    assert ("sensor offsets defaulted" in told) == (toml is None or "[rig" not in toml)
    if toml is not None and "[rig" in toml:
        assert loaded.rig.detector.position_m == (0.0, -0.1, 0.0)


@pytest.mark.parametrize(
    ("kinds", "toml", "told"),
    [
        (("directional",), TOML, None),
        (("directional", "constant"), TOML, "constant"),
        (("area",), TOML, "area"),
        (("directional", "constant"), None, "directional, constant"),
    ],
)
def test_light_of_the_xml_that_is_not_used_is_told(
    tmp_path: Path, kinds: tuple[str, ...], toml: str | None, told: str | None
) -> None:
    """A directional one beside a sun of scene.toml stands for it in stock Mitsuba."""
    folder = scene(tmp_path, toml=toml)
    text = (folder / "scene.xml").read_text()
    for kind in kinds:
        light = f'<emitter type="{kind}"/>'
        end = "</shape>" if kind == "area" else "</scene>"
        text = text.replace(end, light + end, 1)
    (folder / "scene.xml").write_text(text)
    expected = [] if told is None else [f"light sources of the XML are not used: {told}"]
    warnings = load_scene(folder).warnings
    assert [w for w in warnings if w.startswith("light sources")] == expected


def test_a_rig_that_turns_needs_a_place(tmp_path: Path) -> None:
    assert_refused(scene(tmp_path, toml="[rig]\nyaw_deg = 5\n"), "rig: needs `position_m`")


def test_a_bare_scene_may_bring_its_own_reflectance(tmp_path: Path) -> None:
    loaded = load_scene(scene(tmp_path, material="paint", reflectance="0.7", toml=None))
    assert loaded.objects[0].reflectance == pytest.approx(0.7)
    assert any("paint" in w for w in loaded.warnings)


def test_a_table_beside_the_scene_extends_the_bundled_one(tmp_path: Path) -> None:
    """Rows of its own, rows in place of bundled ones, of which a note tells; all others stay."""
    row = '[{}.optical]\nreflectance = {{ value = {}, source = "made up" }}\n'
    for name, value in (("unobtainium", 0.25), ("brick", 0.125), ("concrete", None)):
        folder = scene(tmp_path / name, material=name, reflectance="0.5")
        (folder / "materials.toml").write_text(row.format("unobtainium", 0.25))
        (folder.parent / "materials.toml").write_text(row.format("brick", 0.125))
        table = load_materials(scenes_folder() / "materials.toml")
        expected = table[name].optical.reflectance.value if value is None else value
        loaded = load_scene(folder)
        assert loaded.objects[0].reflectance == expected
        place = folder.parent / "materials.toml"
        assert loaded.notes == (f"{place}: takes the place of the rows brick",)
        assert set(loaded.notes).isdisjoint(loaded.assumptions)
    assert load_scene("table1").notes == ()


def test_a_wrong_table_beside_the_scene_is_refused(tmp_path: Path) -> None:
    folder = scene(tmp_path)
    (folder / "materials.toml").write_text(
        '[unobtainium.optical]\nreflectance = { value = -0.25, source = "made up" }\n'
    )
    assert_refused(folder, "materials.toml", "unobtainium.optical.reflectance.value = -0.25")


@pytest.mark.parametrize(
    ("toml", "expected"),
    [
        (TOML.replace("[sun]", "[sunny]"), "sunny"),
        (TOML.replace("30.0", "nan"), "sun.elevation_deg"),
        (TOML.replace("1e5", "-1.0"), "sun.illuminance_lx = -1.0"),
        (TOML.replace("[0.0, 0.0, 0.0]", "[0.0, 0.0]"), "rig.position_m"),
        (
            TOML + "[objects.thing]\nvelocity_m_per_s = [1, 0]\n",
            "objects.thing.velocity_m_per_s = [1, 0]: expected three numbers",
        ),
        (
            TOML + "[objects.thing]\nvelocity_m_per_s = [1, 0, 0, 0]\n",
            "objects.thing.velocity_m_per_s = [1, 0, 0, 0]: expected three numbers",
        ),
        (
            TOML + "[objects.thing]\nvelocity_m_per_s = 3\n",
            "objects.thing.velocity_m_per_s = 3: expected three numbers",
        ),
        (
            TOML + "[objects.thing.motion.turning]\ncentre_m = []\n",
            "objects.thing.motion.turning.centre_m = []: expected three numbers",
        ),
        ("targets = 3\n" + TOML, "targets = 3: expected a list"),
        (TOML + "[objects.ghost]\nvelocity_m_per_s = [1.0, 0.0, 0.0]\n", "no shape has the id"),
        (
            TOML + '[[targets]]\nname = "t"\nposition_m = [1.0, 0.0, 0.0]\nrcs_m2 = 1.0',
            "rcs_source",
        ),
        ("[rig", "no valid TOML"),
    ],
)
def test_bad_settings_name_file_and_field(tmp_path: Path, toml: str, expected: str) -> None:
    assert_refused(scene(tmp_path, toml=toml), "scene.toml", expected)


def test_unsupported_shapes_and_double_names(tmp_path: Path) -> None:
    assert_refused(scene(tmp_path, plugin="hair"), "'hair' is not supported")
    shutil.rmtree(tmp_path)
    tmp_path.mkdir()
    folder = scene(tmp_path)
    text = (folder / "scene.xml").read_text()
    shape = text[text.index("<shape") : text.index("</scene>")]
    (folder / "scene.xml").write_text(text.replace("</scene>", shape + "</scene>"))
    assert_refused(folder, "thing")


# Faults that were found by trying.


def test_a_pose_is_a_pose() -> None:
    with pytest.raises(InputError, match=r"pose = \(1, 0, 2\): expected a Pose, as twin.Pose"):
        load_scene("yard", (1, 0, 2))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("toml", "expected"),
    [
        (TOML.replace("180.0", '"180"'), "sun.azimuth_deg = '180'"),
        (TOML.replace("180.0", "true"), "sun.azimuth_deg = True"),
    ],
)
def test_numbers_are_numbers(tmp_path: Path, toml: str, expected: str) -> None:
    assert_refused(scene(tmp_path, toml=toml), expected)


def test_a_table_that_overrules_the_xml_says_so(tmp_path: Path) -> None:
    loaded = load_scene(scene(tmp_path, material="concrete", reflectance="0.1"))
    assert any("0.1 in the XML, 0.36 in the table" in w for w in loaded.warnings)


def test_a_rig_inside_an_object_is_warned_of(tmp_path: Path) -> None:
    folder = scene(tmp_path, plugin="cube")
    assert any("the rig stands inside thing" in w for w in load_scene(folder).warnings)
    outside = load_scene(folder, Pose((5.0, 0.0, 0.0)))
    assert not any("inside" in w for w in outside.warnings)


def test_obj_counts_from_one(tmp_path: Path) -> None:
    folder = scene(tmp_path)
    text = (folder / "scene.xml").read_text().replace('"ply"', '"obj"').replace(".ply", ".obj")
    (folder / "scene.xml").write_text(text)
    (folder / "thing.obj").write_text("v 5 0 0\nv 5 1 0\nv 5 0 1\nf 1 2 3\nf 0 1 2\n")
    assert_refused(folder, "thing.obj: line 5: vertex 0")


@pytest.mark.parametrize(
    "to_uv",
    [
        '<scale x="2" y="3"/>',
        '<translate x="0.3" y="0.11"/>',
        '<translate x="0.2" y="0.4"/><rotate z="1" angle="30"/><scale x="1.5" y="0.7"/>',
        '<matrix value="1 0.2 0.3 -0.1 1 0.11 0 0 1"/>',
        '<matrix value="1 0 0 0.3 0 1 0 0.11 0 0 1 0 0 0 0 1"/>',
    ],
)
def test_textures_are_placed_as_stock_mitsuba_places_them(tmp_path: Path, to_uv: str) -> None:
    """An OBJ with a texture, its `to_uv`, filter and wrapping: albedo along 64 rays, both ways.

    Translations in any order with other steps; a matrix of nine values, whose third column stock
    Mitsuba drops, and one of sixteen. With the translation ignored, 0.8 and more of the range off.
    """
    from twin.camera.truth import render_truth
    from twin.optics.devices import Device

    mi = mitsuba()
    image = np.random.default_rng(0).random((8, 8, 1)).astype(np.float32)
    with exr_threads():
        mi.Bitmap(image).write(str(tmp_path / "t.exr"))
    (tmp_path / "q.obj").write_text(
        "v 5 1 1\nv 5 -1 1\nv 5 -1 -1\nv 5 1 -1\n"
        "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nf 1/1 2/2 3/3\nf 1/1 3/3 4/4\n"
    )
    (tmp_path / "s.xml").write_text(
        '<scene version="3.0.0"><shape type="obj" id="q"><string name="filename" value="q.obj"/>'
        '<bsdf type="twosided" id="own"><bsdf type="diffuse"><texture type="bitmap" '
        'name="reflectance"><string name="filename" value="t.exr"/><boolean name="raw" '
        f'value="true"/><transform name="to_uv">{to_uv}</transform></texture></bsdf>'
        "</bsdf></shape></scene>"
    )
    camera = Device(np.zeros(3), np.eye(3), 0.15)
    ours = mitsuba_scene(load_scene(tmp_path / "s.xml", Pose((0.0, 0.0, 0.0))))
    with exr_threads():
        stock = mi.load_file(str(tmp_path / "s.xml"))
    a, b = (render_truth(world, camera, (8, 8)).albedo for world in (ours, stock))
    np.testing.assert_allclose(a, b, atol=2e-3)
    assert np.ptp(a) > 0.2


@pytest.mark.parametrize("name", ["model.stl", "model.GLB", "model.obj"])
def test_a_model_is_no_scene_and_how_it_becomes_one(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(b"solid")
    assert_refused(tmp_path / name, f"`twin import {tmp_path / name} scenes/model`")


# Materials that no table holds.


def test_the_radar_warns_of_unknown_materials_where_their_meshes_answer(tmp_path: Path) -> None:
    """A plate of an unknown metal would be 10 dB weaker as `generic`: the warning names both."""
    told = "materials not in the table, radio properties taken from generic: unobtainium (thing)"

    def warnings(material: str, model: str) -> tuple[str, ...]:
        loaded = load_scene(scene(tmp_path / material, material=material))
        radar = load_radar("hybrid-79").with_({"waveform.n_slots": 4})
        return radar_capture(loaded, radar, fidelity=Fidelity(radar=model)).warnings

    assert told in warnings("unobtainium", "optics")
    assert told not in warnings("unobtainium", "targets")  # which leaves meshes out
    for known in ("generic", "metal"):
        assert not any("radio properties" in text for text in warnings(known, "optics"))


def test_unlike_surfaces_in_one_plane_are_named(tmp_path: Path) -> None:
    """Of two rectangles in one plane the camera sees the last one of the file, without a word it
    was; a millimetre apart they are two, and what is alike makes no difference. A box that stands
    on a floor shows no such faces.
    """
    square = (
        '<shape type="{kind}" id="{id}"><transform name="to_world"><scale x="2" y="2"/>'
        '<rotate y="1" angle="-90"/><translate x="{x}"/></transform>'
        '<bsdf type="diffuse"><spectrum name="reflectance" value="{r}"/></bsdf></shape>'
    )
    (tmp_path / "scene.toml").write_text(TOML)

    def told(*shapes: tuple[str, str, float, float]) -> str:
        text = "".join(square.format(kind=k, id=i, x=x, r=r) for k, i, x, r in shapes)
        (tmp_path / "scene.xml").write_text(f'<scene version="3.0.0">{text}</scene>')
        return " ".join(w for w in load_scene(tmp_path).warnings if "in one plane" in w)

    dark, light = ("rectangle", "dark", 5.0, 0.2), ("rectangle", "light", 5.0, 0.8)
    for pair in ((dark, light), (light, dark)):
        assert "dark" in told(*pair)
        assert "light" in told(*pair)
        assert "reflectance 0.8" in told(*pair)
    assert told(dark, ("rectangle", "light", 5.001, 0.8)) == ""
    assert told(dark, ("rectangle", "same", 5.0, 0.2)) == ""
    assert told(dark, ("cube", "box", 4.0, 0.8)) == ""  # its back
    assert "box" in told(dark, ("cube", "box", 6.0, 0.8))  # its front


def test_a_scene_given_by_its_settings_is_refused_with_its_folder(tmp_path) -> None:
    """It had been read as XML, which it is not."""
    (tmp_path / "scene.toml").write_text(TOML)
    with pytest.raises(InputError, match=r"scene.toml: holds the settings.* `twin run .*` runs it"):
        load_scene(tmp_path / "scene.toml")

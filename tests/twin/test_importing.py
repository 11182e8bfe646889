"""Model files of other people become scenes."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from twin.fidelity import Fidelity
from twin.files import InputError
from twin.scene import load_scene
from twin.scene.checking import check_scene
from twin.scene.importing import import_model


@pytest.fixture
def robot() -> trimesh.Scene:
    """Two parts in a transform graph: a 2 m tall box on a 1 m wide base, y up as glTF has it."""
    scene = trimesh.Scene()
    scene.add_geometry(trimesh.creation.box((1.0, 0.2, 0.5)), node_name="base plate")
    lifted = trimesh.transformations.translation_matrix([0, 1.1, 0])
    scene.add_geometry(trimesh.creation.box((0.4, 2, 0.3)), node_name="mast", transform=lifted)
    return scene


@pytest.mark.parametrize("suffix", ["glb", "obj", "stl", "ply"])
def test_formats(robot: trimesh.Scene, tmp_path: Path, suffix: str) -> None:
    """Size and volume survive; y up becomes z up, +z becomes x forward."""
    model = tmp_path / f"robot.{suffix}"
    (robot if suffix == "glb" else robot.to_geometry()).export(model)
    import_model(model, tmp_path / "scene", up="y")
    loaded = load_scene(tmp_path / "scene")
    vertices = np.vstack([o.vertices_m for o in loaded.objects])
    np.testing.assert_allclose(np.ptp(vertices, axis=0), [0.5, 1.0, 2.2], atol=1e-6)
    volume = sum(trimesh.Trimesh(o.vertices_m, o.geometry.faces).volume for o in loaded.objects)
    assert volume == pytest.approx(0.1 + 0.24, rel=1e-5)
    assert {o.material for o in loaded.objects} == {"generic"}


def test_gltf_is_y_up_by_itself_and_parts_keep_their_names(robot, tmp_path: Path) -> None:
    robot.export(tmp_path / "robot.glb")
    notes = import_model(tmp_path / "robot.glb", tmp_path / "scene", scale=0.01)
    loaded = load_scene(tmp_path / "scene")
    assert {o.name for o in loaded.objects} == {"base_plate", "mast"}
    vertices = np.vstack([o.vertices_m for o in loaded.objects])
    np.testing.assert_allclose(np.ptp(vertices, axis=0), [0.005, 0.01, 0.022], atol=1e-8)
    assert any("y is up, 0.01 m per unit" in note for note in notes)


def test_a_model_in_millimetres_is_told(robot, tmp_path: Path) -> None:
    robot.apply_scale(1000.0)
    robot.export(tmp_path / "robot.glb")
    wide = import_model(tmp_path / "robot.glb", tmp_path / "wide")
    assert "a model in millimetres needs --scale 0.001" in wide
    right = import_model(tmp_path / "robot.glb", tmp_path / "scene", scale=0.001)
    assert not any("millimetres" in note for note in right)


def test_the_rig_sees_the_model(robot, tmp_path: Path) -> None:
    from twin.camera.acquisition import capture
    from twin.system import load_system

    robot.export(tmp_path / "robot.glb")
    import_model(tmp_path / "robot.glb", tmp_path / "scene")
    taken = capture(
        load_scene(tmp_path / "scene"), load_system("workable"), fidelity=Fidelity(4, 1)
    )
    lit = taken.truth.albedo > 0
    assert 0.05 < lit.mean() < 0.9
    assert not lit[0].any()
    assert not lit[:, 0].any()


@pytest.mark.parametrize("side_m", [1e-3, 0.01, 0.1, 1.0])
def test_both_devices_see_a_model_of_any_size(side_m: float, tmp_path: Path) -> None:
    """Corners within 10 degrees of either's axis, up and across; the detector stands 5 cm off."""
    trimesh.creation.box((side_m, side_m, side_m)).export(tmp_path / "cube.stl")
    notes = import_model(tmp_path / "cube.stl", tmp_path / "scene")
    assert any("the radar, 0.3 m below" in note for note in notes) == (side_m < 0.5)
    scene = load_scene(tmp_path / "scene")
    corners = scene.objects[0].vertices_m
    for name in ("emitter", "detector"):
        origin, axes = scene.rig.device(name)
        ahead, left, up = axes @ (corners - scene.rig.position_m - origin).T
        assert (ahead > 0).all()
        assert np.degrees(np.arctan2(np.abs([left, up]), ahead)).max() < 10


@pytest.mark.parametrize(
    ("side_m", "at_m", "told"),
    [
        (1, 1e8, ""),
        (1, 1e12, "1e+12 m from the origin"),
        (5e4, 0, "place it nearer"),
        (2e5, 0, "2e+05"),
    ],
)
def test_a_model_that_no_scene_may_hold_is_refused(
    side_m: float, at_m: float, told: str, tmp_path: Path
) -> None:
    """Before a folder is written that the next run refuses; where the rig alone is too far from the
    model's end, it can be placed elsewhere, and a note says so.
    """
    x = at_m + side_m
    (tmp_path / "far.obj").write_text(f"v {at_m} 0 0\nv {x} 0 0\nv {x} {side_m} 1\nf 1 2 3\n")
    if told and "place" not in told:
        with pytest.raises(InputError, match=re.escape(told)):
            import_model(tmp_path / "far.obj", tmp_path / "scene")
        assert not (tmp_path / "scene").exists()
        return
    notes = import_model(tmp_path / "far.obj", tmp_path / "scene")
    assert any("place it nearer" in note for note in notes) == bool(told)
    if not told:
        assert load_scene(tmp_path / "scene").objects


def test_faces_without_an_area_are_told_and_measure_nothing(tmp_path: Path) -> None:
    vertices = [[0, 0, 0], [1, 0, 0], [2, 0, 0], [1, 1, 1]]
    mesh = trimesh.Trimesh(vertices, [[0, 1, 2], [0, 0, 1], [0, 1, 3]], process=False)
    mesh.export(tmp_path / "flat.stl")
    notes = import_model(tmp_path / "flat.stl", tmp_path / "scene")
    assert "2 faces without an area left out" in notes
    assert any("the scene measures 1 x 1 x 1 m" in note for note in notes)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"scale": 0.0}, "scale: 0.0"),
        ({"scale": float("nan")}, "scale: nan"),
        ({"up": "x"}, "up: 'x'"),
        ({"material": "unobtainium"}, "material: 'unobtainium'"),
    ],
)
def test_bad_arguments(robot, tmp_path: Path, change: dict, expected: str) -> None:
    robot.export(tmp_path / "robot.glb")
    with pytest.raises(InputError, match=expected):
        import_model(tmp_path / "robot.glb", tmp_path / "scene", **change)
    assert not (tmp_path / "scene").exists()


def test_broken_models_leave_nothing(tmp_path: Path) -> None:
    broken = tmp_path / "broken.glb"
    broken.write_bytes(b"glTF but not really")
    with pytest.raises(InputError, match=r"broken\.glb: can't be read"):
        import_model(broken, tmp_path / "scene")
    (tmp_path / "bad.obj").write_text("v 0 0 0\nv 1 0 0\nv nan 1 0\nf 1 2 3\n")
    with pytest.raises(InputError, match=r"bad\.obj"):
        import_model(tmp_path / "bad.obj", tmp_path / "scene")
    assert not (tmp_path / "scene").exists()


def test_an_existing_scene_is_not_overwritten(robot, tmp_path: Path) -> None:
    robot.export(tmp_path / "robot.glb")
    import_model(tmp_path / "robot.glb", tmp_path / "scene")
    with pytest.raises(InputError, match="exists already"):
        import_model(tmp_path / "robot.glb", tmp_path / "scene")


def test_map_coordinates_keep_their_millimetres(tmp_path: Path) -> None:
    """4.5e6 m out float32 has half-metre steps; the scene must not."""
    ball = trimesh.creation.icosphere(2, radius=1.0)
    far = np.array([4.5e6, 5.3e6, 512.0])
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in (ball.vertices + far).tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in ball.faces + 1]
    (tmp_path / "far.obj").write_text("\n".join(lines))
    import_model(tmp_path / "far.obj", tmp_path / "scene")
    (thing,) = load_scene(tmp_path / "scene").objects
    radius = np.linalg.norm(thing.vertices_m - far, axis=1)
    assert len(thing.geometry.faces) == len(ball.faces)
    np.testing.assert_allclose(radius, 1.0, atol=1e-6)


def test_names_that_collide_all_survive(tmp_path: Path) -> None:
    """Also one that is the material's: ids are unique in a scene file."""
    scene = trimesh.Scene()
    for i, name in enumerate(["x", "x-2", "x!", "generic"]):
        box = trimesh.creation.box((1, 1, 1))
        box.apply_translation([0, 0, 2.0 * i])
        scene.add_geometry(box, node_name=name)
    scene.export(tmp_path / 'a "b".glb')
    import_model(tmp_path / 'a "b".glb', tmp_path / "scene")
    loaded = load_scene(tmp_path / "scene")
    assert len(loaded.objects) == 4
    assert loaded.description == 'imported from a "b".glb'


def half_white(name: str, **given) -> trimesh.Trimesh:
    """A square in the x-y plane whose picture is white above and black below."""
    picture = np.zeros((8, 8, 3), np.uint8)
    picture[:4] = 255
    material = trimesh.visual.material.PBRMaterial(
        name=name, baseColorTexture=Image.fromarray(picture), **given
    )
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=float)
    drawn = trimesh.visual.TextureVisuals(uv=corners[:, :2], material=material)
    return trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False, visual=drawn)


@pytest.mark.parametrize("suffix", ["glb", "obj"])
def test_a_picture_is_a_reflectance_when_asked(tmp_path: Path, suffix: str) -> None:
    """The right way up, times the material's colour of linear light, which OBJ leaves out."""
    from twin.camera.acquisition import capture
    from twin.system import load_system

    colour = {"baseColorFactor": [0.5, 0.5, 0.5, 1.0]} if suffix == "glb" else {}
    half_white("Concrete.001", **colour).export(tmp_path / f"wall.{suffix}")
    notes = import_model(
        tmp_path / f"wall.{suffix}", tmp_path / "scene", up="y", texture_as_reflectance=True
    )
    assert "picture of visible light textures/concrete.png taken as reflectance" in "\n".join(notes)
    (wall,) = load_scene(tmp_path / "scene").objects
    assert wall.material == "concrete"
    fine = Fidelity(4, 1)
    albedo = capture(
        load_scene(tmp_path / "scene"), load_system("workable"), fidelity=fine
    ).truth.albedo
    white = 0.5 if suffix == "glb" else 1.0
    assert albedo.max() == pytest.approx(white, abs=0.01)
    # The picture repeats: at its lower border the upper one is mixed in.
    rows = np.flatnonzero((albedo > 0.6 * white).any(axis=1))
    assert 20 < len(rows) < 30
    assert rows.max() <= len(albedo) // 2


def test_a_picture_is_kept_and_the_tables_value_holds_unless_asked(tmp_path: Path) -> None:
    half_white("Concrete.001").export(tmp_path / "wall.glb")
    notes = "\n".join(import_model(tmp_path / "wall.glb", tmp_path / "scene"))
    assert "'Concrete.001' is row 'concrete'" in notes
    assert "textures/concrete.png kept, not used; --texture-as-reflectance" in notes
    assert np.asarray(Image.open(tmp_path / "scene" / "textures" / "concrete.png"))[0, 0, 0] == 255
    (wall,) = load_scene(tmp_path / "scene").objects
    assert wall.reflectance == pytest.approx(0.36)
    # v runs down the picture, as Mitsuba looks it up.
    up = wall.vertices_m[:, 2] > 0.5
    np.testing.assert_allclose(wall.geometry.uv[:, 1], np.where(up, 0.0, 1.0), atol=1e-6)


def test_every_material_and_colour_is_told(tmp_path: Path) -> None:
    scene = trimesh.Scene()
    for i, (name, given) in enumerate(
        [
            ("Painted Steel", {"baseColorFactor": [0.2, 0.4, 0.6, 1.0], "metallicFactor": 1.0}),
            ("Unobtainium", {"baseColorFactor": [1.0, 1.0, 1.0, 0.25], "alphaMode": "BLEND"}),
        ]
    ):
        box = trimesh.creation.box((1, 1, 1))
        box.apply_translation([0, 0, 2.0 * i])
        material = trimesh.visual.material.PBRMaterial(name=name, **given)
        box.visual = trimesh.visual.TextureVisuals(uv=np.zeros((8, 2)), material=material)
        scene.add_geometry(box, node_name=f"part{i}")
    scene.export(tmp_path / "two.glb")
    notes = "\n".join(import_model(tmp_path / "two.glb", tmp_path / "scene", material="wood"))
    materials = {o.name: o.material for o in load_scene(tmp_path / "scene").objects}
    assert materials == {"part0": "painted_steel", "part1": "wood"}
    assert "'Unobtainium' is not in the materials table, 'wood' is used (part1)" in notes
    assert "visible colour 0.2, 0.4, 0.6 left out" in notes
    assert "metallic 1: taken as Lambertian (part0)" in notes
    assert "transparency: taken as opaque (part1)" in notes


def test_objects_of_an_obj_stay_apart(tmp_path: Path) -> None:
    """Two objects without materials, or of the same one, were one: neither could move by itself."""
    wall = trimesh.creation.box((0.2, 4.0, 2.5))
    post = trimesh.creation.cylinder(radius=0.1, height=1.0, sections=16)
    post.apply_translation([-1.5, 0.0, 0.0])
    trimesh.Scene({"wall": wall, "post": post}).export(tmp_path / "two.obj")
    import_model(tmp_path / "two.obj", tmp_path / "scene")
    sizes = {o.name: len(o.geometry.faces) for o in load_scene(tmp_path / "scene").objects}
    assert sizes == {"wall": len(wall.faces), "post": len(post.faces)}


def test_boxes_that_touch_are_not_told_as_open(tmp_path: Path) -> None:
    """The two boxes of an L share edges of four faces, none of one; without a face it is open."""
    wall, wing = trimesh.creation.box((0.2, 4.0, 2.5)), trimesh.creation.box((2.0, 0.2, 2.5))
    wing.apply_translation([-1.1, 1.9, 0.0])
    both = trimesh.util.concatenate([wall, wing])
    remarks = []
    for name, mesh in (("box", wall), ("touching", both), ("cut", both.submesh([range(1, 24)])[0])):
        mesh.export(tmp_path / f"{name}.stl")
        import_model(tmp_path / f"{name}.stl", tmp_path / name)
        remarks.append(*(row.remarks for row in check_scene(load_scene(tmp_path / name))))
    assert remarks == [(), ("edges of more than two faces",), ("open surface",)]


def test_surfaces_that_are_simplified_are_told_object_by_object(tmp_path: Path) -> None:
    """A principled metal, a mask, a conductor; a plain diffuse surface is not simplified."""
    (tmp_path / "odd.xml").write_text(
        """<scene version="3.0.0"><integrator type="path"/>
        <shape type="cube" id="hood"><bsdf type="principled" id="chrome">
          <rgb name="base_color" value="0.27, 0.27, 0.27"/><float name="metallic" value="1"/></bsdf></shape>
        <shape type="sphere" id="fence"><transform name="to_world"><translate value="5,0,0"/></transform>
          <bsdf type="mask" id="net"><float name="opacity" value="0.3"/>
          <bsdf type="diffuse"><spectrum name="reflectance" value="0.6"/></bsdf></bsdf></shape>
        <shape type="sphere" id="ball"><transform name="to_world"><translate value="5,5,0"/></transform>
          <bsdf type="roughconductor" id="al"><string name="material" value="Al"/></bsdf></shape>
        <shape type="sphere" id="plain"><transform name="to_world"><translate value="0,5,0"/></transform>
          <bsdf type="diffuse" id="mine"><spectrum name="reflectance" value="0.6"/></bsdf></shape>
        </scene>"""  # noqa: E501
    )
    warnings = "\n".join(load_scene(tmp_path / "odd.xml").warnings)
    assert "principled, metallic 1: taken as Lambertian (hood)" in warnings
    assert "mask, opacity 0.3: taken as opaque (fence)" in warnings
    assert "roughconductor, material Al: taken as Lambertian (ball)" in warnings
    assert "chrome, 0.27 (hood)" in warnings
    assert "simplified: " in warnings
    assert "(plain)" not in warnings.split("simplified: ")[1]


def test_a_truncated_glb_says_so(robot: trimesh.Scene, tmp_path: Path) -> None:
    robot.export(tmp_path / "robot.glb")
    whole = (tmp_path / "robot.glb").read_bytes()
    for kept in (40, len(whole) // 2, len(whole) - 4):
        (tmp_path / "cut.glb").write_bytes(whole[:kept])
        with pytest.raises(InputError, match=rf"truncated, {kept} of {len(whole)} bytes"):
            import_model(tmp_path / "cut.glb", tmp_path / "scene")


SQUARE = "v 0 0 0\nv 1 0 0\nv 1 0 1\nv 0 0 1\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
FACE = "usemtl Brick\nf 1/1 2/2 3/3 4/4\n"


@pytest.mark.parametrize(
    ("head", "library", "told"),
    [
        (
            "mtllib gone.mtl\n",
            None,
            "pictures of Brick left out: gone.mtl is not there",
        ),
        ("", None, "colours and pictures of Brick left out: no material file defines them"),
        ("mtllib wall.mtl\n", "newmtl Wood\n", "of Brick left out: no material file defines them"),
        ("mtllib wall.mtl\n", "newmtl Brick\nmap_Kd gone.png\n", "picture 'gone.png' of wall.mtl"),
    ],
)
def test_files_that_an_obj_misses_are_told(
    tmp_path: Path, head: str, library: str | None, told: str
) -> None:
    (tmp_path / "wall.obj").write_text(head + SQUARE + FACE)
    if library:
        (tmp_path / "wall.mtl").write_text(library)
    assert told in "\n".join(import_model(tmp_path / "wall.obj", tmp_path / "scene"))
    (wall,) = load_scene(tmp_path / "scene").objects
    assert wall.material == "brick"  # the name is known, whatever defines it


def test_a_picture_of_an_obj_is_taken(tmp_path: Path) -> None:
    """A square of one face whose texture coordinates are those of its corners."""
    Image.new("RGB", (4, 4), (200, 100, 50)).save(tmp_path / "plain.png")
    (tmp_path / "wall.mtl").write_text("newmtl Brick\nKd 1 1 1\nmap_Kd plain.png\n")
    (tmp_path / "wall.obj").write_text("mtllib wall.mtl\n" + SQUARE + FACE)
    notes = import_model(tmp_path / "wall.obj", tmp_path / "scene", texture_as_reflectance=True)
    assert "picture of visible light textures/brick.png taken as reflectance" in "\n".join(notes)
    (wall,) = load_scene(tmp_path / "scene").objects
    corner = np.column_stack([wall.vertices_m[:, 0], 1 - wall.vertices_m[:, 2]])
    np.testing.assert_allclose(wall.geometry.uv, corner, atol=1e-6)


@pytest.mark.parametrize(
    ("uri", "told"),
    [("gone.png", "it is not there"), ("../far.png", "it lies outside the model's folder")],
)
def test_pictures_that_a_gltf_misses_are_told(tmp_path: Path, uri: str, told: str) -> None:
    Image.new("RGB", (4, 4)).save(tmp_path / "far.png")
    notes = "\n".join(import_model(with_picture(tmp_path, uri), tmp_path / "scene"))
    assert f"picture {uri!r} left out: {told}" in notes


def with_picture(tmp_path: Path, uri: str) -> Path:
    """A glTF of a square, in a folder of its own, whose picture has another address."""
    files = trimesh.exchange.gltf.export_gltf(trimesh.Scene(half_white("Concrete")))
    (folder := tmp_path / "model").mkdir()
    for name, data in files.items():
        (folder / name).write_bytes(data)
    content = json.loads(files["model.gltf"])
    content["images"] = [{"uri": uri}]
    (folder / "wall.gltf").write_text(json.dumps(content))
    return folder / "wall.gltf"


def test_names_are_percent_encoded_in_a_gltf(tmp_path: Path) -> None:
    """GlTF 2.0, section 2.8: URIs; the file is named as RFC 3986 decodes it."""
    model = with_picture(tmp_path, "tex%20one%C3%A9.png")
    Image.new("RGB", (4, 4), (200, 100, 50)).save(model.parent / "tex one\u00e9.png")
    notes = "\n".join(import_model(model, tmp_path / "scene"))
    assert "picture of visible light textures/concrete.png kept" in notes
    picture = Image.open(tmp_path / "scene" / "textures" / "concrete.png")
    assert picture.getpixel((0, 0)) == (200, 100, 50)


def test_all_material_files_of_an_obj_are_read(tmp_path: Path) -> None:
    """Two statements of two names; each defines one material, and one is half transparent."""
    (tmp_path / "a.mtl").write_text("newmtl Brick\nKd 0.1 0.2 0.3\n")
    (tmp_path / "b.mtl").write_text("newmtl Wood\nKd 0.4 0.5 0.6\nd 0.5\n")
    (tmp_path / "c.mtl").write_text("newmtl Glass\nTr 0.9\n")
    body = "usemtl Brick\nf 1 2 3\nusemtl Wood\nf 1 3 4\nusemtl Glass\nf 1 2 4\nl 1 2\np 3\np 4\n"
    (tmp_path / "wall.obj").write_text("mtllib a.mtl\nmtllib b.mtl c.mtl\n" + SQUARE + body)
    notes = import_model(tmp_path / "wall.obj", tmp_path / "scene")
    materials = {o.material for o in load_scene(tmp_path / "scene").objects}
    assert materials == {"brick", "wood", "glass"}
    told = "\n".join(notes)
    for colour in ("0.1, 0.2, 0.3", "0.4, 0.5, 0.6"):
        assert f"visible colour {colour} left out" in told
    (clear,) = [note for note in notes if "transparency: taken as opaque" in note]
    assert "Wood" in clear
    assert "Glass" in clear
    assert "Brick" not in clear
    assert "wall.obj: left out: points (2), lines (1)" in told


def test_what_a_gltf_holds_beside_triangles_is_told(robot: trimesh.Scene, tmp_path: Path) -> None:
    """One line that names the file."""
    files = trimesh.exchange.gltf.export_gltf(robot)
    for name, data in files.items():
        (tmp_path / name).write_bytes(data)
    content = json.loads(files["model.gltf"])
    content["cameras"] = [{"type": "perspective", "perspective": {"yfov": 1, "znear": 0.1}}]
    content["extensions"] = {"KHR_lights_punctual": {"lights": [{"type": "point"}] * 2}}
    moved = {"index": 0, "extensions": {"KHR_texture_transform": {"offset": [0.5, 0]}}}
    content["materials"] = [{"name": "Brick", "pbrMetallicRoughness": {"baseColorTexture": moved}}]
    content["extensionsRequired"] = ["KHR_materials_unlit"]
    edges = {key: content["meshes"][0]["primitives"][0][key] for key in ("attributes",)}
    content["meshes"][0]["primitives"].append({**edges, "mode": 1})
    content["animations"] = [{"channels": [], "samplers": []}]
    (tmp_path / "robot.gltf").write_text(json.dumps(content))
    (line,) = [
        note
        for note in import_model(tmp_path / "robot.gltf", tmp_path / "scene")
        if note.startswith("robot.gltf: left out: ")
    ]
    for what in ("cameras (1)", "lights (2)", "parts of points or lines (1)", "animations (1)"):
        assert what in line
    assert "KHR_texture_transform of Brick" in line
    assert "KHR_materials_unlit" in line


@pytest.mark.parametrize(
    ("nodes", "told"),
    [
        ([{"children": [0], "mesh": 0}], "are children of their own children"),
        ([{"children": [1]}, {"children": [0], "mesh": 0}], "are children of their own children"),
        (
            [{"children": [2]}, {"children": [2]}, {"mesh": 0}],
            "node 2: child of 2, expected",
        ),
        ([{"mesh": 0, "translation": [0, float("inf"), 0]}], "node 0: translation"),
        ([{"mesh": 0, "scale": [1, 10**400, 1]}], "no valid glTF: int too large"),
    ],
)
def test_nodes_are_trees_placed_by_numbers(
    robot: trimesh.Scene, tmp_path: Path, nodes: list[dict], told: str
) -> None:
    """GlTF 2.0, section 3.5.1: disjoint strict trees; one line, without a warning of NumPy's."""
    files = trimesh.exchange.gltf.export_gltf(robot)
    for name, data in files.items():
        (tmp_path / name).write_bytes(data)
    content = json.loads(files["model.gltf"]) | {"nodes": nodes, "scenes": [{"nodes": [0]}]}
    (tmp_path / "robot.gltf").write_text(json.dumps(content))
    with pytest.raises(InputError, match=rf"robot\.gltf: .*{told}"):
        import_model(tmp_path / "robot.gltf", tmp_path / "scene")


def test_compressed_triangles_are_told(robot: trimesh.Scene, tmp_path: Path) -> None:
    files = trimesh.exchange.gltf.export_gltf(robot)
    content = json.loads(files["model.gltf"])
    content["extensionsRequired"] = ["EXT_meshopt_compression"]
    (tmp_path / "robot.gltf").write_text(json.dumps(content))
    with pytest.raises(InputError, match=r"needs EXT_meshopt_compression: export it without"):
        import_model(tmp_path / "robot.gltf", tmp_path / "scene")


def test_a_scenes_obj_keeps_its_texture_coordinates(tmp_path: Path) -> None:
    """Faces name their texture coordinates in another order than their vertices, in two materials
    with pictures, as exporters write them: each corner has its own, as written.
    """
    for name in ("Brick", "Wood"):
        Image.new("RGB", (4, 4)).save(tmp_path / f"{name}.png")
    library = "".join(f"newmtl {name}\nmap_Kd {name}.png\n" for name in ("Brick", "Wood"))
    (tmp_path / "wall.mtl").write_text(library)
    texture = "vt 0.1 0.2\nvt 0.9 0.2\nvt 0.9 0.7\nvt 0.1 0.7\n"
    corners = SQUARE.split("vt")[0]
    faces = "usemtl Brick\nf 1/3 2/4 3/1\nusemtl Wood\nf 1/3 3/1 4/2\n"
    (tmp_path / "wall.obj").write_text("mtllib wall.mtl\n" + corners + texture + faces)
    (tmp_path / "scene.xml").write_text(
        '<scene version="3.0.0"><shape type="obj" id="wall">'
        '<string name="filename" value="wall.obj"/>'
        '<boolean name="flip_tex_coords" value="false"/></shape></scene>'
    )
    (wall,) = load_scene(tmp_path / "scene.xml").objects
    assert wall.geometry.uv is not None
    assert len(wall.geometry.faces) == 2
    expected = {(0, 0): (0.9, 0.7), (1, 0): (0.1, 0.7), (1, 1): (0.1, 0.2), (0, 1): (0.9, 0.2)}
    for vertex, uv in zip(wall.vertices_m, wall.geometry.uv, strict=True):
        corner = round(float(vertex[0])), round(float(vertex[2]))
        np.testing.assert_allclose(uv, expected[corner], atol=1e-6)

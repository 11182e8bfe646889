"""Model files of other people become scenes."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from twin.fidelity import Fidelity
from twin.files import InputError
from twin.scene import load_scene
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
    volume = sum(trimesh.Trimesh(o.vertices_m, o.faces).volume for o in loaded.objects)
    assert volume == pytest.approx(0.1 + 0.24, rel=1e-5)
    assert {o.material for o in loaded.objects} == {"generic"}


def test_gltf_is_y_up_by_itself_and_parts_keep_their_names(robot, tmp_path: Path) -> None:
    robot.export(tmp_path / "robot.glb")
    notes = import_model(tmp_path / "robot.glb", tmp_path / "scene", scale=0.01)
    loaded = load_scene(tmp_path / "scene")
    assert {o.name for o in loaded.objects} == {"base_plate", "mast"}
    vertices = np.vstack([o.vertices_m for o in loaded.objects])
    np.testing.assert_allclose(np.ptp(vertices, axis=0), [0.005, 0.01, 0.022], atol=1e-8)
    assert any("y taken as up, 0.01 m per unit" in note for note in notes)


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
    assert len(thing.faces) == len(ball.faces)
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

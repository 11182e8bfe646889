"""What points depend on is known by content: no row, folder or worker mixes two of them."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from twin.files import InputError, scenes_folder
from twin.radar import load_radar
from twin.sweep import load_study, open_sweep, run_sweep
from twin.sweep.evaluate import evaluate_chunk
from twin.sweep.inputs import Inputs, inputs_of
from twin.sweep.setup import changed
from twin.system import load_system

CLOSED = 'model = "closed-form"\nsystem = "mine.toml"\nmetrics = ["signal_e_per_s"]\n'
GRID = '[grid]\n"link.distance_m" = [1.0, 2.0]\n'
#: Nothing is rendered for this metric.
RENDERED = 'scene = "table1"\nmetrics = ["frame_rate_hz"]\n'


def closed_form(folder: Path, f_number: float = 1.0, extra: str = "") -> Path:
    """A study of the closed form with a system file of its own beside it."""
    lens = f'[optics]\nf_number = {{ value = {f_number}, source = "test" }}\n'
    (folder / "mine.toml").write_text(f'base = "workable"\n{lens}{extra}')
    path = folder / "study.toml"
    path.write_text(CLOSED + GRID)
    return path


def signal(out: Path) -> float:
    return float(open_sweep(out)["signal_e_per_s"][0])


@pytest.mark.thorough
def test_a_sweep_that_is_killed_while_it_begins_begins_again(tmp_path: Path) -> None:
    """SIGKILL at the moment when room for the results is taken, which is before anything says
    whose folder it is: the same command works, and nothing of the first is left.
    """
    path, out = closed_form(tmp_path), tmp_path / "runs" / "out"
    killed = (
        "import os, signal\n"
        "os.posix_fallocate = lambda *_: os.kill(os.getpid(), signal.SIGKILL)\n"
        f"from twin.sweep import run_sweep\nrun_sweep({str(path)!r}, out={str(out)!r})\n"
    )
    assert subprocess.run([sys.executable, "-c", killed], check=False).returncode == -9
    run_sweep(path, out=out)
    assert np.isfinite(signal(out))
    assert [item.name for item in out.parent.iterdir()] == ["out"]


def test_two_sweeps_do_not_work_in_one_folder(tmp_path: Path) -> None:
    """The second, also by another name of the folder, says which process is there; a lock does not
    outlive the process that held it, even one that was killed, and leaves no file.
    """
    path, out = closed_form(tmp_path), tmp_path / "runs" / "out"
    waits = (
        "import time\nfrom twin.sweep import store, run_sweep\n"
        "def wait(*_, **__): print('first result', flush=True); time.sleep(600)\n"
        f"store.Store.add = wait\nrun_sweep({str(path)!r}, out={str(out)!r})\n"
    )
    first = subprocess.Popen([sys.executable, "-c", waits], stdout=subprocess.PIPE)
    try:
        assert first.stdout is not None
        assert first.stdout.readline() == b"first result\n"
        (tmp_path / "link").symlink_to(tmp_path / "runs")
        for name in (out, tmp_path / "link" / "out"):
            with pytest.raises(InputError, match=rf"another sweep works in it \(.*{first.pid} on"):
                run_sweep(path, out=name)
        run_sweep(path, out=tmp_path / "runs" / "other")
    finally:
        first.kill()
        first.communicate()
    run_sweep(path, out=out)
    assert np.isfinite(signal(out))
    assert sorted(item.name for item in out.parent.iterdir()) == ["other", "out"]


def test_a_disk_that_is_full_at_the_beginning_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    path, out = closed_form(tmp_path), tmp_path / "runs" / "out"
    with monkeypatch.context() as patched:
        patched.setattr(os, "posix_fallocate", full)
        with pytest.raises(InputError, match="No space left"):
            run_sweep(path, out=out)
    assert not list(out.parent.iterdir())
    run_sweep(path, out=out)
    assert np.isfinite(signal(out))


def test_a_folder_is_of_one_system(tmp_path: Path) -> None:
    """A lens of half the f-number sends (4 N^2 + 1) ratio more light: 17 / 5. After the file has
    changed the old folder is refused, by the name of what changed, and a new one has the new light.
    """
    path, out = closed_form(tmp_path, 2.0), tmp_path / "out"
    run_sweep(path, out=out)
    run_sweep(path, out=out)  # the same content
    closed_form(tmp_path, 1.0)
    with pytest.raises(InputError, match=r"other content of system mine\.toml"):
        run_sweep(path, out=out)
    run_sweep(path, out=tmp_path / "new")
    assert signal(tmp_path / "new") == pytest.approx(signal(out) * 17 / 5, rel=1e-12)


def test_a_curve_counts_by_what_is_in_it(tmp_path: Path) -> None:
    """A filter's curve of half the height, under its old name: half the light, in a new folder."""
    curve = tmp_path / "filter.csv"
    curve.write_text("nm,T\n1500,0.8\n1600,0.8\n")
    csv = '[filter]\ntransmission_csv = { value = "filter.csv", source = "test" }\n'
    path, out = closed_form(tmp_path, extra=csv), tmp_path / "out"
    run_sweep(path, out=out)
    curve.write_text("nm,T\n1500,0.4\n1600,0.4\n")
    with pytest.raises(InputError, match=r"system mine\.toml"):
        run_sweep(path, out=out)
    run_sweep(path, out=tmp_path / "new")
    assert signal(tmp_path / "new") == pytest.approx(signal(out) / 2, rel=1e-12)


def test_what_changes_under_a_sweep_stops_it(tmp_path: Path) -> None:
    """Of a run of points none is kept when a file that they read is another one at their end."""
    curve = tmp_path / "filter.csv"
    curve.write_text("nm,T\n1500,0.8\n1600,0.8\n")
    csv = '[filter]\ntransmission_csv = { value = "filter.csv", source = "test" }\n'
    plan = load_study(closed_form(tmp_path, extra=csv))
    began = inputs_of(plan)
    assert np.isfinite(evaluate_chunk(plan, 0, 2, began).values["signal_e_per_s"]).all()
    curve.write_text("nm,T\n1500,0.4\n1600,0.4\n")
    with pytest.raises(InputError, match="changed since this sweep began"):
        evaluate_chunk(plan, 0, 2, began)


@pytest.mark.thorough
def test_a_folder_is_of_one_scene(tmp_path: Path) -> None:
    """Meshes, the rig's file and the table of materials belong to the scene; as they were, the
    folder is the sweep's again.
    """
    world = tmp_path / "world"
    shutil.copytree(scenes_folder() / "table1", world)
    shutil.copy(scenes_folder() / "materials.toml", world)
    path, out = tmp_path / "study.toml", tmp_path / "out"
    path.write_text(RENDERED.replace("table1", "world") + '[grid]\n"scene.rig.x_m" = [0.0, 0.1]\n')
    run_sweep(path, out=out, workers=1)
    for file in (world / "meshes/patch_20.ply", world / "scene.toml", world / "materials.toml"):
        before = file.read_bytes()
        _change(file)
        with pytest.raises(InputError, match="other content of scene world"):
            run_sweep(path, out=out, workers=1)
        file.write_bytes(before)
        run_sweep(path, out=out, workers=1)


def _change(path: Path) -> None:
    if path.suffix == ".ply":
        import trimesh

        mesh = trimesh.load(path, process=False)
        mesh.apply_translation([0.01, 0.0, 0.0])
        mesh.export(path)
    else:
        pattern = r"(illuminance_lx = |reflectance = \{ value = )[\d.e]+"
        path.write_text(re.sub(pattern, r"\g<1>0.123", path.read_text()))


OWN = (
    'scene = "table1"\nmetrics = ["mine:constant"]\n[grid]\n"system.optics.f_number" = [1.0, 2.0]\n'
)


def constant(folder: Path, value: float, helper: bool = False) -> Path:
    """A study of a metric of one's own, from a module beside it."""
    folder.mkdir(exist_ok=True)
    if helper:
        (folder / "helper.py").write_text(f"VALUE = {value}\n")
        (folder / "mine.py").write_text(
            "from helper import VALUE\n\n\ndef constant(outcome):\n    return VALUE\n"
        )
    else:
        (folder / "mine.py").write_text(f"def constant(outcome):\n    return {value}\n")
    (folder / "study.toml").write_text(OWN)
    return folder / "study.toml"


@pytest.mark.parametrize("helper", [False, True])
def test_a_metric_of_ones_own_is_what_its_file_says(tmp_path: Path, helper: bool) -> None:
    """Rewritten in the same second with as many characters, alone or in what it imports; and of the
    same name in another folder.
    """
    for folder, value in (("one", 1.0), ("one", 2.0), ("two", 3.0), ("one", 4.0)):
        plan = load_study(constant(tmp_path / folder, value, helper))
        assert evaluate_chunk(plan, 0, 1).values["mine:constant"][0] == value


def test_what_a_metric_imports_belongs_to_it(tmp_path: Path) -> None:
    """The digest that a folder is held against changes with a module beside the study that the
    metric's own module imports.
    """
    digests = [
        inputs_of(load_study(constant(tmp_path / "one", value, helper=True))).digests
        for value in (1.0, 2.0, 1.0)
    ]
    name = "metric mine:constant"
    assert digests[0][name] == digests[2][name] != digests[1][name]


@pytest.mark.thorough
def test_workers_that_live_long_see_the_new_system(tmp_path: Path) -> None:
    """A scheduler whose worker has computed with the old file."""
    from distributed import LocalCluster

    path = closed_form(tmp_path, 2.0)
    with LocalCluster(
        n_workers=1, threads_per_worker=1, dashboard_address="127.0.0.1:0", silence_logs=50
    ) as cluster:
        run_sweep(path, out=tmp_path / "old", scheduler=cluster.scheduler_address)
        closed_form(tmp_path, 1.0)
        run_sweep(path, out=tmp_path / "new", scheduler=cluster.scheduler_address)
    ratio = signal(tmp_path / "new") / signal(tmp_path / "old")
    assert ratio == pytest.approx(17 / 5, rel=1e-12)


@pytest.mark.parametrize(
    ("kind", "name", "field", "value", "left"),
    [
        ("radar", "hybrid-79", "antenna.pattern_file", "mine.csv", "gain_dbi"),
        ("system", "paper", "sky.sun_elevation_deg", 30.0, "illuminance_lx"),
    ],
)
def test_a_swept_field_replaces_the_alternatives_to_it(
    tmp_path: Path, kind: str, name: str, field: str, value: str | float, left: str
) -> None:
    """As a file with a base does: one of two alternatives, not both."""
    (tmp_path / "mine.csv").write_text(
        "theta,phi,gain_dbi\n"
        + "\n".join(f"{t},{p},3" for t in (0, 90, 180) for p in (0, 120, 240))
    )
    entry = {"radar": load_radar, "system": load_system}[kind](name)
    section = getattr(changed(entry, ((field, value),), Inputs(tmp_path, {})), field.split(".")[0])
    assert getattr(section, left) is None
    assert str(value) in str(getattr(section, field.split(".")[1]).value)


@pytest.mark.parametrize(
    ("lines", "told"),
    [
        (
            '[sample]\nmethod = "sobol"\nn = 64\n[sample.ranges]\n"x" = [1, 2]',
            "sample.ranges.x = [1, 2]: expected a table of high, log, low",
        ),
        ("sample = [1]", "sample = [1]: expected a table of method, n, "),
        ("grid = 3", "grid = 3: expected a table"),
    ],
)
def test_what_should_be_a_table_is_told_its_fields(tmp_path: Path, lines: str, told: str) -> None:
    head = 'name = "x"\nscene = "yard"\nsystem = "workable"\nmetrics = ["snr_median"]\n'
    (tmp_path / "study.toml").write_text(head + lines)
    with pytest.raises(InputError, match=re.escape(told)):
        load_study(tmp_path / "study.toml")

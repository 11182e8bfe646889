"""The guard that keeps Dr.Jit away from an LLVM on which it aborts the process."""

import os
import platform
import subprocess
import sys
from pathlib import Path
from unittest.mock import MagicMock, patch

import numpy as np
import pytest

from tests.full_disk import files_up_to
from twin import engine
from twin.camera.truth import Truth, write_truth
from twin.engine import EngineError, ensure_llvm, llvm_version
from twin.errors import InputError
from twin.files import whole_folder
from twin.optics.moving_scene import MovingScene
from twin.radar import load_radar, radar_capture
from twin.scene import load_scene
from twin.transfer import aligned

OLD = sorted(
    path
    for version in (14, 15, 16)
    for path in Path("/usr/lib").glob(f"*-linux-gnu/libLLVM-{version}.so.1")
)


@pytest.fixture
def libraries(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A machine whose only libLLVMs are those a test puts here."""
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", "")
    monkeypatch.setattr(engine, "_WHERE", (f"{tmp_path}/libLLVM*.so*",))
    return tmp_path


@pytest.mark.parametrize(
    ("name", "version"),
    [
        ("libLLVM-14.so.1", 14),
        ("libLLVM-15.so", 15),
        ("libLLVM.so.19.1", 19),
        ("libLLVM-20.so", 20),
        ("libLLVM.so.18.1", 18),
    ],
)
def test_version_from_the_file_name(tmp_path: Path, name: str, version: int) -> None:
    (tmp_path / name).touch()
    assert llvm_version(tmp_path / name) == version


def test_a_link_counts_as_what_it_points_to(tmp_path: Path) -> None:
    (tmp_path / "libLLVM-15.so.1").touch()
    (tmp_path / "libLLVM-19.so").symlink_to("libLLVM-15.so.1")
    assert llvm_version(tmp_path / "libLLVM-19.so") == 15


@pytest.mark.parametrize("version", [14, 15, 16, 17, 18])
def test_old_libraries_alone_are_refused(libraries: Path, version: int) -> None:
    (libraries / f"libLLVM-{version}.so.1").touch()
    with pytest.raises(EngineError, match=rf"found: {version}\).*apt-get install libllvm19"):
        ensure_llvm()
    assert not os.environ["DRJIT_LIBLLVM_PATH"]


def test_a_machine_without_llvm_gets_the_command_to_type(libraries: Path) -> None:
    with pytest.raises(EngineError, match=r"found: none\).*apt-get install libllvm19"):
        ensure_llvm()


def test_the_one_that_was_tried_is_preferred(libraries: Path) -> None:
    for name in ("libLLVM-14.so.1", "libLLVM.so.19.1", "libLLVM-21.so"):
        (libraries / name).touch()
    assert ensure_llvm().name == "libLLVM.so.19.1"
    assert os.environ["DRJIT_LIBLLVM_PATH"].endswith("libLLVM.so.19.1")


def test_a_bad_one_named_by_the_user_is_refused(
    libraries: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Even when a good one is installed: the user's word is not overruled silently."""
    (libraries / "libLLVM.so.19.1").touch()
    (libraries / "libLLVM-16.so").touch()
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(libraries / "libLLVM-16.so"))
    with pytest.raises(EngineError, match=r"libLLVM-16\.so is libLLVM 16"):
        ensure_llvm()
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(libraries / "missing.so"))
    with pytest.raises(EngineError, match="no such file"):
        ensure_llvm()
    (libraries / "other.so").write_bytes(b"no library")
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(libraries / "other.so"))
    with pytest.raises(EngineError, match="no libLLVM that loads"):
        ensure_llvm()


def test_unknown_variant_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TWIN_VARIANT", "scalar_rgb")
    with pytest.raises(EngineError, match="TWIN_VARIANT: 'scalar_rgb'"):
        engine.mitsuba()


def test_kernels_of_several_scenes_are_refused_on_cuda(monkeypatch: pytest.MonkeyPatch) -> None:
    """Dr.Jit drops the rays of all but one, with a warning of its own."""
    monkeypatch.setenv("TWIN_VARIANT", "cuda_ad_mono")
    engine.check_scenes_of_a_kernel(1, "one")
    with pytest.raises(EngineError, match="bodies that move are several"):
        MovingScene([MagicMock(), MagicMock()])
    monkeypatch.setenv("TWIN_VARIANT", "llvm_ad_mono")
    engine.check_scenes_of_a_kernel(2, "two")


def test_the_radar_is_refused_on_cuda(monkeypatch: pytest.MonkeyPatch) -> None:
    """Cross-sections were off by up to 6 dB, where `tests/physics` has 0.05."""
    scene, radar = load_scene("table1"), load_radar("hybrid-79")
    monkeypatch.setenv("TWIN_VARIANT", "cuda_ad_mono")
    with pytest.raises(EngineError, match="the radar is computed on the processor"):
        radar_capture(scene, radar)
    with pytest.raises(EngineError, match="the radar is computed on the processor"):
        engine.sionna()


def test_sionnas_variant_stays_while_it_is_asked_for() -> None:
    """Each change loads modules of Sionna's anew, after a thousand with a warning of Dr.Jit's."""
    engine.sionna()
    with patch.object(sys.modules["mitsuba"], "set_variant") as changed:
        engine.sionna()
    changed.assert_not_called()


@pytest.mark.thorough
def test_cuda_without_a_driver_stops_without_a_traceback(tmp_path: Path) -> None:
    """So it is where a container shows the device but not the driver's library. Dr.Jit may put a
    warning of its own before the line.
    """
    done = subprocess.run(
        [sys.executable, "-m", "twin", "check", "table1"],
        env={
            **os.environ,
            "TWIN_VARIANT": "cuda_ad_mono",
            "DRJIT_LIBCUDA_PATH": str(tmp_path / "missing.so"),
        },
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    last = done.stderr.splitlines()[-1]
    assert "cuda_ad_mono can't be started" in last
    assert "TWIN_VARIANT=llvm_ad_mono" in last


@pytest.mark.quick(1)
@pytest.mark.skipif(not OLD, reason="no libLLVM 14, 15 or 16 on this machine")
@pytest.mark.parametrize("library", OLD, ids=lambda path: path.name)
def test_the_real_bad_ones_stop_with_one_line_before_the_abort(library: Path) -> None:
    """Without the guard this process would die with SIGABRT (exit code -6)."""
    done = subprocess.run(
        [sys.executable, "-m", "twin", "check", "table1"],
        env={**os.environ, "DRJIT_LIBLLVM_PATH": str(library)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1
    assert "on which Dr.Jit aborts" in done.stderr


def _textured(tmp_path: Path) -> None:
    """A triangle whose texture is ``t.exr``."""
    (tmp_path / "q.obj").write_text(
        "v 5 1 1\nv 5 -1 1\nv 5 -1 -1\nvt 0 0\nvt 1 0\nvt 1 1\nf 1/1 2/2 3/3\n"
    )
    (tmp_path / "s.xml").write_text(
        '<scene version="3.0.0"><shape type="obj" id="q"><string name="filename" value="q.obj"/>'
        '<bsdf type="diffuse" id="own"><texture type="bitmap" name="reflectance">'
        '<string name="filename" value="t.exr"/><boolean name="raw" value="true"/></texture>'
        "</bsdf></shape></scene>"
    )


@pytest.mark.thorough
def test_one_thread_reads_and_writes_openexr(tmp_path: Path) -> None:
    """Mitsuba by itself waits forever there, as it does on a single core."""
    code = f"""
from pathlib import Path
import drjit
drjit.set_thread_count(1)
import numpy as np
from twin.camera.truth import Truth, write_truth
from twin.engine import exr_threads, mitsuba
from twin.scene import load_scene
albedo = np.full((4, 4), 0.25)
write_truth(Truth(albedo, 1 / albedo), Path({str(tmp_path / "truth.exr")!r}))
with exr_threads():
    mitsuba().Bitmap(albedo.astype(np.float32)).write({str(tmp_path / "t.exr")!r})
load_scene({str(tmp_path / "s.xml")!r})
print(drjit.thread_count())
"""
    _textured(tmp_path)
    run = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False
    )
    assert run.returncode == 0, run.stderr
    assert run.stdout.split()[-1] == "1"


def test_truth_that_does_not_fit_is_an_error_of_the_system(tmp_path: Path) -> None:
    """Mitsuba's own is a RuntimeError, which commands do not expect; in a folder that appears
    whole, the error names its final place, and nothing is left.
    """
    albedo = np.random.default_rng(0).random((64, 64))
    with (
        files_up_to(4096),
        pytest.raises(OSError, match="File too large") as caught,
        whole_folder(tmp_path / "run") as partial,
    ):
        write_truth(Truth(albedo, 1 / albedo), partial / "truth.exr")
    assert caught.value.filename == str(tmp_path / "run")
    assert not list(tmp_path.iterdir())


def test_a_texture_that_is_no_picture_is_told(tmp_path: Path) -> None:
    """Albedo and depth, as the twin itself writes them, are no colours."""
    truth = Truth(np.full((4, 4), 0.25), np.ones((4, 4)))
    write_truth(truth, tmp_path / "t.exr")
    _textured(tmp_path)
    with pytest.raises(InputError, match=r"t\.exr: texture of channels albedo, depth"):
        load_scene(tmp_path / "s.xml")


@pytest.mark.parametrize("kind", [np.float64, np.float32, np.uint32, np.uint8])
@pytest.mark.parametrize("count", [1, 15, 16, 17, 1000])
def test_arrays_of_the_engine_have_memory_behind_them(count: int, kind: type) -> None:
    """Kernels read vectors of 16 numbers of memory that NumPy allots: at the end of a page, without
    memory behind, the process crashed.
    """
    handed = aligned(np.arange(count).astype(kind))
    room: np.ndarray = handed
    while isinstance(room.base, np.ndarray):
        room = room.base
    behind = room.ctypes.data + room.nbytes - (handed.ctypes.data + handed.nbytes)
    assert handed.ctypes.data % 64 == 0
    assert behind >= (-count % 16) * handed.itemsize
    np.testing.assert_array_equal(handed, np.arange(count).astype(kind))


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="only glibc has malloc_trim")
def test_freed_memory_goes_back_to_the_system() -> None:
    """Of 100 MB in small pieces all but the last is freed, which alone keeps glibc from shrinking.

    In a process of its own; fails where nothing is handed back.
    """
    code = """
import os
from twin.engine import return_freed_memory

def resident():
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")

pieces = [bytes(1000) for _ in range(100_000)]
del pieces[:-1]
before = resident()
return_freed_memory()
print(before - resident())
"""
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert int(run.stdout) > 70e6

"""A wheel without the repository: all files of packages and scenes, and commands that run."""

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def unpacked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What `pip install` would put among the installed packages."""
    pytest.importorskip("hatchling")
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    (wheel,) = folder.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(folder / "packages")
    return folder / "packages"


def called(
    packages: Path, folder: Path, *arguments: str, without: str = ""
) -> "subprocess.CompletedProcess[str]":
    """A command in a folder outside the repository, with the packages of the wheel; ``without`` a
    library.
    """
    name, *words = arguments
    code = (
        "import sys; "
        + (f"sys.modules[{without!r}] = None; " if without else "")
        + f"sys.argv = {[name, *words]!r}; from {'hardware' if name == 'ugv' else name} "
        f"import cli; assert cli.__file__.startswith({str(packages)!r}); cli.main()"
    )
    return subprocess.run(
        [sys.executable, "-c", code],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(packages)},
        capture_output=True,
        text=True,
        check=False,
    )


def test_it_holds_every_file_of_the_packages_and_the_scenes(unpacked: Path) -> None:
    listed = ["git", "ls-files", "hardware", "twin", "scenes"]
    try:
        done = subprocess.run(listed, cwd=ROOT, check=True, capture_output=True, text=True)
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("no repository")
    names = [f"{'twin/' * name.startswith('scenes/')}{name}" for name in done.stdout.split()]
    places = [unpacked / name for name in names]
    assert len(places) > 300
    assert [place for place in places if not place.is_file()] == []


@pytest.mark.quick(1)
@pytest.mark.parametrize(
    ("command", "said"),
    [
        ("twin check yard -q", "yard: 15 objects"),
        ("twin systems", "system workable: "),
        ("twin parts fb1550-12", "Thorlabs FB1550-12"),
        ("twin schema scene", '"title": "SceneSettings"'),
        ("ugv --help", "reconstruct"),
    ],
)
def test_commands_run_without_the_repository(
    unpacked: Path, tmp_path: Path, command: str, said: str
) -> None:
    done = called(unpacked, tmp_path, *command.split())
    assert (done.returncode, done.stderr) == (0, "")
    assert said in done.stdout


def test_without_the_simulators_libraries_it_says_how_to_get_them(
    unpacked: Path, tmp_path: Path
) -> None:
    done = called(unpacked, tmp_path, "twin", "systems", without="pydantic")
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1
    assert "pip install 'ugv-twin[twin]'" in done.stderr

"""What the vehicle installs: how much, for which machines, and how soon it is there."""

import re
import subprocess
import sys
import tomllib
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

import pytest

LOCK = Path(__file__).parents[2] / "requirements.lock"
MOST_MB = 250
SIMULATOR = ("mitsuba", "drjit", "sionna", "matplotlib")


def installed_bytes(name: str) -> dict[str, int]:
    """Size of every distribution that one needs, itself included, without bytecode."""
    sizes: dict[str, int] = {}
    wanted = [name]
    while wanted:
        found = distribution(wanted.pop())
        if (name := found.metadata["Name"].lower()) in sizes:
            continue
        files = [found.locate_file(file) for file in found.files or () if file.suffix != ".pyc"]
        sizes[name] = sum(Path(str(file)).stat().st_size for file in files)
        for requirement in found.requires or ():
            word, _, marker = requirement.partition(";")
            if "extra" in marker:
                continue
            try:
                wanted.append(distribution(re.match(r"[\w.-]+", word)[0]).metadata["Name"])
            except PackageNotFoundError:
                assert marker, requirement  # of another system
    return sizes


def test_the_vehicle_needs_no_simulator_and_little_room() -> None:
    sizes = installed_bytes("ugv-twin")
    assert {"numpy", "scipy", "h5py", "mcap"} < sizes.keys()
    assert not any(name.startswith(SIMULATOR) for name in sizes)
    total = sum(sizes.values()) / 1e6
    assert total < MOST_MB, sorted(sizes.items(), key=lambda item: -item[1])


def test_importing_it_imports_nothing_heavy() -> None:
    """Import time itself is a figure of `make bench`; here: what would make it long."""
    heavy = ("scipy", "h5py", "typer")
    code = f"import sys, hardware; print([m for m in {heavy} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_every_dependency_runs_on_aarch64(tmp_path: Path) -> None:
    """A wheel for 64-bit ARM, or pure Python, for each, and all they need: pip resolves them."""
    if not LOCK.is_file():
        pytest.skip("no lock file beside the tests")
    project = tomllib.loads((LOCK.parent / "pyproject.toml").read_text())["project"]
    platforms = [f"manylinux_2_{n}_aarch64" for n in (17, 24, 26, 27, 28, 31, 34)]
    command = [sys.executable, "-m", "pip", "download", "-q", "--disable-pip-version-check",
               "--only-binary", ":all:", "--python-version", "3.11", "-c", str(LOCK),
               "-d", str(tmp_path)]  # fmt: skip
    for platform in ("manylinux2014_aarch64", *platforms):
        command += ["--platform", platform]
    done = subprocess.run(
        [*command, *project["dependencies"]], capture_output=True, text=True, timeout=600
    )
    unreachable = ("NewConnectionError", "Temporary failure", "ConnectTimeout", "No route")
    if done.returncode and any(word in done.stderr for word in unreachable):
        pytest.skip("the registry cannot be reached")
    assert done.returncode == 0, done.stderr
    wheels = [path.name for path in tmp_path.iterdir()]
    assert wheels
    for name in wheels:
        assert name.endswith(("-none-any.whl", "aarch64.whl")), name


def test_usual_windows_need_no_scipy_signal() -> None:
    """Whose import takes half a second: the boxcar is ones, and every burst needs the other."""
    code = (
        "import sys\n"
        "from hardware.radar.windows import normalised_window\n"
        "assert (normalised_window('boxcar', 5) == 1).all()\n"
        "own = {n: normalised_window('blackmanharris', n) for n in (2, 5, 8, 4096)}\n"
        "assert 'scipy.signal' not in sys.modules\n"
        "assert normalised_window('hann', 5)[0] == 0\n"
        "from scipy.signal import get_window\n"
        "for n, window in own.items():\n"
        "    theirs = get_window('blackmanharris', n, fftbins=False)\n"
        "    assert (window == theirs / theirs.mean()).all()\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)

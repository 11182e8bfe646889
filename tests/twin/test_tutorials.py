"""Tutorials and how-to pages run as they stand, each in a folder of its own, block after block."""

import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from twin.files import InputError
from twin.serve.serving import Address, check_ports, parse_address

ROOT = Path(__file__).parents[2]
HOWTO = ("fits", "materials", "camera_settings", "motion", "systems")
QUICK = ("tutorials/*_*", *(f"howto/{name}" for name in HOWTO))
LONG = ("quickstart", "howto/weather", "howto/drive", "howto/studies")
PAGES = [
    *(page for name in QUICK for page in sorted((ROOT / "docs").glob(f"{name}.md"))),
    *(pytest.param(ROOT / "docs" / f"{name}.md", marks=pytest.mark.slow) for name in LONG),
]
#: What an installation does beside what it installs.
INSTALLATION = {"make demo\n": "twin run yard", ". .venv/bin/activate\n": "true"}
BLOCK = re.compile(r"^```(.+)\n((?::\w+: .*\n)*)([\s\S]*?)^```$", re.MULTILINE)


def free_port() -> str:
    with socket.create_server(("127.0.0.1", 0)) as server:
        return str(server.getsockname()[1])


@contextmanager
def running(command: str, folder: Path, environment: dict[str, str]) -> Iterator[None]:
    """A command in the background, until it listens; ended by Ctrl-C."""
    with (folder / "background.log").open("w") as log:
        process = subprocess.Popen(
            ["bash", "-c", f"exec {command}"], cwd=folder, env=environment, stdout=log, stderr=log
        )
        try:
            wanted, since = set(re.findall(r"tcp:([\d.]+):(\d+)", command)), time.monotonic()
            while not all(listens(host, int(port)) for host, port in wanted):
                told = (folder / "background.log").read_text()
                assert process.poll() is None, told
                assert time.monotonic() - since < 120, told
                time.sleep(0.2)
            yield
        finally:
            process.send_signal(signal.SIGINT)
            process.wait(30)


def listens(host: str, port: int) -> bool:
    """Whether the port is taken; a connection would be the one that a camera has room for."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError:
            return True
    return False


@pytest.fixture
def environment(tmp_path: Path) -> dict[str, str]:
    """Both commands and the packages as they stand here; as few threads as in other tests."""
    for name, module in (("twin", "twin"), ("ugv", "hardware")):
        command = tmp_path / "bin" / name
        command.parent.mkdir(exist_ok=True)
        command.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m {module} "$@"\n')
        command.chmod(0o755)
    path = f"{tmp_path / 'bin'}{os.pathsep}{os.environ['PATH']}"
    return {**os.environ, "PATH": path, "PYTHONPATH": f"{ROOT}{os.pathsep}."}


def test_the_ports_of_a_page_as_it_stands_do_not_collide() -> None:
    """The test of the whole page takes free ports in their place, so it would not see that the
    camera's is one of the radar's three.
    """
    text = (ROOT / "docs" / "tutorials" / "drive_a_device.md").read_text()
    camera, radio = (
        parse_address(re.findall(rf"--{name}-at (tcp:\S+)", text)[0]) for name in ("spi", "radar")
    )
    check_ports(camera, radio)
    with pytest.raises(InputError, match="the radar uses the ports 5555 to 5557"):
        check_ports(Address("127.0.0.1", 5556), Address("127.0.0.1", 5555))


@pytest.mark.whole
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_page_runs(page: Path, tmp_path: Path, environment: dict[str, str]) -> None:
    text = page.read_text()
    for port in ("5550", "5555"):
        text = text.replace(f":{port}", f":{free_port()}")
    folder = tmp_path / "user"
    folder.mkdir()
    done = 0
    with ExitStack() as background:
        for head, options, body in BLOCK.findall(text):
            caption = re.search(r":caption: (\S+)", options)
            if caption:
                (folder / caption[1]).parent.mkdir(exist_ok=True)
                (folder / caption[1]).write_text(body)
                continue
            if head == "sh background":
                background.enter_context(running(body, folder, environment))
                continue
            if head not in ("sh", "python"):
                continue
            command = ["bash", "-ec"] if head == "sh" else [sys.executable, "-c"]
            command.append(INSTALLATION.get(body, body))
            result = subprocess.run(
                command, cwd=folder, env=environment, capture_output=True, text=True, timeout=240
            )
            assert result.returncode == 0, f"{body}\n{result.stdout}\n{result.stderr}"
            assert "Traceback" not in result.stderr
            done += 1
    assert done >= 1
    for name, words in TOLD.get(page.stem, {}).items():
        assert (folder / name).stat().st_size > 0, name
        assert not words or words in (folder / name).read_text(), name


#: Files that a page promises, and words in them.
TOLD = {
    "choose_a_detector": {
        "runs/detectors/psnr_db.png": "",
        "runs/detectors/psnr_db-minimum_time_s.png": "",
        "best/report.html": "best",
        "best/record.h5": "",
    },
    "bring_a_scene": {"first/report.html": "inverse", "first/summary.json": "PSNR"},
    "first_day": {
        "first/report.html": "mine",
        "runs/study/psnr_db.png": "",
        "runs/study/psnr_db-minimum_time_s.png": "",
        "best.csv": "minimum_time_s",
        "best/summary.json": "PSNR",
        "best/record-tv.npz": "",
        "image.png": "",
        "best/radar-detections.csv": "range_m",
    },
    "drive_a_device": {"camera-processed.mcap": "", "radar-processed.mcap": ""},
}

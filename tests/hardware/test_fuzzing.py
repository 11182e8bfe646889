"""The parser and the reference firmware under a coverage-guided fuzzer, for a minute each."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import fuzz_firmware
import pytest

import hardware

pytestmark = pytest.mark.library("atheris")

_HERE = Path(__file__).parent
#: Not of the memory at most, which a process has from the one that started it.
_MEMORY = ("-rss_limit_mb=0", "-malloc_limit_mb=2048")
_LIMITS = ("-max_total_time=60", "-timeout=10", *_MEMORY, "-max_len=8192", "-seed=1")
#: A machine that does less in a minute tests next to nothing.
_LEAST = 10_000


def runs(done: "subprocess.CompletedProcess[str]") -> int:
    assert done.returncode == 0, done.stderr[-4000:]
    found = re.search(r"Done (\d+) runs", done.stderr)
    assert found, done.stderr[-1000:]
    return int(found[1])


@pytest.mark.slow
def test_the_parser(tmp_path: Path) -> None:
    (corpus := tmp_path / "corpus").mkdir()
    command = [sys.executable, _HERE / "fuzz_parser.py", *_LIMITS, corpus]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert runs(done) > _LEAST


@pytest.mark.slow
def test_the_firmware(tmp_path: Path) -> None:
    """Compiled with address and undefined-behaviour checks; needs their libraries."""
    compiler = shutil.which("gcc")
    if compiler is None:
        pytest.skip("no gcc")
    (corpus := tmp_path / "corpus").mkdir()
    sources = Path(hardware.__file__).parent / "drivers" / "firmware"
    library = fuzz_firmware.build(compiler, sources, tmp_path)
    done = subprocess.run(
        [sys.executable, _HERE / "fuzz_firmware.py", library, *_LIMITS, corpus],
        cwd=tmp_path, env=fuzz_firmware.environment(compiler), capture_output=True, text=True,
    )  # fmt: skip
    assert runs(done) > _LEAST

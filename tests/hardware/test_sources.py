"""Records of other packages: found by the scheme of a URL under the entry-point group."""

import os
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ugv_command import ugv

from hardware import PatternSet, SpiRecord
from hardware.recording import Received, read_records
from hardware.records import QuaternionPose
from hardware.sources import SourceError, open_source

RECORD = SpiRecord(
    counts=np.full((16, 1), 5, np.int32),
    device_time_ns=np.arange(16, dtype=np.int64),
    sequence=np.arange(16, dtype=np.uint32),
    flags=np.zeros(16, np.uint8),
    patterns=PatternSet(4, 4, 8),
    integration_time_s=1e-4,
    electrons_per_count=2.0,
    offset_counts=0.0,
    adc_bits=12,
    device="elsewhere",
    pose=QuaternionPose(),
)


def records(url: str, settings: object, *, over: threading.Event | None) -> Iterator[Received]:
    """What a package may offer: three records, and what it was called with in their device."""
    for number in range(3):
        yield Received("/spi/record", RECORD, number, None)


def install(folder: Path, scheme: str, function: str) -> None:
    """A package of an entry point alone, as pip leaves it."""
    about = folder / "elsewhere-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: elsewhere\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(f"[ugv.sources]\n{scheme} = {function}\n")


def test_an_installed_package_gives_the_records(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Through the command, in a process that finds the package on its path."""
    install(tmp_path, "elsewhere", "test_sources:records")
    log = tmp_path / "run.mcap"
    here = Path(__file__).parent
    paths = [str(tmp_path), str(here), str(here.parent), os.environ.get("PYTHONPATH", "")]
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, paths)))
    done = ugv("capture", "elsewhere:anything", "-o", log)
    assert done.returncode == 0, done.stderr
    received = list(read_records(log))
    assert [one.record.device for one in received] == ["elsewhere"] * 3
    assert all(np.array_equal(one.record.counts, RECORD.counts) for one in received)


@pytest.mark.parametrize(
    ("function", "says"),
    [
        (
            "no_such_module:records [all]",
            r"^elsewhere: elsewhere offers it, but what that needs is not installed \(No module "
            r"named 'no_such_module'\): pip install 'elsewhere\[all\]'$",
        ),
        (
            "no_such_module:records",
            r"pip install 'elsewhere'$",
        ),
    ],
)
def test_a_package_that_is_not_installed_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, function: str, says: str
) -> None:
    install(tmp_path, "elsewhere", function)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(SourceError, match=says):
        open_source("elsewhere:anything")


def test_a_scheme_that_nothing_offers() -> None:
    with pytest.raises(SourceError, match=r"^nothing:x: no installed package offers nothing:$"):
        open_source("nothing:x")


def test_the_simulator_is_one_of_them() -> None:
    """The project's own entry point: it gives records, or says how to install what it needs."""
    from importlib.metadata import entry_points
    from importlib.util import find_spec

    (point,) = entry_points(group="ugv.sources", name="twin")
    assert point.extras == ["twin"]
    arguments: tuple[Any, ...] = ("twin:no-such-scene",)
    if find_spec("mitsuba"):
        with pytest.raises(ValueError, match="no-such-scene"):
            open_source(*arguments)
    else:
        with pytest.raises(SourceError, match=r"pip install 'ugv-twin\[twin\]'$"):
            open_source(*arguments)

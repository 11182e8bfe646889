"""The smallest tolerance that a time allows."""

from collections.abc import Iterable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from twin.camera import Capture, capture
from twin.camera.render_warnings import tolerance_warnings
from twin.errors import InputError
from twin.fidelity import Fidelity, Tolerance
from twin.scene import load_scene
from twin.system import load_system
from twin.trade import fidelity_within, time_limit


@pytest.mark.parametrize(("limit_s", "share"), [(0.003, 2.0), (0.024, 0.25), (0.048, 0.125)])
def test_the_smallest_share_within_the_limit(
    limit_s: float, share: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of shares 2, 1, 0.5 ..., each frame takes 4 ms over the share by a clock of its own, and is
    told with a quarter more, since frames scatter.
    """
    clock_s = 0.0
    monkeypatch.setattr(time_limit.time, "perf_counter", lambda: clock_s)

    least = 0.0  # of what the paths reach

    def frame(fidelity: Fidelity) -> Iterable[str]:
        nonlocal clock_s
        share = fidelity.light_tolerance
        assert share is not None
        clock_s += 0.004 / share
        permitted = SimpleNamespace(unit="", tolerance_of=lambda cells: share)
        return tolerance_warnings(least / share, permitted, np.ones(1))

    chosen = time_limit.finest(frame, limit_s)
    assert chosen.noise_share == share
    assert chosen.frame_s == pytest.approx(0.005 / share)
    least = 0.4  # none beyond is chosen, though there is time
    assert time_limit.finest(frame, limit_s).noise_share == max(share, 0.5)


def test_a_frame_stays_within_the_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """Frames are rendered, and take 0.1 s over the share by a clock of their own, so that the load
    of the machine does not count: told with a quarter more, 0.5 s at a quarter of the noise.
    """
    clock_s = 0.0
    monkeypatch.setattr(time_limit, "time", SimpleNamespace(perf_counter=lambda: clock_s))

    def frame(*given: Any, fidelity: Fidelity, **named: Any) -> Capture:
        nonlocal clock_s
        assert fidelity.light_tolerance is not None
        clock_s += 0.1 / fidelity.light_tolerance
        return capture(*given, fidelity=fidelity, **named)

    monkeypatch.setattr(time_limit, "capture", frame)
    chosen = fidelity_within("table1", 0.51, radar=None)
    assert chosen.camera is not None
    assert chosen.radar is None
    assert chosen.camera.frame_s == pytest.approx(0.5)
    assert chosen.fidelity.light_tolerance == chosen.camera.noise_share == 0.25
    taken = capture(load_scene("table1"), load_system("workable"), fidelity=chosen.fidelity)
    assert taken.cells_error_e.max() > 0
    assert "500 ms a frame" in str(chosen)
    assert chosen.warnings == ()


@pytest.mark.parametrize(
    ("sensor", "limit_s", "says"),
    [
        ("camera", 0.5, "2 of the noise with nothing that moves within a frame"),
        ("camera", 0.1, "`draft` with nothing that moves within a frame"),
        ("radar", 0.5, "`draft`"),
        ("radar", 0.1, "`draft` with `paths`"),
        ("radar", 0.02, "declared targets alone"),
    ],
)
def test_coarser_knobs_where_the_largest_tolerance_takes_too_long(
    sensor: str, limit_s: float, says: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By a clock of its own: 4 s at any tolerance, of the camera 40 ms by 4 paths and 0.3 s else
    where nothing moves; of the radar 0.3 s, 50 ms and 10 ms.
    """
    clock_s = 0.0
    monkeypatch.setattr(time_limit.time, "perf_counter", lambda: clock_s)

    def frame(knobs: Fidelity) -> Iterable[str]:
        nonlocal clock_s
        if sensor == "camera":
            still_s = 0.04 if knobs.light_tolerance is None else 0.3
            clock_s += still_s if knobs.motion_tolerance is None else 4.0
        elif knobs.radar_tolerance == 0.3:
            clock_s += {"optics": 0.3, "paths": 0.05, "targets": 0.01}[str(knobs.radar)]
        else:
            clock_s += 4.0
        return ()

    chosen = time_limit._best(sensor, frame, limit_s)
    assert str(chosen).startswith(f"{says}, ")
    assert chosen.frame_s <= limit_s
    with pytest.raises(InputError, match=rf"of the {sensor} takes .* by the coarsest knobs"):
        time_limit._best(sensor, frame, 1e-3)


def test_knobs_that_are_fixed_are_timed_and_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    """By a clock of its own: frames take 4 s, but 0.1 s where nothing moves in them. With motion
    fixed no knobs promise a frame in 1 s, and none are told "with nothing that moves".
    """
    clock_s = 0.0
    monkeypatch.setattr(time_limit.time, "perf_counter", lambda: clock_s)
    timed: list[Fidelity] = []

    def frame(*_: object, fidelity: Fidelity, **__: object) -> SimpleNamespace:
        nonlocal clock_s
        timed.append(fidelity)
        clock_s += 0.1 if fidelity.motion_tolerance is None else 4.0
        return SimpleNamespace(warnings=())

    monkeypatch.setattr(time_limit, "capture", frame)
    assert str(fidelity_within("table1", 1.0, radar=None)).endswith(
        "2 of the noise with nothing that moves within a frame, 125 ms a frame"
    )
    timed.clear()
    with pytest.raises(InputError, match=r"5 s by the coarsest knobs, `draft`, and 5 s"):
        fidelity_within("table1", 1.0, radar=None, fixed={"motion_tolerance": 0.1})
    assert {knobs.motion_tolerance for knobs in timed} == {0.1}
    still = fidelity_within("table1", 1.0, radar=None, fixed={"motion_tolerance": None})
    assert still.fidelity.motion_tolerance is None
    assert still.camera is not None
    assert still.camera.noise_share < 2


@pytest.mark.thorough
def test_a_time_below_that_of_the_largest_tolerance() -> None:
    """The yard, whose car moves within a frame: its echoes by declared targets alone, its light by
    coarser knobs than any tolerance's, which then hold for a capture.
    """
    chosen = fidelity_within("yard", 1.5, system=None)
    assert chosen.radar is not None
    assert chosen.radar.coarser
    assert chosen.radar.frame_s <= 1.5
    assert chosen.fidelity.light_tolerance == Tolerance().knobs().light_tolerance
    assert chosen.fidelity.radar_bounces is not None
    (warning,) = chosen.warnings
    assert "errors of its figures are not bounded" in warning


@pytest.mark.thorough
def test_what_no_knobs_bring_down_is_refused() -> None:
    with pytest.raises(InputError, match=r"a frame of the radar takes .* coarsest knobs"):
        fidelity_within("table1", 1e-4, system=None)
    for wrong in (0.0, -1.0, float("nan"), True, None, [1], "2 m"):
        with pytest.raises(InputError, match=r"within|expected"):
            fidelity_within("table1", wrong)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="both are none"):
        fidelity_within("table1", "1 s", system=None, radar=None)
    for seed in (-1, "a"):
        with pytest.raises(InputError, match="seed"):
            fidelity_within("table1", 1.0, seed=seed)  # type: ignore[arg-type]

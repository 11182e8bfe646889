"""The smallest tolerance that a time allows."""

import pytest

from twin.camera import capture
from twin.errors import InputError
from twin.fidelity import Fidelity
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

    def frame(fidelity: Fidelity) -> None:
        nonlocal clock_s
        assert fidelity.light_tolerance is not None
        clock_s += 0.004 / fidelity.light_tolerance

    chosen = time_limit.finest("camera", frame, limit_s)
    assert chosen.noise_share == share
    assert chosen.frame_s == pytest.approx(0.005 / share)


def test_a_frame_stays_within_the_time() -> None:
    chosen = fidelity_within("table1", 0.5, radar=None)
    assert chosen.camera is not None
    assert chosen.radar is None
    assert chosen.camera.frame_s <= 0.5
    assert chosen.fidelity.light_tolerance == chosen.camera.noise_share < 2
    assert (
        capture(
            load_scene("table1"), load_system("workable"), fidelity=chosen.fidelity
        ).cells_error_e.max()
        > 0
    )
    assert "ms a frame" in str(chosen)


def test_what_no_tolerance_brings_down_is_refused() -> None:
    with pytest.raises(InputError, match=r"a frame of the radar takes .* largest tolerance"):
        fidelity_within("table1", 1e-4, system=None)
    for wrong in (0.0, -1.0, float("nan"), True, None, [1], "2 m"):
        with pytest.raises(InputError, match=r"within|expected"):
            fidelity_within("table1", wrong)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="both are none"):
        fidelity_within("table1", "1 s", system=None, radar=None)
    for seed in (-1, "a"):
        with pytest.raises(InputError, match="seed"):
            fidelity_within("table1", 1.0, seed=seed)  # type: ignore[arg-type]

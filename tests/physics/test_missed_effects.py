"""Every effect that is left out although it may change more than is permitted has a warning."""

import math
from collections.abc import Iterable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from tests.still import still_yard
from twin.accuracy import Decision, missed_effects
from twin.camera import capture
from twin.fidelity import Tolerance
from twin.radar import load_radar, radar_capture
from twin.radar.diagnostics import not_followed
from twin.scene import load_scene
from twin.system import load_system

#: Scene and system; fog scatters infinitely much light of table1's emitter, beside its detector.
_ONE_RENDER = "workable", "paper", "lidar-scan"
_MANY_RENDERS = [(s, name) for s in ("yard", "crossing") for name in ("phases", "fog")]
CASES = [
    *((s, name) for s in ("yard", "table1", "crossing") for name in _ONE_RENDER),
    ("table1", "phases"),
    *(pytest.param(*case, marks=pytest.mark.slow) for case in _MANY_RENDERS),
]
_SMALL = {"emitter.rows": 8, "emitter.columns": 8, "acquisition.n_patterns": 64}
_PHASES = "[time_of_flight]\nmodulation_hz = [10e6]\ncontrast = 0.8\n"
_FOG = '[weather]\npart = "fog-200m"\n'


def missed(decisions: Iterable[Decision]) -> list[Decision]:
    """As docs/howto/accuracy.md defines it, apart from the code that warns."""
    return [d for d in decisions if not d.taken and d.bound > d.permitted]


def assert_all_are_warned_of(decisions: Iterable[Decision], warnings: Iterable[str]) -> None:
    told = tuple(warnings)
    effects = [text.partition(": not computed; at most ")[0] for text in told]
    for decision in missed(decisions):
        if decision.is_told:
            assert any(text.startswith("motion within an interval") for text in told)
            continue
        # One line for all bodies that lack the same.
        stem = decision.effect.removesuffix(decision.body)
        some = [e.removeprefix(stem) for e in effects if e.startswith(stem)]
        assert sum(not decision.body or decision.body in e.split(", ") for e in some) == 1


@pytest.mark.quick(3)
@pytest.mark.parametrize(("scene", "system"), CASES)
def test_of_a_camera_every_missed_effect_is_warned_of(
    scene: str, system: str, tmp_path: Path
) -> None:
    """8 x 8 cells, by default. Only the receiver of a scan leaves out indirect light that counts:
    it sees the first surface alone.
    """
    own = {"phases": _PHASES, "fog": _FOG}.get(system)
    if own:
        (tmp_path / "own.toml").write_text(f'base = "workable"\n{own}')
    design = load_system(tmp_path / "own.toml" if own else system).with_(_SMALL)
    found = capture(load_scene(scene), design, seed=1)
    assert found.decisions
    assert_all_are_warned_of(found.decisions, found.warnings)
    effects = [decision.effect for decision in missed(found.decisions)]
    assert effects == (["indirect light"] if system == "lidar-scan" else [])
    assert all(w.kind == "tolerance" for w in found.warnings if "not computed" in w)


def test_light_that_air_may_not_scatter_is_warned_of_by_its_knob(tmp_path: Path) -> None:
    (tmp_path / "own.toml").write_text(f'base = "workable"\n{_FOG}')
    design = load_system(tmp_path / "own.toml").with_(_SMALL)
    knobs = Tolerance().knobs().with_(air_orders=0)
    found = capture(still_yard(), design, seed=1, fidelity=knobs)
    assert_all_are_warned_of(found.decisions, found.warnings)
    (text,) = (text for text in found.warnings if "not computed" in text)
    assert "fidelity.air_orders = 0" in text
    assert not any("scatters forward" in text for text in found.warnings)


@pytest.mark.parametrize("scene", ["table1", pytest.param("crossing", marks=pytest.mark.slow)])
def test_of_a_radar_every_missed_effect_is_warned_of(scene: str) -> None:
    """In every scene some waves round obstacles are left to the stated errors."""
    found = radar_capture(load_scene(scene), load_radar("hybrid-79"), seed=1)
    assert missed(found.decisions)
    assert_all_are_warned_of(found.decisions, found.warnings)


def test_bodies_that_lack_the_same_are_told_in_one_line() -> None:
    """Each with its own figure, in per cent of its echo."""

    def waves(name: str, bound: float, permitted: float = 0.01) -> Decision:
        unit = "of the echo, or of the least level that counts"
        return Decision("radar", f"waves to {name}", bound, permitted, unit, False, body=name)

    several = [waves("post", 0.352), waves("car", 0.337), waves("fine", 0.005), waves("far", 5.64)]
    assert missed_effects([*several, waves("car", 0.2), waves("other", 0.2, 0.1)]) == [
        "waves to post, car, far: not computed; at most 35, 34, 560 % of the echo, or of the least "
        "level that counts, where 1 % is permitted",
        "waves to other: not computed; at most 20 % of the echo, or of the least level that "
        "counts, where 10 % is permitted",
    ]


def test_what_a_remark_tells_is_not_told_again() -> None:
    """Of the first burst, whose remarks are the capture's warnings; of a later one more is."""

    def burst(bound: float, *, is_told: bool) -> Any:
        turns = Decision("radar", "car turns", bound, 0.1, "of the echo", False, is_told=is_told)
        return SimpleNamespace(decisions=(turns,))

    first = burst(0.31, is_told=True)
    assert not_followed([first, burst(0.2, is_told=True)]) == []
    (text,) = not_followed([first, burst(0.5, is_told=True)])
    assert text.startswith("car turns: not computed; at most 50 % of the echo, where 10 % is")
    assert len(not_followed([burst(0.31, is_told=False)])) == 1


def test_the_largest_bound_of_an_effect_is_told_once() -> None:
    def indirect(bound: float, *, taken: bool = False) -> Decision:
        return Decision("camera", "indirect light", bound, 0.02, "of a pixel's noise", taken)

    (text,) = missed_effects([indirect(0.3), indirect(math.inf), indirect(2.0)])
    assert "at most inf of a pixel's noise, where 0.02 is permitted" in text
    assert not missed_effects([indirect(3.0, taken=True), indirect(0.02)])

"""By what a level of a speed/accuracy trade is judged: noise, a cell's light, a body's echo."""

import csv
import json
import sys
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.constants import speed_of_light

from tests.physics.radar_worlds import RADAR, thing, world
from tests.twin.test_trade import once
from twin import cli
from twin.errors import InputError
from twin.fidelity import DEFAULT_SHARE, Fidelity, Tolerance
from twin.trade import Cost, LevelMeasurement, cheapest, choose_fidelity, pareto
from twin.trade.camera import CellSignals, _over_cells
from twin.trade.criterion import criteria_of
from twin.trade.measurement import BY_SOLVER, BodyError
from twin.trade.radar import measure_radar

SMALL = "[emitter]\nrows = 8\ncolumns = 8\n[acquisition]\nn_patterns = 64\n"


def level(seconds: float, *echoes: float, name: str = "", over_noise: float = 1.0) -> Any:
    """A level of the radar whose bodies have these errors."""
    bodies = tuple(BodyError(f"body {i}", 0.0, e, True, "") for i, e in enumerate(echoes))
    cost = Cost(seconds, seconds, seconds, 1, 0.0)
    return LevelMeasurement("radar", name, Fidelity(), cost, 0.1, "", over_noise, bodies=bodies)


def test_each_model_is_judged_by_what_the_tolerance_names() -> None:
    """What it does not name is judged over the noise, as without it."""
    for text, named, limit in (
        ("0.1", {}, 0.1),
        ("1 %", {"light": "of a cell's light"}, DEFAULT_SHARE),
        ("0.3, 0.5 dB", {"radar": "of every body's echo"}, 0.3),
        ("2 mm", {"radar": "of every body's echo"}, DEFAULT_SHARE),
    ):
        for model, criterion in criteria_of(Tolerance.of(text), 1e9).items():
            assert criterion.unit == named.get(model, "of the sensor's noise")
            assert criterion.is_over_noise == (model not in named)
            if criterion.is_over_noise:
                assert criterion.limit == limit
    assert {c.limit for c in criteria_of(1e-9).values()} == {1e-9}


def test_the_limit_of_an_echo_is_that_of_its_level_and_of_its_distance() -> None:
    """An error at the limit makes the echo weaker by 0.5 dB; one that grows linearly over the band,
    a turn of the phase, moves it by 20 mm.
    """
    bandwidth_hz, distance_m = 1e9, 0.02
    weaker = criteria_of(Tolerance(echo_db=0.5), bandwidth_hz)["radar"].limit
    assert 20 * np.log10(1 - weaker) == pytest.approx(-0.5)
    moved = criteria_of(Tolerance(distance_m=distance_m), bandwidth_hz)["radar"].limit
    f_hz = bandwidth_hz * np.linspace(-0.5, 0.5, 100_001)
    turn = 4 * np.pi * f_hz * distance_m / speed_of_light  # of the way out and home
    assert moved == pytest.approx(np.sqrt(np.mean(turn**2)), rel=1e-4)
    both = Tolerance(echo_db=0.5, distance_m=distance_m)
    assert criteria_of(both, bandwidth_hz)["radar"].limit == min(weaker, moved)


def test_the_worst_body_decides_with_its_synthesis() -> None:
    criterion = criteria_of(Tolerance(echo_db=0.5), 1e9)["radar"]  # 0.056
    levels = [level(3, 0.01, 0.02, name="fine"), level(1, 0.001, 0.3, name="one body")]
    assert cheapest(levels, criterion).measurement.name == "fine"
    fine = levels[0]
    coarse = tuple(replace(body, synthesis=0.06) for body in fine.bodies)
    assert not cheapest([replace(fine, bodies=coarse)], criterion).within


def test_a_level_whose_echoes_were_not_compared_is_never_within() -> None:
    criterion = criteria_of(Tolerance(echo_db=0.5), 1e9)["radar"]
    silent = level(0.1, name="targets", over_noise=1e-9)
    choice = cheapest([silent, level(1, 0.01, name="optics"), level(2, 0.2)], criterion)
    assert (choice.measurement.name, choice.within) == ("optics", True)
    assert "nan" not in choice.reason
    late = cheapest([silent, level(1, 0.2, name="optics")], criterion)
    assert (late.measurement.name, late.within) == ("optics", False)
    alone = cheapest([silent, level(0.01, name="worse", over_noise=2.0)], criterion)
    assert (alone.measurement.name, alone.within) == ("targets", False)
    assert "no level has an error of every body's echo that was measured" in alone.reason


def test_an_error_of_cells_is_over_their_light_or_their_mean() -> None:
    """Cells of 1 and 3: 0.1 of the mean, 2, and 0.3 of 3; two runs, the other exact."""
    true = np.array([[1.0, 3.0]])
    off = true + [[0.2, -0.9]]
    signals = [CellSignals(cells, np.zeros((1, 2)), 0.0) for cells in (off, true)]
    assert _over_cells(signals, true) == pytest.approx(np.sqrt((0.1**2 + 0.3**2) / 4))
    assert _over_cells(signals, np.zeros((1, 2))) == np.inf  # light where there is none
    assert _over_cells([CellSignals(0 * true, 0 * true, 0.0)], 0 * true) == 0


def test_echoes_of_plates_are_judged_by_the_level_asked_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A plate square to the radar. Whatever is chosen for a level is within it, and no cheaper one
    is; declared targets alone, far cheaper, are never. A channel of one echo has the error of its
    synthesis in that echo.
    """
    monkeypatch.setattr("twin.trade.radar.measure_cost", once)
    corners = np.array([[8, y, z] for y, z in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
    scene = world(thing("plate", corners * [1, 0.15, 0.15], [[0, 1, 2], [0, 2, 3]]))
    levels = measure_radar(scene, RADAR, 0, lambda name: nullcontext())
    for echo_db in (1.0, 0.3, 0.02):
        tolerance = Tolerance(echo_db=echo_db)
        choice = cheapest(levels, criteria_of(tolerance, RADAR.total_bandwidth_hz)["radar"])
        assert choice.within
        chosen = choice.measurement
        assert chosen.fidelity is not None
        assert chosen.fidelity.radar == "optics"
        within = [m for m in levels if m.bodies and level_off_db(m) < echo_db]
        assert chosen.name == min(within, key=lambda m: m.cost.seconds).name
    for m in levels:
        for body in m.bodies:
            assert m.fidelity is not None
            assert body.synthesis == pytest.approx(m.fidelity.nufft_tolerance, rel=0.02)


def test_echoes_closer_than_those_they_are_compared_with_are_told() -> None:
    """The solver at 0.01, of bodies that are not sampled by brute force."""
    fine = level(1, 0.001, 0.001)
    by_solver = replace(fine.bodies[0], reference=f"{BY_SOLVER} at tolerance 0.01")
    chosen = replace(fine, bodies=(by_solver, replace(fine.bodies[1], reference="brute force")))
    close = criteria_of(Tolerance(echo_db=0.05), 1e9)["radar"]  # 0.0057
    (told,) = pareto._of_reference(chosen, close)
    assert "body 0: compared with echoes to 0.01 of themselves, more than the 0.0057" in told
    assert "body 1" not in told
    for criterion in (
        criteria_of(Tolerance(echo_db=0.5), 1e9)["radar"],
        criteria_of(1e-9)["radar"],
    ):
        assert not pareto._of_reference(chosen, criterion)


def level_off_db(measurement: LevelMeasurement) -> float:
    """What the error of the one body's echo may take of its level."""
    (body,) = measurement.bodies
    return -20 * np.log10(1 - body.error)


@pytest.mark.parametrize(
    ("tolerance", "radar", "told"),
    [
        (Tolerance(psnr_db=0.1), "hybrid-79", "of levels no scores of images are measured"),
        (Tolerance(echo_db=0.5), None, "0.5 dB of an echo, without a radar"),
        (Tolerance(distance_m=1e-6), "hybrid-79", "cannot be promised"),
        ("0.5 dB", "hybrid-79", "expected a number above 0"),
    ],
)
def test_what_cannot_be_judged_is_refused_before_any_work(
    tolerance: Any, radar: str | None, told: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delattr(pareto, "_measure")
    with pytest.raises(InputError, match=told):
        choose_fidelity("table1", tolerance, radar=radar)


def test_a_share_of_the_noise_is_the_same_as_a_number(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []

    def measure(*given: Any, **_: Any) -> Any:
        asked.append(given[3])
        return SimpleNamespace(fidelity=Fidelity())

    monkeypatch.setattr(pareto, "_measure", measure)
    for tolerance in (Tolerance(0.3), 0.3, Tolerance(echo_db=0.5)):
        choose_fidelity("table1", tolerance)
    assert asked == [0.3, 0.3, Tolerance(echo_db=0.5)]


@pytest.mark.thorough
def test_the_command_chooses_by_a_cells_light(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("twin.trade.camera._LEAST_PATHS", 1)
    monkeypatch.setattr("twin.trade.camera._DEPTHS", (1, 4))
    monkeypatch.setattr("twin.trade.brute_force._SEEDS", 3)
    monkeypatch.setattr("twin.trade.meter._ENOUGH_S", 0.0)
    (tmp_path / "small.toml").write_text(f'base = "workable"\n{SMALL}')
    out = tmp_path / "out"
    command = ["twin", "trade", "table1", "--system", str(tmp_path / "small.toml")]
    options = ["--radar", "none", "--tolerance", "3 %", "--out", str(out)]
    monkeypatch.setattr(sys, "argv", [*command, *options])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert not ended.value.code
    assert "light: " in (printed := capsys.readouterr().out)
    assert "below 0.03 of a cell's light" in printed
    content = json.loads((out / "trade.json").read_text())
    assert Tolerance.of(content["tolerance"]) == Tolerance(cell_share=0.03)
    assert content["criteria"]["light"] == {"limit": 0.03, "unit": "of a cell's light"}
    with (out / "trade.csv").open() as file:
        rows = [r for r in csv.DictReader(file) if r["error_over_cells"]]
    (taken,) = (r for r in rows if r["taken"] == "1")
    assert float(taken["error_over_cells"]) < 0.03
    within = [r for r in rows if float(r["error_over_cells"]) < 0.03]
    fastest = min(within, key=lambda r: float(r["seconds"]))
    assert float(taken["seconds_low"]) <= float(fastest["seconds_high"])

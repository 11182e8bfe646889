"""The speed/accuracy trade: what is measured of a level, and what is written."""

import csv
import json
import mmap
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np
import pytest
from scipy import stats
from scipy.constants import speed_of_light
from scipy.linalg import hadamard

import twin.trade.radar as radar_levels
from hardware.patterns import PatternSet
from tests.physics.radar_worlds import RADAR, thing, world
from twin import cli
from twin.detector import FrontEnd
from twin.fidelity import PRESETS, Fidelity, Tolerance
from twin.progress import Stages
from twin.radar import load_radar
from twin.radar.propagation.solvers import trace as find_echoes
from twin.scene import Pose, Rig, Scene, Sun, Target, load_scene
from twin.system import load_system
from twin.trade import (
    Cost,
    LevelMeasurement,
    Trade,
    choose_fidelity,
    meter,
    run_trade,
)
from twin.trade.bodies import errors_of, reference_bodies
from twin.trade.brute_force import Agreement, _agreement, _sampled_masks, _transport, check
from twin.trade.camera import (
    CameraCase,
    CellSignals,
    distributions,
    light_levels,
    measurable_part,
    measure_light,
    reference_level,
)
from twin.trade.measurement import RADAR_KNOBS
from twin.trade.meter import measure_cost
from twin.trade.pareto import stage_names
from twin.trade.radar import _reference, measure_radar


def silent(name: str) -> nullcontext[None]:
    return nullcontext()


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """`workable` with 8 x 8 cells, and a radar of 256 x 16 bins."""
    folder = tmp_path_factory.mktemp("designs")
    (folder / "small.toml").write_text(
        'base = "workable"\nname = "small"\n[emitter]\nrows = 8\ncolumns = 8\n'
        "[acquisition]\nn_patterns = 64\n"
    )
    (folder / "short.toml").write_text(
        'base = "hybrid-79"\nname = "short"\n[waveform]\nn_subcarriers = 256\nn_slots = 16\n'
    )
    return folder / "small.toml", folder / "short.toml"


T = TypeVar("T")


def no_longer_than_needed(patch: pytest.MonkeyPatch) -> None:
    """As few runs of each level as its errors take, of those of a second for its time: three of the
    light's, over which its error is a mean, and of the radar's the one that is compared.
    """
    patch.setattr("twin.trade.meter._ENOUGH_S", 0.0)
    patch.setattr("twin.trade.radar.measure_cost", once)


def once(work: Callable[[int], T], *, least: int = 1) -> tuple[Cost, list[T]]:
    """Neither warm nor repeated."""
    start = time.perf_counter()
    found = work(1)
    seconds = time.perf_counter() - start
    return Cost(seconds, seconds, seconds, 1, 0.0), [found]


def without_car_and_person() -> Scene:
    """The yard with the bodies of fewest triangles."""
    yard, gone = load_scene("yard"), ("car", "person")
    return replace(
        yard,
        objects=tuple(item for item in yard.objects if not item.name.startswith(gone)),
        targets=tuple(target for target in yard.targets if target.name not in gone),
    )


@pytest.fixture(scope="module")
def measured(small: tuple[Path, Path], tmp_path_factory) -> tuple[Trade, Path]:
    out = tmp_path_factory.mktemp("trade") / "yard"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("twin.trade.camera._LEAST_PATHS", 2**16)  # 1024 for each of 64 cells
        no_longer_than_needed(patch)
        patch.setattr("twin.trade.radar._FINEST", Fidelity(radar_tolerance=0.02))
        patch.setattr("twin.trade.radar._LEVELS", radar_levels._LEVELS[:-2])  # these are slow
        patch.setattr("twin.trade.radar._MOST_TERMS", 4e7)
        patch.setattr("twin.trade.bodies._MOST_POINTS", 3_000_000)
        seen, stage = [], Stages.stage
        patch.setattr(Stages, "stage", lambda self, name: seen.append(name) or stage(self, name))
        found, folder = run_trade(
            without_car_and_person(), small[0], radar=small[1], out=out, seed=3
        )
        assert seen == stage_names(load_system(small[0]), load_radar(small[1]))
    assert folder == out
    return found, out


# What is measured.


@pytest.mark.thorough
def test_more_paths_less_error(measured: tuple[Trade, Path]) -> None:
    """64 times the paths: direct light's error falls as n^-0.75, 23 times, all light's as n^-0.5,
    8 times, at least; by 4 anything else is wrong. (Over 20 seeds the least was 7.9, by one step
    of four 1.6.) Without further bounces a seventeenth of the sun's light is missing.
    """
    levels = [m for m in measured[0].of("light") if m.fidelity and not m.fidelity.light_tolerance]
    light = {(m.fidelity.samples, m.fidelity.max_depth): m for m in levels}
    for depth in (2, 4):
        errors = [light[n, depth].error for n in (4, 16, 64, 256)]
        assert errors == sorted(errors, reverse=True)
        assert errors[0] > 4 * errors[-1]
    lost = [light[256, depth].detail["sun_off"] for depth in (1, 2, 4)]
    assert lost == pytest.approx([-0.057, -0.006, 0.0], abs=5e-3)
    reference = light[1024, 8]
    assert reference.error == min(m.error for m in light.values())


@pytest.mark.thorough
def test_light_is_as_exact_as_was_asked(measured: tuple[Trade, Path]) -> None:
    """Root mean square over runs and cells, beside the error of the mean of four references: no
    more than the share of the noise asked for.
    """
    *levels, reference = measured[0].of("light")
    shares = {m.fidelity.light_tolerance: m.over_noise for m in levels if m.fidelity}
    assert {1.0, 0.5, 0.2, 0.1} < shares.keys()
    for share, error in shares.items():
        if share is not None:
            assert error < np.hypot(share, reference.over_noise / 2)


@pytest.mark.thorough
def test_errors_in_all_units_are_the_same_error(measured: tuple[Trade, Path]) -> None:
    """Electrons over the pixel's noise; watts through the responsivity that was asked for."""
    found, _ = measured
    for m in found.of("light"):
        assert m.over_noise == pytest.approx(m.error / found.pixel_noise_e, rel=1e-9)
        per_watt = m.error / m.detail["error_w"]
        assert per_watt == pytest.approx(0.95 * 80e-6 / 1.602176634e-19, rel=1e-9)


@pytest.mark.thorough
def test_the_reference_agrees_with_brute_force(measured: tuple[Trade, Path]) -> None:
    """Within 4 standard errors and 0.2 %, and no pattern of 8 beyond 6 of its own: 1e-3 false
    alarms in all. A transport 1 % too bright, or mirrored, is found.
    """
    agreement = measured[0].agreement
    assert agreement.holds
    assert agreement.worst_sigmas < 6
    assert 0 < agreement.standard_error < 2e-3
    assert str(agreement).startswith("transport over brute force: ")


@pytest.mark.thorough
def test_a_wrong_reference_is_found(small: tuple[Path, Path]) -> None:
    """Brute force is made from the transport itself here, with 0.1 % of scatter."""
    case = CameraCase.of(load_scene("yard"), load_system(small[0]), 1)
    masks, transport = _sampled_masks(case), _transport(case)
    assert masks[0].all()
    assert len({m.tobytes() for m in masks}) == len(masks) == 8
    exact = masks.reshape(8, -1) @ transport.mean(axis=0)
    brute = exact[:, None] * (1 + 1e-3 * np.random.default_rng(0).normal(size=(8, 12)))

    def found(of: np.ndarray) -> Agreement:
        return _agreement(case, brute, of, masks)

    assert found(transport).holds
    assert not found(1.01 * transport).holds
    assert found(transport[:, ::-1]).worst_sigmas > 10 > found(transport).worst_sigmas


@pytest.mark.thorough
def test_rows_of_leds_agree_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """16 rows x 1 column before 16 columns of a sensor: a projector's texture must not shrink to
    the pattern's aspect. Mean of all patterns to 4 standard errors and 0.2 %, each to 6.
    """
    monkeypatch.setattr("twin.trade.camera._LEAST_PATHS", 1)
    monkeypatch.setattr("twin.trade.camera._DEPTHS", ())  # the reference alone
    (tmp_path / "rows.toml").write_text(
        'base = "line-256x16"\nname = "rows"\n[acquisition]\ncolumns = 16\n'
    )
    case = CameraCase.of(load_scene("table1"), load_system(tmp_path / "rows.toml"), 2)
    reference, _ = measure_light(case, silent)
    agreement, by_force = check(case, reference)
    assert by_force is None
    assert agreement.holds
    assert agreement.worst_sigmas < 6


def test_the_references_own_error_is_the_scatter_of_its_renders(
    small: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Standard deviation over the renders, estimated without bias, in electrons and as a share of
    the light; of the same four renders, made here.
    """
    few = Fidelity(samples=16, max_depth=2)
    monkeypatch.setattr("twin.trade.camera.reference_level", lambda system: few)
    monkeypatch.setattr("twin.trade.camera.light_levels", lambda system: [])
    monkeypatch.setattr("twin.trade.meter._ENOUGH_S", 0.0)
    case = CameraCase.of(without_car_and_person(), load_system(small[0]), seed=3)
    told: list[str] = []
    reference, [own] = measure_light(case, lambda name: told.append(name) or silent(name))
    cells = np.array(
        [CellSignals.of(case, case.light(few, 0, run)).cells_e for run in (1, 2, 3, 4)]
    )
    scatter = np.sqrt(cells.var(axis=0, ddof=1).mean())
    assert own.error == pytest.approx(scatter, rel=1e-5)
    assert own.detail["relative"] == pytest.approx(
        scatter / np.sqrt(np.mean(cells.mean(axis=0) ** 2)), rel=1e-5
    )
    assert own.detail["error_w"] == pytest.approx(scatter / case.electrons_per_watt, rel=1e-5)
    over_noise = np.abs(cells - cells.mean(axis=0)) / reference.noise_e[:, None]
    median = np.sqrt(4 / 3) * np.median(over_noise)
    assert own.detail["median_over_noise"] == pytest.approx(median, rel=1e-5)
    assert told == [f"reference light, render {run}" for run in (1, 2, 3, 4, 5)]


def test_noise_levels_are_as_far_from_poisson_as_they_should_be() -> None:
    """Ten electrons of pure shot noise. Rounded and spread again, distribution functions are
    polygons through the half integers: the area between two of them is the distance. 20 000 draws
    leave 0.02 of it open.
    """
    mean, offset = 10.0, 100
    device = FrontEnd(1.0, 0.0, 0.0, 0.0, 1.0, offset, 16)
    rng = np.random.default_rng(5)
    drawn = distributions(np.array([mean]), device, ("none", "gaussian", "full"), rng)
    edges = np.arange(-20, 80) + 0.5
    cdf = {
        "none": stats.uniform(mean - 0.5, 1).cdf,
        "gaussian": stats.norm(mean, np.sqrt(mean)).cdf,
        "full": stats.poisson(mean).cdf,
    }
    fine = np.linspace(edges[0], edges[-1], 200_001)
    polygon = {kind: np.interp(fine, edges, of(edges)) for kind, of in cdf.items()}
    for kind in cdf:
        expected = np.trapezoid(np.abs(polygon[kind] - polygon["full"]), fine)
        shift = np.abs(drawn[kind][1] - drawn["full"][0]).mean()
        assert shift == pytest.approx(expected, abs=0.07)
    assert np.trapezoid(np.abs(polygon["gaussian"] - polygon["full"]), fine) > 0.14


@pytest.mark.thorough
def test_without_noise_the_distribution_is_missed_altogether(measured: tuple[Trade, Path]) -> None:
    """Mean distance of a normal number from its mean: sqrt(2 / pi) sigma, less a quarter of the
    converter's step, which is spread over.
    """
    none, gaussian, full = measured[0].of("noise")
    front_end = CameraCase.of(load_scene("table1"), load_system("workable"), 0).chain.front_end
    sigma = none.detail["noise_e"]
    expected = np.sqrt(2 / np.pi) * sigma - front_end.electrons_per_count / 4
    assert none.error == pytest.approx(expected, rel=0.02)
    assert gaussian.over_noise < 0.05
    assert full.over_noise == 0


def test_a_missing_echo_is_as_far_above_noise_as_the_link_budget_says(small, monkeypatch) -> None:
    """A sphere at 30 m: the whole channel over noise is the root of its image SNR."""
    no_longer_than_needed(monkeypatch)
    radar = load_radar(small[1])
    rig = Rig(Pose((0.0, 0.0, 0.0)), radar=Pose((0.0, 0.0, 0.0)))
    target = Target("t", (30.0, 0.0, 0.0), (0.0, 0.0, 0.0), 10.0, "declared")
    scene = Scene("free space", Path(), "", (), rig, Sun(0.0, 0.0, 0.0), targets=(target,))
    found = {(m.fidelity.radar, m.fidelity.nufft_tolerance): m for m in measure(scene, radar)}
    snr = radar.image_snr(radar.received_power_w(30.0, 10.0))
    # In free space declared targets are all there is, on every level; Sionna's to float32.
    assert found["targets", 1e-6].error < 1e-6
    assert found["paths", 1e-6].error < 1e-4
    reference_rms = found["paths", 1e-6].over_noise / found["paths", 1e-6].error
    assert reference_rms == pytest.approx(np.sqrt(snr), rel=1e-3)
    for tolerance in (1e-3, 1e-6, 1e-10):
        assert found["optics", tolerance].error < tolerance
    bins = _reference(scene, radar, 0)
    assert (len(set(bins.rows)), bins.rows.min(), bins.rows.max()) == (len(bins.rows), 0, 255)
    assert len(bins.rows) >= 64
    assert bins.columns.tolist() == list(range(16))


@pytest.mark.thorough
def test_a_closer_tolerance_is_nearer_to_the_reference(measured: tuple[Trade, Path]) -> None:
    """On the yard; and what says nothing of the meshes is as far off as silence."""
    found = {(m.fidelity.radar, m.fidelity.radar_tolerance): m for m in measured[0].of("radar")}
    tolerances = sorted((t for level, t in found if level == "optics"), reverse=True)
    errors = [found["optics", t].error for t in tolerances]
    assert tolerances == [0.3, 0.1]
    assert errors == sorted(errors, reverse=True)
    assert found["targets", Fidelity().radar_tolerance].error > 0.5


@pytest.mark.thorough
def test_errors_are_named_body_by_body(measured: tuple[Trade, Path]) -> None:
    """Within 40 dB of the strongest, each with what it was compared with; what is off by more than
    its tolerance is named. Weighted by their power, errors of bodies are that of their sum, as far
    as they are independent: within a factor of 3.
    """
    found, out = measured
    levels = {m.fidelity.radar_tolerance: m for m in found.of("radar") if m.bodies}
    assert list(levels) == [0.3, 0.1]
    text = (out / "trade.md").read_text()
    assert "| optics, tolerance 0.3 | optics, tolerance 0.1 |" in text
    for tolerance, m in levels.items():
        assert {"post_left", "post_right"} <= {e.body for e in m.bodies}
        assert all(-40 <= e.level_db <= 0 for e in m.bodies)
        assert all(e.is_converged == (e.error <= tolerance) for e in m.bodies)
        power = np.array([10 ** (e.level_db / 10) for e in m.bodies])
        error = np.array([e.error for e in m.bodies])
        whole = np.sqrt(np.sum(power * error**2) / power.sum())
        assert whole / 3 < m.error < 3 * whole
        assert all(f"| {e.body} |" in text for e in m.bodies)
        assert ("not converged" in text) >= any(not e.is_converged for e in m.bodies)
    references = {e.reference.split(" at ")[0] for e in levels[0.1].bodies}
    assert references == {"direct echo sampled by brute force", "the solver itself"}


def test_brute_force_is_the_plate_of_the_textbook() -> None:
    """The sampler against what neither it nor the solver is made of: a square plate in its far
    field, sigma = 4 pi (A cos t sinc(2 k h sin t))^2 / lambda^2, to 1 %.
    The solver agrees with it then.
    """
    side, place, turn = 0.03, 40.0, np.radians(4.0)
    h = side / 2
    square = np.array([[0, -h, -h], [0, h, -h], [0, h, h], [0, -h, h]])
    about = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    corners = square @ about.T + [place, 0.0, 0.0]
    scene, radar = world(thing("plate", corners, [[0, 1, 2], [0, 2, 3]])), RADAR
    closest = Fidelity(radar_tolerance=0.01)
    found = find_echoes(scene, radar, fidelity=closest, seed=0)
    bodies = reference_bodies(scene, radar, closest, found, 0)
    assert bodies.is_sampled == (True,)
    wavelength = speed_of_light / bodies.frequencies_hz
    form = np.sinc(2 * side * np.sin(turn) / wavelength) * np.cos(turn)
    gain = radar.antenna.gain(np.array([1.0, 0.0, 0.0]))
    loss = 10 ** (-radar.front_end.losses_db.value / 20)
    expected = gain * loss * side**2 * np.abs(form) / (4 * np.pi * place**2)
    np.testing.assert_allclose(np.abs(bodies.echo[0]), expected, rtol=0.01)
    assert errors_of(bodies, found, radar, 0.01)[0].error < 0.01


def test_the_default_has_a_row_that_tells_what_all_rows_leave_out(small, monkeypatch) -> None:
    """A plate of 0.3 m whose half a nearer one hides: only the default has the waves round that and
    of both edges, as the reference has, and is nearer to it than the same tolerance without them.
    """
    no_longer_than_needed(monkeypatch)
    monkeypatch.setattr("twin.trade.bodies._MOST_POINTS", 0)
    front = np.array([[4, 0, -0.3], [4, 0.4, -0.3], [4, 0.4, 0.3], [4, 0, 0.3]], dtype=float)
    back = np.array([[8, y, z] for y, z in ((-0.15, -0.15), (0.15, -0.15), (0.15, 0.15))])
    back = np.vstack([back, [[8, -0.15, 0.15]]]) + [0, 0.1, 0]
    faces = [[0, 1, 2], [0, 2, 3]]
    scene = world(thing("front", front, faces), thing("back", back, faces))
    rows = [m for m in measure(scene, load_radar(small[1])) if m.bodies]
    named = {m.name.rsplit(", synthesis", 1)[0]: m for m in rows}
    default, plain = (
        named["optics, tolerance 0.1, as run: all by bounds"],
        named["optics, tolerance 0.1"],
    )
    knobs = Tolerance().knobs()
    assert default.knobs == {
        **{name: getattr(knobs, name) for name in RADAR_KNOBS},
        "radar": "optics",
    }
    assert default.leaves_out == "what is bounded by 1 % of an echo, each effect"
    assert plain.leaves_out == (
        "reflections beyond 3 at bodies, 1 at surfaces; edges; waves round obstacles to bodies"
    )
    behind = {m.name: {e.body: e.error for e in m.bodies}["back"] for m in (default, plain)}
    assert behind[default.name] < behind[plain.name] / 2
    assert default.error < plain.error / 2


def measure(scene: Scene, radar) -> list[LevelMeasurement]:
    return measure_radar(scene, radar, 0, silent)


def test_no_echo_no_levels(small: tuple[Path, Path]) -> None:
    rig = Rig(Pose((0.0, 0.0, 0.0)), radar=Pose((0.0, 0.0, 0.0)))
    scene = Scene("nothing", Path(), "", (), rig, Sun(0.0, 0.0, 0.0))
    assert measure(scene, load_radar(small[1])) == []


def test_only_what_the_patterns_tell_counts() -> None:
    """Against the dense projection on the rows shown."""
    patterns = PatternSet(4, 8, 11)
    cells = np.random.default_rng(0).normal(size=(2, 32))
    rows = hadamard(32)[patterns.indices]
    np.testing.assert_allclose(
        measurable_part(cells, patterns), cells @ rows.T @ rows / 32, atol=1e-12
    )
    assert measurable_part(cells, PatternSet(4, 8, 32)) is cells


def touched(n_bytes: int) -> mmap.mmap:
    """Memory from the system itself: an allocator may have some left of earlier tests."""
    block = mmap.mmap(-1, n_bytes, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
    for page in range(0, n_bytes, mmap.PAGESIZE):
        block[page] = 1
    return block


@pytest.mark.quick(1)
@pytest.mark.parametrize("forgets", [True, False], ids=["high-water mark", "sampled"])
def test_time_and_memory_are_the_works_own(forgets, monkeypatch, tmp_path) -> None:
    """64 MiB for 30 ms, after 512 MiB that are gone: 60 to 100 MiB; the first run counts not."""
    if not forgets:  # as in some containers: the file takes what is written and nothing follows
        monkeypatch.setattr(meter, "_CLEAR", tmp_path / "clear_refs")
    touched(2**29).close()

    called = []

    def work(run: int) -> int:
        called.append(run)
        with touched(2**26):
            time.sleep(0.03 if run else 3.0)
        return run

    cost, results = measure_cost(work, most=4)
    assert results == [1, 2, 3, 4]
    assert called == [0, 1, 2, 3, 4]
    assert 60 < cost.peak_bytes / 2**20 < 100
    assert 0.03 < cost.low_s <= cost.seconds <= cost.high_s
    assert cost.seconds < 2.0


# What is written.


@pytest.mark.thorough
def test_a_trade_writes_data_and_says_what_to_take(measured: tuple[Trade, Path]) -> None:
    found, out = measured
    assert {p.name for p in out.iterdir()} == {"trade.json", "trade.csv", "trade.md", "trade.png"}
    assert list(out.parent.iterdir()) == [out]
    content = json.loads((out / "trade.json").read_text())
    assert Fidelity(**content["fidelity"]) == found.fidelity
    assert content["agreement"]["holds"]
    with (out / "trade.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(found.measurements) == 15 + 4 + 2 + 3 + 6
    assert sum(int(row["taken"]) for row in rows) == 3
    text = (out / "trade.md").read_text()
    for choice in found.choices.values():
        assert f"| **{choice.measurement.name}** |" in text
    assert "brute force per pattern" in text
    assert "(standard)" in text
    tables = [line for line in text.splitlines() if line.startswith("|")]
    assert {line.count("|") for line in tables} == {6, 7}


@pytest.mark.thorough
def test_the_choice_joins_the_models(measured: tuple[Trade, Path]) -> None:
    found, _ = measured
    light, noise, radar = (
        found.choices[k].measurement.fidelity for k in ("light", "noise", "radar")
    )
    assert found.fidelity.quality == light.quality
    assert found.fidelity.noise == noise.noise
    assert (found.fidelity.radar, found.fidelity.nufft_tolerance) == (
        radar.radar,
        radar.nufft_tolerance,
    )
    without = replace(found, choices={k: found.choices[k] for k in ("light", "noise")})
    usual = Fidelity()
    assert without.fidelity == found.fidelity.with_(
        **{name: getattr(usual, name) for name in RADAR_KNOBS},
    )


@pytest.fixture
def few_levels(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("twin.trade.camera._LEAST_PATHS", 1)
    monkeypatch.setattr("twin.trade.camera._DEPTHS", (1, 4))
    monkeypatch.setattr("twin.trade.brute_force._SEEDS", 3)
    no_longer_than_needed(monkeypatch)


def test_few_cells_need_more_paths_each() -> None:
    """Paths of the reference in all: never fewer than those of 64 x 64 cells."""
    for name, expected in (("workable", 1024), ("led-16x16", 128**2), ("line-256x16", 1024)):
        system = load_system(name)
        assert reference_level(system).samples == expected
        assert max(r.samples for r in light_levels(system)) == expected / 4


@pytest.mark.thorough
@pytest.mark.usefixtures("few_levels")
def test_choose_measures_and_returns_a_fidelity(small: tuple[Path, Path]) -> None:
    """A tolerance that nothing meets gives the most exact; one that all meet, little work."""
    scene = load_scene("table1")
    strict = choose_fidelity(scene, 1e-9, system=small[0], radar=None)
    exact = strict.light_tolerance is not None or strict.quality == PRESETS["reference"].quality
    assert exact
    loose = choose_fidelity(scene, 1e9, system=small[0], radar=None)
    assert loose != strict


def twin(*arguments: str, monkeypatch, capsys) -> tuple[int, str, str]:
    monkeypatch.setattr(sys, "argv", ["twin", "trade", *arguments])
    with pytest.raises(SystemExit) as stopped:
        cli.main()
    streams = capsys.readouterr()
    return stopped.value.code or 0, streams.out, streams.err


@pytest.mark.thorough
@pytest.mark.usefixtures("few_levels")
def test_the_command_prints_table_check_and_choice(small, monkeypatch, capsys, tmp_path) -> None:
    out = tmp_path / "out"
    arguments = ("table1", "--system", str(small[0]), "--radar", "none", "--tolerance", "1e-4")
    code, printed, errors = twin(
        *arguments, "--out", str(out), monkeypatch=monkeypatch, capsys=capsys
    )
    assert code == 0
    assert "warning: light: no level is below 0.0001" in errors
    for part in (
        "takes minutes; -v tells each",
        "64 paths, 4 bounces",
        "transport over brute force",
        "take: Fidelity(",
    ):
        assert part in printed
    assert "radar:" not in printed
    assert printed.splitlines()[-1] == f"written: {out / 'trade.md'}"


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["nope"], "nope: no such scene"),
        (["yard", "--system", "nope"], "system: 'nope'"),
        (["yard", "--radar", "nope"], "radar: 'nope'"),
        (["yard", "--tolerance", "0"], "--tolerance: 0 of the noise: expected 0.0001 to 10"),
        (["yard", "--tolerance", "-0.1"], "--tolerance: -0.1 of the noise: expected"),
        (["yard", "--tolerance", "nan"], "--tolerance: 'nan': expected a share"),
        (["yard", "--tolerance", "inf"], "--tolerance: 'inf': expected a share"),
        (["yard", "--tolerance", "much"], "--tolerance: 'much': expected a share"),
        (["yard", "--seed", "-1"], "--seed"),
        (["yard", "--out", ""], "out: is empty"),
        (["yard", "--out", "/proc/nowhere/out"], "/proc/nowhere/out"),
        (["yard", "--within", "0"], "within: 0 s is not above 0"),
        (["yard", "--radar", "none", "--tolerance", "2 mm"], "without a radar"),
    ],
)
def test_bad_input_is_one_line_before_any_work(
    arguments, expected, monkeypatch, capsys, tmp_path
) -> None:
    monkeypatch.chdir(tmp_path)
    start = time.monotonic()
    code, printed, errors = twin(*arguments, monkeypatch=monkeypatch, capsys=capsys)
    assert code == 2
    assert printed == ""  # not even that it takes minutes
    assert len(errors.splitlines()) == 1
    assert expected in errors
    assert list(tmp_path.iterdir()) == []
    assert time.monotonic() - start < 3


def test_ctrl_c_leaves_nothing_behind(tmp_path: Path) -> None:
    process = subprocess.Popen(
        [sys.executable, "-m", "twin", "trade", "yard", "--out", str(tmp_path / "out")],
        stderr=subprocess.PIPE,
        text=True,
    )
    time.sleep(4.0)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=20)
    assert process.returncode == 130, errors
    assert list(tmp_path.iterdir()) == []

"""What the regression plugin runs: records, methods and detectors, and what of them it finds."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from yard_32x32 import RADAR, SYSTEM

from hardware import METHODS, reconstruct
from twin.camera.acquisition import measure
from twin.fidelity import PRESETS
from twin.files import InputError
from twin.radar import load_radar
from twin.regression.checker import Regression
from twin.regression.metrics import CAMERA_METRICS, RADAR_METRICS, Metric
from twin.regression.runs import (
    image_method,
    radar_detector,
    records,
    run_camera,
    run_radar,
    vehicle_detector,
)
from twin.regression.statistics import compare
from twin.scene import Pose, load_scene
from twin.system import load_system


@pytest.mark.parametrize(
    ("given", "told"),
    [
        (None, "gave a NoneType"),
        (3, "gave a int"),
        ("picture", "gave a str"),
        ([[1.0], [1.0, 2.0]], "gave a list"),
        (np.ma.zeros((32, 32)), "gave a masked array"),
    ],
)
def test_a_result_that_is_no_image_is_named(yard, given: object, told: str) -> None:
    scene, system, light = yard
    with pytest.raises(InputError, match=re.escape(told)):
        run_camera(scene, system, light, lambda _: given, range(1), CAMERA_METRICS)


class Wrong:
    """A method or detector that goes wrong with some of its records, told by their order."""

    def __init__(self, right, wrong, records) -> None:
        self.right, self.wrong, self.records, self.known = right, wrong, set(records), {}

    def __call__(self, record):
        content = (record.counts if hasattr(record, "counts") else record.iq).tobytes()
        place = self.known.setdefault(content, len(self.known))
        result = self.right(record)
        return self.wrong(result) if place in self.records else result


class AtRandom(Wrong):
    """One that goes wrong in some of its runs, whatever the record."""

    def __call__(self, record):
        self.known[len(self.known)] = None
        result = self.right(record)
        return self.wrong(result) if len(self.known) - 1 in self.records else result


@pytest.mark.thorough
def test_what_fails_in_few_seeds_fails_the_test(twin_truth, tmp_path: Path) -> None:
    """End to end: a black image in 5 of 48, one that is stuck, one of complex numbers.

    Five failures of a method that fails at random, against none before, are 1 in 32 by chance: no
    alarm at 1 % can come of it.
    """

    def lmmse(record):
        return reconstruct(record).picture

    def camera(method, reason: str | None = None) -> None:
        fixture = Regression(twin_truth, tmp_path, tmp_path, "test", "test", reason, [])
        fixture.camera("yard", SYSTEM, method=method)

    camera(lmmse, "first of all")
    camera(lmmse)
    with pytest.raises(pytest.fail.Exception, match=r"psnr_db.*WORSE at 5 seeds: 2, 9, 17, 30, 47"):
        camera(Wrong(lmmse, np.zeros_like, [2, 9, 17, 30, 47]))
    # The same number of failures, which do not come again with the same records.
    camera(AtRandom(lmmse, np.zeros_like, [2, 9, 17, 30, 47]))
    seen = []

    def stuck(record):
        seen.append(lmmse(record))
        return seen[0]

    with pytest.raises(pytest.fail.Exception, match=r"psnr_db.*WORSE"):
        camera(stuck)
    told = "an image of complex128, expected real numbers"
    with pytest.raises(pytest.fail.Exception, match=told):
        camera(lambda record: lmmse(record) + 0j)


@pytest.mark.whole
def test_what_a_detector_loses_or_shifts_fails_the_test(twin_truth, tmp_path: Path) -> None:
    """One target in one of four records, one detection more in one, all a range cell farther: the
    last reads nearer to the declared centres on the whole, and is no gain.
    """

    def radar(detector, reason: str | None = None) -> None:
        fixture = Regression(twin_truth, tmp_path, tmp_path, "test", "test", reason, [])
        fixture.radar("yard", RADAR, detector=detector, seeds=4, fidelity=PRESETS["draft"])

    def without_the_nearest(found):
        return sorted(found, key=lambda d: d.range_m)[3:]

    def with_one_more(found):
        return [*found, replace(found[0], range_m=100.0)]

    cell = load_radar(RADAR).ofdm.range_cell_m
    radar(vehicle_detector, "first of all")
    radar(vehicle_detector)
    for given, told in ((None, "gave a NoneType"), ([1, 2], "gave a int, expected hardware's")):
        with pytest.raises(pytest.fail.Exception, match=told):
            radar(lambda _, given=given: given)
    for wrong, metric in ((without_the_nearest, "missed"), (with_one_more, "unmatched")):
        with pytest.raises(pytest.fail.Exception, match=rf"{metric}: .*WORSE at 1 seeds: 2"):
            radar(Wrong(vehicle_detector, wrong, [2]))
    with pytest.raises(pytest.fail.Exception, match=r"range_offset_m: .*WORSE"):
        radar(lambda r: [replace(d, range_m=d.range_m + cell) for d in vehicle_detector(r)])


def test_records_are_those_of_measure(yard) -> None:
    scene, system, light = yard
    for seed, record in enumerate(records(scene, system, light, range(2))):
        expected = measure(scene, system, light, rng=np.random.default_rng(seed)).record
        np.testing.assert_array_equal(record.counts, expected.counts)
        np.testing.assert_array_equal(record.pose, expected.pose)


def test_a_name_and_a_function_are_the_same_method(yard) -> None:
    scene, system, light = yard
    methods = (
        "lmmse",
        lambda record: reconstruct(record, "lmmse"),
        lambda values, noise_variance, sensing: METHODS["lmmse"](values, noise_variance, sensing)[
            0
        ],
    )
    runs = [
        run_camera(scene, system, light, method, range(3), CAMERA_METRICS).figures
        for method in methods
    ]
    for other in runs[1:]:
        np.testing.assert_array_equal(runs[0]["psnr_db"], other["psnr_db"])


def test_methods_and_detectors_may_stand_in_files(tmp_path: Path) -> None:
    """As everywhere else: what is not there is told, and what is takes the same arguments."""
    (tmp_path / "mine.py").write_text(
        "def inverse(values, noise_variance, sensing):\n    return values\n"
        "def nothing(channel, waveform, image):\n    return []\n"
    )
    assert image_method(f"{tmp_path / 'mine.py'}:inverse")
    assert radar_detector(f"{tmp_path / 'mine.py'}:nothing")
    for take, name in ((image_method, "absent"), (radar_detector, "inverse_")):
        with pytest.raises(InputError, match=f"has no function '{name}'"):
            take(f"{tmp_path / 'mine.py'}:{name}")
    with pytest.raises(InputError, match=r"expected a function of \(values, noise_var"):
        image_method(lambda one, two: one)


def test_a_metric_of_ones_own(twin_truth, tmp_path: Path) -> None:
    bias = Metric("bias", "electrons", lambda truth, image: abs((image - truth).mean()), 1.0)

    def fixture(reason: str | None = None) -> Regression:
        return Regression(twin_truth, tmp_path, tmp_path, "test", "test", reason, [])

    fixture("first of all").camera("yard", SYSTEM, metrics=[bias], seeds=4)
    (verdict,) = fixture().camera("yard", SYSTEM, metrics=[bias], seeds=4)
    assert verdict.metric.name == "bias"
    with pytest.raises(pytest.fail.Exception, match=r"bias: .* electrons .*WORSE"):
        fixture().camera(
            "yard", SYSTEM, metrics=[bias], seeds=4, method=lambda r: reconstruct(r).picture + 50
        )


@pytest.mark.thorough
def test_faults_of_a_detector_show_in_its_figures(twin_truth) -> None:
    """Ranges 5 mm too long, all beyond 10 m dropped, a ghost: each in the metrics that are its.

    Targets are points: bodies have several echoes, among which millimetres are nothing.
    """
    scene, radar = load_scene("yard"), load_radar(RADAR)
    capture = twin_truth.echo(scene, radar, PRESETS["draft"].with_(radar="paths"))

    def too_far(record):
        return [replace(d, range_m=d.range_m + 5e-3) for d in vehicle_detector(record)]

    def forgetful(record):
        return [d for d in vehicle_detector(record) if d.range_m < 10]

    def sees_ghosts(record):
        found = vehicle_detector(record)
        return [*found, replace(found[0], range_m=100.0)]

    def figures(detector):
        return run_radar(capture, radar, detector, range(3), RADAR_METRICS, 1e-6).figures

    good = figures(vehicle_detector)
    assert compare(RADAR_METRICS, good, figures(vehicle_detector))
    assert not any(v.worse for v in compare(RADAR_METRICS, good, good))
    for detector, expected in (
        (too_far, {"range_error_m", "range_offset_m"}),
        (forgetful, {"range_error_m", "missed", "undetected_echoes"}),
        (sees_ghosts, {"unmatched"}),
    ):
        verdicts = compare(RADAR_METRICS, good, figures(detector))
        assert {v.metric.name for v in verdicts if v.worse} == expected, detector.__name__


@pytest.mark.whole
def test_a_detector_is_held_against_its_baseline(twin_truth, tmp_path: Path) -> None:
    """One's own detector in one line: made, kept, then worse, with a picture of its detections."""

    def fixture(reason: str | None = None) -> Regression:
        folders = tmp_path / "baselines", tmp_path / "pictures"
        return Regression(twin_truth, *folders, "test", "test.py::test", reason, [])

    fixture("first of all").radar("yard", RADAR, seeds=2)
    assert not any(v.worse for v in fixture().radar("yard", RADAR, seeds=2))
    with pytest.raises(pytest.fail.Exception, match=r"missed: 0 before, 5 after.*WORSE"):
        fixture().radar("yard", RADAR, seeds=2, detector=lambda record: [])
    assert (tmp_path / "pictures" / "test.png").read_bytes().startswith(b"\x89PNG")
    twice = fixture("again")
    twice.radar("yard", RADAR, seeds=2)
    with pytest.raises(pytest.fail.Exception, match="'' is taken"):
        twice.radar("yard", RADAR, seeds=2)


@pytest.mark.thorough
def test_several_poses_in_turn(twin_truth, tmp_path: Path) -> None:
    """Seed i sees pose i modulo 2, what a capture from there sees; a method that is worse from one
    of them alone, by a fifth of its image, is found, and another pose is another setup.
    """
    poses = [Pose((0.0, 0.0, 1.2)), Pose((0.5, 0.3, 1.2), yaw_deg=10.0)]
    seen = []

    def lmmse(record):
        seen.append(record)
        return reconstruct(record).picture

    def dark_from_the_second(record):
        image = lmmse(record)
        return image if record.pose.x_m == 0.0 else 0.8 * image

    def camera(method, reason: str | None = None, poses=poses):
        fixture = Regression(twin_truth, tmp_path, tmp_path, "test", "test", reason, [])
        return fixture.camera("yard", SYSTEM, method=method, seeds=8, poses=poses)

    camera(lmmse, "first of all")
    scene, system = load_scene("yard", poses[1]), load_system(SYSTEM)
    light = twin_truth.light(scene, system)
    expected = measure(scene, system, light, rng=np.random.default_rng(3)).record
    assert any(np.array_equal(record.counts, expected.counts) for record in seen)
    assert not any(verdict.worse for verdict in camera(lmmse))
    with pytest.raises(pytest.fail.Exception, match=r"psnr_db.*WORSE"):
        camera(dark_from_the_second)
    with pytest.raises(pytest.fail.Exception, match="another setup: poses"):
        camera(lmmse, poses=poses[:1])
    with pytest.raises(ValueError, match="at least 2 of each of 9 poses"):
        camera(lmmse, poses=poses[:1] * 9)


def test_carrier_steps_are_judged_by_the_cell_of_all_together(twin_truth) -> None:
    """A detection 5 m from everything is no target, though one step's cell has 7.5 m."""
    scene, radar = load_scene("yard"), load_radar("prototype")
    capture = twin_truth.echo(scene, radar, PRESETS["draft"].with_(radar="paths"))
    visible = [target for target in capture.truth if target.visible]
    far = max(target.range_m for target in visible) + 5

    def elsewhere(record):
        return [replace(vehicle_detector(record)[0], range_m=far)]

    found = run_radar(capture, radar, elsewhere, range(2), RADAR_METRICS, 1e-6)
    assert found.results[0].range_cell_m == pytest.approx(radar.range_cell_m)
    assert (found.figures["missed"] == len(visible)).all()
    np.testing.assert_allclose(found.figures["range_error_m"], 2 * radar.range_cell_m)
    assert (found.figures["unmatched"] == 1).all()


def test_what_the_oscillator_hides_is_no_strong_echo(twin_truth) -> None:
    """Round a strong echo its noise is 30 dB over the receiver's, and side lobes of carrier steps
    lie in it, some 40 dB over the receiver's: no detector finds them.
    """
    scene, radar = load_scene("yard"), load_radar("prototype")
    capture = twin_truth.echo(scene, radar, PRESETS["draft"].with_(radar="paths"))

    def figures(detector):
        found = run_radar(capture, radar, detector, range(2), RADAR_METRICS, 1e-6)
        return found.figures["undetected_echoes"]

    assert not figures(vehicle_detector).any()
    assert (figures(lambda _: []) >= 4).all()


@pytest.mark.thorough
def test_echoes_of_antennas_that_take_turns_are_over_their_noise(twin_truth) -> None:
    """Of twelve channels: what the removal of the leakage's phase noise changes of echoes, and how
    the map is whitened, had counted as noise beside them, and one was left. A record without noise
    would show twelve more, of the converter's rounding.
    """
    scene, radar = load_scene("street"), load_radar("hybrid-79-mimo")
    capture = twin_truth.echo(scene, radar, PRESETS["draft"].with_(radar="paths"))

    def undetected(detector):
        found = run_radar(capture, radar, detector, range(1), RADAR_METRICS, 1e-6)
        return float(found.figures["undetected_echoes"][0])

    assert undetected(vehicle_detector) == 0
    assert undetected(lambda _: []) == 2


def test_levels_and_strong_echoes_of_no_declared_target_count(twin_truth) -> None:
    """All 20 dB weaker; the strongest echo lost, and a ghost in its place, where none is declared:
    these had passed, the loss as a gain.
    """
    scene, radar = load_scene("yard"), load_radar(RADAR)
    capture = twin_truth.echo(scene, radar, PRESETS["draft"].with_(radar="paths"))

    def weaker(record):
        return [replace(d, power_w=d.power_w / 100) for d in vehicle_detector(record)]

    def without_the_strongest(record):
        return vehicle_detector(record)[1:]

    def with_a_ghost_for_it(record):
        first, *others = vehicle_detector(record)
        return [replace(first, range_m=100.0), *others]

    def figures(capture, detector):
        return run_radar(capture, radar, detector, range(3), RADAR_METRICS, 1e-6).figures

    def worse(capture, detector):
        good = figures(capture, vehicle_detector)
        verdicts = compare(RADAR_METRICS, good, figures(capture, detector))
        return {verdict.metric.name for verdict in verdicts if verdict.worse}

    assert worse(capture, weaker) == {"level_offset_db"}
    undeclared = replace(capture, truth=())
    assert not figures(undeclared, vehicle_detector)["undetected_echoes"].any()
    for detector in (without_the_strongest, with_a_ghost_for_it):
        assert worse(undeclared, detector) == {"undetected_echoes"}


@pytest.mark.thorough
def test_every_strong_echo_that_is_lost_shows(twin_truth) -> None:
    """Echoes far below the strongest, and parts of what is declared as one target: detections that
    are left out were fewer `unmatched` alone, which passed as better.
    """
    scene, radar = load_scene("yard"), load_radar(RADAR)
    capture = twin_truth.echo(scene, radar, PRESETS["draft"].with_(radar="paths"))
    wide = {"nearer_m": 20.0, "farther_m": 20.0, "slower_m_per_s": 5.0, "faster_m_per_s": 5.0}
    bodies = replace(capture, truth=tuple(replace(target, **wide) for target in capture.truth))
    seen = {}

    def detected(record):
        return seen.setdefault(record.iq.tobytes(), vehicle_detector(record))

    def figures(detector):
        return run_radar(bodies, radar, detector, range(2), RADAR_METRICS, 1e-6).figures

    good = figures(detected)
    first = next(iter(seen.values()))
    strong = [one for one in first if one.snr_db > 23]
    weakest = min(one.snr_db for one in strong)
    assert max(one.snr_db for one in strong) > weakest + 40
    for lost in strong:

        def without(record, lost=lost):
            return [d for d in detected(record) if abs(d.range_m - lost.range_m) > 0.02]

        verdicts = compare(RADAR_METRICS, good, figures(without))
        worse = {verdict.metric.name for verdict in verdicts if verdict.worse}
        assert "undetected_echoes" in worse, lost.range_m

"""The knobs: stricter of two, presets, and what each level leaves out."""

import re
from dataclasses import asdict, fields

import numpy as np
import pytest

from twin.camera import capture
from twin.errors import InputError
from twin.fidelity import PRESETS, Fidelity, LightFidelity, RadarFidelity, Tolerance, knobs_of
from twin.optics.paths import TracingQuality
from twin.radar import load_radar, radar_capture
from twin.scene import load_scene
from twin.system import load_system


def test_the_stricter_of_two_wins_knob_by_knob() -> None:
    rough = Fidelity(samples=4, max_depth=6, noise="none", nufft_tolerance=1e-8, radar="paths")
    fine = Fidelity(samples=256, max_depth=1, radar="targets", start="dual")
    both = rough | fine
    assert both == Fidelity(256, 6, 64, "dual", radar="paths", nufft_tolerance=1e-8)
    assert both == fine | rough
    assert both | both == both


def test_presets_are_ordered_by_strictness() -> None:
    draft, standard, reference = (PRESETS[n] for n in ("draft", "standard", "reference"))
    for rough, fine in ((draft, standard), (standard, reference)):
        both = (rough | fine).quality
        assert both == TracingQuality(fine.samples, fine.max_depth, fine.quality.further_samples)
        assert (rough | fine).radar_tolerance == fine.radar_tolerance < rough.radar_tolerance
    assert draft.motion_tolerance > standard.motion_tolerance > reference.motion_tolerance
    assert Fidelity(motion_tolerance="none").motion_tolerance is None
    assert knobs_of("draft") == draft
    assert knobs_of(draft) is draft


@pytest.mark.parametrize(
    "wrong",
    [
        {"samples": 5},
        {"max_depth": 0},
        {"indirect_samples": 3},
        {"noise": "loud"},
        {"radar": "rays"},
        {"start": "left"},
        {"nufft_tolerance": 0.0},
        {"radar_tolerance": 0.0},
        {"radar_tolerance": "fine"},
        {"radar_bounces": 2.5},
        {"radar_edges": True},
        {"radar_shadow_db": -1.0},
        {"max_depth": None},
        {"nufft_tolerance": float("nan")},
    ],
)
def test_wrong_knobs_are_named(wrong: dict[str, object]) -> None:
    (name,) = wrong
    with pytest.raises(ValueError, match=name):
        Fidelity(**wrong)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="no knob"):
        Fidelity().with_(speed=1)
    with pytest.raises(ValueError, match="radar_rays gave way to radar_tolerance"):
        Fidelity().with_(radar_rays=200_000)
    with pytest.raises(ValueError, match="is none of draft"):
        knobs_of("fast")


def test_every_knob_has_a_rule_that_takes_its_default() -> None:
    """And of two values the same one is stricter whichever comes first, for every knob."""
    usual, fine = Fidelity(), PRESETS["reference"]
    for knob in fields(Fidelity):
        rule = knob.metadata["rule"]
        assert rule.check(getattr(usual, knob.name)) == ""
        if knob.name != "indirect_samples":  # None stands for a share of the samples
            pair = getattr(usual, knob.name), getattr(fine, knob.name)
            assert rule.stricter(*pair) == rule.stricter(*pair[::-1])
    assert usual | fine == fine | usual == fine.with_(indirect_samples=256)


def test_light_and_radar_have_knobs_of_their_own() -> None:
    fidelity = Fidelity(samples=16, radar_tolerance=0.03)
    light, radar = fidelity.part(LightFidelity), fidelity.part(RadarFidelity)
    assert light == LightFidelity(samples=16)
    assert radar == RadarFidelity(radar_tolerance=0.03)
    assert Fidelity(**asdict(light), **asdict(radar)) == fidelity
    assert (light | LightFidelity(max_depth=8)).max_depth == 8
    assert fidelity.with_({"samples": 4}) == fidelity.with_(samples=4)


def test_without_noise_counts_are_the_mean_of_noisy_ones() -> None:
    """Mean of 64 noisy records against the silent one: within 5 sigma plus half a count."""
    scene, system = load_scene("table1"), load_system("workable")
    system = system.model_copy(
        update={
            "acquisition": system.acquisition.model_copy(
                update={
                    "n_patterns": system.acquisition.n_patterns.model_copy(update={"value": 32})
                }
            )
        }
    )
    quiet = Fidelity(4, 1, noise="none")
    silent, again = (capture(scene, system, fidelity=quiet) for _ in range(2))
    np.testing.assert_array_equal(silent.record.counts, again.record.counts)
    from twin.camera.acquisition import measure
    from twin.camera.light import render

    light_seed = np.random.SeedSequence(0).spawn(2)[0]
    rendered = render(scene, system, fidelity=Fidelity(4, 1), seed=light_seed)
    for noise in ("gaussian", "full"):
        noisy = np.array(
            [
                measure(
                    scene, system, rendered, rng=np.random.default_rng(s), noise=noise
                ).record.counts
                for s in range(64)
            ]
        )
        error = noisy.std(axis=0) / 8
        assert (np.abs(noisy.mean(axis=0) - silent.record.counts) < 5 * error + 0.5).all()


def test_free_space_targets_are_the_traced_direct_paths() -> None:
    """The radar equation against Sionna's own legs: delay to 1 um, level to 0.01 dB."""
    scene, radar = load_scene("yard"), load_radar("hybrid-79")
    traced = radar_capture(scene, radar, fidelity=Fidelity(radar="paths")).propagation.paths
    direct = {p.target: p for p in traced if p.via == (p.target,)}
    free = radar_capture(scene, radar, fidelity=Fidelity(radar="targets")).propagation.paths
    assert len(free) == len(scene.targets)
    for path in free:
        if path.target not in direct:
            continue
        other = direct[path.target]
        assert path.range_m == pytest.approx(other.range_m, abs=1e-6)
        assert path.delay_rate == pytest.approx(other.delay_rate, rel=1e-6, abs=1e-15)
        assert 20 * np.log10(abs(path.amplitude / other.amplitude)) == pytest.approx(0, abs=0.01)
    assert len(direct) >= 3


def test_whole_numbers_may_have_an_exponent() -> None:
    made = Fidelity(radar_edges=1e6, samples=np.int64(16))
    assert (made.radar_edges, made.samples) == (10**6, 16)
    assert type(made.radar_edges) is type(made.samples) is int
    for value in (2.5, float("nan"), float("inf"), True, "7"):
        with pytest.raises(InputError, match=r"radar_bounces: .* is no int"):
            Fidelity(radar_bounces=value)


def test_a_tolerance_is_a_share_of_the_noise() -> None:
    knobs = Tolerance(0.4).knobs()
    assert (knobs.light_tolerance, knobs.motion_tolerance, knobs.radar_tolerance) == (0.4, 0.2, 0.2)
    assert (knobs | Tolerance(0.1).knobs()).light_tolerance == 0.1
    assert (knobs | Fidelity()).light_tolerance == 0.4
    assert Tolerance().knobs() == Tolerance.of("0.2").knobs() == knobs_of(0.2)
    assert knobs_of(None).light_tolerance == knobs_of(0.2).light_tolerance
    for wrong in (0.0, 11.0, float("nan"), "fine", True):
        with pytest.raises(InputError, match="tolerance"):
            Tolerance(wrong)  # type: ignore[arg-type]


def test_a_tolerance_of_a_cell_is_in_per_cent() -> None:
    knobs = Tolerance.of("2 %").knobs()
    assert (knobs.light_tolerance, knobs.light_tolerance_relative) == (None, 0.02)
    assert knobs.radar_tolerance == Tolerance().knobs().radar_tolerance


@pytest.mark.parametrize("asked_db", [0.01, 0.5, 3.0, 6.0, 20.0])
def test_a_tolerance_of_an_echo_is_in_db(asked_db: float) -> None:
    """An echo that is off by the radar's tolerance, in whatever phase, is off by at most as much as
    was asked, up and down, and by as much in one of them.
    """
    error = Tolerance.of(f"{asked_db} dB").knobs().radar_tolerance
    phases = np.linspace(0, 2 * np.pi, 721)
    off_db = 20 * np.log10(np.abs(1 + error * np.exp(1j * phases)))
    assert np.abs(off_db).max() == pytest.approx(asked_db, rel=1e-9)


def test_a_tolerance_of_a_distance_is_that_of_the_steepest_error() -> None:
    """An error of the echo, linear over the band, moves the straight line through the phase by as
    much as was asked: fitted to phases, without the formula.
    """
    bandwidth_hz, distance_m = 1e9, 2e-3
    error = Tolerance(distance_m=distance_m).knobs(bandwidth_hz).radar_tolerance
    offsets_hz = np.linspace(-0.5, 0.5, 4001) * bandwidth_hz
    slope = error / np.sqrt(np.mean(offsets_hz**2))
    phase = np.angle(1 + 1j * slope * offsets_hz)
    delay_s = np.polyfit(offsets_hz, phase, 1)[0] / (2 * np.pi)
    assert 299_792_458 * delay_s / 2 == pytest.approx(distance_m, rel=0.02)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("0.2, 0.3", "a share of the noise twice"),
        ("", "tolerance"),
        ("3 V", "2 mm"),
        ("0,2", "a share of the noise twice"),
        ("1 mm, 2 m", "a distance twice"),
        ("1000 dB", "1000 dB of an echo: expected 0.0087 to 20"),
        ("10.000001", "10.000001 of the noise: expected 0.0001 to 10"),
        ("200 %", "200 % of a cell's light: expected 0.001 to 100"),
        ("-1 dB", "-1 dB of an echo"),
        (",", "expected a share"),
        (0.2, "is no text"),
        ("0 mm", "0 m of a distance: expected above 0"),
        ("1e-9", "1e-09 of the noise: expected 0.0001 to 10"),
    ],
)
def test_a_wrong_tolerance_is_named(text: str, said: str) -> None:
    with pytest.raises(InputError, match="tolerance") as told:
        Tolerance.of(text)
    assert said in str(told.value)
    assert not any(
        field.name in str(told.value) for field in fields(Tolerance) if "_" in field.name
    )


def test_a_tolerance_is_told_as_it_is_read() -> None:
    """To the last bit, also of NumPy's numbers and of whole ones."""
    rng = np.random.default_rng(1)
    ranges = {"noise_share": (1e-4, 10), "cell_share": (1e-5, 1), "echo_db": (0.0087, 20)}
    for _ in range(1000):
        given = {name: np.exp(rng.uniform(*np.log(ends))) for name, ends in ranges.items()}
        of_scores = {"psnr_db": np.float64(rng.uniform(1e-3, 20)), "distance_m": 10 ** rng.normal()}
        for some in (given, of_scores):
            asked = Tolerance(**some)
            assert Tolerance.of(str(asked)) == asked
    for name, unit in (("cell_share", " %"), ("echo_db", " dB"), ("distance_m", " m")):
        for one in (np.float64(1), 1, 1.0):
            share = "100.0" if name == "cell_share" else "1.0"
            assert str(Tolerance(**{name: one})) == f"0.2, {share}{unit}"


@pytest.mark.parametrize("name", [field.name for field in fields(Tolerance)])
def test_what_is_told_as_a_limit_is_taken(name: str) -> None:
    """And nothing beyond it, to whole numbers that no double holds."""
    told = []
    for wrong in (0, -1.0, float("nan"), float("inf"), 10**400, -(10**400)):
        with pytest.raises(InputError, match="expected") as error:
            Tolerance(**{name: wrong})
        told.append(str(error.value).partition("expected ")[2])
    (expected,) = set(told)
    if name == "distance_m":
        assert expected == "above 0, finite"
        ends = [5e-324, np.finfo(float).max]
    else:
        scale = 0.01 if name == "cell_share" else 1
        ends = [scale * float(end) for end in expected.split(" to ")]
        for beyond in (0.999 * ends[0], 1.001 * ends[1]):
            with pytest.raises(InputError, match="expected"):
                Tolerance(**{name: beyond})
    for end in ends:
        assert getattr(Tolerance(**{name: end}), name) == end


def test_what_no_knob_promises_of_a_radar_is_refused() -> None:
    """With the least that can be."""
    with pytest.raises(InputError, match=r"0\.001 of the noise asks for .* cannot be promised"):
        Tolerance(0.001).knobs(bandwidth_hz=1e9)
    assert Tolerance(0.001).knobs().light_tolerance == 0.001  # of light it can
    assert Tolerance(1e-4).knobs().motion_tolerance == 1e-4  # the least that one takes
    # Beside an error of echoes a share is that of light alone.
    assert Tolerance(1e-4, echo_db=0.0087).knobs(1e9).radar_tolerance == pytest.approx(
        1e-3, rel=2e-3
    )
    for bandwidth_hz in (1.0, 20e6, 1e9, 3.97e9, 4e9, 1e300):
        for given in ({"noise_share": 0.0019999}, {"distance_m": 1e-320}):
            with pytest.raises(InputError, match="cannot be promised") as told:
                Tolerance(**given).knobs(bandwidth_hz)
            least = float(re.search(r"expected (\S+) (m|of the noise)", str(told.value))[1])
            (name,) = given
            assert 1e-3 <= Tolerance(**{name: least}).knobs(bandwidth_hz).radar_tolerance < 1.01e-3


@pytest.mark.parametrize(
    "wrong",
    [0, -1.0, "4 GHz", float("nan"), float("inf"), pytest.param(10**400, id="1e400"), True],
)
def test_a_bandwidth_is_a_number_above_0(wrong: object) -> None:
    for asked in (Tolerance(distance_m=2e-3), Tolerance()):
        with pytest.raises(InputError, match=r"bandwidth_hz: .* number") as told:
            asked.knobs(wrong)  # type: ignore[arg-type]
        assert len(str(told.value)) < 120

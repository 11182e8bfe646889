"""Path lengths: phase, time and gates against geometry, and through the camera."""

import math
from pathlib import Path

import numpy as np
import pytest
from scipy import constants, stats

from hardware.reconstruction import range_image
from twin.camera import capture
from twin.camera.acquisition import measure
from twin.camera.light import render
from twin.camera.shutters import shutters
from twin.fidelity import Fidelity
from twin.geometry import Geometry
from twin.optics.devices import Device
from twin.optics.paths import TracingQuality
from twin.optics.problem import LightProblem
from twin.optics.time_of_flight import Paths, gate, phase_shutter, trace_paths
from twin.optics.transport import transport
from twin.optics.weather import Air
from twin.scene import Pose, Rig, Scene, SceneObject, Sun, load_scene
from twin.scene.mitsuba import mitsuba_scene
from twin.system import System, load_system

TAN = math.tan(math.radians(10))
BASELINE = 0.05


def wall(distance_m: float) -> Scene:
    corners = np.array([[0, -50, -50], [0, 50, -50], [0, 50, 50], [0, -50, 50.0]])
    faces = np.array([[0, 2, 1], [0, 3, 2]], dtype=np.int32)
    item = SceneObject("wall", Geometry(corners + [distance_m, 0, 0], faces), "white", 0.5)
    rig = Rig(Pose((0.0, 0.0, 0.0)), detector=Pose((0.0, -BASELINE, 0.0)))
    return Scene("wall", Path(), "", (item,), rig, Sun(180.0, 0.0, 1e5))


def paths_to_wall(distance_m: float, samples: int = 16) -> Paths:
    emitter = Device(np.zeros(3), np.eye(3), TAN)
    # A wider field than what is lit: no cell is cut by its edge.
    detector = Device(np.array([0, -BASELINE, 0]), np.eye(3), 2 * TAN)
    problem = LightProblem(mitsuba_scene(wall(distance_m)), emitter, detector)
    return trace_paths(problem, (16, 16), quality=TracingQuality(samples, 1), seed=1)


def middle_lengths(distance_m: float, n: int = 16) -> np.ndarray:
    """Emitter to wall to detector through the middle of each cell, float64."""
    u = distance_m * TAN * (1 - (2 * np.arange(n) + 1) / n)
    left, up = u[None, :], u[:, None]
    out = np.sqrt(distance_m**2 + left**2 + up**2)
    return out + np.sqrt(distance_m**2 + (left + BASELINE) ** 2 + up**2)


@pytest.mark.parametrize("distance_m", [0.5, 1.0, 2.0, 5.0, 10.0])
@pytest.mark.parametrize("modulation_hz", [1e6, 10e6])
def test_phase_tells_the_distance_within_a_millimetre(
    distance_m: float, modulation_hz: float
) -> None:
    phasor = paths_to_wall(distance_m, samples=256).phasor(modulation_hz)
    phase = -np.angle(phasor) % (2 * np.pi)
    length = phase * constants.c / (2 * np.pi * modulation_hz)
    error = (length - middle_lengths(distance_m)) / 2
    assert np.abs(error).max() < 1e-3


def test_two_surfaces_in_one_cell_add_as_phasors() -> None:
    """a1 e^(-j k L1) + a2 e^(-j k L2), by hand: why a mixed cell reads a distance in between."""
    paths = Paths(np.array([[1.0, 3.0]], np.float32), np.array([[4.0, 10.0]], np.float32), (1, 1))
    k = 2 * np.pi * 20e6 / constants.c
    expected = np.exp(-1j * k * 4) + 3 * np.exp(-1j * k * 10)
    assert paths.phasor(20e6)[0, 0] == pytest.approx(expected, rel=1e-12)


def test_all_the_light_comes_at_the_right_time() -> None:
    """Each cell's light by its time of flight, in bins of 0.25 ns."""
    paths = paths_to_wall(3.0, samples=64)
    edges = np.arange(0, 257) * 0.25e-9
    times = paths.length_m.astype(np.float64) / constants.c
    cells = [
        np.histogram(t, edges, weights=v.astype(np.float64))[0]
        for t, v in zip(times, paths.value, strict=True)
    ]
    histogram = np.reshape(cells, (*paths.shape, -1))
    np.testing.assert_allclose(histogram.sum(axis=-1), paths.light(), rtol=1e-12)
    peak = np.argmax(histogram, axis=-1)
    time = middle_lengths(3.0) / constants.c
    seen = paths.light() > 0
    assert (np.abs((peak + 0.5) * 0.25e-9 - time)[seen] < 0.5e-9).all()


def test_lengths_cost_no_light_on_the_yard() -> None:
    """Recorded paths and the fused tracer agree: Student t over 12 seeds each, 1e-4 over all."""
    scene = load_scene("yard")
    emitter = Device(*scene.rig.device("emitter"), tan_half_field=TAN)
    detector = Device(*scene.rig.device("detector"), tan_half_field=TAN)
    problem = LightProblem(mitsuba_scene(scene), emitter, detector)
    shape, quality = (8, 8), TracingQuality(256, 4)
    both = [
        [
            trace_paths(problem, shape, quality=quality, seed=s).light(),
            transport(problem, shape, quality=quality, seed=100 + s).total,
        ]
        for s in range(12)
    ]
    recorded, fused = np.moveaxis(np.array(both), 1, 0)
    lit = fused.mean(axis=0) > 0
    _, p = stats.ttest_ind(recorded[:, lit], fused[:, lit], equal_var=False)
    assert p.min() > 1e-4 / lit.sum()


def test_lengths_grow_with_every_bounce() -> None:
    """From the middle of a sphere of radius 3 m: 6 m with one bounce, a chord of up to 6 m more
    with each further one.
    """
    import trimesh

    ball = trimesh.creation.icosphere(5, radius=3.0)
    item = SceneObject("ball", Geometry(ball.vertices, ball.faces), "white", 0.5)
    scene = Scene("ball", Path(), "", (item,), Rig(Pose((0.0, 0.0, 0.0))), Sun(180.0, 0.0, 1e5))
    here = Device(np.zeros(3), np.eye(3), 3.0)
    problem = LightProblem(mitsuba_scene(scene), here, here)
    paths = trace_paths(problem, (2, 2), quality=TracingQuality(1024, 3), seed=1)
    value, length = (x.reshape(4, 3, -1) for x in (paths.value, paths.length_m))
    for bounces in range(3):
        seen = length[:, bounces][value[:, bounces] > 0]
        assert seen.size > 1000
        assert seen.min() > 6 - 0.02 if bounces == 0 else seen.min() > 6
        assert seen.max() < 6 * (bounces + 1) + 0.02
        assert np.mean(seen) == pytest.approx(6 + 4 * bounces, rel=0.15)


def test_shutters_in_four_phases_give_the_phasor_back() -> None:
    paths = paths_to_wall(4.0)
    f, contrast = 15e6, 0.7
    phases = np.pi / 2 * np.arange(4)
    taken = [paths.light(phase_shutter(f, p, contrast)) for p in phases]
    phasor = sum(t * np.exp(-1j * p) for t, p in zip(taken, phases, strict=True)) / contrast
    np.testing.assert_allclose(phasor, paths.phasor(f), rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(sum(taken), 2 * paths.light(), rtol=1e-12)


def test_a_gate_takes_the_part_of_the_pulse_that_arrives_in_it() -> None:
    response = gate(pulse_width_s=10e-9, delay_s=20e-9, width_s=10e-9, pulse_rate_hz=1e6)
    arrives = np.array([5e-9, 10e-9, 15e-9, 20e-9, 25e-9, 30e-9, 40e-9])
    np.testing.assert_allclose(
        response(arrives * constants.c), [0, 0, 0.5, 1, 0.5, 0, 0], atol=1e-12
    )
    gates = [gate(10e-9, d, 10e-9, 1e6) for d in np.arange(10) * 10e-9]
    whole = sum(one(np.array([4.0, 7.3, 11.0])) for one in gates)
    np.testing.assert_allclose(whole, 1.0, rtol=1e-12)


def test_a_gate_sees_the_echoes_of_all_pulses_before() -> None:
    """A train of pulses of 5 ns every 40 ns, sampled in time: of echoes up to 4 pulses late, and of
    ones that the next pulse cuts in two. Those beyond the next pulse had been left out.
    """
    width, period, step = 5e-9, 40e-9, 1e-11
    time = np.arange(10 * period, 11 * period, step) + step / 2
    lengths = np.random.default_rng(0).uniform(0, 4 * period, 300) * constants.c
    lengths[0] = 38e-9 * constants.c
    for delay in (0.0, 3e-9, 35e-9):
        is_open = (time % period >= delay) & (time % period < delay + width)
        arrives = [((time - x / constants.c) % period < width)[is_open] for x in lengths]
        expected = np.array([np.mean(x) for x in arrives])  # the gate is as long as the pulse
        found = gate(width, delay, width, 1 / period)(lengths)
        np.testing.assert_allclose(found, expected, atol=2.1 * step / width)
        assert found.max() > 0.8


@pytest.mark.parametrize(
    "section",
    [
        (
            "pulse_width_s = 5e-9\npulse_rate_hz = 25e6\ngate_width_s = 5e-9\n"
            "gate_delays_s = [0.0, 5e-9, 10e-9, 15e-9]\n"
        ),
        "modulation_hz = [25e6]\ncontrast = 1.0\n",
    ],
)
def test_distances_that_repeat_are_warned_of(tmp_path: Path, section: str) -> None:
    """A wall at 7 m is seen at 1 m, by pulses of 25 MHz as by phases; one at 4 m where it is."""
    system = with_time_of_flight(tmp_path, section)
    quick = Fidelity(16, 1)
    far = capture(wall(7.0), system, fidelity=quick)
    assert any("distances are ambiguous" in str(warning) for warning in far.warnings)
    assert not far.void
    found = range_image(far.record, "zero-fill").distance_m[0][8, 8]
    assert found == pytest.approx(7.0 - constants.c / 2 / 25e6, abs=0.02)
    near = capture(wall(1.0), system, fidelity=quick)
    assert not any("ambiguous" in str(warning) for warning in near.warnings)


def with_time_of_flight(tmp_path: Path, section: str) -> System:
    """16 x 16 cells, all light, hardly any noise: a bright emitter, no sun, a fine converter."""
    (tmp_path / "tof.toml").write_text(
        'base = "workable"\n[emitter]\nrows = 16\ncolumns = 16\nradiant_intensity_w_per_sr = 1e3\n'
        "[acquisition]\nn_patterns = 256\n[sky]\nilluminance_lx = 0.0\n"
        "[readout]\ntransimpedance_ohm = 5e4\nread_noise_e = 0.0\nadc_bits = 31\n"
        f"[time_of_flight]\n{section}"
    )
    return load_system(tmp_path / "tof.toml")


@pytest.mark.parametrize(("frequencies", "distance_m"), [([10e6], 4.0), ([10e6, 13e6], 19.0)])
def test_the_camera_measures_distance_by_phase(
    tmp_path: Path, frequencies: list[float], distance_m: float
) -> None:
    """Record to distance by the vehicle's own software: 4 taken a frequency, each shown with every
    pattern; the wall at 19 m lies beyond the first wrap of both, 15 and 11.5 m. Within 3 sigma of
    shot noise, and the median within 1 mm (4 m) or 5 mm (19 m, 20 times less light).
    """
    system = with_time_of_flight(tmp_path, f"modulation_hz = {frequencies}\ncontrast = 0.8\n")
    scene = wall(distance_m)
    rendered = render(scene, system, fidelity=Fidelity(16, 1), seed=np.random.SeedSequence(1))
    record = measure(scene, system, rendered, rng=np.random.default_rng(2)).record
    assert record.counts.shape == (2 * 256 * 4 * len(frequencies), 1)
    found = range_image(record, "zero-fill")
    seen = found.amplitude[0] > 0.5 * found.amplitude.max()
    error = (found.distance_m[0] - middle_lengths(distance_m) / 2)[seen]
    assert (found.confidence[0][seen] > 0.99).all()
    assert np.abs(error).max() < (3e-3 if distance_m < 5 else 5e-2)
    assert abs(np.median(error)) < (1e-3 if distance_m < 5 else 5e-3)


def test_gates_see_only_what_stands_in_their_range(tmp_path: Path) -> None:
    """A wall at 4 m: light comes back at 26.7 ns; the gate after 60 ns has none of it."""
    section = (
        "pulse_width_s = 10e-9\npulse_rate_hz = 1e6\ngate_width_s = 12e-9\n"
        "gate_delays_s = [26e-9, 60e-9]\n"
    )
    system = with_time_of_flight(tmp_path, section)
    taken = shutters(system)
    assert taken[0].light_share == pytest.approx(0.01)
    assert taken[0].open_share == pytest.approx(0.012)
    scene = wall(4.0)
    rendered = render(scene, system, fidelity=Fidelity(16, 1), seed=np.random.SeedSequence(1))
    taken = measure(scene, system, rendered, rng=np.random.default_rng(2))
    # All cells lit less none: without the dark current.
    near, far = np.subtract(*taken.record.electrons_by_shutter[:2, :, 0])
    assert near > 1e7
    assert abs(far) < 1e-3 * near
    assert taken.record.shutters[1].gate_delay_s == pytest.approx(60e-9)
    # Of one gate alone the echo may have begun from 16 to 38 ns.
    found = range_image(taken.record, "zero-fill")
    seen = found.amplitude[0] > 0.5 * found.amplitude.max()
    np.testing.assert_allclose(found.distance_m[0][seen], constants.c / 2 * 27e-9, rtol=1e-3)
    expected = constants.c / 2 * 22e-9 / math.sqrt(12)
    np.testing.assert_allclose(found.standard_error_m[0][seen], expected, rtol=0.01)


@pytest.mark.parametrize("pulse_ns", [10, 20])
def test_the_camera_measures_distance_by_gates(tmp_path: Path, pulse_ns: int) -> None:
    """Walls through the whole chain: gates of 20 ns (3 m) every 10 ns, pulses of 10 and 20 ns.

    Within four of the claimed standard errors in 99 % of the cells, and within 2 cm in the median.
    Taken for the middle of the brightest gate, a wall stands up to c x 20 ns / 4 = 1.5 m too far.
    """
    delays = ", ".join(f"{10 * i}e-9" for i in range(8))
    section = (
        f"pulse_width_s = {pulse_ns}e-9\npulse_rate_hz = 1e6\ngate_width_s = 20e-9\n"
        f"gate_delays_s = [{delays}]\n"
    )
    system = with_time_of_flight(tmp_path, section)
    for distance in (4.0, 5.2):
        scene = wall(distance)
        rendered = render(scene, system, fidelity=Fidelity(16, 1), seed=np.random.SeedSequence(1))
        record = measure(scene, system, rendered, rng=np.random.default_rng(2)).record
        assert record.pulse_width_s == pytest.approx(pulse_ns * 1e-9)
        found = range_image(record, "zero-fill")
        seen = found.amplitude[0] > 0.5 * found.amplitude.max()
        error = (found.distance_m[0] - middle_lengths(distance) / 2)[seen]
        assert (found.confidence[0][seen] > 0.99).all()
        assert np.mean(np.abs(error) < 4 * found.standard_error_m[0][seen]) > 0.99
        assert abs(np.median(error)) < 0.02


@pytest.mark.parametrize(
    ("section", "complaint"),
    [
        ("modulation_hz = [1e6]\n", "needs either modulation_hz and contrast"),
        ("modulation_hz = []\ncontrast = 1.0\n", "modulation_hz"),
        ("modulation_hz = [-1e6]\ncontrast = 1.0\n", "modulation_hz"),
        (
            "pulse_width_s = 2e-6\npulse_rate_hz = 1e6\ngate_width_s = 1e-8\n"
            "gate_delays_s = [0.0]\n",
            "pulse_width_s = 2e-06: expected at most the time between pulses",
        ),
    ],
)
def test_bad_sections_are_named(tmp_path: Path, section: str, complaint: str) -> None:
    from twin.files import InputError

    with pytest.raises(InputError, match=r"tof\.toml.*") as caught:
        with_time_of_flight(tmp_path, section)
    assert complaint in str(caught.value)


def test_air_takes_its_share_of_every_path() -> None:
    """exp(-extinction x length) with the length through the middle of each cell: 1e-3."""
    emitter = Device(np.zeros(3), np.eye(3), TAN)
    world = mitsuba_scene(wall(20.0))
    clear, hazy = (
        transport(
            LightProblem(world, emitter, emitter, air=air),
            (16, 16),
            quality=TracingQuality(16, 1),
            seed=1,
        ).total
        for air in (None, Air(extinction_per_m=0.02, scattering_per_m=0.0, asymmetry=0.0))
    )
    u = 20.0 * TAN * (1 - (2 * np.arange(16) + 1) / 16)
    length = 2 * np.sqrt(400 + u[None, :] ** 2 + u[:, None] ** 2)
    np.testing.assert_allclose(hazy / clear, np.exp(-0.02 * length), rtol=1e-3)

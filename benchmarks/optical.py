"""Figures of the optical chain: accuracy against closed forms, then time for each level."""

import importlib.util
import resource
from collections.abc import Iterator
from dataclasses import replace
from itertools import count, islice
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.linalg import hadamard

from benchmarks.timing import Figure, timed
from hardware import PatternSet, reconstruct
from hardware.patterns import fwht
from hardware.reconstruction import METHODS
from twin.budget import OpticalLink, audit, link_of
from twin.budget.link import maximum_distance_m, minimum_time_s
from twin.camera.acquisition import capture
from twin.camera.evaluation import evaluate
from twin.camera.mounting import light_problem
from twin.camera.stream import frames
from twin.fidelity import Fidelity
from twin.geometry import Geometry
from twin.optics.matrix import Start, transport_matrix
from twin.optics.paths import TracingQuality
from twin.optics.radiometry import collection, wall_power_w
from twin.optics.reference import PatternRenderer
from twin.optics.solar_irradiance import sun_band_irradiance
from twin.optics.transport import transport
from twin.scene import Pose, Rig, Scene, SceneObject, Sun, load_scene
from twin.system import load_part, load_system
from twin.toml import Sourced


def figures() -> Iterator[Figure]:
    """Name, value and unit of everything that is measured."""
    yield from _accuracy()
    yield from _findings()
    yield from _transport()
    yield from _speed_up()
    yield from _moving()
    yield from _line_sensor()
    yield from _vehicle()
    yield from _budget()


def _accuracy() -> Iterator[Figure]:
    yield "sun, 1544-1556 nm at 100 klx", sun_band_irradiance(1e5, 1550e-9, 12e-9), "W/m^2"
    system = load_system("paper")
    lens = collection(system)
    watt = system.emitter.radiant_intensity_w_per_sr.value * lens.transmission * lens.pupil_area_m2
    for distance in (2.0, 5.0, 10.0):
        scene = wall_at(distance)
        problem = light_problem(scene, system)
        problem = replace(problem, detector=problem.emitter)
        cells = transport(problem, (64, 64), quality=TracingQuality(16, 1), seed=1)
        ratio = watt * cells.total.sum() / wall_power_w(system, 0.5, distance)
        yield f"wall at {distance:g} m: watts over closed form, less 1", 100 * (ratio - 1), "%"


def _findings() -> Iterator[Figure]:
    scene = load_scene("yard")
    for name in ("workable", "paper"):
        system = load_system(name)
        evaluation = evaluate(system, capture(scene, system, seed=0))
        verdict = evaluation.verdict
        yield f"{name}: signal over noise per lit pixel, median", verdict.snr_median, ""
        yield f"{name}: lit pixels above their noise", 100 * verdict.above_noise_share, "%"
        for image, score in zip(evaluation.reconstructions, evaluation.scores, strict=True):
            yield f"{name}: {image.method}, PSNR", score.psnr_db, "dB"
            yield f"{name}: {image.method}, SSIM", score.ssim, ""


def _transport() -> Iterator[Figure]:
    scene, system = load_scene("yard"), load_system("workable")
    problem, shape = light_problem(scene, system), (64, 64)
    noise = capture(scene, system).noise.pixel_noise_e(system.patterns)
    best = capture(scene, system, fidelity=Fidelity(4096, 6), seed=99).cells_e
    for samples, depth in ((1, 1), (4, 2), (16, 2), (64, 4), (256, 6)):
        quality = TracingQuality(samples, depth)
        name = f"transport, {samples} samples, depth {depth}"
        yield (
            name,
            timed(lambda q=quality: transport(problem, shape, quality=q, seed=1)),
            "",
        )
        error = capture(scene, system, fidelity=Fidelity(samples, depth), seed=5).cells_e - best
        relative = np.sqrt(np.mean(error**2)) / np.sqrt(np.mean(best**2))
        yield f"{name}: rms error over rms signal", 100 * float(relative), "%"
        yield f"{name}: median error over sensor noise", float(np.median(abs(error)) / noise), ""


def _speed_up() -> Iterator[Figure]:
    """One transport render against Mitsuba's projector for every exposure, at equal error.

    Brute force with n rays a pattern leaves 2 var / cells of variance in each cell; the transport
    compared is the cheapest that leaves no more.
    """
    scene, system = load_scene("yard"), load_system("workable")
    problem, depth, samples = light_problem(scene, system), 4, 4
    renderer = PatternRenderer(problem, max_depth=depth)
    for side in (64, 8):
        shape = (side, side)
        patterns = PatternSet(side, side, side**2)
        masks = patterns.masks(slice(side, side + 4))
        seeds = range(16)
        signals = [[renderer.render(m, samples=samples, seed=s) for s in seeds] for m in masks]
        brute_error = np.sqrt(2 * np.var(signals, axis=1, ddof=1).mean() / side**2)
        one = timed(lambda m=masks: [renderer.render(x, samples=samples, seed=1) for x in m])
        renders = patterns.n_exposures
        brute = one.scaled(renders / len(masks), f"{len(masks)} renders timed, scaled")
        name = f"{side} x {side} cells, depth {depth}"
        yield f"{name}: brute force, {renders} renders of {samples * 64**2} rays", brute, ""
        best = transport(problem, shape, quality=TracingQuality(4096, depth), seed=9)
        for rays in (1, 4, 16, 64, 256):
            quality = TracingQuality(rays, depth)

            def once(
                seed: int = 1, quality: TracingQuality = quality, shape: tuple[int, int] = shape
            ) -> NDArray[np.float64]:
                return transport(problem, shape, quality=quality, seed=seed).total

            error = np.sqrt(np.mean([(once(s) - best.total) ** 2 for s in range(4)]))
            if error <= brute_error:
                break
        scale = np.sqrt(np.mean(best.total**2))
        yield f"{name}: brute force, rms error over rms", 100 * float(brute_error / scale), "%"
        took = timed(once)
        yield f"{name}: one transport render, {rays} paths a cell", took, ""
        yield f"{name}: transport, rms error over rms", 100 * float(error / scale), "%"
        yield f"{name}: times faster at no more error", brute.median_s / took.median_s, ""


def _moving() -> Iterator[Figure]:
    """A moving rig before 82k triangles: rendering, and whole frames to the image."""
    scene, system = _ball(), load_system("workable")
    system = system.model_copy(
        update={
            "acquisition": system.acquisition.model_copy(
                update={"n_patterns": Sourced(value=2048, assumed="half of a set")}
            )
        }
    )
    problem, steps = light_problem(scene, system), count()

    def render() -> None:
        shift = np.array([0, 1e-3 * next(steps), 0])
        moved = problem.moved(np.eye(3), shift)
        transport(moved, (64, 64), quality=TracingQuality(16, 1), seed=next(steps))

    name = f"moving rig, {scene.triangles} triangles, 64 x 64"
    yield f"{name}: render, 16 paths a cell, direct", timed(render, runs=25), ""
    poses = (Pose((0.0, 1e-3 * i, 0.0)) for i in count())
    stream = frames(scene, system, poses)
    whole = timed(lambda: reconstruct(next(stream), "lmmse"), runs=50)
    yield f"{name}: pose to image, 2048 differential measurements, lmmse", whole, ""
    yield f"{name}: frames per second", 1 / whole.median_s, "1/s"
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for _ in islice(stream, 2000):
        pass
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    yield f"{name}: memory over 2000 frames, growth of the peak", grown / 1024, "MiB"


def _line_sensor() -> Iterator[Figure]:
    """T between 16 LED rows and 256 columns: time, and error against 50 times the paths."""
    scene, system = load_scene("yard"), load_system("line-256x16")
    problem, rows, columns = light_problem(scene, system), (16, 1), (1, 256)
    best = transport_matrix(
        problem, rows, columns, quality=TracingQuality(400**2, 1), seed=9, start="scatter"
    )[0]
    for start, side in (("scatter", 20), ("scatter", 56), ("dual", 320)):

        def work(start: Start = start, side: int = side) -> NDArray[np.float64]:
            quality = TracingQuality(side**2, 1)
            return transport_matrix(problem, rows, columns, quality=quality, seed=1, start=start)[0]

        name = f"T, 16 rows x 256 columns, direct, {start}, {side}^2 paths"
        yield name, timed(work), ""
        error = np.sqrt(np.mean((work() - best) ** 2)) / np.sqrt(np.mean(best**2))
        yield f"{name}: rms error over rms", 100 * float(error), "%"


def _vehicle() -> Iterator[Figure]:
    rng = np.random.default_rng(0)
    for n in (4096, 2**20):
        x = rng.normal(size=n)
        yield f"fast Walsh-Hadamard transform, {n}", timed(lambda x=x: fwht(x), runs=25), ""
    yield from _peers(rng.integers(0, 1000, size=4096))
    image = rng.normal(size=4096)
    for shown in (1024, 4096):
        patterns = PatternSet(64, 64, shown)
        y = fwht(image)[patterns.indices]
        for name in ("zero-fill", "lmmse"):
            work = timed(lambda m=METHODS[name], y=y, p=patterns: m(y, 1.0, p))
            yield f"{name}, {shown} of 64 x 64", work, ""
    record = capture(load_scene("table1"), load_system("workable")).record
    yield "record to image, lmmse, 4096 pairs", timed(lambda: reconstruct(record)), ""


def _budget() -> Iterator[Figure]:
    """A million designs at once; Table 1's residuals with one read noise per row."""
    fields = np.random.default_rng(0).lognormal(0, 0.3, (8, 1_000_000))

    def designs() -> None:
        link = OpticalLink(*fields)
        signal, background = link.signal_e_per_s(0.5, 5.0), link.background_e_per_s(0.5)
        minimum_time_s(signal, background, 1e3)
        maximum_distance_m(link.signal_e_per_s(0.5, 1.0), background, 1e-3, 1e3)

    yield "budget of 1e6 designs: shortest time, farthest distance", timed(designs, runs=5), ""
    for name in ("fga015", "g10768-1024d", "g9201-256"):
        part = load_part(name)
        row = audit(link_of(load_system("paper"), part, whole_line=True), part)
        ratio = row.printed_time_s / row.photon_limited_s
        yield f"Table 1, {name}: printed over photon-limited time, most", float(ratio.max()), ""
        worst = 100 * float(np.abs(row.residual).max())
        yield f"Table 1, {name}: worst residual with one read noise", worst, "%"


def _peers(x: NDArray[np.integer]) -> Iterator[Figure]:
    """Other people's transforms, checked for equality and timed; `pip install .[peers]`."""
    dense = hadamard(len(x)).astype(np.float64)
    np.testing.assert_array_equal(dense @ x, fwht(x))
    yield "peer: dense product with scipy.linalg.hadamard, 4096", timed(lambda: dense @ x), ""
    if importlib.util.find_spec("sympy"):
        from sympy import fwht as sympy_fwht

        values = [int(v) for v in x]
        np.testing.assert_array_equal([int(v) for v in sympy_fwht(values)], fwht(x))
        yield "peer: sympy.fwht, 4096", timed(lambda: sympy_fwht(values), runs=3), ""


def _ball() -> Scene:
    """A sphere of 81 920 triangles before a wall."""
    ball = trimesh.creation.icosphere(6, 1.0)
    vertices = np.asarray(ball.vertices, dtype=np.float64) + [5, 0, 0]
    item = SceneObject("ball", Geometry(vertices, np.asarray(ball.faces)), "white", 0.5)
    behind = wall_at(7.0)
    return replace(behind, objects=(item, *behind.objects))


def wall_at(distance_m: float) -> Scene:
    """A wall that faces the rig, of reflectance 0.5."""
    h = 50.0
    corners = np.array([[0, -h, -h], [0, h, -h], [0, h, h], [0, -h, h]]) + [distance_m, 0, 0]
    faces = np.array([[0, 2, 1], [0, 3, 2]], dtype=np.int32)
    wall = SceneObject("wall", Geometry(corners, faces), "white", 0.5)
    return Scene("wall", Path(), "", (wall,), Rig(Pose((0.0, 0.0, 0.0))), Sun(180.0, 30.0, 1e5))

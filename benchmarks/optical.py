"""Figures of the optical chain: accuracy against closed forms, then time for each rung."""

import importlib.util
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import hadamard

from benchmarks.timing import Figure, timed
from hardware import PatternSet, reconstruct
from hardware.patterns import fwht
from hardware.reconstruction import METHODS
from twin.budget import Link, audit, link_of
from twin.budget.link import maximum_distance_m, minimum_time_s
from twin.camera.acquisition import capture
from twin.camera.evaluation import evaluate
from twin.camera.light import devices
from twin.optics.matrix import Grid, Role, transport_matrix
from twin.optics.radiometry import collection, wall_power_w
from twin.optics.reference import PatternRenderer
from twin.optics.spectra import sun_band_irradiance
from twin.optics.transport import Quality, transport
from twin.scene import Pose, Rig, Scene, SceneObject, Sun, load_scene
from twin.scene.mitsuba import mitsuba_scene
from twin.system import load_part, load_system


def figures() -> Iterator[Figure]:
    """Name, value and unit of everything that is measured."""
    yield from _accuracy()
    yield from _findings()
    yield from _transport()
    yield from _line_sensor()
    yield from _vehicle()
    yield from _budget()


def _accuracy() -> Iterator[Figure]:
    yield "sun, 1544-1556 nm at 100 klx", sun_band_irradiance(1e5, 1550e-9, 12e-9), "W/m^2"
    system = load_system("paper")
    lens = collection(system)
    watt = system.emitter.radiant_intensity_w_per_sr.value * lens.transmission * lens.pupil_area_m2
    for distance in (2.0, 5.0, 10.0):
        scene = _wall(distance)
        emitter, _, _ = devices(scene, system)
        world = mitsuba_scene(scene)
        cells = transport(world, emitter, emitter, (64, 64), quality=Quality(16, 1), seed=1)
        ratio = watt * cells.total.sum() / wall_power_w(system, 0.5, distance)
        yield f"wall at {distance:g} m: watts over closed form, less 1", 100 * (ratio - 1), "%"


def _findings() -> Iterator[Figure]:
    scene = load_scene("yard")
    for name in ("workable", "paper"):
        system = load_system(name)
        evaluation = evaluate(system, capture(scene, system, seed=0))
        snr = evaluation.capture.snr
        yield f"{name}: signal over noise per pixel, median", float(np.median(snr)), ""
        yield f"{name}: pixels above their noise", 100 * float(np.mean(snr >= 1)), "%"
        for image, score in zip(evaluation.reconstructions, evaluation.scores, strict=True):
            yield f"{name}: {image.method}, PSNR", score.psnr_db, "dB"
            yield f"{name}: {image.method}, SSIM", score.ssim, ""


def _transport() -> Iterator[Figure]:
    scene, system = load_scene("yard"), load_system("workable")
    emitter, detector, _ = devices(scene, system)
    world, shape = mitsuba_scene(scene), (64, 64)
    noise = capture(scene, system).noise.pixel_noise_e(system.patterns)
    best = capture(scene, system, quality=Quality(4096, 6), seed=99).cells_e
    for samples, depth in ((1, 1), (4, 2), (16, 2), (64, 4), (256, 6)):
        quality = Quality(samples, depth)
        name = f"transport, {samples} samples, depth {depth}"
        yield (
            name,
            timed(lambda q=quality: transport(world, emitter, detector, shape, quality=q, seed=1)),
            "",
        )
        error = capture(scene, system, quality=quality, seed=5).cells_e - best
        relative = np.sqrt(np.mean(error**2)) / np.sqrt(np.mean(best**2))
        yield f"{name}: rms error over rms signal", 100 * float(relative), "%"
        yield f"{name}: median error over sensor noise", float(np.median(abs(error)) / noise), ""
    reference = PatternRenderer(scene, emitter, detector, max_depth=4)
    masks = system.patterns.masks(slice(100, 104))
    one = timed(lambda: [reference.render(m, samples=4, seed=1) for m in masks], runs=3)
    note = "4 renders timed, scaled to 8192"
    yield "brute force, 8192 patterns, depth 4", one.scaled(8192 / 4, note), ""


def _line_sensor() -> Iterator[Figure]:
    """T between 16 LED rows and 256 columns: time, and error against 20 times the paths."""
    scene, system = load_scene("yard"), load_system("line-256x16")
    emitter, detector, _ = devices(scene, system)
    world, rows, columns = mitsuba_scene(scene), Grid(emitter, 16, 1), Grid(detector, 1, 256)
    best = transport_matrix(world, rows, columns, quality=Quality(96**2, 1), seed=9, role="scatter")
    for role, side in (("scatter", 20), ("dual", 80)):

        def work(role: Role = role, side: int = side) -> NDArray[np.float64]:
            quality = Quality(side**2, 1)
            return transport_matrix(world, rows, columns, quality=quality, seed=1, role=role)

        name = f"T, 16 rows x 256 columns, direct, {role}"
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
    for count in (1024, 4096):
        patterns = PatternSet(64, 64, count)
        y = fwht(image)[patterns.indices]
        for name, method in METHODS.items():
            work = timed(lambda m=method, y=y, p=patterns: m(y, 1.0, p))
            yield f"{name}, {count} of 64 x 64", work, ""
    record = capture(load_scene("table1"), load_system("workable")).record
    yield "record to image, lmmse, 4096 pairs", timed(lambda: reconstruct(record)), ""


def _budget() -> Iterator[Figure]:
    """A million designs at once; Table 1's residuals with one read noise per row."""
    fields = np.random.default_rng(0).lognormal(0, 0.3, (8, 1_000_000))

    def designs() -> None:
        link = Link(*fields)
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


def _wall(distance_m: float) -> Scene:
    h = 50.0
    corners = np.array([[0, -h, -h], [0, h, -h], [0, h, h], [0, -h, h]]) + [distance_m, 0, 0]
    faces = np.array([[0, 2, 1], [0, 3, 2]], dtype=np.int32)
    wall = SceneObject("wall", corners, faces, None, "white", 0.5)
    return Scene("wall", Path(), "", (wall,), Rig(Pose((0.0, 0.0, 0.0))), Sun(180.0, 30.0, 1e5))

"""`workable` beside `lidar-scan` at equal mean power and in equal time: frames of patterns that fit
into one scan are averaged, and both images are compared with the scene at the middle of that time.

The yard at rest, and `scenes/crossing`, through which the rig drives at 5 m/s. Images by LMMSE;
PSNR with the scene's brightest cell as peak, in each system's own light. ``lidar.png`` shows them.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.timing import Figure
from hardware import reconstruct
from twin.camera import capture
from twin.camera.score import Score, score
from twin.fidelity import DEFAULT, Fidelity
from twin.scene import Scene, load_scene
from twin.system import System, load_system

Array = NDArray[np.float64]

PICTURE = "lidar.png"
_SCENES = ("yard", "crossing")


@dataclass(frozen=True, eq=False)
class Beside:
    """Images of one system within some time: ``truth`` and the mean ``image`` of ``n_frames``,
    electrons (rows, columns); their score, and that of each frame against its own middle.
    """

    system: System
    n_frames: int
    truth: Array
    image: Array
    score: Score
    of_single: tuple[Score, ...]

    @property
    def median_error(self) -> float:
        """Of a cell, over the brightest one."""
        return float(np.nanmedian(np.abs(self.image - self.truth)) / np.nanmax(self.truth))

    @property
    def in_few_cells(self) -> float:
        """Share of the squared error that the worst 5 % of the cells have."""
        squares = np.sort(((self.image - self.truth) ** 2)[np.isfinite(self.truth)])
        return float(squares[-(len(squares) // 20) :].sum() / squares.sum())


def beside(
    scene: Scene, systems: Sequence[System], *, seed: int, fidelity: Fidelity = DEFAULT
) -> list[Beside]:
    """Each system over the longest of their frame times, from now on; the others take as many whole
    frames one after another, around its middle.
    """
    whole_s = max(system.frame_time_s for system in systems)
    return [_within(whole_s, scene, system, seed, fidelity) for system in systems]


def _within(whole_s: float, scene: Scene, system: System, seed: int, fidelity: Fidelity) -> Beside:
    # A frame time that is a hair longer than its share, by rounding, fits too.
    frame_s, n_frames = system.frame_time_s, int(whole_s / system.frame_time_s + 1e-6)
    begin_s = (whole_s - n_frames * frame_s) / 2
    images, truths, of_single = [], [], []
    for number in range(n_frames):
        at_start = scene.after(max(begin_s + number * frame_s, 0.0))
        taken = capture(at_start, system, seed=seed + number, fidelity=fidelity)
        images.append(reconstruct(taken.record, "lmmse").image[0])
        truths.append(taken.measured_scene_e)
        of_single.append(score(truths[-1], images[-1]))
    truth = np.mean(truths, axis=0)  # the same light, of other paths
    if n_frames > 1 and not (scene.at_rest and not scene.rig.moves):
        still = replace(fidelity, motion_tolerance=None)
        middle = capture(scene.after(whole_s / 2), system, seed=seed, fidelity=still)
        truth = middle.measured_scene_e
    image = np.mean(images, axis=0)
    return Beside(system, n_frames, truth, image, score(truth, image), tuple(of_single))


def figures() -> Iterator[Figure]:
    systems, found = [load_system("workable"), load_system("lidar-scan")], []
    for name in _SCENES:
        both = beside(load_scene(name), systems, seed=1)
        found.append((name, both))
        for one in both:
            label = f"{name}, {one.system.name}"
            yield f"{label}: frame", one.system.frame_time_s, "s"
            yield f"{label}: mean power sent out", one.system.mean_power_w, "W"
            for score_of_one in one.of_single:
                yield f"{label}: PSNR of a frame", score_of_one.psnr_db, "dB"
            yield f"{label}: frames in equal time", float(one.n_frames), ""
            yield f"{label}: PSNR in equal time", one.score.psnr_db, "dB"
            yield f"{label}: SSIM in equal time", one.score.ssim, ""
            yield f"{label}: median error over the brightest cell", 100 * one.median_error, "%"
            yield f"{label}: squared error in 5 % of the cells", 100 * one.in_few_cells, "%"
    _draw(found)


def _draw(found: Sequence[tuple[str, Sequence[Beside]]]) -> None:
    """Of each scene a row: what there is at the middle of the time, and both images."""
    from matplotlib.figure import Figure as Drawing

    drawing = Drawing(figsize=(9, 3.2 * len(found)), layout="constrained")
    axes = drawing.subplots(len(found), 3, squeeze=False)
    for row, (name, both) in zip(axes, found, strict=True):
        peak = np.nanmax(both[0].truth)
        shown = [(f"{name}: light at the middle", both[0].truth / peak)]
        for one in both:
            told = f"{one.system.name}, {one.n_frames} x {one.system.frame_time_s:.2f} s"
            text = f"{told}: PSNR {one.score.psnr_db:.1f} dB"
            shown.append((text, one.image / np.nanmax(one.truth)))
        for axis, (text, image) in zip(row, shown, strict=True):
            axis.imshow(image, vmin=0, vmax=1, cmap="gray")
            axis.set_title(text, fontsize=8)
            axis.set_axis_off()
    drawing.savefig(PICTURE, dpi=120)

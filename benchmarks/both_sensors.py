"""Draw what both sensors make of the yard: the camera's image and the plan view, with the truth.

python -m benchmarks.both_sensors docs/both_sensors.png [FIDELITY]
"""

import sys
import tempfile
from typing import Any

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray

import twin
from twin.accuracy.interval import TWO_SIDED_95
from twin.job import Result
from twin.report.overview import grey
from twin.report.places import Place, half_width_rad, in_image, places_of, radar_frame
from twin.report.style import BLUE, GREY, ORANGE, new_figure

Array = NDArray[np.float64]

_RADAR = "hybrid-79-mimo"  # its array measures bearings
_FAR_M, _SIDE_M = 16.2, 5.2
_RIGHT = 0.6  # of the half field: from here on labels are kept off their neighbours
_GREEN = "#009e73"
_COLOURS, _SPAN_DB = "plasma", (5.0, 55.0)  # SNR of detections


def main() -> None:
    """One run of the yard by the commands' own job, one picture."""
    fidelity = twin.PRESETS[sys.argv[2]] if len(sys.argv) > 2 else None
    with tempfile.TemporaryDirectory() as folder:
        result = twin.run(
            "yard", radar=_RADAR, compare=None, out=f"{folder}/yard", fidelity=fidelity
        )
    picture(result).savefig(sys.argv[1], dpi=130, metadata={"Software": None})


def picture(result: Result) -> Figure:
    """Image on the left, plan view on the right, one key for both."""
    assert result.radar is not None
    places = [p for p in places_of(result.scene, result.radar) if p.position_m is not None]
    figure = new_figure((11.0, 4.9))
    left, right = figure.subplots(1, 2, width_ratios=(1.0, 1.52))
    _image(left, result, places)
    drawn = _plan(right, result, places)
    figure.colorbar(drawn, ax=right, shrink=0.75, pad=0.01, label="SNR of a detection (dB)")
    handles, names = right.get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=5, frameon=False, fontsize=8.5)
    return figure


def _image(axis: Any, result: Result, places: list[Place]) -> None:
    evaluation, radar = result.evaluations[0], result.radar
    assert radar is not None
    seen = evaluation.reconstructions[0]
    axis.imshow(grey(seen.picture), cmap="gray", vmin=0, vmax=1, extent=(-1, 1, -1, 1))
    targets = [p for p in places if p.label]
    true = {t.name: np.array(t.position_m) for t in result.scene.targets}
    # Of a row of antennas the height is not measured: that of the target is shown.
    points = np.array([[*p.position_m[:2], true[p.target][2]] for p in targets])  # type: ignore[index]
    at = in_image(result.scene, evaluation, points)
    levels = [p.detection.snr_db for p in targets]
    axis.scatter(*at.T, s=230, facecolors="none", edgecolors="black", linewidths=4.2)
    scale = ScalarMappable(Normalize(*_SPAN_DB), _COLOURS)
    axis.scatter(*at.T, s=230, facecolors="none", edgecolors=scale.to_rgba(levels), linewidths=2.2)
    for place, (x, y) in zip(targets, at, strict=True):
        found = place.detection
        moving = abs(found.range_rate_m_per_s) > radar.waveform.velocity_cell_m_per_s
        text = f"{place.target.replace('_', ' ')}\n{found.range_m:.2f} m"
        text += f", {found.range_rate_m_per_s:+.2f} m/s" if moving else ""
        axis.annotate(
            text,
            (x, y),
            xytext=(0, 13 if x > _RIGHT else -13),
            textcoords="offset points",
            ha="left" if x < -_RIGHT else "center",
            va="bottom" if x > _RIGHT else "top",
            fontsize=7.6,
            color="white",
            bbox={"facecolor": "black", "alpha": 0.55, "edgecolor": "none", "pad": 1.5},
        )
    rows, columns = seen.picture.shape
    axis.set_title(f"{columns} x {rows} cells from one photodiode, and detections")
    axis.set(xlim=(-1, 1), ylim=(-1, 1), xticks=[], yticks=[])


def _plan(axis: Any, result: Result, places: list[Place]) -> Any:
    scene, radar = result.scene, result.radar
    assert radar is not None
    for item in scene.objects:
        low, high = item.box_m
        if (high - low)[:2].max() < _FAR_M:
            _outline(axis, item.vertices_m[:, :2])
    rig = scene.rig.position_m[:2]
    origin, axes = radar_frame(scene)
    field = np.radians(result.evaluations[0].system.emitter.field_of_view_deg.value / 2)
    beam = half_width_rad(radar.radar)
    _wedge(axis, origin[:2], axes, beam, _GREEN, f"radar's beam, ±{np.degrees(beam):.0f}°")
    _wedge(axis, rig, axes, field, BLUE, f"camera's field, ±{np.degrees(field):.0f}°")
    at = np.array([p.position_m for p in places])
    for place in places:
        _errors(axis, place, origin)
    levels = [p.detection.snr_db for p in places]
    drawn = axis.scatter(
        at[:, 0], at[:, 1], s=34, c=levels, edgecolors="black", linewidths=0.6, zorder=4,
        cmap=_COLOURS, norm=Normalize(*_SPAN_DB), label="detection, ± 95 % of its stated error",
    )  # fmt: skip
    _targets(axis, result)
    axis.plot(*rig, "D", color="black", ms=6, label="rig", zorder=5)
    axis.set_aspect("equal")
    axis.set(xlim=(-0.6, _FAR_M), ylim=(-_SIDE_M, _SIDE_M), xlabel="x (m)", ylabel="y (m)")
    beyond = int((at[:, 0] > _FAR_M).sum())
    axis.set_title(
        "where the radar finds them, and where they are"
        + (f" ({beyond} detection beyond)" if beyond == 1 else "")
        + (f" ({beyond} detections beyond)" if beyond > 1 else "")
    )
    return drawn


def _targets(axis: Any, result: Result) -> None:
    for row, target in enumerate(result.scene.targets):
        x, y, _ = target.position_m
        label = "true target, its way in 1 s" if row == 0 else None
        axis.plot(x, y, "+", color=ORANGE, ms=13, mew=2.2, zorder=5, label=label)
        u, v, _ = target.velocity_m_per_s
        if u or v:
            way = {"arrowstyle": "->", "color": ORANGE, "lw": 1.8}
            axis.annotate("", (x + u, y + v), (x, y), arrowprops=way, zorder=5)
        above, moves = y > 0 or u or v, u or v
        axis.annotate(
            target.name.replace("_", " "),
            (x + u, y + v),
            xytext=(4 if moves else 0, 2 if moves else 11 if above else -11),
            textcoords="offset points",
            ha="left" if moves else "center",
            va="bottom" if above else "top",
            color=ORANGE,
            fontsize=8.5,
            zorder=6,
        )


def _wedge(axis: Any, start: Array, axes: Array, half: float, colour: str, name: str) -> None:
    angles = np.linspace(-half, half, 41)
    around = np.cos(angles)[:, None] * axes[0, :2] + np.sin(angles)[:, None] * axes[1, :2]
    rim = np.vstack([start, start + 1.6 * _FAR_M * around, start])
    axis.fill(*rim.T, color=colour, alpha=0.13, lw=0, label=name)


def _outline(axis: Any, points: Array) -> None:
    from scipy.spatial import ConvexHull, QhullError

    try:
        corners = points[ConvexHull(points).vertices]
    except QhullError:  # in one line, as a wall seen from above
        corners = np.array([points.min(axis=0), points.max(axis=0)])
    axis.fill(*corners.T, facecolor="#d5d8dd", edgecolor=GREY, lw=0.8, zorder=1.5)


def _errors(axis: Any, place: Place, origin: Array) -> None:
    assert place.position_m is not None
    towards = (place.position_m - origin)[:2]
    towards = towards / np.linalg.norm(towards)
    across = np.array([-towards[1], towards[0]])
    found = place.detection
    ways = (towards, found.range_error_m), (across, found.azimuth_error_rad * found.range_m)
    for way, error in ways:
        ends = place.position_m[:2] + TWO_SIDED_95 * error * np.array([[-1], [1]]) * way
        axis.plot(*ends.T, color="black", lw=0.9, zorder=3)


if __name__ == "__main__":
    main()

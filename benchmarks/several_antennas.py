"""How often intervals of a radar of several antennas hold the figure of another draw of its noise.

`hybrid-79-mimo` with 33 slots, a quarter of its subcarriers and a raised transmitter, so that it
tells elevation: with its oscillator and leakage, whose phase noise the receivers share, and
without. Point targets of a given SNR on a channel without a window, of thermal noise alone. Where
the phases of transmitters that take turns do not tell a rate it is stated with alternatives, and so
is a direction where noise may have raised another lobe of the array; the figures hold if none of
them is the true one, so draws of another rate or lobe count apart.
"""

from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.noise_intervals import evaluations, told
from benchmarks.timing import Figure
from hardware import Detection
from twin.accuracy import Interval
from twin.fidelity import Fidelity
from twin.radar import RadarDesign, load_radar
from twin.scene import Pose, Rig, Scene, Sun
from twin.scene.objects import Target

_SEEDS = 60
_CASES: dict[str, tuple[float, ...]] = {
    "one of 12 dB": (12.0,),
    "one of 20 dB": (20.0,),
    "one of 40 dB": (40.0,),
    "one of 60 dB": (60.0,),
    "two of 20 dB": (20.0, 20.0),
    "of 50 and 20 dB": (50.0, 20.0),
}
_PLACES = ((8.3, 12.0, 4.0, 1.1), (9.3, -20.0, -3.0, -0.5))  # m, degrees left and up, m/s


def figures() -> Iterator[Figure]:
    """Name, value and unit of everything that is measured."""
    for oscillator in (False, True):
        radar, noise = design(oscillator), "oscillator and leakage" if oscillator else "white noise"
        for name, levels_db in _CASES.items():
            yield from _of_case(f"{noise}, {name}", levels_db, radar)


def design(oscillator: bool) -> RadarDesign:
    """The radar, with or without its oscillator and leakage."""
    places_m = [[0.0, 7.59e-3, 0.0], [0.0, 0.0, 3.8e-3], [0.0, -7.59e-3, 0.0]]
    radar = load_radar("hybrid-79-mimo").with_(
        {
            "waveform.n_slots": 33,
            "waveform.n_subcarriers": 1024,
            "waveform.subcarrier_spacing_hz": 3.90625e6,
            "waveform.prefix_s": 0.256e-6,
            "waveform.repeats": 146,
            "elements.transmitters_m": places_m,
        }
    )
    return radar if oscillator else radar.model_copy(update={"leakage": None, "oscillator": None})


def _of_case(what: str, levels_db: tuple[float, ...], radar: RadarDesign) -> Iterator[Figure]:
    drawn: dict[str, list[Interval]] = defaultdict(list)
    n_detected, others, alternatives = 0, Counter[str](), Counter[str]()
    lobe_rad = _half_lobe_rad(radar)
    span = 2 * radar.channel_waveform.max_velocity_m_per_s
    for evaluation in evaluations(
        _points(levels_db, radar), radar, _SEEDS, Fidelity(radar="targets")
    ):
        rows = zip(evaluation.matches, evaluation.detections, evaluation.intervals, strict=True)
        for target, detection, intervals in rows:
            if target is None:
                continue
            n_detected += 1
            rates = detection.range_rate_m_per_s, *detection.range_rate_alternatives_m_per_s
            off = {
                "rate": np.abs(np.array(rates) - target.range_rate_m_per_s) / (span / 2),
                "lobe": np.array([_off(one, target.name, lobe_rad) for one in _told(detection)]),
            }
            another = [name for name, each in off.items() if each[0] > 1]
            if another:
                others[another[0]] += 1
                alternatives[another[0]] += bool(off[another[0]].min() < 1)
                continue
            for name, interval in vars(intervals).items():
                drawn[f"{what}, {target.name}, {name}"].append(interval)
    yield f"{what}: detected", 100 * n_detected / (_SEEDS * len(levels_db)), "%"
    for name in ("rate", "lobe"):
        yield f"{what}: of another {name}", 100 * others[name] / max(n_detected, 1), "%"
        if others[name]:
            share = 100 * alternatives[name] / others[name]
            yield f"{what}: of these with the true one as alternative", share, "%"
    for name, some in drawn.items():
        if len(some) > 1:
            yield from told(name, some)


def _told(detection: Detection) -> Iterator[tuple[float, float]]:
    """Azimuth and elevation, rad, of the direction and its alternatives."""
    yield detection.azimuth_rad, detection.elevation_rad
    yield from zip(
        detection.azimuth_alternatives_rad, detection.elevation_alternatives_rad, strict=True
    )


def _off(told_rad: tuple[float, float], name: str, lobe_rad: NDArray[np.float64]) -> float:
    """Of the target's direction, in half lobes."""
    _, left_deg, up_deg, _ = _PLACES[int(name.split()[-1]) - 1]
    off_rad = np.abs(np.subtract(told_rad, np.radians([left_deg, up_deg])))
    return float(np.max(off_rad / lobe_rad))


def _half_lobe_rad(radar: RadarDesign) -> NDArray[np.float64]:
    """Azimuth and elevation from the array's main lobe half way to its first zero, ahead."""
    extent_m = sum(
        np.ptp(part, axis=0) for part in (radar.burst.transmitters_m, radar.burst.receivers_m)
    )
    return radar.burst.waveform.wavelength_m / extent_m[1:] / 2


def _points(levels_db: tuple[float, ...], radar: RadarDesign) -> Scene:
    targets = []
    for i, (level_db, place) in enumerate(zip(levels_db, _PLACES, strict=False)):
        range_m, left_deg, up_deg, rate = place
        left, up = np.radians([left_deg, up_deg])
        way = np.array([np.cos(left) * np.cos(up), np.sin(left) * np.cos(up), np.sin(up)])
        of_one = radar.image_snr(radar.received_power_w(range_m, 1.0))
        x, y, z = (range_m * way).tolist()
        u, v, w = (rate * way).tolist()
        rcs_m2 = 10 ** (level_db / 10) / of_one
        targets.append(Target(f"target {i + 1}", (x, y, z), (u, v, w), rcs_m2, "by its SNR"))
    rig = Rig(Pose((0.0, 0.0, 0.0)), radar=Pose((0.0, 0.0, 0.0)))
    return Scene("points", Path("."), "", (), rig, Sun(180.0, 30.0, 0.0), targets=tuple(targets))

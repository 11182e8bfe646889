"""Figures of the radar chain."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.constants import c as light_speed

from benchmarks.timing import Figure, timed
from hardware.radar.process import process
from twin.radar import load_radar, radar_capture
from twin.radar.evaluation import evaluate_radar
from twin.radar.propagation.sionna.paths import sionna_paths
from twin.radar.synthesis import Contributions, direct_sum, synthesize
from twin.scene import Pose, Rig, Scene, Sun, Target, load_scene


def figures() -> Iterator[Figure]:
    """Name, value and unit of everything that is measured."""
    yield from _budget()
    yield from _synthesis()
    yield from _free_space()
    yield from _yard()


def _budget() -> Iterator[Figure]:
    radar = load_radar("hybrid-79")
    received = radar.received_power_w(150.0, 10.0)
    yield "received from 10 m^2 at 150 m", 10 * np.log10(received * 1e3), "dBm"
    yield "SNR after processing, the same", 10 * np.log10(radar.image_snr(received)), "dB"


def _synthesis() -> Iterator[Figure]:
    """1e5 echoes of a static world and one moving body, 4096 x 64."""
    wave = load_radar("hybrid-79-slow").ofdm
    rng = np.random.default_rng(0)
    n = 100_000
    amplitude = rng.normal(size=n) + 1j * rng.normal(size=n)
    delay = rng.uniform(1e-8, 1e-6, n)
    cases = {
        "static": np.zeros(n),
        "static and one moving body": np.where(rng.random(n) < 0.1, 2 * 5.0 / light_speed, 0.0),
        "every echo its own speed": rng.uniform(-6, 6, n) * 2 / light_speed,
    }
    rows, columns = np.array([0, 777, 2048, 4095]), np.array([0, 31, 63])
    f, t = wave.frequency_offsets_hz, wave.slot_times_s
    for name, rate in cases.items():
        echoes = Contributions.ahead(amplitude, delay, rate)
        label = f"synthesis, 1e5 echoes, 4096 x 64, {name}"
        yield label, timed(lambda e=echoes: synthesize(e, wave), runs=7), ""
        found = synthesize(echoes, wave)
        exact = direct_sum(echoes, f[rows], t[columns], wave.carrier_hz)
        rms = np.sqrt(np.mean(np.abs(found) ** 2))
        yield (
            f"{label}: error over rms",
            np.abs(found[np.ix_(rows, columns)] - exact).max() / rms,
            "",
        )
    few = timed(lambda: direct_sum(echoes, f[rows], t[columns], wave.carrier_hz), runs=3)
    scale = wave.n_subcarriers * wave.n_slots / (len(rows) * len(columns))
    yield "direct sum, the same", few.scaled(scale, "12 bins timed, scaled"), ""


def _free_space() -> Iterator[Figure]:
    """10 m^2 receding at 2 m/s, by default: level, range and rate against truth."""
    radar = load_radar("hybrid-79")
    loss = float(radar.ofdm.slot_gain(np.array(4.0 / radar.ofdm.wavelength_m))) ** 2
    rig = Rig(Pose((0.0, 0.0, 0.0)), radar=Pose((0.0, 0.0, 0.0)))
    empty = Scene("free space", Path(), "", (), rig, Sun(0.0, 0.0, 0.0))
    for distance in (10.0, 50.0, 140.0):
        target = Target("t", (distance, 0.0, 0.0), (2.0, 0.0, 0.0), 10.0, "declared")
        record = radar_capture(replace(empty, targets=(target,)), radar, seed=4).record
        found = process(record).detections[0]
        expected = radar.received_power_w(distance, 10.0) * loss
        level = 10 * np.log10(found.power_w / expected)
        yield f"10 m^2 at {distance:g} m: level less radar equation", float(level), "dB"
        off = 1e6 * (found.range_m - distance)
        yield f"10 m^2 at {distance:g} m: range error", off, "um"


def _yard() -> Iterator[Figure]:
    scene, radar = load_scene("yard"), load_radar("hybrid-79")
    yield (
        "radar paths of scenes/yard, Sionna",
        timed(lambda: sionna_paths(scene, radar), runs=5),
        "",
    )
    taken = radar_capture(scene, radar)
    yield "record to map and detections", timed(lambda: evaluate_radar(radar, taken), runs=5), ""
    evaluation = evaluate_radar(radar, taken)
    hit = sum(match is not None for match in evaluation.matches)
    yield "targets of scenes/yard detected, of 5", float(hit), ""

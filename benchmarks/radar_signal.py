"""Figures of the radar's signal: synthesis beside Sionna's, bursts of arrays and of steps."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from scipy.constants import c as light_speed

from benchmarks.timing import Figure, Timing, timed
from hardware.waveform import OfdmWaveform
from twin.engine import sionna
from twin.fidelity import Fidelity
from twin.radar import load_radar, radar_capture
from twin.radar.device.burst import burst_channel
from twin.radar.synthesis import Contributions, demodulated, synthesize
from twin.scene import Pose, Rig, Scene, Sun, Target

_ECHOES = 100_000
_SIONNA_BINS = 16, 4  # frequencies and times at which Sionna is timed


def figures() -> Iterator[Figure]:
    """Name, value and unit of everything that is measured."""
    yield from _beside_sionna()
    yield from _bursts()


def _echoes(rate: np.ndarray) -> Contributions:
    rng = np.random.default_rng(0)
    amplitude = rng.normal(size=_ECHOES) + 1j * rng.normal(size=_ECHOES)
    return Contributions.ahead(amplitude, rng.uniform(1e-8, 1e-6, _ECHOES), rate)


def _beside_sionna() -> Iterator[Figure]:
    """1e5 echoes, 4096 x 64 bins, 1e-5: a world at rest, with a car in it, and `Paths.cfr`."""
    wave = load_radar("hybrid-79-slow").ofdm
    rng = np.random.default_rng(1)
    car = 2 / light_speed * (5 + rng.uniform(-0.2, 0.2, _ECHOES))  # its parts are seen at an angle
    cases = {
        "at rest": np.zeros(_ECHOES),
        "a tenth a car at 5 m/s": np.where(rng.random(_ECHOES) < 0.1, car, 0.0),
    }
    ours = {}
    for name, rate in cases.items():
        echoes = _echoes(rate)
        ours[name] = timed(lambda e=echoes: synthesize(e, wave, 1e-5), runs=15)
        yield f"1e5 echoes, 4096 x 64, 1e-5, {name}", ours[name], ""
        within = timed(lambda e=echoes: demodulated(e, wave, 1e-5), runs=15)
        yield f"1e5 echoes, 4096 x 64, 1e-5, {name}, with Doppler within symbols", within, ""
    theirs = _sionna(_echoes(cases["a tenth a car at 5 m/s"]), wave)
    yield "Sionna's Paths.cfr, the same echoes and bins", theirs, ""
    for name, mine in ours.items():
        yield f"Paths.cfr over ours, {name}", theirs.median_s / mine.median_s, "times"


def _sionna(echoes: Contributions, wave: OfdmWaveform) -> Timing:
    """`Paths.cfr` on a `Paths` that holds these echoes.

    Whole, its sums would take 1e5 x 4096 x 64 numbers at once; few bins are timed, and scaled.
    """
    import drjit as dr
    import mitsuba as mi

    rt = sionna()
    scene = rt.load_scene()
    array = rt.PlanarArray(num_rows=1, num_cols=1, pattern="iso", polarization="V")
    scene.tx_array = scene.rx_array = array
    scene.frequency = wave.carrier_hz
    scene.add(rt.Transmitter("transmitter", [0.0, 0.0, 0.0]))
    scene.add(rt.Receiver("receiver", [10.0, 0.0, 0.0]))
    paths = rt.PathSolver()(scene, max_depth=0)
    shape = (1, 1, 1, 1, len(echoes.delay_s))
    doppler = -wave.carrier_hz * echoes.delay_rate

    def tensor(values: np.ndarray, shape: tuple[int, ...]) -> object:
        return mi.TensorXf(np.ascontiguousarray(values.reshape(shape), dtype=np.float32))

    paths._a_real, paths._a_imag = (
        tensor(part, shape) for part in (echoes.amplitude.real, echoes.amplitude.imag)
    )
    alone = (1, 1, len(echoes.delay_s)) if paths.synthetic_array else shape
    paths._tau, paths._doppler = tensor(echoes.delay_s, alone), tensor(doppler, alone)
    rows, columns = _SIONNA_BINS
    frequencies = mi.Float(wave.frequency_offsets_hz[:rows].astype(np.float32))

    def response() -> None:
        found = paths.cfr(
            frequencies,
            sampling_frequency=1 / wave.slot_period_s,
            num_time_steps=columns,
            normalize_delays=False,
        )
        dr.eval(found)
        dr.sync_thread()

    bins = wave.n_subcarriers * wave.n_slots / (rows * columns)
    return timed(response, runs=3).scaled(bins, f"{rows} x {columns} bins timed, scaled")


def _bursts() -> Iterator[Figure]:
    """Channels of whole bursts, and captures of one target with every fault switched on."""
    rng = np.random.default_rng(2)
    for name, n in (("hybrid-79-mimo", 1000), ("prototype", _ECHOES)):
        burst = load_radar(name).burst
        echoes = _echoes(2 / light_speed * rng.uniform(4.9, 5.1, _ECHOES))
        few = Contributions.ahead(echoes.amplitude[:n], echoes.delay_s[:n], echoes.delay_rate[:n])
        label = f"channel of {name}, {n:g} echoes, 1e-5"
        yield label, timed(lambda e=few, b=burst: burst_channel(e, b, 1e-5), runs=3), ""
    rig = Rig(Pose((0.0, 0.0, 0.0)), radar=Pose((0.0, 0.0, 0.0)))
    target = Target("t", (20.0, 0.0, 0.0), (1.0, 0.0, 0.0), 10.0, "declared")
    scene = Scene("free space", Path(), "", (), rig, Sun(0.0, 0.0, 0.0), (target,))
    free = Fidelity(radar="targets")
    for name in ("hybrid-79", "hybrid-79-mimo", "prototype"):
        radar = load_radar(name)
        taken = timed(lambda r=radar: radar_capture(scene, r, fidelity=free), runs=3)
        yield f"capture of {name}, one target", taken, ""

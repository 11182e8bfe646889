"""A virtual radio with short bursts, behind free ports, and what the twin itself records."""

import threading
from contextlib import contextmanager

import numpy as np

from hardware.records import RadarRecord
from twin.fidelity import Fidelity
from twin.files import InputError
from twin.radar import load_radar, radar_capture
from twin.radar.device.design import RadarDesign
from twin.serve.clock import DeviceClock
from twin.serve.radio import VirtualRadio
from twin.serve.sweeps import RadarSweeps
from twin.serve.zeromq import RadioServer

SEED = 11
QUICK = Fidelity(radar="targets")


def small(**changes: float) -> RadarDesign:
    """A radar whose burst is 16 slots of 72 samples."""
    content = load_radar("hybrid-79").model_dump()
    values = {
        "n_subcarriers": 64,
        "subcarrier_spacing_hz": 312.5e3,
        "n_slots": 16,
        "slot_period_s": 3.6e-6,
        "repeats": 1,
        "prefix_s": 0.4e-6,
        **changes,
    }
    for name, value in values.items():
        content["waveform"][name] = {"value": value, "assumed": "short bursts"}
    return RadarDesign.model_validate(content)


def direct(scene, design: RadarDesign, sweep: int) -> RadarRecord:
    """What the twin records of a sweep by itself, of the middle of its burst."""
    world = scene.after(sweep * design.burst_s + design.middle_s)
    return radar_capture(world, design, seed=SEED + sweep, fidelity=QUICK).record


def virtual(scene, design: RadarDesign, **options) -> VirtualRadio:
    options = {"clock": DeviceClock("fast"), **options}
    return VirtualRadio(design, RadarSweeps(scene, design, SEED, QUICK), **options)


@contextmanager
def served(radio: VirtualRadio, **options):
    """The radio behind three free ports; yields the first."""
    for _ in range(20):
        port = int(np.random.default_rng().integers(20000, 60000))
        try:
            server = RadioServer(radio, "127.0.0.1", port, n_samples=radio.n_samples, **options)
            break
        except InputError:
            continue
    thread = threading.Thread(target=server.run)
    thread.start()
    try:
        yield port
    finally:
        server.stop()
        thread.join()

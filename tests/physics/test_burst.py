"""A burst against its definition: one exponential per echo, step, slot, receiver, sample and
subcarrier.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.constants import c as light_speed

from hardware.waveform import OfdmWaveform
from twin.radar.device.burst import Burst, burst_channel
from twin.radar.synthesis import Contributions, demodulated, direct_sum, synthesize
from twin.radar.synthesis.contributions import OWN_IMAGE, PLANE
from twin.radar.synthesis.wavefronts import nearer_m

WIDE = OfdmWaveform(79e9, 64, 15.625e6, 24, 39.0625e-6, 20, 1e-6)
NARROW = OfdmWaveform(2.26e9, 64, 312.5e3, 16, 3.6e-6, 1, 0.4e-6)


def unit_vectors(rng: np.random.Generator, n: int) -> np.ndarray:
    v = rng.normal(size=(n, 3)) + [3.0, 0, 0]
    return v / np.linalg.norm(v, axis=1)[:, None]


def echoes(n: int, n_steps: int, seed: int = 0, speed: float = 20.0) -> Contributions:
    rng = np.random.default_rng(seed)
    shape = (n_steps, n) if n_steps > 1 else (n,)
    return Contributions(
        rng.normal(size=shape) + 1j * rng.normal(size=shape),
        rng.uniform(1e-9, 9e-7, n),
        2 * speed / light_speed * rng.uniform(-1, 1, n),
        2 * speed**2 / 10 / light_speed * rng.uniform(0, 1, n),
        unit_vectors(rng, n),
        unit_vectors(rng, n),
        speed / 10 * rng.normal(size=(n, 3)),
        speed / 10 * rng.normal(size=(n, 3)),
        wavefront=np.full(n, PLANE, dtype=np.uint32),
    )


def definition(part: Contributions, burst: Burst) -> np.ndarray:
    """exp(-j 2 pi (fc + f) (tau + rate t + acceleration t^2 / 2 - (d . p + a . q) / c)), in
    float64, nothing shared; d and a at t, that of every sample; then divided by what was sent.
    """
    wave = burst.waveform
    amplitude = np.broadcast_to(part.amplitude, (len(burst.carriers_hz), len(part.delay_s)))
    shape = (len(burst.carriers_hz), wave.n_slots, len(burst.receivers_m), wave.n_subcarriers)
    found = np.zeros(shape, dtype=complex)
    n, sent = wave.n_subcarriers, wave.sent()
    f = (np.arange(n) - n // 2) * wave.subcarrier_spacing_hz
    of_sample = np.exp(2j * np.pi * np.outer(np.arange(n), f) / wave.bandwidth_hz)
    for step, slot, receiver in np.ndindex(shape[:3]):
        middle = burst.step_times_s[step] + (slot - (wave.n_slots - 1) / 2) * wave.slot_period_s
        sender = burst.transmitters_m[slot % len(burst.transmitters_m)]
        samples = np.zeros(n, dtype=complex)
        for sample, since in enumerate((np.arange(n) - (n - 1) / 2) / wave.bandwidth_hz):
            time = middle + since
            length = (part.departure + part.departure_per_s * time) @ sender
            length += (part.arrival + part.arrival_per_s * time) @ burst.receivers_m[receiver]
            delay = part.delay_s + part.delay_rate * time - length / light_speed
            delay += part.delay_acceleration_per_s * time**2 / 2
            cycles = (burst.carriers_hz[step] + f)[:, None] * delay
            channel = np.exp(-2j * np.pi * (cycles % 1.0)) @ amplitude[step]
            samples[sample] = (of_sample[sample] * sent) @ channel
        found[step, slot, receiver] = of_sample.conj().T @ samples / n * sent.conj()
    return found


def line(n: int, spacing_m: float) -> np.ndarray:
    return np.column_stack([np.zeros(n), spacing_m * (np.arange(n) - (n - 1) / 2), np.zeros(n)])


# Doppler turns a symbol by up to a tenth of a cycle.
LONG = OfdmWaveform(79e9, 48, 100e3, 6, 25e-6, 2, 1e-6)

BURSTS = {
    "long symbols": Burst(LONG, np.array([79e9]), np.zeros(1), line(2, 4e-3), line(1, 0.0)),
    "long random symbols": Burst(
        replace(LONG, symbols=np.exp(2j * np.pi * np.random.default_rng(0).random(48))),
        np.array([79e9]),
        np.zeros(1),
        line(1, 0.0),
        line(2, 4e-3),
    ),
    "long symbols of one phase": Burst(
        replace(LONG, symbols="flat"), np.array([79e9]), np.zeros(1), line(1, 0.0), line(1, 0.0)
    ),
    "array": Burst(WIDE, np.array([79e9]), np.zeros(1), line(3, 7.6e-3), line(4, 1.9e-3)),
    "uneven turns": Burst(
        replace(WIDE, n_slots=11), np.array([79e9]), np.zeros(1), line(3, 0.2), line(1, 0.0)
    ),
    "steps": Burst(
        NARROW,
        2.26e9 + 20e6 * np.arange(5),
        5e-3 * (np.arange(5) - 2),
        np.zeros((1, 3)),
        np.zeros((1, 3)),
    ),
    "steps of an array": Burst(
        NARROW, np.array([2.26e9, 2.9e9]), np.array([-0.1, 0.1]), line(2, 0.06), line(3, 0.3)
    ),
    "one of each": Burst(
        replace(NARROW, n_subcarriers=1, n_slots=1, slot_period_s=4e-6),
        np.array([2.26e9]),
        np.zeros(1),
        line(1, 0.0) + 0.1,
        line(1, 0.0),
    ),
}


@pytest.mark.parametrize("name", BURSTS)
def test_a_burst_is_its_definition(name: str) -> None:
    """Echoes with a speed of their own each; within the tolerance of the rms."""
    burst = BURSTS[name]
    part = echoes(10, len(burst.carriers_hz))
    exact = definition(part, burst)
    rms = np.sqrt(np.mean(np.abs(exact) ** 2))
    for tolerance in (1e-4, 1e-6):
        found = burst_channel(part, burst, tolerance)
        assert np.sqrt(np.mean(np.abs(found - exact) ** 2)) < tolerance * rms


def test_one_step_and_one_antenna_is_the_plain_channel() -> None:
    burst = Burst(WIDE, np.array([79e9]), np.zeros(1), np.zeros((1, 3)), np.zeros((1, 3)))
    part = echoes(50, 1)
    np.testing.assert_array_equal(burst_channel(part, burst)[0, :, 0].T, demodulated(part, WIDE))


def test_what_goes_straight_across_does_not_depend_on_places() -> None:
    """Leakage: no direction, so every pair of antennas has the same."""
    nowhere = np.zeros((1, 3))
    still = np.zeros(1)
    part = Contributions(np.ones(1, complex), np.array([3e-9]), still, still, nowhere, nowhere)
    part = replace(part, wavefront=np.full(1, PLANE, dtype=np.uint32))
    found = burst_channel(part, BURSTS["array"])
    np.testing.assert_allclose(found, np.broadcast_to(found[:, :1, :1], found.shape), rtol=1e-12)


def test_no_echo_gives_zeros() -> None:
    assert not burst_channel(Contributions.none(), BURSTS["steps of an array"]).any()


def test_a_targets_angle_is_in_the_phase_from_antenna_to_antenna() -> None:
    """Closed form: 12 virtual elements half a wavelength apart, phase pi sin(azimuth) each."""
    half = light_speed / 79e9 / 2
    burst = Burst(WIDE, np.array([79e9]), np.zeros(1), line(3, 4 * half), line(4, half))
    azimuth = np.radians(17.0)
    towards = np.array([[np.cos(azimuth), np.sin(azimuth), 0.0]])
    still = np.zeros(1)
    part = Contributions(np.ones(1, complex), np.array([2e-7]), still, still, towards, towards)
    part = replace(part, wavefront=np.full(1, PLANE, dtype=np.uint32))
    middle = WIDE.n_subcarriers // 2
    virtual = burst_channel(part, burst)[0, :3, :, middle].ravel()
    steps = np.angle(virtual[1:] / virtual[:-1])
    np.testing.assert_allclose(steps, np.pi * np.sin(azimuth), atol=1e-6)


@pytest.mark.parametrize("distance_m", [0.5, 5.0, 150.0, 1e4])
def test_ways_from_an_element_to_a_point_and_back_are_straight(distance_m: float) -> None:
    """By their lengths, to 1e-12 m; as a plane it were 15 mm off at 5 m."""
    rng = np.random.default_rng(3)
    towards = unit_vectors(rng, 20)
    sender_m, listener_m = rng.normal(size=(2, 3)) * 0.2
    still = np.zeros(20)
    delay_s = np.full(20, 2 * distance_m / light_speed)
    part = Contributions(np.ones(20, complex), delay_s, still, still, towards, towards)
    points_m = distance_m * towards
    ways_m = sum(np.linalg.norm(points_m - place, axis=1) for place in (sender_m, listener_m))
    found = nearer_m(part, sender_m, listener_m)
    np.testing.assert_allclose(found, 2 * distance_m - ways_m, atol=1e-12 * max(1, distance_m))


@pytest.mark.parametrize("distance_m", [0.5, 5.0, 150.0])
def test_the_way_from_an_element_over_a_mirror_to_another_is_straight(distance_m: float) -> None:
    """To the mirror image of the other one."""
    rng = np.random.default_rng(4)
    normal = unit_vectors(rng, 1)
    sender_m, listener_m = rng.normal(size=(2, 3)) * 0.1
    still = np.zeros(1)
    delay_s = np.full(1, 2 * distance_m / light_speed)
    part = Contributions(np.ones(1, complex), delay_s, still, still, normal, normal)
    part = replace(part, wavefront=np.full(1, OWN_IMAGE, dtype=np.uint32))
    image_m = listener_m + 2 * (distance_m - listener_m @ normal[0]) * normal[0]
    found = nearer_m(part, sender_m, listener_m)
    way_m = np.linalg.norm(image_m - sender_m)
    np.testing.assert_allclose(found, 2 * distance_m - way_m, atol=1e-12)


@pytest.mark.parametrize("spread", [0.0, 1e-5, 1e-3, 0.3, 30.0])
def test_every_way_through_the_synthesis_is_exact(spread: float) -> None:
    """From a common speed (one transform) to one per echo (one per slot), 5 m/s on average."""
    wave = OfdmWaveform(79e9, 512, 976_562.5, 16, 156.25e-6, 100, 1e-6)
    rng = np.random.default_rng(1)
    n = 400
    rate = 2 / light_speed * (5 + spread * rng.uniform(-1, 1, n))
    part = Contributions.ahead(rng.normal(size=n) + 0j, rng.uniform(0, 3e-6, n), rate)
    exact = direct_sum(part, wave.frequency_offsets_hz, wave.slot_times_s, wave.carrier_hz)
    rms = np.sqrt(np.mean(np.abs(exact) ** 2))
    for tolerance in (1e-3, 1e-5, 1e-9):
        off = np.abs(synthesize(part, wave, tolerance) - exact).max()
        assert off < 3 * tolerance * rms

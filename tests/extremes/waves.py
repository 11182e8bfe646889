"""Extremes of the radar: carrier, velocity, subcarriers, against sums in arbitrary precision."""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import mpmath as mp
import numpy as np

from tests.extremes import oracle
from tests.extremes.case import Case, Found
from tests.extremes.worlds import Triangles, asked, mosaic, square, validated
from tests.extremes.worlds import scene as scene_of
from twin.fidelity import Fidelity, Tolerance
from twin.radar import load_radar, radar_capture
from twin.radar.acquisition import channel as received
from twin.radar.device.design import RadarDesign
from twin.radar.propagation.interval.instants import traced_interval
from twin.radar.propagation.scene.atmosphere import Atmosphere
from twin.scene import Pose, Rig, Scene, Sun, Target
from twin.scene.settings import SceneSettings

#: Default of `Fidelity.nufft_tolerance`, with the factor it is tested to.
CHANNEL = 1e-5
_LEVEL = 10 ** (0.2 / 20) - 1  # 0.2 dB, to which traced levels are tested
_SUM = "mpmath: radar equation, phases, repeats"
_AT = (47.3, 3.1, -1.7)
#: 5 m/s straight away from the radar.
_AWAY = tuple(5.0 * np.array(_AT) / np.linalg.norm(_AT))
Vector = Sequence[float]


def radar(**changes: object) -> RadarDesign:
    """`hybrid-79-slow` changed by ``section__field``."""
    content = load_radar("hybrid-79-slow").model_dump()
    for name, value in changes.items():
        section, field = name.split("__")
        content[section][field] = value
    return validated(RadarDesign, content)


def world(position: Vector = _AT, velocity: Vector = (0.0, 0.0, 0.0)) -> Scene:
    """One target of 10 m^2; the radar in the origin, looking along x."""
    target = Target("target", tuple(position), tuple(velocity), 10.0, "declared")  # type: ignore[arg-type]
    rig = Rig(Pose((0.0, 0.0, 0.0)), radar=Pose((0.0, 0.0, 0.0)))
    return Scene("extreme", Path("extreme"), "", (), rig, Sun(0.0, 0.0, 0.0), (target,))


def _echo(design: RadarDesign, scene: Scene, time_s: float) -> np.ndarray:
    """Channel of one slot at all subcarriers, divided by what was sent: range |p + v t| at every
    averaged repeat and every sample. Whole cycles are taken off in mpmath.
    """
    (target,) = scene.targets
    wave, end = design.ofdm, design.front_end
    p, v = (mp.matrix([mp.mpf(x) for x in y]) for y in (target.position_m, target.velocity_m_per_s))
    there = p + v * mp.mpf(time_s)
    distance = mp.norm(there)
    wavelength = oracle.C / mp.mpf(wave.carrier_hz)
    peak = 10 ** (mp.mpf(design.antenna.gain_dbi.value) / 10)
    gain = peak * (there[0] / distance) ** (peak / 2 - 1)
    loss = 10 ** (mp.mpf(end.losses_db.value) / 10)
    power = (
        gain**2 * wavelength**2 * mp.mpf(target.rcs_m2) / ((4 * mp.pi) ** 3 * distance**4 * loss)
    )
    carrier, total = mp.mpf(wave.carrier_hz), mp.mpc(0)
    rate = (there.T * v)[0] / distance
    for repeat in range(wave.repeats):
        # From repeat to repeat the carrier alone turns; subcarriers keep their delay.
        later = (repeat - mp.mpf(wave.repeats - 1) / 2) / mp.mpf(wave.subcarrier_spacing_hz)
        cycles = 2 * carrier * (distance + rate * later) / oracle.C
        total += mp.expjpi(-2 * (cycles - mp.floor(cycles)))
    level = complex(mp.sqrt(power) * total / wave.repeats)
    offsets_hz = wave.frequency_offsets_hz
    still = level * np.exp(-4j * np.pi * offsets_hz * float(distance / oracle.C))
    return _within_symbol(still, design, float(2 * rate / oracle.C))


def _within_symbol(still: np.ndarray, design: RadarDesign, delay_rate: float) -> np.ndarray:
    """A slot's channel (n_subcarriers,) of what moves on from sample to sample: at the carrier
    exactly, subcarriers' own turns by a power series.
    """
    wave = design.ofdm
    n, sent, offsets_hz = wave.n_subcarriers, wave.sent(), wave.frequency_offsets_hz
    turn = -2j * np.pi * delay_rate * (np.arange(n) - (n - 1) / 2) / wave.bandwidth_hz
    # Samples are relative to the lowest subcarrier: a turn that division by what is sent undoes.
    samples = np.zeros(n, dtype=complex)
    for power in range(6):
        term = np.fft.ifft(sent * still * offsets_hz**power)
        samples += turn**power / math.factorial(power) * term
    return np.fft.fft(samples * np.exp(turn * wave.carrier_hz)) * sent.conj()


def _channel(design: RadarDesign, scene: Scene) -> Found:
    """Synthesised channel against the sum, at corners, middle and in between, relative to it.
    Stated is the transform's error, and what one instant leaves out.
    """
    wave = design.ofdm
    quiet = Fidelity(radar="targets", noise="none", radar_motion_tolerance=1e-3)
    echoes = traced_interval(scene, design, quiet, 1)
    found = received(echoes, design, Atmosphere())[0, :, 0].T
    rows = sorted({0, wave.n_subcarriers // 3, wave.n_subcarriers - 1})
    columns = sorted({0, wave.n_slots // 2, wave.n_slots - 1})
    exact = np.stack([_echo(design, scene, wave.slot_times_s[m])[rows] for m in columns], axis=1)
    error = float(np.max(np.abs(found[np.ix_(rows, columns)] / exact - 1)))
    taken = radar_capture(scene, design, fidelity=quiet) if found.size < 2**19 else None
    stated = CHANNEL + sum(one.bound for one in echoes.decisions if not one.taken)
    return Found(error, stated, warnings=taken.warnings if taken else ())


def _carrier(hz: float) -> Found:
    """64 subcarriers: 63 MHz of band."""
    design = radar(waveform__carrier_hz=hz, waveform__n_subcarriers=64)
    return _channel(design, world(velocity=_AWAY))


def _traced(hz: float) -> Found:
    """Sionna's own legs to a target, with the radar equation: stated to 0.2 dB."""
    design = radar(waveform__carrier_hz=hz, waveform__n_subcarriers=64)
    scene = world()
    taken = radar_capture(scene, design, fidelity=asked(Fidelity(noise="none")))
    (path,) = [p for p in taken.propagation.paths if p.via == ("target",)]
    exact = abs(_echo(design, scene, 0.0)[design.ofdm.n_subcarriers // 2])
    return Found(abs(abs(path.amplitude) / exact - 1), _LEVEL)


def _doubled(shape: Triangles, *, flipped: bool) -> Triangles:
    """Every triangle twice, the second time with its other side out."""
    corners, faces = shape
    again = faces[:, ::-1] if flipped else faces
    return corners, np.vstack([faces, again])


def _wall(half_m: float, turned: bool = True, how: str = "", parts: int = 1) -> Found:
    """Echo of a concrete wall 25 m ahead, of triangles that are there twice, with their other side
    out, both sides, or in a second object (``how``), and of ``parts`` x ``parts`` squares: image
    method, Fresnel's coefficient (ITU-R P.2040-3).

    Amplitude relative, or the delay's error in periods of the carrier where that is larger.
    """
    design = radar()
    shape = square((25.0, -0.11 * half_m, 0.3 * half_m), half_m)
    shape = mosaic(shape, parts) if parts > 1 else shape
    shape = (shape[0], shape[1][:, ::-1]) if how == "other side" else shape
    shapes = [_doubled(shape, flipped=how == "flipped") if how in ("twice", "flipped") else shape]
    shapes += [shape] if how == "coplanar" else []
    with scene_of(*shapes, turned=turned, radio="concrete") as found:
        there = replace(found, rig=replace(found.rig, radar=Pose((0.0, 0.0, 0.0))))
        taken = radar_capture(there, design, fidelity=asked(Fidelity(noise="none")))
    paths = [p for p in taken.propagation.paths if set(p.via) <= {"shape-0", "shape-1"}]
    carrier = mp.mpf(design.ofdm.carrier_hz)
    ghz = carrier / 10**9
    eta = mp.mpc("5.24", -mp.mpf("17.98") * mp.mpf("0.0462") * ghz ** mp.mpf("0.7822") / ghz)
    mirror = abs((1 - mp.sqrt(eta)) / (1 + mp.sqrt(eta)))
    gain = 10 ** (mp.mpf(design.antenna.gain_dbi.value) / 10)
    loss = 10 ** (mp.mpf(design.front_end.losses_db.value) / 20)
    exact = mirror * gain * oracle.C / carrier / (4 * mp.pi * 50) / loss
    late = max((abs(p.delay_s - 50 / oracle.C) * carrier for p in paths), default=0)
    error = oracle.relative(abs(sum(p.amplitude for p in paths)), exact)
    return Found(max(error, float(late)), _LEVEL, warnings=taken.warnings)


def plate(share: float) -> Found:
    """Echo of a metal plate of 10 cm, square to the radar 25 m ahead, to a share of the noise:
    Kirchhoff's integral with Fresnel's phases, of the way out and home. Stated is what the radar
    states of the body.
    """
    design, half, distance = radar(), mp.mpf("0.05"), mp.mpf(25)
    with scene_of(square((25.0, 0, 0), float(half)), turned=True, radio="metal") as found:
        there = replace(found, rig=replace(found.rig, radar=Pose((0.0, 0.0, 0.0))))
        taken = radar_capture(there, design, fidelity=Tolerance(share))
    (body,) = taken.propagation.bodies
    wavelength = oracle.C / mp.mpf(design.ofdm.carrier_hz)
    gain = 10 ** (mp.mpf(design.antenna.gain_dbi.value) / 10)
    loss = 10 ** (mp.mpf(design.front_end.losses_db.value) / 20)
    side = mp.quad(lambda x: mp.expjpi(-2 * x**2 / wavelength / distance), [-half, half])
    exact = gain * abs(side) ** 2 / (4 * mp.pi * distance**2) / loss
    error = oracle.relative(body.amplitude, exact)
    return Found(error, body.estimated_error, warnings=taken.warnings)


def _material(hz: float) -> Found:
    """A wall in front of the radar whose material has no data at the carrier."""
    design = radar(waveform__carrier_hz=hz, waveform__n_subcarriers=64)
    with scene_of(square((20.0, 0, 0), 20.0)) as found:
        radar_capture(found, design)
    return Found(0.0, 0.0)


def _moving(*velocity: float) -> Found:
    return _channel(radar(), world((50.0, 0.0, 0.0), velocity))


def _crossing(range_m: float) -> Found:
    """300 m/s across: what is beyond a parabola takes several instants."""
    return replace(_channel(radar(), world((range_m, 0.0, 0.0), (0.0, 300.0, 0.0))), stated=0.02)


def _declared(speed: float) -> Found:
    content = {
        "rig": {"position_m": (0.0, 0.0, 0.0)},
        "sun": {"azimuth_deg": 0.0, "elevation_deg": 0.0, "illuminance_lx": 0.0},
        "objects": {"car": {"velocity_m_per_s": (speed, 0.0, 0.0)}},
    }
    validated(SceneSettings, content)
    return Found(0.0, 0.0)


def _subcarriers(n: int, spacing_hz: float, slots: int) -> Found:
    design = radar(
        waveform__n_subcarriers=n,
        waveform__subcarrier_spacing_hz=spacing_hz,
        waveform__n_slots=slots,
        waveform__repeats=2,
        waveform__slot_period_s=max(156.25e-6, 4 / spacing_hz),
    )
    return _channel(design, world(velocity=_AWAY))


def cases() -> list[Case]:
    """All of this room."""
    carriers = [
        Case("carrier", text, _SUM, lambda hz=hz: _carrier(hz), slow=slow)
        for text, hz, slow in (
            ("100 MHz", 1e8, False), ("2.5 GHz", 2.5e9, True), ("100 GHz", 1e11, False),
            ("10 THz", 1e13, False),
        )
    ]  # fmt: skip
    velocities = [
        Case("velocity", text, _SUM, lambda v=v: _moving(*v), says=says)
        for text, v, says in (
            ("0", (0.0, 0.0, 0.0), ""),
            ("1e-6 m/s", (1e-6, 0.0, 0.0), ""),
            ("1e-6 m/s across", (0.0, 1e-6, 0.0), ""),
            ("300 m/s", (300.0, 0.0, 0.0), "beyond the unambiguous"),
            ("-300 m/s", (-300.0, 0.0, 0.0), "beyond the unambiguous"),
        )
    ]
    return [
        *carriers,
        Case("carrier", "1 PHz", "-", lambda: _carrier(1e15), "error", "carrier_hz"),
        Case("carrier", "10 MHz", "-", lambda: _carrier(1e7), "error", "carrier_hz"),
        Case("carrier", "100 MHz, traced", "mpmath: radar equation", lambda: _traced(1e8),
             slow=True),
        Case("carrier", "100 GHz, traced", "mpmath: radar equation", lambda: _traced(1e11),
             slow=True),
        Case("carrier", "1 GHz on a material without data", "-", lambda: _material(1e9), "error",
             "no radio properties", slow=True),
        *[
            Case("radar's triangles", text, "mpmath: image method, Fresnel",
                 lambda half=half: _wall(half), expected, says, slow=half < 5e4)
            for text, half, expected, says in (
                ("20 m at 25 m", 10.0, "within", ""),
                ("4 km at 25 m", 2e3, "within", ""),
                ("10 km at 25 m, off its middle", 5e3, "within", ""),
                ("100 km at 25 m", 5e4, "within", ""),
            )
        ],
        Case("radar's triangles", "10 008 338", "mpmath: image method, Fresnel",
             lambda: _wall(10.0, parts=2237), slow=True),
        *[
            Case("faces", f"a wall's, {text}, by radar", "mpmath: image method, Fresnel",
                 lambda how=how: _wall(10.0, how=how))
            for text, how in (
                ("twice", "twice"), ("other side out", "other side"),
                ("both sides out", "flipped"), ("in two objects", "coplanar"),
            )
        ],
        *velocities,
        Case("velocity", "300 m/s across", _SUM, lambda: _crossing(50.0)),
        Case("velocity", "300 m/s across at 10 m", _SUM, lambda: _crossing(10.0)),
        Case("velocity", "3e8 m/s", "-", lambda: _declared(3e8), "error", "velocity_m_per_s"),
        Case("subcarriers", "1", _SUM, lambda: _subcarriers(1, 976562.5, 64)),
        Case("slots", "1", _SUM, lambda: _subcarriers(1024, 976562.5, 1)),
        Case("slots", "1 of 1 subcarrier", _SUM, lambda: _subcarriers(1, 976562.5, 1)),
        Case("subcarriers", "65 536", _SUM, lambda: _subcarriers(65536, 61035.15625, 16)),
        Case("subcarriers", "1 048 576", _SUM, lambda: _subcarriers(2**20, 3814.697, 4), slow=True),
        Case("subcarriers", "2 097 152", "-", lambda: _subcarriers(2**21, 1907.3, 4), "error",
             "n_subcarriers"),
        Case("subcarriers", "65 536 in 1024 slots", "-", lambda: _subcarriers(65536, 61035.0, 1024),
             "error", "n_subcarriers x n_slots"),
    ]  # fmt: skip

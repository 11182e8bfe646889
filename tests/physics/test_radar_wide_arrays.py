"""Echoes at elements beside the antennas' middle: against sums of currents at each."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.constants import speed_of_light

from tests.physics.radar_worlds import RADAR, quad, world
from twin.errors import InputError
from twin.fidelity import PRESETS, Fidelity, Tolerance
from twin.radar import RadarDesign, radar_capture
from twin.radar.propagation.interval.instants import traced_interval
from twin.radar.propagation.result import Propagation
from twin.radar.propagation.solvers import trace
from twin.radar.synthesis.wavefronts import nearer_m
from twin.scene import Pose, Rig, Scene
from twin.scene.objects import Target

K = 2 * np.pi * RADAR.ofdm.carrier_hz / speed_of_light
ALONE = {"radar_edges": 0, "radar_images": 0, "radar_shadowed": 0, "radar_bounces": 1}


def places_m(half_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Transmitters and receivers in a row across, out to either side of the middle."""
    row = np.array([[0.0, share, 0.0] for share in (-1.0, 0.0, 1.0)])
    return 0.75 * half_m * row, 0.25 * half_m * row


def currents(corners: np.ndarray, half_m: float) -> np.ndarray:
    """By brute force over a quad: sum of cos / (r s) exp(-j k (r + s)), a quarter wavelength."""
    senders, listeners = places_m(half_m)
    edges = corners[1] - corners[0], corners[3] - corners[0]
    u, v = (
        (np.arange(n) + 0.5) / n
        for n in (int(8 * K / (2 * np.pi) * np.linalg.norm(edge)) for edge in edges)
    )
    points = corners[0] + u[:, None, None] * edges[0] + v[None, :, None] * edges[1]
    normal = np.cross(*edges)
    from_senders = [points - place for place in senders]
    r = [np.linalg.norm(way, axis=-1) for way in from_senders]
    cosine = [np.abs(way @ normal) / length for way, length in zip(from_senders, r, strict=True)]
    s = [np.linalg.norm(points - place, axis=-1) for place in listeners]
    return np.array(
        [
            [np.sum(cosine[i] / (r[i] * there) * np.exp(-1j * K * (r[i] + there))) for there in s]
            for i in range(3)
        ]
    )


@pytest.mark.parametrize("half_m", [0.0104, 0.104])
@pytest.mark.parametrize(
    ("distance_m", "side_m", "tilt_deg"), [(5.0, 0.05, 20.0), (5.0, 0.3, 0.5), (15.0, 0.3, 3.0)]
)
def test_elements_aside_have_the_echo_within_what_is_stated(
    half_m: float, distance_m: float, side_m: float, tilt_deg: float
) -> None:
    """Of plates, relative to the echo from the middle transmitter; 0.104 m aside it was 47 to 146 %
    off, with wavefronts that were plane and facets divided for the middle, and 0.6 to 0.8 % stated.
    """
    tilt = np.radians(tilt_deg)
    across, up = np.array([-np.sin(tilt), np.cos(tilt), 0.0]), np.array([0.0, 0.0, 1.0])
    signs = ((-1, -1), (1, -1), (1, 1), (-1, 1))
    corners = np.array([[distance_m, 0, 0] + side_m / 2 * (a * across + b * up) for a, b in signs])
    senders, listeners = places_m(half_m)
    fields = {"transmitters_m": senders.tolist(), "receivers_m": listeners.tolist()}
    radar = RADAR.with_({"elements": fields, "waveform.n_slots": 255})
    found = trace(world(quad("plate", corners)), radar, fidelity=Tolerance().knobs().with_(**ALONE))
    echoes = found.contributions
    wave = np.array(
        [
            [
                np.sum(
                    echoes.amplitude
                    * np.exp(1j * K * (nearer_m(echoes, a, b) - speed_of_light * echoes.delay_s))
                )
                for b in listeners
            ]
            for a in senders
        ]
    )
    exact = currents(corners, half_m)
    level = np.vdot(exact[1], wave[1]) / np.vdot(exact[1], exact[1])
    off = np.abs(wave / level - exact) / np.sqrt(np.mean(np.abs(exact) ** 2))
    assert off.max() < found.bodies[0].estimated_error
    assert off.max() < 0.05


def test_shadows_that_elements_aside_see_past_are_in_the_stated_errors() -> None:
    """A strip 6 cm wide 5 m away, before one 10 cm wide at 8 m: 5 cm aside more of it is seen, and
    its echo is off, 4 cm aside as well, by far more than a trace from the middle states. Antennas
    within three wavelengths are not compared.
    """
    places = ((5, 0.0, 0.03), (8, 0.06, 0.05))
    strips = [quad(f"{x} m", strip(x, y, half_m)) for x, y, half_m in places]
    scene, knobs = world(*strips), PRESETS["standard"].with_(**ALONE)
    found, told = (find(scene, with_receiver(0.05), knobs, 0) for find in (traced, traced_interval))
    moved = replace(scene, rig=replace(scene.rig, radar=Pose((0.0, 0.04, 0.0))))
    there = wave_of(traced(moved, RADAR, knobs), "8 m", (0.0, 0.0, 0.0))
    own, stated = (next(b for b in x.bodies if b.name == "8 m") for x in (found, told))
    off = abs(wave_of(found, "8 m", (0.0, 0.04, 0.0)) - there) / own.level_amplitude
    assert 2 * own.estimated_error < off <= stated.estimated_error
    assert any("antennas aside: 50 mm" in line for line in told.warnings)
    near = with_receiver(0.011)
    alike = (find(scene, near, knobs, 0).bodies for find in (traced, traced_interval))
    for one, other in zip(*alike, strict=True):
        assert one.estimated_error == other.estimated_error


def traced(scene: Scene, radar: RadarDesign, knobs: Fidelity, seed: int = 0) -> Propagation:
    return trace(scene, radar, fidelity=knobs, seed=seed)


def with_receiver(aside_m: float) -> RadarDesign:
    """And one in the middle."""
    receivers_m = [[0.0, 0.0, 0.0], [0.0, aside_m, 0.0]]
    fields = {"transmitters_m": [[0.0, 0.0, 0.0]], "receivers_m": receivers_m}
    return RADAR.with_({"elements": fields})


def strip(distance_m: float, middle_m: float, half_m: float) -> np.ndarray:
    """Corners of one that faces the radar, 0.4 m high."""
    signs = ((-1, -1), (1, -1), (1, 1), (-1, 1))
    return np.array([[distance_m, middle_m + half_m * a, 0.2 * b] for a, b in signs])


def wave_of(found: Propagation, name: str, element_m: tuple[float, float, float]) -> complex:
    """Echo of an object at an element, at the carrier."""
    echoes, place = found.contributions, np.array(element_m)
    is_own = echoes.object == found.objects.index(name)
    length_m = speed_of_light * echoes.delay_s - nearer_m(echoes, place, place)
    return complex(np.sum((echoes.amplitude * np.exp(-1j * K * length_m))[is_own]))


@pytest.mark.parametrize("place_m", [(0.0, 0.02, 0.0), (0.01, -0.3, 0.2)])
@pytest.mark.parametrize("target_m", [(1.0, 0.5, 0.0), (0.6, -0.2, 0.3), (30.0, -5.0, 2.0)])
def test_each_antenna_has_its_own_gain_and_distance(
    place_m: tuple[float, float, float], target_m: tuple[float, float, float]
) -> None:
    """By the radar equation at its own place: 2 cm aside, 1.1 m from a target, 7 % were missing."""
    fields = {"transmitters_m": [place_m], "receivers_m": [place_m]}
    radar = RADAR.with_({"elements": fields, "antenna.gain_dbi": 15.0})
    scene = world(targets=(Target("point", target_m, (0.0, 0.0, 0.0), 1.0, "test"),))
    found = trace(scene, radar, fidelity=Fidelity(radar="targets"))
    (amplitude,) = np.abs(radar.burst.seen(found.contributions).amplitude)
    away = np.array(target_m) - place_m
    distance_m = float(np.linalg.norm(away))
    power_w = radar.received_power_w(distance_m, 1.0, tuple(away / distance_m))
    sent_w = radar.front_end.transmit_power_w.value
    assert amplitude == pytest.approx(np.sqrt(power_w / sent_w), rel=1e-9)


@pytest.mark.parametrize("order", [1, -1])
def test_whichever_of_the_farthest_comes_first_both_ends_are_compared(order: int) -> None:
    """Of a row only one end was, so that what the other sees past a strip was not stated."""
    places = ((5, 0.0, 0.03), (8, 0.06, 0.05))
    strips = [quad(f"{x} m", strip(x, y, half_m)) for x, y, half_m in places]
    ends_m = [[0.0, y, 0.0] for y in (0.05 * order, -0.05 * order)]
    fields = {"transmitters_m": [[0.0, 0.0, 0.0]], "receivers_m": ends_m}
    radar, knobs = RADAR.with_({"elements": fields}), PRESETS["standard"].with_(**ALONE)
    stated = [b.estimated_error for b in traced_interval(world(*strips), radar, knobs, 0).bodies]
    one = traced_interval(world(*strips), with_receiver(0.05), knobs, 0).bodies
    assert all(both >= alone.estimated_error for both, alone in zip(stated, one, strict=True))
    assert max(stated) > 0.5


@pytest.mark.parametrize("place", [[float("nan"), 0, 0], [0, 11.0, 0], [0, 0]])
def test_antennas_stand_within_ten_metres(place: list[float]) -> None:
    fields = {"transmitters_m": [[0.0, 0.0, 0.0]], "receivers_m": [place]}
    with pytest.raises(InputError, match="receivers_m"):
        RADAR.with_({"elements": fields})
    target = Target("point", (5.0, 0.2, 0.0), (0.0, 0.0, 0.0), 1.0, "test")
    rig = Rig(Pose((5.0, 0.0, 0.0)), radar=Pose((0.0, 0.0, 0.0)))
    with pytest.raises(InputError, match="'point': is 0 m from one of its antennas"):
        radar_capture(world(targets=(target,), rig=rig), with_receiver(0.2))

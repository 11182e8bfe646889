"""Frames that keep of an earlier one what nothing that has moved since concerns.

Each is compared with the same frame traced by itself: echoes of all bodies differ by less than both
tell of their errors, and where nothing of a body's ways is concerned, by nothing. What fails if a
way is kept that should not be: a body in a shadow that is new answers as before, one that comes out
of a shadow stays dark.
"""

import gc
import resource
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import trimesh

from hardware import process
from hardware.waveform import C_M_PER_S
from tests.physics.radar_worlds import (
    OPTICS,
    RADAR,
    ball,
    ground,
    plate,
    quad,
    reshaped,
    thing,
    trihedral,
    world,
)
from twin.errors import InputError
from twin.fidelity import Fidelity
from twin.radar import RadarDesign
from twin.radar.propagation.facets.convergence import band_of, summed_by
from twin.radar.propagation.result import Propagation
from twin.radar.propagation.solvers import trace
from twin.scene import Pose, Rig, Scene, load_scene
from twin.serve.sweeps import RadarSweeps

RIG = Rig(Pose((0.0, 0.0, 0.9)), radar=Pose((0.0, 0.0, 0.0)))


def moved(scene: Scene, name: str, by) -> Scene:
    """Every object whose name begins so is somewhere else."""
    objects = tuple(
        o.moved(np.asarray(by)) if o.name.startswith(name) else o for o in scene.objects
    )
    return replace(scene, objects=objects)


def box(name: str, center, size, material: str = "metal", turn_deg: float = 0.0, **more):
    mesh = trimesh.creation.box(size)
    mesh.apply_transform(trimesh.transformations.rotation_matrix(np.radians(turn_deg), [0, 0, 1]))
    return thing(name, mesh.vertices + np.asarray(center), mesh.faces, material, **more)


def echoes(found: Propagation) -> dict[tuple[str, ...], tuple[np.ndarray, float]]:
    """Of every body over the band, and the error that is told of it, in amplitude."""
    number = {name: k for k, body in enumerate(found.bodies) for name in body.objects}
    owner = np.array([number.get(name, -1) for name in found.objects])[found.surfaces.object]
    wave = RADAR.ofdm
    echo = summed_by(owner, len(found.bodies), found.surfaces, wave.carrier_hz, band_of(wave))
    rms = np.sqrt(np.mean(np.abs(echo) ** 2, axis=1))
    least = 0.01 * rms.max(initial=0.0)
    return {
        body.objects: (row, body.estimated_error * max(level, least))
        for body, row, level in zip(found.bodies, echo, rms, strict=True)
    }


def agree(one: Propagation, other: Propagation) -> bool:
    """Whether bodies differ by no more than is told of both."""
    first, second = echoes(one), echoes(other)
    strongest = max((np.sqrt(np.mean(np.abs(row) ** 2)) for row, _ in first.values()), default=0.0)
    # What is 40 dB fainter and more may be left out, as errors of so faint bodies count.
    silent = np.zeros(len(band_of(RADAR.ofdm))), 0.1 * 0.01 * strongest
    for name in {*first, *second}:
        (a, error_a), (b, error_b) = first.get(name, silent), second.get(name, silent)
        if np.sqrt(np.mean(np.abs(a - b) ** 2)) > error_a + error_b + 1e-12:
            return False
    return True


def frames(before: Scene, after: Scene, fidelity=OPTICS) -> tuple[Propagation, Propagation]:
    """That after, by itself and with what is kept of that before."""
    earlier = trace(before, RADAR, fidelity=fidelity, keep=True)
    alone = trace(after, RADAR, fidelity=fidelity)
    return alone, trace(after, RADAR, fidelity=fidelity, earlier=earlier)


def test_where_nothing_moved_all_is_kept_bit_for_bit() -> None:
    scene = load_scene("street")
    alone, kept = frames(scene, scene)
    assert kept.reused_share == 1
    assert np.array_equal(np.sort(alone.surfaces.amplitude), np.sort(kept.surfaces.amplitude))
    assert np.array_equal(np.sort(alone.surfaces.delay_s), np.sort(kept.surfaces.delay_s))
    told = [[b.estimated_error for b in found.bodies] for found in (alone, kept)]
    assert np.allclose(*told)


@pytest.mark.parametrize(
    ("name", "least"),
    [
        pytest.param("yard", 0.05, marks=pytest.mark.slow),
        pytest.param("street", 0.4, marks=pytest.mark.whole),
    ],
)
def test_a_car_that_drives_on(name: str, least: float) -> None:
    """The same echoes as by itself, within what is told, which is no more than half as much again
    as of a frame by itself: what is kept counts with the errors of both.
    """
    scene = load_scene(name)
    earlier = trace(scene, RADAR, keep=True)
    for step in (1, 30):
        after = moved(scene, "car", [0.0137 * step, 0, 0])
        alone, kept = trace(after, RADAR), trace(after, RADAR, earlier=earlier)
        assert kept.reused_share > least
        assert agree(alone, kept)
        told = {b.objects: b.estimated_error for b in alone.bodies}
        for body in kept.bodies:
            assert body.estimated_error < 2 * told[body.objects] + 0.05


@pytest.mark.thorough
def test_what_comes_between_is_seen_and_so_is_what_leaves() -> None:
    """A box that steps before a ball silences it, and lets it answer again where it leaves."""
    aside = box("box", (5, 2, 0), (0.5, 0.5, 0.5), turn_deg=30)
    beside = world(ball("hidden", (10, 0, 0)), aside, ball("other", (8, 1.5, 0)))
    before = moved(beside, "box", [0, -2, 0])
    for there, here in ((beside, before), (before, beside)):
        alone, kept = frames(there, here)
        assert agree(alone, kept)
        assert kept.reused_share > 0.1  # the other ball
        assert (("hidden",) in echoes(kept)) == (here is beside)


def test_a_way_over_the_ground_is_a_way() -> None:
    """A low box that only the way over the ground meets, which it darkens there."""
    far = box("box", (10, 5, 0.15), (0.3, 1.0, 0.3))
    scene = world(plate("plate", (20, 0, 0.9)), far, ground(0.0), rig=RIG)
    # The way over the ground comes down to it half way, 10 m ahead.
    alone, kept = frames(scene, moved(scene, "box", [0, -5, 0]))
    still = trace(scene, RADAR)
    assert agree(alone, kept)
    assert not agree(still, alone)
    assert not agree(still, kept)


@pytest.mark.thorough
def test_a_body_that_appears_in_the_ground() -> None:
    """What comes into view of the ground alone: the plate hides it from the radar itself."""
    scene = world(
        quad("screen", [[5, -1, 0.6], [5, 1, 0.6], [5, 1, 2], [5, -1, 2]]),
        ball("ball", (12, 6, 0.9), 0.2),
        ball("other", (9, -4, 0.5), 0.2, level=5),
        ground(0.0),
        rig=RIG,
    )
    alone, kept = frames(scene, moved(scene, "ball", [0, -6, 0]))
    assert agree(alone, kept)
    assert ("ball",) in echoes(kept)
    assert kept.reused_share > 0.05


def test_a_bounce_between_bodies_is_a_way() -> None:
    """Two plates at a right angle, a box that comes between them and not before them."""
    h = 0.15
    left = quad("left", [[10, 1.0 - h, -h], [10, 1.0 + h, -h], [10, 1.0 + h, h], [10, 1.0 - h, h]])
    right = quad(
        "right", [[10, -1.0 - h, -h], [10, -1.0 + h, -h], [10, -1.0 + h, h], [10, -1.0 - h, h]]
    )

    def turned(item, degrees: float):
        middle = item.vertices_m.mean(axis=0)
        turn = trimesh.transformations.rotation_matrix(np.radians(degrees), [0, 0, 1])[:3, :3]
        corners = (item.vertices_m - middle) @ turn.T + middle
        return thing(item.name, corners, item.geometry.faces)

    aside = np.degrees(np.arctan2(1, 10))
    scene = world(
        turned(left, 45 - aside / 2),
        turned(right, -45 + aside / 2),
        box("box", (10, 0, 1.0), (0.3, 0.3, 0.6)),
    )
    alone, kept = frames(scene, moved(scene, "box", [0, 0, -1.0]))
    assert agree(alone, kept)


@pytest.mark.quick(2)
@pytest.mark.parametrize("what", ["rig", "tolerance", "material", "mirror"])
def test_nothing_is_kept_where_more_than_an_object_changed(what: str) -> None:
    scene = world(
        plate("plate", (10, 0, 0.9)), ball("ball", (8, 2, 0.9), level=4), ground(0.0), rig=RIG
    )
    earlier, fidelity, after = trace(scene, RADAR, fidelity=OPTICS, keep=True), OPTICS, scene
    if what == "rig":
        after = scene.at(Pose((0.001, 0.0, 0.9)))
    elif what == "tolerance":
        fidelity = OPTICS.with_(radar_tolerance=0.05)
    elif what == "material":
        objects = [
            replace(o, material="wet_skin" if o.name == "x" else "concrete")
            if o.name == "ground"
            else o
            for o in scene.objects
        ]
        after = replace(scene, objects=tuple(objects))
    else:
        after = moved(scene, "ground", [0, 0, -0.01])
    assert trace(scene, RADAR, fidelity=OPTICS, earlier=earlier).reused_share == 1
    kept = trace(after, RADAR, fidelity=fidelity, earlier=earlier)
    alone = trace(after, RADAR, fidelity=fidelity)
    assert kept.reused_share == 0
    assert np.array_equal(kept.surfaces.amplitude, alone.surfaces.amplitude)


def test_a_frame_in_which_nothing_answers_may_be_an_earlier_one() -> None:
    """For there is no body, or an obstacle hides it: it answers when that has gone."""
    empty = trace(world(), RADAR, keep=True)
    assert trace(world(), RADAR, earlier=empty).reused_share == 0
    hidden = world(plate("wall", (4, 0, 0), 3.0, radar="obstacle"), ball("ball", (8, 0, 0), 0.1, 4))
    alone, kept = frames(hidden, moved(hidden, "wall", [0, 5, 0]))
    assert ("ball",) in echoes(kept)
    assert agree(alone, kept)


def test_what_is_no_earlier_frame_is_an_error() -> None:
    """But another name alone makes no other design."""
    scene = world(plate("plate", (10, 0, 0)))
    earlier = trace(scene, RADAR, fidelity=OPTICS, keep=True)
    other = RADAR.with_({"waveform.n_slots": 128})
    rough, targets = Fidelity(radar="rough"), Fidelity(radar="targets")
    wrong: list[tuple[Any, RadarDesign, Fidelity, str]] = [
        (object(), RADAR, OPTICS, "earlier: a object, expected the propagation of a frame"),
        (
            earlier.traced,
            RADAR,
            OPTICS,
            "earlier: a TracedFrame, expected the propagation of a frame",
        ),
        (trace(scene, RADAR, fidelity=OPTICS), RADAR, OPTICS, "earlier: traced without keep"),
        (earlier, other, OPTICS, "earlier: waveform of radar 'hybrid-79', with which it was"),
        (earlier, RADAR, rough, "earlier: traced with fidelity.radar = 'optics', expected 'rough'"),
        (earlier, RADAR, targets, "earlier: traced with fidelity.radar = 'optics'"),
    ]
    for what, radar, fidelity, words in wrong:
        with pytest.raises(InputError, match=words):
            trace(scene, radar, fidelity=fidelity, earlier=what)
    assert (
        trace(
            scene, RADAR.with_({"name": "renamed"}), fidelity=OPTICS, earlier=earlier
        ).reused_share
        == 1
    )


def test_rates_are_those_of_now() -> None:
    """A body whose velocity alone has changed is found anew, with its own rates."""
    scene = world(plate("plate", (10, 0, 0)), ball("ball", (8, 2, 0), level=4))
    objects = [
        replace(o, velocity_m_per_s=(3.0, 0, 0)) if o.name == "ball" else o for o in scene.objects
    ]
    after = replace(scene, objects=tuple(objects))
    alone, kept = frames(scene, after)
    assert np.array_equal(np.sort(alone.surfaces.delay_rate), np.sort(kept.surfaces.delay_rate))
    driving = [
        replace(o, velocity_m_per_s=(2.0, 0, 0)) if o.name == "ball" else o for o in scene.objects
    ]
    alone, kept = frames(replace(scene, objects=tuple(driving)), after)
    assert kept.reused_share > 0
    for found in (alone, kept):
        rates = C_M_PER_S * found.surfaces.delay_rate[found.surfaces.object == 1]
        assert found.objects[1] == "ball"
        assert np.allclose(rates, 2 * 3.0 * 8 / np.hypot(8, 2), rtol=0.02)


def test_what_a_strong_echo_made_negligible_is_found_when_that_is_gone() -> None:
    """Errors are relative to 40 dB below the strongest body at least: without it, others' count."""
    scene = world(trihedral("strong", (3, 0, 0), 100.0), ball("weak", (20, 4, 0), 0.1, level=5))
    alone, kept = frames(scene, moved(scene, "strong", [-30, 0, 0]))
    assert agree(alone, kept)
    assert all(b.estimated_error < 3 * b.tolerance + 0.01 for b in kept.bodies)


def flash(change: str, scene: Scene) -> Scene:
    """The scene after the flash of its plate has ended."""
    big, small = scene.objects
    if change == "aside":
        big = big.moved([0, -2.5, 0])
    elif change == "obstacle":
        big = replace(big, radar="obstacle")
    elif change == "wood":
        big = replace(big, material="wood")
    else:
        middle = big.vertices_m.mean(axis=0)
        turn = trimesh.transformations.rotation_matrix(np.radians(5), [0, 0, 1])[:3, :3]
        big = reshaped(big, (big.vertices_m - middle) @ turn.T + middle)
    return replace(scene, objects=(big, small))


@pytest.mark.parametrize("change", ["aside", "turned", "obstacle", "wood"])
def test_a_body_that_a_flash_outshone_answers_when_that_has_ended(change: str) -> None:
    """A ball far below a plate that faces the radar has no contribution beside it. When the flash
    ends it has, as strong as in the frame by itself, though nothing on its paths has changed.
    """
    scene = world(plate("big", (5, 0, 0.9), 1.0), ball("ball", (6, 1, 0.9), 0.02, 2), rig=RIG)
    earlier = trace(scene, RADAR, keep=True)
    assert [body.name for body in earlier.bodies] == ["big"]
    alone, kept = frames(scene, flash(change, scene))
    (here, told_here), (there, told_there) = echoes(alone)["ball",], echoes(kept)["ball",]
    assert np.sqrt(np.mean(np.abs(here - there) ** 2)) <= min(told_here, told_there)


@pytest.mark.whole
def test_what_a_flash_left_out_is_found_again_in_sweeps() -> None:
    """The first of a group of sweeps is the flash; the plate drives on, and a later sweep has the
    echoes of the ball, as the same one has that is traced by itself.
    """
    big = plate("big", (5, 0, 0.9), 1.0, velocity_m_per_s=(0.0, -5.0, 0.0))
    scene = world(big, ball("ball", (6, 1, 0.9), 0.02, 2), rig=RIG)
    sweep = 15
    full = RadarSweeps(scene, RADAR, 0, OPTICS)(sweep).record
    reused = RadarSweeps(scene, RADAR, 0, OPTICS, reuse=16)(sweep).record
    ranges = [[d.range_m for d in process(record).detections] for record in (full, reused)]
    ball_m = np.hypot(6, 1)
    for found in ranges:
        assert any(abs(range_m - ball_m) < 0.1 for range_m in found)
    assert len(ranges[0]) == len(ranges[1])


@pytest.mark.slow
def test_many_frames_in_the_memory_of_a_few() -> None:
    """One frame is kept, whatever comes after it."""
    scene = world(*(ball(f"{k}", (8, k - 3, 0.9), level=4) for k in range(6)), ground(0.0), rig=RIG)
    earlier = trace(scene, RADAR, keep=True)

    def drive(count: int) -> int:
        for step in range(count):
            trace(moved(scene, "3", [0.01 * step, 0, 0]), RADAR, earlier=earlier)
        gc.collect()
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss

    first = drive(4)
    assert drive(12) - first < 20_000  # KiB; a frame that is kept takes 34 000


@pytest.mark.quick(1)
@pytest.mark.parametrize(
    "seed",
    [
        *range(3),
        *(pytest.param(n, marks=pytest.mark.thorough) for n in range(3, 8)),
        *(pytest.param(n, marks=pytest.mark.slow) for n in range(8, 20)),
    ],
)
def test_random_scenes(seed: int) -> None:
    """Boxes, balls and plates on the ground, a wall behind them; some of them jump."""
    rng = np.random.default_rng([seed, 15])

    def place(height: float) -> np.ndarray:
        return np.array([rng.uniform(4, 20), rng.uniform(-4, 4), height])

    things = [ground(0.0, "concrete")] if seed % 4 else []
    if seed % 3 == 0:
        things.append(
            quad("wall", [[25, -20, 0], [25, 20, 0], [25, 20, 6], [25, -20, 6]], "concrete")
        )
    for k in range(int(rng.integers(2, 5))):
        size = rng.uniform(0.3, 1.5, 3)
        things.append(box(f"box {k}", place(size[2] / 2 + 0.01), size, turn_deg=rng.uniform(0, 90)))
    for k in range(int(rng.integers(1, 4))):
        things.append(
            ball(f"ball {k}", place(rng.uniform(0.5, 1.5)), rng.uniform(0.1, 0.3), level=4)
        )
    things.append(plate("plate", place(0.9)))
    scene = world(*things, rig=RIG)
    step = rng.choice([0.003, 0.1, 2.0])
    after = moved(scene, "box 0", step * np.array([*rng.normal(size=2), 0.0]))
    if seed % 2:
        after = moved(after, "ball 0", step * np.array([*rng.normal(size=2), 0.0]))
    alone, kept = frames(scene, after)
    assert agree(alone, kept)

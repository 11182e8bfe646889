"""What the sensors of a drive send: frame k of the camera, burst k of the radar."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from hardware.records import RadarRecord, SpiRecord
from twin.camera.acquisition import capture, measure
from twin.camera.mounting import devices
from twin.camera.still_world import StillWorld
from twin.camera.stream import numbered
from twin.camera.truth import Truth, render_truth
from twin.drive.plan import Drive, Event
from twin.engine import return_freed_memory
from twin.radar import RadarEcho, radar_echo
from twin.scene.mitsuba import mitsuba_scene
from twin.warned import CaptureWarning


def seed_of(seed: int, sensor: int, number: int) -> int:
    """Seed of one frame of one sensor."""
    words = np.random.SeedSequence([seed, sensor, number]).generate_state(2, np.uint32)
    return int(words[0]) << 31 | int(words[1]) >> 1


@dataclass(frozen=True, eq=False)
class Measured:
    """What a sensor sent, with warnings of it; of a camera's frame the ``truth`` of its middle."""

    record: SpiRecord | RadarRecord
    warnings: tuple[CaptureWarning, ...]
    truth: Truth | None = None


class Sensors:
    """Both sensors of a drive. In a moving world what they measure depends on nothing that they
    measured before.
    """

    def __init__(self, drive: Drive) -> None:
        self._camera, self._radar = CameraFrames(drive), RadarBursts(drive)

    def measured(self, event: Event) -> Measured:
        """In an event of one of them."""
        if event.kind == "camera":
            found = self._camera(event.number, event.begin_ns)
            found = replace(found, truth=self._camera.truth(event.middle_ns))
        else:
            found = self._radar(event.number)
        return_freed_memory()
        return found


@dataclass(frozen=True)
class CameraFrames:
    """The camera of a drive. A world at rest is rendered once, or as often as the sun's course
    needs.
    """

    drive: Drive

    def __call__(self, number: int, begin_ns: int) -> Measured:
        """Frame ``number``, which begins at a time of the reference, in device time."""
        drive, system = self.drive, self.drive.system
        assert system is not None
        seed = seed_of(drive.seed, 0, number)
        if drive.moves:
            world = drive.scene.after(1e-9 * begin_ns)
            taken = capture(world, system, seed=seed, fidelity=drive.knobs)
        else:
            rng = np.random.default_rng(seed)
            world, light = self._still.at(1e-9 * begin_ns)
            taken = measure(world, system, light, rng=rng, noise=drive.knobs.noise)
        begin_ns = drive.camera_clock.after_start(0)
        return Measured(numbered(taken.record, system, number, begin_ns), taken.warnings)

    def truth(self, at_ns: int) -> Truth:
        """Albedo and depth of the virtual image at a time of the reference."""
        drive, system = self.drive, self.drive.system
        assert system is not None
        if not drive.moves:
            return self._still.at(1e-9 * at_ns)[1].truth
        world = drive.scene.after(1e-9 * at_ns)
        emitter, _, _ = devices(world, system)
        return render_truth(mitsuba_scene(world), emitter, system.image_shape)

    @cached_property
    def _still(self) -> StillWorld:
        drive, seed = self.drive, np.random.SeedSequence([self.drive.seed, 2])
        assert drive.system is not None
        return StillWorld(drive.scene, drive.system, drive.knobs, seed)


class RadarBursts:
    """The radar of a drive. A world at rest is traced once, where that gives the same bits."""

    def __init__(self, drive: Drive) -> None:
        self._drive = drive
        self._still: RadarEcho | None = None
        self._warned: tuple[CaptureWarning, ...] = ()

    def __call__(self, number: int) -> Measured:
        """Burst ``number``, in device time; its pose is that of its middle."""
        drive, seed = self._drive, seed_of(self._drive.seed, 1, number)
        echo = self._echo(drive.burst_ns(number), seed)
        record = echo.record()
        if echo.bursts:
            self._warned = echo.warnings(record)
        begin = drive.radar_clock.after_start(round(number * 1e9 * drive.radar_period_s))
        record = replace(record, device_time_ns=record.device_time_ns + begin)
        return Measured(record, self._warned)

    def _echo(self, middle_ns: int, seed: int) -> RadarEcho:
        drive = self._drive
        assert drive.radar is not None
        if self._still is not None and (again := self._still.reseeded(seed)) is not None:
            return again
        weather = drive.system.weather if drive.system else None
        echo = radar_echo(
            replace(drive.scene, track=None).after(1e-9 * middle_ns),
            drive.radar,
            seed=seed,
            fidelity=drive.knobs,
            weather=weather,
        )
        if not drive.moves:
            self._still = echo.condensed()
        return echo

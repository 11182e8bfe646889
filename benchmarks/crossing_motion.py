"""Motion by the radar's tracks in `scenes/crossing`: what of the loss of each frame it regains.

`python -m benchmarks.crossing_motion [FRAMES] [SEED]` prints for each frame of a drive, system
`workable` in the order `interleaved`, radar `hybrid-79-mimo`: PSNR (peak: the brightest cell;
truth: the light in the frame's middle) of LMMSE at rest, moving and taken as at rest, and
compensated as `ugv process LOG --motion radar` does; what was taken out; CPU time of the search.
Light is computed to the default tolerance, echoes as `draft`.
"""

import math
import sys
import time
from dataclasses import replace

from hardware import reconstruct
from hardware.drivers.clock import ClockModel
from hardware.motion_of_tracks import MotionOfTracks
from hardware.radar.process import frames
from hardware.recording import Received
from hardware.recording.mounting import Mounting
from hardware.records import QuaternionPose
from hardware.tracks import RadarTracks
from twin.camera.acquisition import Capture, capture
from twin.camera.score import psnr_db
from twin.camera.stream import numbered
from twin.drive import Drive
from twin.drive.sensors import RadarBursts, seed_of
from twin.fidelity import PRESETS, Tolerance
from twin.radar import load_radar
from twin.scene import load_scene
from twin.system import load_system

_ON_TIME = ClockModel(0, 0, 0.0, 0.0)


def main(n_frames: int, seed: int) -> None:
    scene, radar = load_scene("crossing"), load_radar("hybrid-79-mimo")
    system = load_system("workable").with_({"acquisition.order": "interleaved"})
    frame_s = system.frame_time_s
    drive = Drive(scene, None, radar, n_frames * frame_s, PRESETS["draft"], seed=seed)
    bursts, events = RadarBursts(drive), [e for e in drive.events() if e.kind == "radar"]
    field = math.radians(system.emitter.field_of_view_deg.value)
    rig = scene.rig
    poses = {
        name: QuaternionPose.of(device.position_m, device.rotation)
        for name, device in (("spi", rig.emitter), ("radar", rig.radar))
    }
    motion, tracks = MotionOfTracks(Mounting(poses, {"spi": (field, field)})), RadarTracks()
    still = Tolerance().knobs().with_(motion_tolerance=None)
    for number in range(n_frames):
        begin_s, end_ns = number * frame_s, round(1e9 * (number + 1) * frame_s)
        while events and events[0].end_ns <= end_ns:
            event = events.pop(0)
            record = bursts(event.number).record
            for frame in frames(record, None):
                pose, middle_ns = record.pose[0], frame.middle_ns
                confirmed = tracks.update("/radar", frame.detections, middle_ns, pose)
                motion.burst("/radar", middle_ns, pose, confirmed)
        moving = capture(scene.after(begin_s), system, seed=seed_of(seed, 0, number))
        middle = scene.after(begin_s + frame_s / 2)
        rest = capture(middle, system, seed=seed_of(seed, 2, number), fidelity=still)
        _tell(number, rest, _numbered(moving, system, number), motion, end_ns)


def _numbered(taken: Capture, system: object, number: int) -> Capture:
    """With the times of frame ``number`` of a drive."""
    return replace(taken, record=numbered(taken.record, system, number, 0))  # type: ignore[arg-type]


def _tell(number: int, rest: Capture, moving: Capture, motion: MotionOfTracks, end_ns: int) -> None:
    truth, start = moving.measured_scene_e, time.process_time()
    received = Received("/spi/record", moving.record, end_ns, _ON_TIME)
    found, told = motion.supported(received, "/spi")
    took_s = time.process_time() - start
    images = (
        reconstruct(rest.record),
        reconstruct(moving.record),
        reconstruct(moving.record, motion=found.motion),
    )
    levels = " / ".join(f"{psnr_db(truth, one.image[0]):.1f}" for one in images)
    print(f"frame {number}: at rest / moving / compensated {levels} dB; {took_s:.0f} s; {told}")


if __name__ == "__main__":
    given = [int(one) for one in sys.argv[1:3]]
    main(*given, *(2, 1)[len(given) :])

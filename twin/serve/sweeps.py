"""What a scene answers to each sweep of a radar."""

from dataclasses import dataclass, replace

from hardware.records import RadarRecord
from twin.fidelity import Fidelity
from twin.radar import RadarDesign, RadarEcho, radar_echo
from twin.scene import Scene


@dataclass(frozen=True, eq=False)
class Sweep:
    """The scene's answer, and what is recorded where the waveform's own samples are sent."""

    echo: RadarEcho
    record: RadarRecord


class Sweeps:
    """Sweep k of a radar, with ``seed`` plus k.

    From one sweep to the next everything moves on by a burst's time, and the rig to the next stop
    of the scene's track, where it has one. What stands as it stood is not traced again, wherever
    that gives the same bits.

    Parameters
    ----------
    scene, radar, seed, fidelity
        As `radar_echo` takes them.
    """

    def __init__(
        self, scene: Scene, radar: RadarDesign, seed: int, fidelity: Fidelity | None = None
    ) -> None:
        self._scene, self._radar = scene, radar
        self._seed, self._fidelity = seed, fidelity
        self._stops = scene.track.poses(scene.rig.pose) if scene.track else [scene.rig.pose]
        self._last: tuple[int, RadarEcho] | None = None  # stop and echo

    def __call__(self, number: int) -> Sweep:
        """One sweep, in any order. Raises InputError as `radar_echo` does."""
        stop = min(number, len(self._stops) - 1)
        echo = self._again(number, stop) or self._traced(number, stop)
        self._last = stop, echo
        return Sweep(echo, echo.record())

    def record(self, number: int) -> RadarRecord:
        """The record of one sweep, in the device time of all: sweeps follow without a pause."""
        begun_ns = round(1e9 * number * self._radar.burst_s)
        record = self(number).record
        return replace(record, device_time_ns=record.device_time_ns + begun_ns)

    def _again(self, number: int, stop: int) -> RadarEcho | None:
        if self._last is None or self._last[0] != stop or not self._scene.at_rest:
            return None
        return self._last[1].reseeded(self._seed + number)

    def _traced(self, number: int, stop: int) -> RadarEcho:
        return radar_echo(
            self._scene.after(number * self._radar.burst_s),
            self._radar,
            seed=self._seed + number,
            fidelity=self._fidelity,
            poses=[self._stops[stop]],
        ).condensed()

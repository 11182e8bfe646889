"""Echoes of a scene for each sweep of a radar."""

from dataclasses import dataclass, replace

from hardware.records import RadarRecord
from twin.errors import InputError
from twin.fidelity import Accuracy
from twin.radar import RadarDesign, RadarEcho, radar_echo
from twin.radar.propagation.result import Propagation
from twin.scene import Scene


@dataclass(frozen=True, eq=False)
class RadarSweep:
    """Echoes of one sweep, and their record for the waveform's own samples."""

    echo: RadarEcho
    record: RadarRecord


class RadarSweeps:
    """Sweep k of a radar, with ``seed`` plus k.

    The first begins now: as in `radar_capture` the scene is that of its middle. From one sweep to
    the next all objects move on by ``period_s``, and the rig to the next stop of the scene's track,
    where it has one. A scene at rest is not traced again, if that gives
    the same bits.

    Parameters
    ----------
    scene, radar, seed, fidelity
        As in `radar_echo`.
    reuse
        Sweeps that are traced together: the first of so many in full, and the others keep of it the
        echoes on whose paths nothing has changed; each in full where the rig or a surface that
        mirrors moves (``earlier`` of `radar_capture`). So a sweep depends on its number alone,
        whichever are asked for before. At 1 each is that of a capture, bit for bit; at more it
        differs within the errors that it tells.
    period_s
        By which the world goes on from sweep to sweep; default: a burst.
    """

    def __init__(
        self,
        scene: Scene,
        radar: RadarDesign,
        seed: int,
        fidelity: Accuracy | None = None,
        reuse: int = 1,
        period_s: float | None = None,
    ) -> None:
        if reuse < 1:
            raise InputError(f"reuse: {reuse} sweeps traced together, expected at least 1")
        self._scene, self._radar = scene, radar
        self._seed, self._fidelity = seed, fidelity
        self._period_s = radar.burst_s if period_s is None else period_s
        self._stops = scene.track.poses(scene.rig.pose) if scene.track else ()
        self._last: tuple[int, RadarEcho] | None = None  # stop and echo
        self._reuse = reuse
        self._full: tuple[int, Propagation] | None = None  # number and what was found

    def __call__(self, number: int) -> RadarSweep:
        """One sweep, in any order. Raises InputError as `radar_echo` does."""
        stop = self._stop(number)
        echo = self._without_tracing(number, stop) or self._traced(number, stop)
        self._last = stop, echo
        return RadarSweep(echo, echo.record())

    def beginning(self, begins_s: float, period_s: float | None) -> "RadarSweeps":
        """Those of the world as it is ``begins_s`` after the scene's own time."""
        return RadarSweeps(
            *(self._scene.after(begins_s), self._radar, self._seed, self._fidelity),
            reuse=self._reuse,
            period_s=period_s,
        )

    def record(self, number: int) -> RadarRecord:
        """The record of one sweep, in the device time of all: sweeps follow without a pause."""
        begun_ns = round(1e9 * number * self._radar.burst_s)
        record = self(number).record
        return replace(record, device_time_ns=record.device_time_ns + begun_ns)

    def _without_tracing(self, number: int, stop: int) -> RadarEcho | None:
        if self._last is None or self._last[0] != stop:
            return None
        if self._scene.rig.moves or not self._scene.at_rest:
            return None
        return self._last[1].reseeded(self._seed + number)

    def _traced(self, number: int, stop: int) -> RadarEcho:
        first = number - number % self._reuse
        if self._reuse == 1 or self._stop(first) != stop:
            return self._echo(number).condensed()
        if self._full is None or self._full[0] != first:
            echo = self._echo(first, keep=True)
            self._full = first, echo.bursts[0]
            if number == first:
                return echo.condensed()
        return self._echo(number, self._full[1]).condensed()

    def _echo(
        self, number: int, earlier: Propagation | None = None, *, keep: bool = False
    ) -> RadarEcho:
        return radar_echo(
            self._scene.after(number * self._period_s + self._radar.middle_s),
            self._radar,
            seed=self._seed + number,
            fidelity=self._fidelity,
            poses=[self._stops[self._stop(number)]] if self._stops else None,
            earlier=earlier,
            keep=keep,
        )

    def _stop(self, number: int) -> int:
        return min(number, max(len(self._stops) - 1, 0))


class SweepsOfWorld:
    """Sweeps that may begin at any time of a world, as those of ``first`` do at the scene's own."""

    def __init__(self, first: RadarSweeps) -> None:
        self._first = self._sweeps = first
        self._begun: tuple[float, float | None] = 0.0, None

    def __call__(
        self, number: int, begins_s: float = 0.0, period_s: float | None = None
    ) -> RadarSweep:
        """Sweep ``number`` of those that begin then. Raises InputError as `RadarSweeps` does."""
        if (begins_s, period_s) != self._begun:
            self._sweeps = self._first.beginning(begins_s, period_s)
            self._begun = begins_s, period_s
        return self._sweeps(number)

"""From light to counts: the part of a camera that depends on neither scene nor pose."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from hardware.patterns import Patterns
from hardware.read_only import read_only
from hardware.records import QuaternionPose, SpiRecord
from twin import __version__
from twin.camera.filtered import share_of_cells, sun_of_parts
from twin.camera.illumination import (
    amplifier_keeps,
    amplifier_lag,
    amplifier_residue,
    fading,
    frame_signal,
    mean_signal,
    residual_share,
    settled,
)
from twin.camera.shutters import (
    ShutterResponse,
    most_collected,
    shutters,
    unambiguous_m,
    weight,
)
from twin.detector import Detector, FrontEnd, NoiseBudget
from twin.detector.flicker import ExposureTimes, in_image
from twin.detector.interface import check_detector, checked_exposure
from twin.fidelity import Noise
from twin.optics.emission import cell_gains
from twin.optics.passband import Passband, passband
from twin.optics.radiometry import Collection, collection, near_pupil_m
from twin.optics.spectra import responsivity_a_per_w
from twin.own_parts import made_by
from twin.scene import Pose, Sun
from twin.system import Sky, System
from twin.toml import Sourced

if TYPE_CHECKING:
    from twin.camera.rendered import RenderedLight

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Powers:
    """Power on the detectors, W: from each cell lit alone, (n_shutters, n_detectors, n_cells), with
    its Monte-Carlo error (n_detectors, n_cells), and from the sun (n_detectors,).
    ``backscatter_w``: the part of ``cells_w`` that the air scattered back. ``left_out_w``: bound of
    each cell's light that the render left out, (n_detectors, n_cells). ``sun_error_w``,
    ``sun_left_out_w`` (n_detectors,): standard error of ``sun_w``, and bound of what is left out of
    it. ``sun_of_cells_w`` (n_cells,): the sun while a cell is lit, of a detector whose field
    follows it; ``sun_w`` is then the mean.
    """

    cells_w: Array
    error_w: Array
    sun_w: Array
    backscatter_w: Array
    left_out_w: Array
    sun_error_w: Array
    sun_left_out_w: Array
    sun_of_cells_w: Array | None = None

    def sun_by_exposure(self, patterns: Patterns) -> Array:
        """Sun on the detectors, W: (n_detectors,), or (n_exposures, 1, n_detectors) where it is not
        the same in all exposures.
        """
        if self.sun_of_cells_w is None:
            return self.sun_w
        lit = np.repeat(self.sun_of_cells_w, patterns.n_exposures // patterns.count)
        return lit[:, None, None]


def _sky(system: System, sun: Sun) -> Passband:
    """Of the system's own sky, or else the scene's sun: of one that moves the spectrum is that of
    its elevation.
    """
    if system.sky and not sun.has_set:
        return passband(system, system.sky)
    if sun.moves:
        low = Sourced(value=sun.elevation_deg, source="scene.toml")
        return passband(system, Sky(sun_elevation_deg=low), sun.share)
    return passband(
        system, Sky(illuminance_lx=Sourced(value=sun.illuminance_lx, source="scene.toml"))
    )


@dataclass(frozen=True, eq=False)
class Chain:
    """Lens, filter under a sky, shutters, detector and amplifier of a system."""

    system: System
    lens: Collection
    sky: Passband
    shutters: tuple[ShutterResponse, ...]
    front_end: Detector
    gains: Array

    @classmethod
    def of(cls, system: System, sun: Sun, detector: Detector | None = None) -> "Chain":
        """Chain of a system, under its own sky or else the scene's sun; of a sun that has moved
        below the horizon, in the dark. ``detector``: in place of
        the system's detector and readout, `detector.function` among them. Raises InputError for an
        incomplete one.
        """
        if detector is None and (given := system.detector.function) is not None:
            detector = made_by("detector.function", given.value, system, Detector)
        responsivity = responsivity_a_per_w(system.detector, system.emitter, system.filter)
        return cls(
            system=system,
            lens=collection(system),
            sky=read_only(_sky(system, sun)),
            shutters=shutters(system),
            front_end=FrontEnd.of(system, responsivity)
            if detector is None
            else check_detector(detector),
            gains=read_only(cell_gains(system.emitter)),
        )

    @cached_property
    def patterns(self) -> Patterns:
        """The pattern set of the emitter."""
        return self.system.patterns

    @property
    def open_share(self) -> Array:
        """Share of the time that the detector is open, by shutter."""
        return np.array([shutter.open_share for shutter in self.shutters])

    def watts(self, passed: Array) -> Array:
        """Power of each cell of light 1 on its detector, (n_detectors, n_cells), of whose light the
        filter passes these shares.
        """
        intensity = self.system.emitter.radiant_intensity_w_per_sr.value
        collected = self.lens.transmission * self.lens.pupil_area_m2
        return np.asarray(intensity * collected * passed * self.gains)

    def watts_of(self, rendered: "RenderedLight") -> Array:
        """The same of the light rendered, as the filter passes it from each cell."""
        passed = self.passed(rendered)
        if not self.system.emitter.has_lens:  # every LED lights the whole field
            passed = np.full_like(passed, passed.mean())
        return self.watts(passed)

    @cached_property
    def largest_share(self) -> float:
        """Largest share of a cell's light that the shutters collect, all together, averaged over
        the exposure.
        """
        if self.system.time_of_flight is None:
            return 1.0
        ends_m = np.zeros(1), np.full(1, 2 * unambiguous_m(self.system))
        return float(most_collected(self.shutters, *ends_m)[0])

    def passed(self, rendered: "RenderedLight") -> Array:
        """Share of light that the filter passes from each cell, (n_detectors, n_cells)."""
        view = rendered.truth, rendered.emitter, rendered.detector
        return self._of_view(
            "cells", view, lambda: _by_detector(share_of_cells(rendered, self.sky), self.system)
        )

    def _of_view(self, what: str, view: tuple[object, ...], found: Callable[[], Array]) -> Array:
        """What is found of a view; asked again of the same objects it is not computed anew."""
        known = self._known.get(what)
        if known is None or any(a is not b for a, b in zip(known[0], view, strict=True)):
            known = self._known[what] = view, found()
            known[1].flags.writeable = False
        return known[1]

    @cached_property
    def _known(self) -> dict[str, tuple[tuple[object, ...], Array]]:
        """Views, and what was found of them."""
        return {}

    def powers(self, rendered: "RenderedLight") -> Powers:
        """Power of the rendered light on the detectors."""
        watt, light = self.watts_of(rendered), rendered.light
        cells, error, backscatter = self._behind_shutters(rendered)
        share = np.full_like(light.cells, self.largest_share)
        np.divide(cells.sum(axis=0), light.cells, out=share, where=light.cells > 0)
        return Powers(
            cells_w=watt * cells,
            error_w=watt * error,
            sun_w=self.sun_power(rendered),
            backscatter_w=watt * backscatter,
            left_out_w=_left_out(
                watt * share, light.left_out + self._of_pupil(rendered) * light.cells
            ),
            sun_error_w=self._sun_error(rendered),
            sun_left_out_w=self._sun_left_out(rendered),
            sun_of_cells_w=self._sun_of_cells(rendered),
        )

    def _sun_of_cells(self, rendered: "RenderedLight") -> Array | None:
        """Of a detector that follows the lit cell: sun from the cells that it sees with it."""
        optics = self.system.optics
        if not optics.is_scanned:
            return None
        side = optics.receiver_cells.value if optics.receiver_cells else 1
        parts = self.sun_weight(rendered) * rendered.sun
        seen = side**2 * uniform_filter(parts, side, mode="nearest")
        return np.asarray(seen[rendered.cell_parts()].ravel())

    def sun_power(self, rendered: "RenderedLight") -> Array:
        """Power of the sun on the detectors, (n_detectors,)."""
        followed = self._sun_of_cells(rendered)
        if followed is not None:
            return followed.mean(keepdims=True)
        return self._of_detectors(self.sun_weight(rendered) * rendered.sun)

    def sun_weight(self, rendered: "RenderedLight") -> Array:
        """That power per unit of each part of `RenderedLight.sun`."""
        collected = self.lens.transmission * self.lens.pupil_area_m2
        parts = f"sun in {rendered.sun.shape}"
        return self._of_view(
            parts, (rendered.detector,), lambda: collected * sun_of_parts(rendered, self.sky)
        )

    def _sun_error(self, rendered: "RenderedLight") -> Array:
        """Standard error of that power, (n_detectors,)."""
        return np.sqrt(self._of_exposure((self.sun_weight(rendered) * rendered.sun_error) ** 2))

    def _sun_left_out(self, rendered: "RenderedLight") -> Array:
        """Bound of what is left out of that power, (n_detectors,)."""
        beyond = rendered.sun_left_out + self._of_pupil(rendered) * rendered.sun
        return self._of_exposure(_left_out(self.sun_weight(rendered), beyond))

    def _of_pupil(self, rendered: "RenderedLight") -> float:
        """Share of the light that a pupil takes too much where its area does not count."""
        nearest_m = float(rendered.truth.depth_m.min(initial=np.inf))
        if self.system.optics.focus_m or near_pupil_m(self.lens, nearest_m):
            return 0.0
        return (self.lens.pupil_diameter_m / 2 / nearest_m) ** 2

    def _of_exposure(self, parts: Array) -> Array:
        """Sum over the parts of the field that a detector sees in an exposure, in the mean."""
        if self.system.optics.is_scanned:
            seen = self.system.receiver_share * self.system.patterns.n_cells
            return np.asarray(seen * np.mean(parts, keepdims=True).reshape(1))
        return self._of_detectors(parts)

    def _of_detectors(self, parts: Array) -> Array:
        """Sum of the parts of the field (rows, columns) by detector, (n_detectors,)."""
        one = self.system.n_detectors == 1
        return np.asarray(parts.sum(keepdims=True).reshape(1) if one else parts.sum(axis=0))

    def _behind_shutters(self, rendered: "RenderedLight") -> tuple[Array, Array, Array]:
        """Light behind each shutter, (n_shutters, n_detectors, n_cells); the standard error of all
        together, (n_detectors, n_cells); and the part of the light that the air scattered back.
        """
        air, paths = rendered.backscatter, rendered.paths
        if paths is None:
            cells = rendered.light.cells[None]
            return cells, rendered.light.error, air.light[None] if air else np.zeros_like(cells)
        responses = [weight(shutter) for shutter in self.shutters]
        cells, error = paths.behind(responses, partial(most_collected, self.shutters))
        one = (len(cells), 1, -1)  # detector
        backscatter = np.zeros_like(cells)
        if air is not None:
            assert air.paths is not None  # rendered for a system with time of flight
            backscatter = np.array([air.paths.light(response) for response in responses])
        cells += backscatter
        return cells.reshape(one), error.reshape(1, -1), backscatter.reshape(one)

    def mean_signal(self, power: Powers) -> Array:
        """Mean signal, (n_exposures, n_shutters, n_detectors) in W."""
        return mean_signal(self.system, power.cells_w)

    def measure_frame(
        self,
        power: Powers,
        *,
        rng: np.random.Generator,
        noise: Noise = "full",
        mean_w: Array | None = None,
        sun_w: Array | None = None,
    ) -> tuple[Array, NDArray[np.int32], NDArray[np.uint8]]:
        """One frame: signal (n_exposures, n_shutters, n_detectors) in W; counts and flags.

        ``mean_w``: `mean_signal` of these powers, if already computed; or that of light that
        changes from exposure to exposure, then with the sun's power in each of them, ``sun_w``
        (n_exposures, n_shutters, n_detectors).
        """
        fluctuating = None if noise == "none" else rng
        signal_w = frame_signal(self.system, power.cells_w, rng=fluctuating, mean_w=mean_w)
        sun_w = power.sun_by_exposure(self.patterns) if sun_w is None else sun_w
        settled_w = self.amplifier_output(signal_w, sun_w, power.sun_w)
        counts, flags = checked_exposure(self.front_end, settled_w, rng, noise)
        return signal_w, counts, flags

    def exposure_power(self, signal_w: Array, sun_w: Array) -> Array:
        """Signal and sun of every exposure in turn, (n_exposures x n_shutters, n_detectors), W;
        ``sun_w`` as `Powers.sun_by_exposure` gives it.
        """
        power_w = signal_w + self.open_share[:, None] * sun_w
        return np.asarray(power_w.reshape(-1, power_w.shape[-1]))

    def amplifier_output(self, signal_w: Array, sun_w: Array, before_w: Array) -> Array:
        """`exposure_power` behind the amplifier, whose pole carries a share of each into later
        ones, and follows light that fades within an exposure; ``before_w``: sun before the frame.
        """
        exposed_w, alone = self.exposure_power(signal_w, sun_w), amplifier_residue(self.system)
        if not alone:
            return exposed_w
        lasting_w = fading(self.system, signal_w).reshape(exposed_w.shape)
        level_w = exposed_w - residual_share(self.system) * lasting_w
        in_mean, at_end = amplifier_lag(self.system)
        dark_w = self.open_share[-1] * before_w  # before the frame no cell is lit
        ends = settled(level_w + at_end * lasting_w, amplifier_keeps(self.system), dark_w)
        before = np.concatenate([dark_w[None], ends[:-1]])
        return level_w + alone * (before - level_w) + in_mean * lasting_w

    def noise(self, signal_w: Array, sun_w: Array) -> NoiseBudget:
        """Budget at the mean of exposures."""
        fluctuation = self.system.emitter.intensity_noise
        relative = fluctuation.value if fluctuation else 0.0
        with np.errstate():  # what a user's own may set ends with it, as of `OwnFunction`
            budget = self.front_end.noise_budget(signal_w, sun_w, relative)
        times = self.exposure_times
        return in_image(budget, self.patterns, times) if times else budget

    @property
    def exposure_times(self) -> ExposureTimes | None:
        """Of the bundled detector, for its 1/f noise; None of a user's own, whose budget is taken
        as it is.
        """
        return self.front_end.times if isinstance(self.front_end, FrontEnd) else None

    def noise_by_detector(self, signal_w: Array, sun_w: Array) -> list[NoiseBudget]:
        """Budget of each detector, in one exposure.

        ``signal_w`` (n_exposures, n_shutters, n_detectors) as `measure_frame` gives it; ``sun_w``
        (n_detectors,) while the detector is open.
        """
        sun_w = float(self.open_share.mean()) * sun_w
        return [
            self.noise(signal, sun)
            for signal, sun in zip(np.moveaxis(signal_w, -1, 0), sun_w, strict=True)
        ]

    def record(
        self, pose: Pose, counts: NDArray[np.int32], flags: NDArray[np.uint8], number: int = 0
    ) -> SpiRecord:
        """Record for the vehicle, number ``number`` of a series without pauses."""
        n, system = len(counts), self.system
        period_ns = system.acquisition.pattern_period_s.value * 1e9
        exposures = np.arange(number * n, (number + 1) * n)
        turns = exposures // len(self.shutters) if system.gates_at_once else exposures
        return SpiRecord(
            counts=counts,
            device_time_ns=np.rint(turns * period_ns).astype(np.int64),
            sequence=(exposures % 2**32).astype(np.uint32),
            flags=flags,
            patterns=self.patterns,
            shutters=tuple(shutter.recorded for shutter in self.shutters),
            pulse_width_s=self.shutters[0].pulse_width_s,
            integration_time_s=system.acquisition.integration_time_s.value,
            electrons_per_count=self.front_end.electrons_per_count,
            offset_counts=self.front_end.offset_counts,
            adc_bits=self.front_end.adc_bits,
            device=f"twin {__version__}: {system.name}",
            pose=QuaternionPose.of(pose.position_m, pose.rotation),
        )


def _left_out(weight: Array, bound: Array | float) -> Array:
    """Bound of power: of light of which none arrives nothing is left out, be the bound infinite."""
    return np.multiply(weight, bound, out=np.zeros_like(weight), where=weight > 0)


def _by_detector(image: Array, system: System) -> Array:
    """Cells of an image with the detectors side by side, (n_detectors, n_cells)."""
    return np.stack(np.hsplit(image, system.n_detectors)).reshape(system.n_detectors, -1)

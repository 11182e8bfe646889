"""A user's own detector: a photon counter with dead time, against its closed form."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy import constants

from hardware import Flag
from twin.camera import capture
from twin.detector import Detector, FrontEnd, NoiseBudget
from twin.errors import InputError
from twin.fidelity import Fidelity
from twin.scene import load_scene
from twin.system import load_system

QUICK = Fidelity(samples=16, max_depth=1)
T_S = 1e-4


@dataclass(frozen=True)
class Spad:
    """Free-running single-photon counter with a dead time that photons do not extend.

    Of detectable events at a rate r it counts r T / (1 + r tau), with a variance of
    r T / (1 + r tau)^3 (Mueller, Nucl. Instrum. Methods 112, 1973; T much longer than tau).
    """

    efficiency: float = 0.25
    dark_rate_hz: float = 1e4
    dead_time_s: float = 0.0
    wavelength_m: float = 1550e-9
    integration_time_s: float = T_S
    electrons_per_count: float = 1.0
    offset_counts: float = 0.0
    adc_bits: int = 24

    @property
    def electrons_per_watt(self) -> float:
        photon_j = constants.h * constants.c / self.wavelength_m
        return self.efficiency * self.integration_time_s / photon_j

    @property
    def dark_e(self) -> float:
        return self.dark_rate_hz * self.integration_time_s

    def _linear_e(self, power_w):
        return power_w * self.electrons_per_watt + self.dark_e

    def _alive(self, power_w):
        """Share of the time in which it would count."""
        rate_hz = self._linear_e(power_w) / self.integration_time_s
        return 1 / (1 + rate_hz * self.dead_time_s)

    def mean_e(self, power_w):
        return self._linear_e(power_w) * self._alive(power_w)

    def expose(self, power_w, *, rng, noise="full"):
        """Intervals between counts are the dead time and an exponential one."""
        mean = self._linear_e(power_w)
        counts = np.zeros(power_w.shape, np.int32)
        for place in np.ndindex(power_w.shape):
            wait_s = self.integration_time_s / mean[place]
            n = int(1.2 * mean[place] + 50)
            times = np.cumsum(rng.exponential(wait_s, n) + self.dead_time_s) - self.dead_time_s
            assert times[-1] > self.integration_time_s
            counts[place] = np.count_nonzero(times < self.integration_time_s)
        return counts, np.zeros(len(power_w), np.uint8)

    def noise_budget(self, signal_w, background_w, emitter_noise=0.0):
        signal = float(np.mean(signal_w)) * self.electrons_per_watt
        background = float(np.mean(background_w)) * self.electrons_per_watt
        alive = float(self._alive(np.mean(signal_w) + np.mean(background_w)))
        # Of the light, not of the counts, whose slope over it is alive^2: alive^3 / alive^4.
        parts = {"signal": signal, "sun": background, "dark current": self.dark_e}
        return NoiseBudget(
            signal_e=signal,
            background_e=background,
            dark_e=self.dark_e,
            noise_e={f"shot noise of the {n}": (e / alive) ** 0.5 for n, e in parts.items()}
            | {
                "fluctuation of the emitter": emitter_noise * signal,
                "quantisation": 0.0,
            },
        )


@pytest.mark.parametrize("dead_time_s", [0.0, 50e-9, 1e-6])
def test_dead_time_takes_counts_and_scatter(dead_time_s: float) -> None:
    """Mean and variance of 20 000 exposures to 1000 events each, within five standard errors and
    what the closed form, of T much longer than the dead time, leaves out: up to half a count, and
    the rounding's variance of about 1/12.
    """
    spad = Spad(dead_time_s=dead_time_s)
    power_w = np.full((20_000, 1), (1000 - spad.dark_e) / spad.electrons_per_watt)
    counts, _ = spad.expose(power_w, rng=np.random.default_rng(0))
    alive = 1 / (1 + 1000 / T_S * dead_time_s)
    mean, variance = 1000 * alive, 1000 * alive**3
    assert spad.mean_e(power_w[:1]) == pytest.approx(mean)
    assert counts.mean() == pytest.approx(mean, abs=5 * (variance / 20_000) ** 0.5 + 0.5)
    assert counts.var() == pytest.approx(variance, abs=5 * (2 / 20_000) ** 0.5 * variance + 0.1)


def test_both_are_detectors() -> None:
    assert isinstance(FrontEnd.of(load_system("workable")), Detector)
    assert isinstance(Spad(), Detector)


def test_a_capture_with_it_shows_its_noise() -> None:
    """A frame through the whole chain: counts average to what the light says."""
    scene, system = load_scene("table1"), load_system("workable")
    time_s = system.acquisition.integration_time_s.value
    spad = Spad(integration_time_s=time_s, efficiency=1e-3)
    own = capture(scene, system, seed=1, fidelity=QUICK, detector=spad)
    power_w = own.signal_w + own.background_w
    expected = spad.mean_e(power_w)
    scatter = (own.record.counts - expected) / np.sqrt(expected)
    assert scatter.mean() == pytest.approx(0, abs=5 / scatter.size**0.5)
    assert scatter.std() == pytest.approx(1, abs=5 / (2 * scatter.size) ** 0.5)
    assert own.record.electrons_per_count == 1
    assert "Spad" in own.assumptions[-1]


def test_the_bundled_one_given_by_hand_gives_the_same_bits() -> None:
    from twin.optics.spectra import responsivity_a_per_w

    scene, system = load_scene("table1"), load_system("workable")
    responsivity = responsivity_a_per_w(system.detector, system.emitter, system.filter)
    given = FrontEnd.of(system, responsivity)
    known, own = (
        capture(scene, system, seed=1, fidelity=QUICK, detector=one) for one in (None, given)
    )
    np.testing.assert_array_equal(known.record.counts, own.record.counts)
    np.testing.assert_array_equal(known.snr, own.snr)


class Wrong(Spad):
    def expose(self, power_w, *, rng, noise="full"):
        counts, flags = np.zeros(power_w.shape, np.int32), np.zeros(len(power_w), np.uint8)
        given = {8: (counts + 0.5, flags), 9: (counts[:-1], flags), 10: (counts, counts)}
        return given.get(self.adc_bits, (counts - 1, flags | np.uint8(Flag.SATURATED)))


@pytest.mark.parametrize(
    ("bits", "told"),
    [
        (8, "counts float64"),
        (9, r"counts int32 of shape \(8191, 1\)"),
        (10, "flags int32 of shape"),
        (11, "counts -1 to -1, expected 0 to 2047"),
    ],
)
def test_what_is_no_count_is_refused(bits: int, told: str) -> None:
    scene, system = load_scene("table1"), load_system("workable")
    with pytest.raises(InputError, match=f"Wrong.expose: {told}"):
        capture(scene, system, fidelity=QUICK, detector=Wrong(adc_bits=bits))


def test_what_is_no_detector_is_told_what_it_lacks() -> None:
    with pytest.raises(InputError, match="dict has no electrons_per_watt, dark_e"):
        capture(load_scene("table1"), load_system("workable"), fidelity=QUICK, detector={})


@dataclass(frozen=True)
class Counting(Spad):
    """Counts Poisson events; may flag exposures, and tell a budget of its own."""

    flag: int = 0
    told_e: float | None = None

    def expose(self, power_w, *, rng, noise="full"):
        flags = np.full(len(power_w), self.flag, np.uint8)
        return rng.poisson(self.mean_e(power_w)).astype(np.int32), flags

    def noise_budget(self, signal_w, background_w, emitter_noise=0.0):
        budget = super().noise_budget(signal_w, background_w, emitter_noise)
        told = budget.total_noise_e if self.told_e is None else self.told_e
        return replace(budget, noise_e={"my noise": told})


def faint(**given) -> Counting:
    """About half a count in the mean exposure of `table1`."""
    scene, system = load_scene("table1"), load_system("workable")
    power_w = capture(scene, system, seed=1, fidelity=QUICK).signal_w.mean()
    spad = Counting(dark_rate_hz=0.0)
    return replace(spad, efficiency=0.25 * 0.5 / (power_w * spad.electrons_per_watt), **given)


def test_a_count_of_zero_is_a_reading_unless_the_detector_says_otherwise() -> None:
    """Of a counter with half a count in the mean exposure most read 0: not black, not void. What it
    flags is told without fields that it does not have.
    """
    scene, system = load_scene("table1"), load_system("workable").with_({"sky.part": "night"})
    own = capture(scene, system, seed=1, fidelity=QUICK, detector=faint())
    assert np.mean(own.record.counts == 0) > 0.5
    assert not {w.kind for w in own.warnings} & {"black", "saturated"}
    assert not own.void
    flagged = capture(scene, system, seed=1, fidelity=QUICK, detector=faint(flag=Flag.SATURATED))
    (told,) = [w for w in flagged.warnings if w.kind == "saturated"]
    assert told.void
    assert "are marked saturated by Counting" in told
    assert "readout" not in told


@pytest.mark.parametrize("told_e", [np.nan, -1.0, 0.0, np.inf])
def test_a_budget_that_can_be_none_is_refused(told_e: float) -> None:
    """NaN would stand as SNR, no noise as an infinite one. Contributions have any name."""
    scene, system = load_scene("table1"), load_system("workable")
    with pytest.raises(InputError, match=r"noise budget: .* e: expected a"):
        capture(scene, system, fidelity=QUICK, detector=faint(told_e=told_e))
    assert capture(scene, system, fidelity=QUICK, detector=faint()).noise.noise_e.keys() == {
        "my noise"
    }


@dataclass(frozen=True)
class Altered(Spad):
    """A counter whose exposures are changed on their way out."""

    change: object = None

    def expose(self, power_w, *, rng, noise="full"):
        counts = np.random.default_rng(0).integers(1, 100, power_w.shape)
        return self.change(counts, np.zeros(len(power_w), int))


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda counts, flags: None, "returned a NoneType, expected counts and flags"),
        (lambda counts, flags: (counts, flags, flags), "returned a tuple, expected counts"),
        (lambda counts, flags: (counts, flags + 256), "flags 256 to 256, expected bits"),
        (lambda counts, flags: (counts, flags + 128), "flags 128 to 128, expected bits"),
        (lambda counts, flags: (np.ma.masked_less(counts, 50), flags), "returned masked values"),
    ],
)
def test_a_wrong_exposure_is_an_error(change, told: str) -> None:
    with pytest.raises(InputError, match=rf"Altered\.expose: {told}"):
        capture(
            load_scene("table1"),
            load_system("workable"),
            fidelity=QUICK,
            detector=Altered(change=change),
        )


@pytest.mark.parametrize(
    ("field", "value"),
    [("adc_bits", "8"), ("adc_bits", 3.5), ("adc_bits", 40), ("electrons_per_count", 0.0)],
)
def test_a_constant_that_no_detector_has_is_an_error(field: str, value: object) -> None:
    wrong = replace(Spad(), **{field: value})
    with pytest.raises(InputError, match=rf"Spad\.{field} = .*: expected a (whole )?number from"):
        capture(load_scene("table1"), load_system("workable"), fidelity=QUICK, detector=wrong)


def test_a_void_record_has_no_signal_over_noise() -> None:
    """Whose exposures are all marked lost: the verdict says void, and SNR is 0 in every cell."""
    lost = Altered(change=lambda counts, flags: (counts, flags + int(Flag.LOST)))
    own = capture(load_scene("table1"), load_system("workable"), fidelity=QUICK, detector=lost)
    assert own.void
    assert not own.snr.any()

"""Extremes of the detector's electronics: integration time, and counts of electrons."""

import mpmath as mp
import numpy as np

from tests.extremes import oracle
from tests.extremes.case import Case, Found
from tests.extremes.light import expected_electrons
from tests.extremes.worlds import camera, light_stated, look, scene, square
from twin.detector import FrontEnd, expose, noise_budget

_N = 20_000
_POWER_W = 2e-9
_MOMENTS = "mpmath: mean and variance"


def _integrated(time_s: float, transimpedance_ohm: float) -> Found:
    """Electrons back from the counts of 20 000 exposures, and their noise as the budget has it.

    Mean: within 5 standard errors and half a count; noise of the budget: to rounding.
    """
    system = camera(
        acquisition__integration_time_s=time_s,
        acquisition__pattern_period_s=time_s,
        readout__transimpedance_ohm=transimpedance_ohm,
        readout__read_noise_e=0.0,
    )
    front_end = FrontEnd.of(system)
    counts, flags = expose(np.full((_N, 1), _POWER_W), front_end, rng=np.random.default_rng(7))
    electrons = (counts - front_end.offset_counts) * front_end.electrons_per_count
    time, d, r = mp.mpf(time_s), system.detector, system.readout
    dark = mp.mpf(d.dark_current_a.value) * time / oracle.Q
    signal = mp.mpf(_POWER_W) * mp.mpf(d.responsivity_a_per_w.value) * time / oracle.Q
    johnson2 = 2 * oracle.K * mp.mpf(r.temperature_k.value) * time / mp.mpf(transimpedance_ohm)
    step = (
        mp.mpf(r.adc_full_scale_v.value) / 2 ** r.adc_bits.value
        / (oracle.Q * mp.mpf(transimpedance_ohm) / time)
    )  # fmt: skip
    variance = signal + dark + johnson2 / oracle.Q**2
    budget = noise_budget(np.array([_POWER_W]), 0.0, front_end)
    noise = oracle.relative(budget.total_noise_e, mp.sqrt(variance + step**2 / 12))
    if noise > 1e-12 or flags.any():
        return Found(noise, 1e-12)
    allowed = (5 * mp.sqrt(variance / _N) + step / 2) / (signal + dark)
    error = oracle.relative(float(electrons.mean()), signal + dark)
    return Found(error, float(allowed))


def _one_bit() -> Found:
    """Counts of a converter of one bit, whose step is at half a sigma below the mean: as often 1 as
    a normal distribution says, in standard errors.
    """
    system = camera(readout__adc_bits=1, readout__transimpedance_ohm=1e7)
    front_end = FrontEnd.of(system)
    threshold_e = (0.5 - front_end.offset_counts) * front_end.electrons_per_count
    noise_e = noise_budget(np.array([threshold_e / front_end.electrons_per_watt]), 0.0, front_end)
    sigma_e = mp.sqrt(noise_e.total_noise_e**2 - mp.mpf(front_end.electrons_per_count) ** 2 / 12)
    power_w = (threshold_e + float(sigma_e) / 2 - front_end.dark_e) / front_end.electrons_per_watt
    counts, _ = expose(np.full((_N, 1), power_w), front_end, rng=np.random.default_rng(5))
    exact = float(mp.ncdf(0.5))
    off = abs(float(np.mean(counts == 1)) - exact) / np.sqrt(exact * (1 - exact) / _N)
    return Found(off if set(np.unique(counts)) <= {0, 1} else np.inf, 5.0, "sigma")


def _bits(bits: int) -> Found:
    """A whole frame through a converter of so many bits."""
    system = camera(readout__adc_bits=bits)
    with scene(square((5.0, 0, 0), 10.0), sun_lx=0.0) as world:
        taken = look(world, system)
    exact = expected_electrons(system, 5.0, 0.5)
    error = oracle.relative(float(taken.cells_e.sum()), exact)
    return Found(error, light_stated(taken, exact), warnings=taken.warnings)


def _frame(time_s: float) -> Found:
    """A whole frame of a wall with the amplifier as it is."""
    system = camera(acquisition__integration_time_s=time_s, acquisition__pattern_period_s=time_s)
    with scene(square((5.0, 0, 0), 10.0), sun_lx=0.0) as world:
        taken = look(world, system)
    exact = expected_electrons(system, 5.0, 0.5)
    error = oracle.relative(float(taken.cells_e.sum()), exact)
    return Found(error, light_stated(taken, exact), warnings=taken.warnings)


def _counted(mean: float) -> Found:
    """Mean and variance of Poisson electrons through a converter of 31 bits, in sigmas."""
    step = max(mean / 2**30, 1.0)
    front_end = FrontEnd(
        electrons_per_watt=1.0,
        dark_e=0.0,
        johnson_e=0.0,
        read_e=0.0,
        electrons_per_count=step,
        offset_counts=0.0,
        adc_bits=31,
    )
    counts, _ = expose(np.full((_N, 1), mean), front_end, rng=np.random.default_rng(3))
    drawn = (counts[:, 0] - mean / step) * step  # float64 keeps the difference from the mean
    variance = mean + (step**2 / 12 if step > 1 else 0)
    if mean == 0:
        return Found(float(np.abs(drawn).max()), 0.0, "sigma")
    of_mean = abs(drawn.mean()) / np.sqrt(variance / _N)
    of_variance = abs(drawn.var() - variance) / np.sqrt((2 * variance**2 + mean) / _N)
    return Found(float(max(of_mean, of_variance)), 5.0, "sigma")


def cases() -> list[Case]:
    """All of this room."""
    times = [
        Case("integration", text, _MOMENTS, lambda t=t, r=r: _integrated(t, r))
        for text, t, r in (
            ("1 ns", 1e-9, 1e5), ("1 us", 1e-6, 1e5), ("1 ms", 1e-3, 1e7), ("100 s", 100.0, 1e7)
        )
    ]  # fmt: skip
    counts = [
        Case("electrons", f"{n:g}", _MOMENTS, lambda n=n: _counted(n))
        for n in (0.0, 1e-3, 1.0, 1e6, 1e12, 1e13, 1e15, 1e18)
    ]
    return [
        *times,
        Case("integration", "1 ns, a whole frame of `workable`", "mpmath: integral over the field",
             lambda: _frame(1e-9), says="saturate the ADC"),
        Case("integration", "100 s, a whole frame of `workable`", "mpmath: integral over the field",
             lambda: _frame(100.0)),
        Case("integration", "0.1 ns", "-", lambda: _frame(1e-10), "error", "integration_time_s"),
        Case("integration", "1e4 s", "-", lambda: _frame(1e4), "error", "integration_time_s"),
        *counts,
        Case("converter", "1 bit", "mpmath: normal distribution", _one_bit),
        Case("converter", "1 bit, a whole frame", "mpmath: integral over the field",
             lambda: _bits(1), says="converter's step"),
        Case("converter", "31 bits, a whole frame", "mpmath: integral over the field",
             lambda: _bits(31), slow=True),
        Case("converter", "32 bits", "-", lambda: _bits(32), "error", "adc_bits"),
        Case("electrons", "infinite", "-", lambda: _counted(np.inf), "error", "power_w"),
    ]  # fmt: skip

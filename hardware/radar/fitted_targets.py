"""Targets of a joint fit as echoes: errors of all together, rates as those of other echoes."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hardware.radar.ambiguity import possible_rates, with_likeliest_rate
from hardware.radar.channel_noise import ChannelNoise
from hardware.radar.demodulation import Complex
from hardware.radar.joint_fit import JointFit, JointModel
from hardware.radar.measurement import EchoMeasurement, echo_measurement
from hardware.radar.rate_evidence import rate_evidence
from hardware.radar.residue import residual_cells
from hardware.waveform import OfdmWaveform

Array = NDArray[np.float64]

_PASSES = 3  # at most: what one target was tested beside may have another rate afterwards


def fitted_echo(
    model: JointModel, fit: JointFit, i: int, waveform: OfdmWaveform, noise_w: float
) -> EchoMeasurement:
    """One target of a fit, with the standard errors of all in the noise around it."""
    blocks = model.blocks
    beside = np.vstack([np.delete(fit.places, i, axis=0), model.fixed])
    if model.beside_static:
        at_rest = [(cells, model.at_rest) for cells, _ in fit.places]
        beside = np.vstack([beside, at_rest])
    around = residual_cells(blocks, fit.places[i], beside=beside)
    if model.beside_static:  # the mean over slots took as much of the noise as one of them
        around = around * np.sqrt(waveform.n_slots / (waveform.n_slots - 1))
    noise = ChannelNoise.of_cells(around, noise_w)
    own = noise.scaled(float(fit.gram[i, i].real))  # of its amplitudes, beside the others
    amplitude = fit.amplitudes[i]
    part = echo_measurement(blocks, fit.places[i], amplitude, waveform, noise_w, "boxcar", own)
    power_w = noise.along(amplitude)
    errors = np.sqrt(power_w * np.diag(fit.covariance)[2 * i : 2 * i + 2]) * blocks.grid.cell
    by_place_w = np.sqrt(power_w * fit.power_variance(i))
    return replace(
        part,
        delay_error_s=float(np.where(np.isnan(part.delay_error_s), np.nan, errors[0])),
        delay_rate_error=float(np.where(np.isnan(part.delay_rate_error), np.nan, errors[1])),
        power_error_w=float(np.hypot(part.power_error_w, by_place_w)),
    )


@dataclass(frozen=True, eq=False)
class FittedTargets:
    """Targets at the first ``n_targets`` places of fits of a model of a channel; ``noise_w``: of a
    cell without a window, ``fastest``: largest delay rate, in s/s.
    """

    model: JointModel
    n_targets: int
    channel: Complex
    waveform: OfdmWaveform
    noise_w: float
    fastest: float

    def at_likeliest_rates(self, fit: JointFit) -> list[EchoMeasurement]:
        """The targets, each at the likeliest of the rates that fold to its own; others that the
        channel leaves open are its alternatives.

        The stronger ones are first, as of other echoes: at a wrong rate they are smeared over
        weaker ones.
        """
        echoes = self.echoes(fit)
        if self.waveform.n_slots == 1:  # no rate is measured
            return echoes
        fit, echoes = self.at_rates(fit, echoes, [self.rates(echo)[0] for echo in echoes])
        for _ in range(_PASSES):
            before, more = fit, [np.zeros(0)] * self.n_targets  # open rates, from the target's own
            order = np.argsort([-echo.power_w for echo in echoes], kind="stable").tolist()
            for count, i in enumerate(order):
                echo = self.at_likeliest_rate(fit, echoes, i, order[:count])
                fit, echoes = self.at_rates(fit, echoes, _with(echoes, i, echo.delay_rate))
                more[i] = np.array(echo.delay_rate_alternatives) - echo.delay_rate
            if fit is before:
                break
        return [
            replace(echo, delay_rate_alternatives=tuple((echo.delay_rate + more[i]).tolist()))
            for i, echo in enumerate(echoes)
        ]

    def at_likeliest_rate(
        self, fit: JointFit, echoes: list[EchoMeasurement], i: int, stronger: Sequence[int]
    ) -> EchoMeasurement:
        """One of the echoes of a fit at its likeliest rate, fitted with all others."""
        rates = self.rates(echoes[i])
        if len(rates) == 1:
            return echoes[i]

        def measured(number: int) -> EchoMeasurement:
            return self.at_rates(fit, echoes, _with(echoes, i, float(rates[number])))[1][i]

        evidence = rate_evidence(self.model.alone(fit, i), rates, self.noise_w)
        others = [echoes[number] for number in stronger]
        return with_likeliest_rate(
            echoes[i], evidence, others, self.channel, self.waveform, measured
        )

    def rates(self, echo: EchoMeasurement) -> Array:
        """Rates (n_rates,) that an echo may have, the slowest first."""
        return possible_rates(echo, self.waveform, self.fastest)

    def echoes(self, fit: JointFit) -> list[EchoMeasurement]:
        """The targets of a fit."""
        return [
            fitted_echo(self.model, fit, i, self.waveform, self.noise_w)
            for i in range(self.n_targets)
        ]

    def at_rates(
        self, fit: JointFit, echoes: list[EchoMeasurement], rates: Sequence[float]
    ) -> tuple[JointFit, list[EchoMeasurement]]:
        """A fit and its echoes, at the rates that fold to theirs and are nearest to these."""
        n_slots, cell = self.waveform.n_slots, self.waveform.delay_rate_cell
        moved = np.array(rates) - [echo.delay_rate for echo in echoes]
        spans = np.rint(moved / (n_slots * cell))
        if not spans.any():
            return fit, echoes
        places = fit.places.copy()
        places[: self.n_targets, 1] += n_slots * spans
        fit = self.model.refined(places)
        return fit, self.echoes(fit)


def _with(echoes: Sequence[EchoMeasurement], i: int, rate: float) -> list[float]:
    """Rates of echoes, of one of them ``rate``."""
    return [rate if number == i else echo.delay_rate for number, echo in enumerate(echoes)]

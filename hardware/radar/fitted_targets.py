"""Targets of a joint fit as echoes: errors of all together, rates as those of other echoes."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray

from hardware.radar.ambiguity import possible_rates, with_likeliest_rate
from hardware.radar.channel_noise import ChannelNoise
from hardware.radar.demodulation import Complex
from hardware.radar.joint_fit import JointFit, JointModel
from hardware.radar.measurement import EchoMeasurement, echo_measurement
from hardware.radar.rate_evidence import CERTAIN, USUAL_RATE, rate_evidence
from hardware.radar.residue import residual_cells
from hardware.waveform import OfdmWaveform

Array = NDArray[np.float64]

_MOST_TOGETHER = 3  # targets whose rates are fitted in pairs
_MOST_COMBINED = 36  # pairs of rates of two targets that are fitted
_SAME = 0.3  # cells, within which echoes of two fits are the same
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
        found, own = fit, echoes
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
        if not fit.tells_apart(self.n_targets, found):  # targets that cancel fit any rate
            fit, echoes = found, own
            apart = [self.rates(echo) - echo.delay_rate for echo in own]
            more = [some[np.abs(some) > self.waveform.max_delay_rate] for some in apart]
        fits, with_another = self.at_rates_of_pairs(fit)
        if with_another.any():
            noise_w = max(self.noise_w, *self.left_around_w(fits[0]))
            span = 2 * self.waveform.max_delay_rate
            fit, together = _likeliest(fits, self.rates_of(fits), span, noise_w)
            more = [together[i] if with_another[i] else more[i] for i in range(self.n_targets)]
            echoes = self.echoes(fit)
        return [
            replace(echo, delay_rate_alternatives=tuple((echo.delay_rate + more[i]).tolist()))
            for i, echo in enumerate(echoes)
        ]

    def at_rates_of_pairs(self, fit: JointFit) -> tuple[list[JointFit], NDArray[np.bool_]]:
        """Fits, the best first, at all combinations of the rates of any two targets that may be
        smeared over each other, and which targets these are: at a wrong rate one moves the other,
        which then fits its wrong rate. Of many targets, as of a body, that would take too long.
        """
        fits, with_another = [fit], np.zeros(self.n_targets, dtype=bool)
        if self.n_targets > _MOST_TOGETHER:
            return fits, with_another
        for pair in combinations(range(self.n_targets), 2):
            both = [self.echo(fits[0], i) for i in pair]
            chosen = np.array(list(product(*(self.rates(echo) for echo in both))))
            if not 1 < len(chosen) <= _MOST_COMBINED or not self.may_meet(both, chosen):
                continue
            with_another[list(pair)] = True
            for rates in chosen:
                spans = np.zeros(self.n_targets)
                spans[list(pair)] = self.spans(both, rates)
                fits.append(self.moved(fits[0], spans))
            sound = [one for one in fits[1:] if one.tells_apart(self.n_targets, fit)]
            fits = sorted([fits[0], *sound], key=lambda one: one.misfit)
        return fits, with_another

    def may_meet(self, echoes: Sequence[EchoMeasurement], rates: Array) -> bool:
        """Whether two echoes are in one range cell at some time, at any of the rates (n, 2)."""
        moved_s = float(np.ptp(rates)) * self.waveform.n_slots * self.waveform.slot_period_s / 2
        apart_s = abs(echoes[0].delay_s - echoes[1].delay_s)
        return bool(apart_s < moved_s + self.waveform.delay_cell_s)

    def left_around_w(self, fit: JointFit) -> list[float]:
        """Power in the cells around each target that a fit leaves."""
        sizes = np.diag(fit.gram).real
        return [echo.noise.mean_w / sizes[i] for i, echo in enumerate(self.echoes(fit))]

    def rates_of(self, fits: Sequence[JointFit]) -> Array:
        """Delay rates (n_fits, n_targets) of the targets of fits."""
        blocks = self.model.blocks
        cells = np.array([fit.places[: self.n_targets, 1] for fit in fits])
        return np.asarray(blocks.delay_rate + cells * blocks.grid.cell[1])

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
        return [self.echo(fit, i) for i in range(self.n_targets)]

    def echo(self, fit: JointFit, i: int) -> EchoMeasurement:
        """One of the targets of a fit."""
        return fitted_echo(self.model, fit, i, self.waveform, self.noise_w)

    def at_rates(
        self, fit: JointFit, echoes: list[EchoMeasurement], rates: Sequence[float]
    ) -> tuple[JointFit, list[EchoMeasurement]]:
        """A fit and its echoes, at the rates that fold to theirs and are nearest to these."""
        spans = self.spans(echoes, rates)
        if not spans.any():
            return fit, echoes
        fit = self.moved(fit, spans)
        return fit, self.echoes(fit)

    def spans(self, echoes: Sequence[EchoMeasurement], rates: Sequence[float] | Array) -> Array:
        """Spans of the Doppler ambiguity (n_echoes,) from echoes to rates."""
        moved = np.array(rates) - [echo.delay_rate for echo in echoes]
        return np.asarray(np.rint(moved / (2 * self.waveform.max_delay_rate)))

    def moved(self, fit: JointFit, spans: Array) -> JointFit:
        """A fit of targets whose rates are so many spans (n_targets,) from those of another fit."""
        places = fit.places.copy()
        places[: self.n_targets, 1] += self.waveform.n_slots * spans
        return self.model.refined(places)


def _likeliest(
    fits: Sequence[JointFit], rates: Array, span: float, noise_w: float
) -> tuple[JointFit, list[Array]]:
    """The likeliest of fits, the best first, and other rates of each target that are open, from
    its own, likeliest first.

    ``rates`` (n_fits, n_targets): of the targets, which are points here; ``span``: between those
    that fold to the same; ``noise_w``: noise, and what the best fit leaves beside it.
    """
    behind = np.array([fit.misfit - fits[0].misfit for fit in fits]) / noise_w
    order = np.argsort(behind + np.sum((rates / USUAL_RATE) ** 2, axis=1) / 2, kind="stable")
    first, *others = order[behind[order] < CERTAIN].tolist()
    more: list[list[float]] = [[] for _ in rates.T]
    for other in others:
        if _are_the_same(fits[other], fits[first]):
            continue
        for open_rates, rate in zip(more, rates[other] - rates[first], strict=True):
            if np.abs(np.array([0.0, *open_rates]) - rate).min() > span / 2:
                open_rates.append(float(rate))
    return fits[first], [np.array(open_rates) for open_rates in more]


def _are_the_same(fit: JointFit, other: JointFit) -> bool:
    """Whether two fits have the same echoes, in whatever order."""
    places, others = (one.places[np.argsort(one.places[:, 1])] for one in (fit, other))
    return bool(np.abs(places - others).max() < _SAME)


def _with(echoes: Sequence[EchoMeasurement], i: int, rate: float) -> list[float]:
    """Rates of echoes, of one of them ``rate``."""
    return [rate if number == i else echo.delay_rate for number, echo in enumerate(echoes)]

"""Targets closer than a cell or two, resolved by Newtonized orthogonal matching pursuit.

The strongest target is searched, all targets are fitted together by least squares (delays, rates
and amplitudes), their sum is subtracted, and the residual is searched again until it is noise
(Mamandipoor, Ramasamy and Madhow, IEEE Trans. Signal Process. 64, 2016, doi
10.1109/TSP.2016.2580523). No window is used: it would cost resolution, and the fit has no side
lobes. Targets without which the others explain as much are then left out again.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hardware.radar.demodulation import Complex
from hardware.radar.fitted_targets import FittedTargets
from hardware.radar.joint_fit import JointFit, JointModel
from hardware.radar.measurement import EchoMeasurement
from hardware.radar.rate_evidence import ambiguous_rates, fastest_resolved
from hardware.radar.refinement import Blocks, blocks_about, echo_amplitudes
from hardware.radar.within_symbols import channel_without_leakage
from hardware.waveform import OfdmWaveform

Array = NDArray[np.float64]

_CLOSEST = 0.3  # cells
_WINDOW, _LEAST_SEEN = "blackmanharris", 1e-3  # of a target's power, with that window
_MOST_IN_VAIN = 3  # peaks after each other at which no target can be told from the others
#: Cells that are searched around an echo: the main lobe of a window.
REACH = 4.0
_OF_A_BODY = 1e-3  # of its power: what a body has beside a point, at its place
_BESIDE, _MOST_BESIDE = 8.0, 4  # cells, and number, of other echoes that are fitted with an echo
_NONE = np.zeros((0, 2))
_FEW, _SLOW = 8, (-0.3, 0.3)  # slots, and cells of rate


def resolve(
    channel: Complex,
    waveform: OfdmWaveform,
    echo: EchoMeasurement,
    noise_w: float,
    *,
    fastest: float,
    false_alarm: float = 1e-6,
    reach: float = REACH,
    at_most: int = 4,
    together: Sequence[EchoMeasurement] = (),
    others: Sequence[EchoMeasurement] = (),
    beside_static: bool = False,
    least_at: Callable[[Array], Array] | None = None,
) -> list[EchoMeasurement]:
    """Split an echo into those of the targets that it consists of, nearest first.

    Parameters
    ----------
    channel, waveform
        As for `detect`.
    echo
        What is to be split.
    noise_w
        Mean noise power of a cell without a window.
    fastest
        Largest delay rate, in s/s, of approaching or receding targets: which of the rates that fold
        to that of a target is told as of other echoes, see `resolve_delay_rates`.
    false_alarm
        Probability of a false target per cell searched.
    reach
        Cells searched to each side in delay and in rate, of the echo and of each target that is
        found: the main lobe of a window. No more than half of those that can be told apart, beyond
        which the same target is found again.
    at_most
        Largest number of targets for each echo that is split.
    together
        Echoes near it that are split with it.
    others
        Echoes elsewhere, whose side lobes are fitted as well; of the nearest ones also the places,
        which were measured in the side lobes of this echo.
    beside_static
        The channel is one without its mean over slots, see `JointModel`.
    least_at
        Power (n,) at delays (n,), in s, up to which peaks are none of targets, beside what noise
        makes.

    Standard errors are those of the joint fit, in the noise that it leaves around each target.

    A target 30 dB and more below the main lobe or the side lobes of another at its place is not
    split off: bodies are no points, and what they have beside one looks like that.

    Two targets closer than 0.3 cells are never resolved, nor several whose amplitudes could not be
    told apart but with ten times the noise of one alone: strong targets that cancel would fit what
    a body has beside points, or the error of the model, which is 60 dB and more below a target
    because of single precision and the blocks.
    """
    place = np.array([echo.delay_s]), np.array([echo.delay_rate])
    still = channel_without_leakage(channel, echo, waveform, noise_w)
    (blocks,), (windowed,) = (
        blocks_about(still, waveform, window, *place) for window in ("boxcar", _WINDOW)
    )
    split = [echo, *together]
    middle = np.array([blocks.delay_s, blocks.delay_rate])
    middles = steps_of(split, middle, blocks.grid.cell)
    beside, fixed = _nearest(steps_of(others, middle, blocks.grid.cell))
    least_w = noise_w * peak_of_noise(false_alarm, len(blocks.sums)) / len(blocks.sums)
    model = JointModel(blocks, fixed, noise_w, beside_static)
    reaches = np.minimum(reach, np.array([waveform.n_subcarriers, waveform.n_slots]) / 2)
    none = FittedTargets(model, 0, still, waveform, noise_w, fastest)
    search = _Search(model, windowed, middles, beside, reaches, least_w, none, least_at)
    fit = search.without_needless(search.targets(at_most * len(split)))
    parts = [
        replace(part, is_corrected=still is not channel)
        for part in search.fitted(fit).at_likeliest_rates(fit)
    ]
    return sorted(parts, key=lambda part: part.delay_s)


@dataclass(frozen=True, eq=False)
class _Search:
    """Search for targets of which echoes at ``middles`` (n, 2) consist; ``windowed``: the blocks of
    the model with a window.

    ``beside`` (n, 2): other echoes, the last places of every fit. ``reach``: cells searched around
    the middles and around targets that are found, of delay and of rate (2,); ``least_w``: mean
    power over channels of a target that is not noise; ``none``: of no target; ``least_at``: see
    `resolve`.
    """

    model: JointModel
    windowed: Blocks
    middles: Array
    beside: Array
    reach: Array
    least_w: float
    none: FittedTargets
    least_at: Callable[[Array], Array] | None

    def targets(self, at_most: int) -> JointFit:
        """Targets added one by one, the strongest first, until noise is left."""
        fit, barred, in_vain = self.model.refined(self.beside), _NONE, 0
        if self.model.beside_static:
            # What is static moves peaks; the echoes themselves are measured beside it already.
            fit = self.model.refined(np.vstack([self.middles, self.beside]))
            if not self.is_sound(fit):
                return fit
            fit = self.at_best_rates(fit)
        while in_vain < _MOST_IN_VAIN and len(self.targets_of(fit)) < at_most:
            excess, place = self.strongest(fit, barred)
            if excess <= 1:
                break
            fits = [
                self.model.refined(np.vstack([at, fit.places])) for at in self.beginnings(place)
            ]
            more = min(fits, key=lambda one: one.misfit)
            if self.is_sound(more):
                fit, in_vain = self.at_best_rates(more), 0
            else:
                barred, in_vain = np.vstack([barred, place]), in_vain + 1
        return fit

    def at_best_rates(self, fit: JointFit) -> JointFit:
        """A fit that leaves more than noise, at other rates of its targets if these do not: of a
        body no rates of points leave noise alone, and those that leave least are not its own.
        """
        if len(self.targets_of(fit)) < 2 or self.strongest(fit)[0] <= 1:
            return fit
        (best, *_), _ = self.fitted(fit).at_rates_of_pairs(fit)
        return best if self.is_sound(best) and self.strongest(best)[0] <= 1 else fit

    def fitted(self, fit: JointFit) -> FittedTargets:
        """The targets of a fit."""
        return replace(self.none, n_targets=len(self.targets_of(fit)))

    def beginnings(self, place: Array) -> list[Array]:
        """Places (2,) from which that of a target is looked for: of few slots, whose lobes are
        wide, also at other rates of its delay; beside what is static also at slow ones, of which
        little is left at their own place and more elsewhere; and at all rates up to the fastest
        that fold to the same, since at a wrong one a target is smeared and passes for several.
        """
        rates = [place[1]]
        if (n_slots := int(self.model.blocks.grid.count_t.sum())) <= _FEW:
            rates += [place[1] + half / 2 for half in range(1 - n_slots, n_slots) if half]
        if self.model.beside_static:
            rates += [self.model.at_rest + slow for slow in _SLOW]
        cell, own = self.none.waveform.delay_rate_cell, self.model.blocks.delay_rate
        folding = [
            ambiguous_rates(self.none.waveform, own + rate * cell, self.most) for rate in rates
        ]
        return [np.array([place[0], rate]) for rate in (np.concatenate(folding) - own) / cell]

    @cached_property
    def most(self) -> float:
        """Delay rate up to which others are tested, in s/s."""
        return fastest_resolved(self.none.waveform, self.none.fastest)

    def nearest(self, cells: Array) -> Array:
        """Cells between rates, to the nearest of those that fold to them."""
        n_slots = self.none.waveform.n_slots
        return np.asarray(cells - n_slots * np.rint(cells / n_slots))

    def is_sound(self, fit: JointFit) -> bool:
        """Whether the targets of a fit can be those that are looked for."""
        return (
            self.are_apart(fit)
            and self.are_seen(fit)
            and self.are_of_these(self.targets_of(fit))
            and self.are_told_by_slots(self.targets_of(fit))
        )

    def are_apart(self, fit: JointFit) -> bool:
        """Whether each target of a fit can be told from all others."""
        targets = self.targets_of(fit)
        apart = _apart(targets, np.vstack([fit.places, self.model.fixed]))
        apart[np.diag_indices(len(targets))] = np.inf
        return bool((apart >= _CLOSEST).all()) and fit.tells_apart(len(targets))

    def targets_of(self, fit: JointFit) -> Array:
        """Places (n, 2) of a fit without those of other echoes."""
        return fit.places[: len(fit.places) - len(self.beside)]

    def are_seen(self, fit: JointFit) -> bool:
        """Whether targets of a fit show where side lobes do not, with a window."""
        places = self.targets_of(fit)
        seen_w = [np.mean(np.abs(echo_amplitudes(self.windowed, at)) ** 2) for at in places]
        power_w = np.mean(np.abs(fit.amplitudes[: len(places)]) ** 2, axis=1)
        return bool((seen_w >= _LEAST_SEEN * power_w).all())

    def are_of_these(self, places: Array) -> bool:
        """Whether places (n, 2) are near what is split, and nearer than to echoes elsewhere."""
        elsewhere = np.vstack([self.beside, self.model.fixed])
        own, others = (
            np.maximum(
                np.abs(places[:, None, 0] - echoes[:, 0]),
                np.abs(self.nearest(places[:, None, 1] - echoes[:, 1])),
            ).min(axis=1, initial=np.inf)
            for echoes in (self.middles, elsewhere)
        )
        return bool((own <= np.minimum(others, 2 * self.reach.max())).all())

    def are_told_by_slots(self, places: Array) -> bool:
        """Whether no more places (n, 2) are within a cell of range than slots tell: each target has
        three numbers there, rate and amplitude, and each slot two; what is static takes one slot.
        """
        n_slots = int(self.model.blocks.grid.count_t.sum()) - self.model.beside_static
        in_cell = np.abs(places[:, None, 0] - places[:, 0]) < 1
        return bool(in_cell.sum(axis=1).max(initial=0) <= max(2 * n_slots / 3, 1))

    def without_needless(self, fit: JointFit) -> JointFit:
        """The fit without targets that leave no more of a target where they are left out."""
        n_targets = len(self.targets_of(fit))
        if n_targets < 2:
            return fit
        most = max(1.0, self.strongest(fit)[0])
        for i in np.argsort(np.sum(np.abs(fit.amplitudes[:n_targets]) ** 2, axis=1), kind="stable"):
            fewer = self.model.refined(np.delete(fit.places, i, axis=0))
            if self.strongest(fewer)[0] <= most and self.is_sound(fewer):
                return self.without_needless(fewer)
        return fit

    def strongest(self, fit: JointFit, barred: Array = _NONE) -> tuple[float, Array]:
        """Mean power over channels, over that of which a target consists at least, and cells (2,),
        of the highest point of the residual, not within a cell of places ``barred`` (n, 2).
        """
        grid = self.model.blocks.grid
        middle = self.middles[0, 1]
        centres = np.vstack([self.middles, self.targets_of(fit)])
        centres[:, 1] = middle + self.nearest(centres[:, 1] - middle)
        axes = [_eighths(at, reach) for at, reach in zip(centres.T, self.reach, strict=True)]
        across = np.exp(1j * np.outer(axes[0], grid.by_delay))
        along = np.exp(1j * np.outer(grid.by_rate, axes[1]))
        rest = self.model.residual_sums(fit)
        power = np.mean(np.abs(across @ rest @ along) ** 2, axis=0)
        power_w = np.mean(np.abs(fit.amplitudes) ** 2, axis=1)
        away = [axis[:, None] - at for axis, at in zip(axes, fit.places.T, strict=True)]
        lobes = [highest_side_lobe(away[0]), highest_side_lobe(self.nearest(away[1]))]
        least_w = self.least_w + _OF_A_BODY * (lobes[0] * power_w) @ lobes[1].T
        if self.least_at is not None:
            least_w += self.least_at(self.model.blocks.delay_s + axes[0] * grid.cell[0])[:, None]
        excess = power / least_w
        inside = _within(axes, centres, self.reach) & _within(
            axes, centres[: len(self.middles)], 2 * self.reach
        )
        inside &= ~_within(axes, barred, np.ones(2))
        excess = np.where(inside, excess, 0.0)
        row, column = np.unravel_index(np.argmax(excess), excess.shape)
        return float(excess[row, column]), np.array([axes[0][row], axes[1][column]])


def peak_of_noise(false_alarm: float, n_channels: int) -> float:
    """Level that a peak of noise near a cell exceeds with this probability: sum over channels, over
    the mean of one.

    Between cells noise peaks higher than on them: along each axis sqrt(pi x / 3) times as often
    (Rice's rate of crossings of a level x by band-limited noise).
    """
    from scipy.special import gammainccinv

    return float(gammainccinv(n_channels, false_alarm / (np.pi / 3 * -np.log(false_alarm))))


def _eighths(centres: Array, reach: float) -> Array:
    """A grid of eighths of a cell over all within ``reach`` of places on an axis."""
    low, high = centres.min() - reach, centres.max() + reach
    return np.linspace(low, high, int(8 * (high - low)) + 1)


def _within(axes: Sequence[Array], centres: Array, reach: Array) -> NDArray[np.bool_]:
    """Cells (n, m) of two axes (n,) and (m,) within ``reach`` (2,) of one of the places (k, 2)."""
    near = [
        np.abs(axis[:, None] - at) <= far
        for axis, at, far in zip(axes, centres.T, reach, strict=True)
    ]
    return np.asarray((near[0][:, None] & near[1]).any(axis=-1))


def steps_of(echoes: Sequence[EchoMeasurement], middle: Array, cell: Array) -> Array:
    """Cells (n, 2) from a delay and a rate (2,) to echoes."""
    places = np.array([(echo.delay_s, echo.delay_rate) for echo in echoes]).reshape(-1, 2)
    return np.nan_to_num((places - middle) / cell)  # NaN is not measured


def _nearest(steps: Array) -> tuple[Array, Array]:
    """Of echoes at steps (n, 2) those that are fitted with their places, and the others."""
    away = np.abs(steps).max(axis=1)
    order = np.argsort(away, kind="stable")
    count = min(int(np.count_nonzero(away <= _BESIDE)), _MOST_BESIDE)
    return steps[order[:count]], steps[order[count:]]


def _apart(places: Array, others: Array) -> Array:
    """Cells (n, m) between places (n, 2) and others (m, 2), along the axis on which they are
    farther apart.
    """
    return np.asarray(np.abs(places[:, None] - others).max(axis=-1))


def highest_side_lobe(cells: Array) -> Array:
    """Highest side lobe beyond so many cells on one axis, over the peak in power, no window."""
    return np.asarray(1 / np.maximum(np.pi * np.abs(cells), 1) ** 2)

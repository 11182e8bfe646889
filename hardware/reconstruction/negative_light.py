"""Whether all cells together are less than no light: counts that fall as light rises, exposures
that are exchanged; or one pattern tells more than all light: a count that is not the light's.

Values of patterns that count no cell negatively (Hadamard row 0, all cells lit) are sums of light,
and none is below 0 but by noise. A sum below it by more than 5 standard errors is told: of one
image of no light in 3.5 million where noise is normal, and of fewer where there is light. As the
noise is found in the record itself, Student's distribution takes the normal one's place, with the
degrees of freedom that the patterns leave. Most sets of a user's own plain patterns have no such
value.

No value of a Hadamard pattern is larger than the sum of all cells, as none of them is negative. In
sets that show nothing twice that is all that tells a single wrong count; a smaller one looks like
detail. In pairs it is in the noise.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from hardware.formatting import number
from hardware.patterns import OwnPatterns, Patterns, PatternSet
from hardware.reconstruction.measurements import Measurements
from hardware.reconstruction.noise import errors_of_few, finest_patterns, freedom
from hardware.records import SpiRecord

Array = NDArray[np.float64]

#: Variance that the constant of sets without complements adds to that of a value, at most: two
#: references half of it, the mean of two or more of the finest values half or less.
_WITH_CONSTANT = 1.5
#: Share of the values beyond all light, from which on it is their constant that is off.
_MANY = 1 / 8


def negative_light(record: SpiRecord, measured: Measurements) -> Iterator[str]:
    """A warning where ``measured`` of a record is less than no light. Phase shutters may hold the
    difference of two taps, whose sums have either sign: nothing is told of them.
    """
    patterns = record.patterns
    sums = sums_of_light(patterns)
    if not sums.any() or any(shutter.modulated for shutter in record.shutters):
        return
    paired = patterns.mode in ("differential", "complementary")
    light = measured.values[sums].mean(axis=0)
    error = error_of_a_sum(patterns, measured)
    least = errors_of_few(freedom(patterns))
    if not (negative := light < -least * error).any():
        return
    worst = int(np.nanargmin(np.where(negative, light / error, np.nan)))
    causes = ["counts fall as light rises"]
    if paired:
        causes.append("exposures and those to their complements are exchanged")
    causes.append(
        "the second detector sees more background"
        if patterns.mode == "complementary"
        else "the background rose meanwhile"
    )
    yield (
        f"{np.count_nonzero(negative)} of {len(light)} images hold less than no light: all cells "
        f"together {number(light[worst])} electrons, with a standard error of "
        f"{number(error[worst])}; {', or '.join(causes)}"
    )


def beyond_all_light(record: SpiRecord, measured: Measurements) -> Iterator[str]:
    """A warning where a value of a Hadamard set that shows nothing twice is larger than all light,
    by more than the error of both.
    """
    patterns = record.patterns
    paired = patterns.mode in ("differential", "complementary")
    if paired or not isinstance(patterns, PatternSet) or not (patterns.indices == 0).any():
        return
    if any(shutter.modulated for shutter in record.shutters):
        return
    light = measured.values[patterns.indices == 0].mean(axis=0)
    excess = np.abs(measured.values) - np.maximum(light, 0)
    error = np.sqrt((1 + _WITH_CONSTANT) * measured.most_noise_variance)
    finest = finest_patterns(patterns)
    if patterns.mode != "reference" and finest.size:  # their mean is the constant, detail and all
        error = np.hypot(error, measured.values[finest].std(axis=0) / np.sqrt(finest.size))
    beyond = (excess > errors_of_few(freedom(patterns)) * error) & (patterns.indices > 0)[:, None]
    # Of one bright cell the finest values may all be alike, and their mean not the constant.
    beyond &= beyond.mean(axis=0) < _MANY
    if not beyond.any():
        return
    pattern, image = np.unravel_index(np.argmax(np.where(beyond, excess, -np.inf)), excess.shape)
    yield (
        f"{np.count_nonzero(beyond)} of {beyond.size} measurements are larger than all light, "
        f"that of pattern {pattern} by {number(excess[pattern, image])} electrons, with a standard "
        f"error of {number(error[image])}: counts are not the light's, or light changed meanwhile"
    )


def error_of_a_sum(patterns: Patterns, measured: Measurements) -> Array:
    """Standard error of the light of all cells, ``(n_images,)``."""
    paired = patterns.mode in ("differential", "complementary")
    factor = 1.0 if paired else _WITH_CONSTANT
    return np.asarray(np.sqrt(factor * measured.most_noise_variance))


def sums_of_light(patterns: Patterns) -> NDArray[np.bool_]:
    """Values in which no cell counts negatively."""
    if isinstance(patterns, OwnPatterns):
        return np.asarray((patterns.matrix >= 0).all(axis=1))
    if isinstance(patterns, PatternSet):
        return patterns.indices == 0
    return np.arange(patterns.n_cells) == 0  # a scan is transformed whole

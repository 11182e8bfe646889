"""Image quality: scores of reconstructions of one capture against its noise-free truth.

The truth is the light of the scene. Backscatter in fog is neither truth nor noise: its expectation,
which the twin knows, is subtracted from the image before scoring. A score thus falls with the
attenuation by the fog and with the noise of its backscatter, but does not depend on the mean
backscatter itself.
"""

from dataclasses import dataclass, replace
from functools import cached_property

from hardware.described import Described
from hardware.patterns import OwnPatterns
from hardware.reconstruction import (
    METHODS,
    Method,
    Reconstruction,
    fits_in_memory,
    method_of,
    reconstruct,
)
from hardware.reconstruction.registry import Solve
from twin.camera.acquisition import Capture
from twin.camera.intervals import (
    CaptureIntervals,
    ScoreIntervals,
    capture_intervals,
    score_intervals,
)
from twin.camera.range_score import RangeScore, range_score
from twin.camera.score import Score, score_of
from twin.camera.verdict import ImageVerdict
from twin.errors import InputError, check_kind
from twin.system import System

#: Methods of every evaluation: the plain inverse and the vehicle's default.
SHOWN = ("zero-fill", "lmmse")
#: Of a user's own patterns, which zero-fill cannot invert.
SHOWN_OF_OWN = ("least-squares", "lmmse")


@dataclass(frozen=True, eq=False, repr=False)
class Evaluation(Described):
    """One system's capture with its reconstructions, best first, and their scores; ``asked``: the
    method that was asked for by its name.
    """

    system: System
    capture: Capture
    reconstructions: tuple[Reconstruction, ...]
    scores: tuple[Score, ...]
    asked: str | None = None

    @cached_property
    def intervals(self) -> CaptureIntervals:
        """Figures of the capture, with what the model may be off by."""
        return capture_intervals(self.capture)

    @cached_property
    def score_intervals(self) -> tuple[ScoreIntervals, ...]:
        """The scores, with what the model may be off by."""
        return tuple(score_intervals(self.capture, image) for image in self.reconstructions)

    @cached_property
    def ranges(self) -> RangeScore | None:
        """Errors of the distances, None without time of flight."""
        return range_score(self.capture)

    @property
    def verdict(self) -> ImageVerdict:
        """Quality of an image of the record."""
        verdict = self.capture.verdict
        return verdict if verdict.void else replace(verdict, snr_interval=self.intervals.snr_median)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Of the capture, and of what the vehicle's reconstructions say of the record."""
        of_images = (warning for image in self.reconstructions for warning in image.warnings)
        return tuple(dict.fromkeys([*map(str, self.capture.warnings), *of_images]))

    @property
    def best(self) -> str:
        """The best reconstruction with its score, in words; of a void record there is none."""
        return "no image" if self.capture.void else self._scored(0)

    @property
    def images(self) -> str:
        """The image by the method that was asked for with its score, in words, and the best one
        where that is another; without one the best alone.
        """
        methods = [image.method for image in self.reconstructions]
        asked = methods.index(self.asked) if self.asked in methods else 0
        if asked == 0 or self.capture.void:
            return self.best
        return f"{self._scored(asked)}; best of {len(methods)} methods, {self.best}"

    def _scored(self, place: int) -> str:
        return f"{self.reconstructions[place].method}: {self.score_intervals[place]}"

    def __str__(self) -> str:
        """The result in one line, as the command prints it."""
        ranges = f"; distances off by {self.ranges}" if self.ranges else ""
        return f"{self.system.name}: {self.verdict}; {self.images}{ranges}"


def evaluate(
    system: System,
    capture: Capture,
    reconstructions: list[Reconstruction] | None = None,
    *,
    method: str | Method | Solve | None = None,
) -> Evaluation:
    """Score reconstructions of a capture, by default those of `SHOWN` that fit in memory, and that
    by ``method``, a bundled one or a user's own, see `hardware.reconstruct`. They come back with
    the highest PSNR first, whatever order they were given in: tell them by their `method`.

    Raises InputError for a system or a reconstruction of another grid than the capture's.

    >>> from twin.camera.acquisition import capture
    >>> from twin.fidelity import PRESETS
    >>> from twin.scene import load_scene
    >>> from twin.system import load_system
    >>> system = load_system("workable").with_({"acquisition.n_patterns": 1024})
    >>> taken = capture(load_scene("table1"), system, seed=1, fidelity=PRESETS["draft"])
    >>> found = evaluate(system, taken, method=lambda values, noise_variance, sensing: (
    ...     sensing.adjoint(values) / sensing.n_cells
    ... ))
    >>> sorted(image.method.split("-")[0] for image in found.reconstructions)
    ['lambda', 'lmmse', 'zero']
    >>> found.verdict.void
    False
    """
    _check(system, capture, reconstructions)
    record = capture.record
    bundled = SHOWN_OF_OWN if isinstance(record.patterns, OwnPatterns) else SHOWN
    shown = [METHODS[name] for name in bundled if fits_in_memory(name, record.patterns)]
    own = None if method is None else method_of(method)
    if own is not None and own not in shown:
        shown.append(own)
    images = reconstructions or [reconstruct(record, solve) for solve in shown]
    scored = [(image, score_of(capture, image.picture)) for image in images]
    scored.sort(key=lambda pair: -pair[1].psnr_db)
    ordered = tuple(image for image, _ in scored), tuple(score for _, score in scored)
    return Evaluation(system, capture, *ordered, asked=own.name if own else None)


def _check(system: System, capture: Capture, reconstructions: object) -> None:
    """Raise InputError for what `evaluate` cannot score."""
    check_kind("system", system, System, "twin.load_system")
    check_kind("capture", capture, Capture, "twin.capture")
    shown, of = (
        f"{patterns.rows} x {patterns.columns} cells"
        for patterns in (system.patterns, capture.record.patterns)
    )
    if shown != of:
        raise InputError(
            f"system: {system.name} shows {shown}, expected the {of} that the capture is of"
        )
    if reconstructions is None:
        return
    if not isinstance(reconstructions, list | tuple):
        kind = type(reconstructions).__name__
        raise InputError(f"reconstructions: a {kind}, expected a list of them")
    for place, image in enumerate(reconstructions):
        check_kind(f"reconstructions[{place}]", image, Reconstruction, "hardware.reconstruct")

"""Baselines: figures of a method, seed by seed, with the reasons for every change, as JSON."""

import hashlib
import json
import re
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hardware.files import whole_file
from twin.accuracy import Interval
from twin.files import InputError

_FORMAT = 2
_DIGITS = 10


@dataclass(frozen=True)
class Baseline:
    """What a method reached.

    setup
        Scene, design, fidelity, seeds, metrics: what has to be the same for figures to compare.
    figures
        By metric, one number per seed.
    records
        Digest of the records that they are of.
    example
        The first seed's result, to be shown beside a later one.
    history
        Why it is as it is, oldest first: reason, method, versions, means before and after, and the
        smallest loss that the figures find even when draws don't pair.
    model_error
        Of each metric's mean, statistical (standard deviation) and systematic (bound); none in
        baselines of earlier versions, where it is 0.
    """

    setup: dict[str, Any]
    figures: dict[str, list[float]]
    records: str
    example: dict[str, Any]
    history: tuple[dict[str, Any], ...]
    model_error: dict[str, list[float]] = field(default_factory=dict)

    def errors(self) -> dict[str, Interval]:
        """Mean figure of each metric with the model's error."""
        return {
            name: Interval(mean, *self.model_error.get(name, ()))
            for name, mean in self.means().items()
        }

    def arrays(self) -> dict[str, NDArray[np.float64]]:
        """Figures as arrays."""
        return {name: np.array(values) for name, values in self.figures.items()}

    def means(self) -> dict[str, float]:
        """Mean figure of each metric."""
        return {name: rounded(np.mean(values)) for name, values in self.figures.items()}


def rounded(value: Any) -> float:
    """To as many digits as baselines hold."""
    return float(f"{value:.{_DIGITS}g}")


def read_baseline(path: Path) -> Baseline | None:
    """A baseline, or None where there is none.

    Raises InputError for a file that is none, or is not as `write_baseline` left it: its digest is
    of all else that it holds, so that whatever was edited or lost shows in one way.
    """
    try:
        content = json.loads(path.read_bytes())
    except FileNotFoundError:
        return None
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"{path}: cannot be read as a baseline: {error}") from error
    if not isinstance(content, dict) or content.pop("format", None) != _FORMAT:
        raise InputError(f"{path}: is no baseline of format {_FORMAT}")
    if content.pop("digest", None) != _digest(content):
        raise InputError(
            f"{path}: is not as it was written: its digest does not fit; take it from version "
            "control, or make it anew"
        )
    return Baseline(**content | {"history": tuple(content["history"])})


def write_baseline(baseline: Baseline, path: Path) -> None:
    """Write it whole or not at all; the numbers of a list stand on one line."""
    content = asdict(baseline)
    whole = {"format": _FORMAT, "digest": _digest(content), **content}
    text = json.dumps(whole, indent=1, ensure_ascii=False)
    text = re.sub(r"\[[^][{}\"]*\]", lambda found: " ".join(found[0].split()), text)
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as partial:
        partial.write_text(text + "\n", encoding="utf-8")


def _digest(content: dict[str, Any]) -> str:
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()

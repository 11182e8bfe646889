"""How closely the twin follows physics: every knob in one object, each with the error it bounds.

The knobs are of two kinds, those of light and those of the radar; a `Fidelity` is both. Each knob
says beside its default what values it takes and which of two is the stricter.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, Literal, Self, TypeVar, get_args

import numpy as np

from hardware.own_functions import OwnFunction, OwnFunctionError, own_function
from twin.errors import InputError
from twin.optics.paths import TracingQuality

Noise = Literal["none", "gaussian", "full"]
Start = Literal["auto", "dual", "scatter"]
RadarModel = Literal["targets", "paths", "optics", "rough"]

K = TypeVar("K", bound="Knobs")

_BELOW_1 = math.nextafter(1.0, 0.0)


@dataclass(frozen=True)
class Rule:
    """What a knob takes, and which of two values is the stricter.

    ``made_of`` makes the value of what is given, such as 1 000 000 of 1e6; ``check`` says what is
    wrong with it, nothing where it is right.
    """

    check: Callable[[Any], str]
    stricter: Callable[[Any, Any], Any]
    made_of: Callable[[Any], Any] = lambda value: value


def _whole(least: int, *, optional: bool = False) -> dict[str, Rule]:
    """A whole number, the stricter the more; ``optional``: or None."""

    def check(value: Any) -> str:
        if value is None and optional:
            return ""
        if isinstance(value, bool) or not isinstance(value, int):
            return "is no int"
        return f"is less than {least}" if value < least else ""

    return {"rule": Rule(check, max, _integral)}


def _integral(value: Any) -> Any:
    """A whole number of any kind, such as 1e6, as an int; anything else as it is."""
    if isinstance(value, float | np.number) and float(value).is_integer():
        return int(value)
    return value


def _depth(least: float) -> dict[str, Rule]:
    """A number, the stricter the more."""

    def check(value: Any) -> str:
        return "" if _is_number(value) and value >= least else f"is less than {least:g}"

    return {"rule": Rule(check, max)}


def _tolerance(low: float, high: float) -> dict[str, Rule]:
    """A number, the stricter the less."""

    def check(value: Any) -> str:
        within = _is_number(value) and low <= value <= high
        return "" if within else f"is not in {low:g} to {high:g}"

    return {"rule": Rule(check, min)}


def _optional_tolerance(low: float, high: float) -> dict[str, Rule]:
    """A number, the stricter the less, or None, which leaves it to other knobs."""
    rule = _tolerance(low, high)["rule"]

    def stricter(one: Any, other: Any) -> Any:
        given = [value for value in (one, other) if value is not None]
        return min(given) if given else None

    return {"rule": Rule(lambda value: "" if value is None else rule.check(value), stricter)}


def _one_of(kind: Any, stricter: Callable[[Any, Any], Any] | None = None) -> dict[str, Rule]:
    """One of some words, the stricter the later it stands among them."""
    known = get_args(kind)

    def check(value: Any) -> str:
        return "" if value in known else f"is none of {', '.join(known)}"

    def later(one: Any, other: Any) -> Any:
        return max(one, other, key=known.index)

    return {"rule": Rule(check, stricter or later)}


#: Arguments of a user's own propagation model, see `twin.PropagationModel`.
_SOLVED = ("scene", "radar", "fidelity", "seed")
_OWN_SOLVERS = "twin.propagation"


def own_solver(radar: "RadarModel | str | Callable[..., Any]") -> OwnFunction | None:
    """A user's own propagation model where ``fidelity.radar`` names or holds one; None: a bundled
    one. Raises OwnFunctionError, an InputError, for one that is not there or takes other arguments.
    """
    if isinstance(radar, str) and radar in get_args(RadarModel):
        return None
    return own_function(radar, _SOLVED, group=_OWN_SOLVERS)


def _solver() -> dict[str, Rule]:
    """One of the bundled models, the stricter the later; or a user's own, which is before all."""
    known = get_args(RadarModel)

    def check(value: Any) -> str:
        if not callable(value) and not isinstance(value, str):
            return f"is none of {', '.join(known)}"
        try:
            own_solver(value)
        except OwnFunctionError as error:
            return f"is none of {', '.join(known)}, and no function of a user's own: {error}"
        return ""

    def stricter(one: Any, other: Any) -> Any:
        own = [value for value in (one, other) if value not in known]
        if len(own) == 2 and one != other:
            raise InputError(f"radar: {one!r:.60} and {other!r:.60}: neither is the stricter")
        return own[0] if own else max(one, other, key=known.index)

    return {"rule": Rule(check, stricter)}


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _named_side(one: Start, other: Start) -> Start:
    """The side to start from, when only one of the two names it: neither is stricter."""
    return one if other == "auto" else other


@dataclass(frozen=True)
class Knobs:
    """Checks knobs by their rules; ``a | b`` takes the stricter of each."""

    def __post_init__(self) -> None:
        for knob in fields(self):
            value = knob.metadata["rule"].made_of(getattr(self, knob.name))
            object.__setattr__(self, knob.name, value)
            if wrong := knob.metadata["rule"].check(value):
                raise InputError(f"{knob.name}: {value!r:.60} {wrong}")

    def __or__(self, other: Self) -> Self:
        """The stricter of each knob."""
        one, two = self._said(), other._said()
        stricter = {
            knob.name: knob.metadata["rule"].stricter(
                getattr(one, knob.name), getattr(two, knob.name)
            )
            for knob in fields(self)
        }
        return type(self)(**stricter)

    def _said(self) -> Self:
        """The same, with what a default stands for."""
        return self

    def with_(self, changes: Mapping[str, Any] | None = None, **knobs: Any) -> Self:
        """The same with some knobs changed. Raises InputError for a knob that is none, or a value
        that it does not take.

        >>> Fidelity().with_({"radar_tolerance": 0.03}) == Fidelity(radar_tolerance=0.03)
        True
        >>> Fidelity().with_(radar_tolerance=3)
        Traceback (most recent call last):
        hardware.errors.InputError: radar_tolerance: 3 is not in 0.001 to 1
        """
        new = {**(changes or {}), **knobs}
        unknown = new.keys() - {knob.name for knob in fields(self)}
        if unknown:
            gone = "".join(f"; {old} {REPLACED[old]}" for old in sorted(unknown & REPLACED.keys()))
            raise InputError(f"fidelity: no knob {', '.join(sorted(unknown))}{gone}")
        return replace(self, **new)

    def said(self) -> dict[str, Any]:
        """Knobs as names and numbers; a user's own model by name and digest."""
        knobs = {knob.name: getattr(self, knob.name) for knob in fields(self)}
        if "radar" in knobs and (own := own_solver(knobs["radar"])):
            knobs["radar"] = own.label
        return knobs

    def part(self, kind: type[K]) -> K:
        """The knobs of light alone, or those of the radar alone: what results depend on.

        >>> Fidelity(samples=16, radar="paths").part(RadarFidelity)
        RadarFidelity(radar='paths', ...)
        """
        return kind(**{knob.name: getattr(self, knob.name) for knob in fields(kind)})


@dataclass(frozen=True)
class LightFidelity(Knobs):
    """Knobs of the camera chain.

    samples
        Paths per cell, a square number: noise of direct light, falling as samples^-0.75.
    max_depth
        Bounces of light: light of further ones, up to the reflectance's next power, is lost.
    indirect_samples
        Paths per cell for further bounces: their noise, falling as samples^-0.5. Default: a
        quarter of ``samples``.
    start
        Side on which paths to a line sensor start: noise alone, for the same number of paths.
        ``auto`` is the side with more cells.
    light_tolerance
        Error that light transport may add to the image, root mean square over the cells, as a share
        of the noise of a pixel: paths are added cell by cell until their own scatter says that it
        is less, and bounces end by chance, so that no light is lost; ``samples``, ``max_depth`` and
        ``indirect_samples`` then do not count. Line sensors and time of flight have as many paths
        in every cell, and bounces up to ``max_depth``. None: as many paths as ``samples`` says.
    noise
        ``none``: counts of the mean, rounded. ``gaussian``: shot noise as a normal distribution,
        wrong in shape below some 100 electrons. ``full``: Poisson.
    air_orders
        Scatterings that are followed in the air on the way to a surface, and as many back: light of
        more is lost. Of a wall's light, at an optical depth of 1 each way, less than 0.1 % (mean
        cosine 0.85) and 0.6 % (0); at 3 0.2 % and 29 %. 0: what is scattered forward stays in its
        cell, whose contrast is then too high by the optical depth.
    """

    samples: int = field(default=64, metadata=_whole(1))
    max_depth: int = field(default=4, metadata=_whole(1))
    indirect_samples: int | None = field(default=None, metadata=_whole(1, optional=True))
    start: Start = field(default="auto", metadata=_one_of(Start, _named_side))
    light_tolerance: float | None = field(default=None, metadata=_optional_tolerance(1e-4, 10.0))
    noise: Noise = field(default="full", metadata=_one_of(Noise))
    air_orders: int = field(default=12, metadata=_whole(0))

    def __post_init__(self) -> None:
        super().__post_init__()
        _ = self.quality  # has its own checks

    def _said(self) -> Self:
        return replace(self, indirect_samples=self.quality.further_samples)

    @property
    def quality(self) -> TracingQuality:
        """Knobs of the path tracer."""
        return TracingQuality(self.samples, self.max_depth, self.indirect_samples, self.air_orders)


@dataclass(frozen=True)
class RadarFidelity(Knobs):
    """Knobs of the radar chain.

    radar
        ``targets``: declared targets straight ahead, without the scene: no multipath, no clutter,
        no shadows. ``paths``: traced through the scene, where small far meshes answer from tables.
        ``optics``: meshes scatter by physical optics instead of a declared cross-section, over the
        ground and large walls too. ``rough``: surfaces scatter as well, and reflect the less.
        Or a model of a user's own (`twin.PropagationModel`): a function, ``file.py:function``, or
        the name of an entry point of the group ``twin.propagation``.
    nufft_tolerance
        Relative error of the radar's channel against the direct sum.
    radar_tolerance
        Of physical optics, 0.001 to 1. Estimated error of the echo of every body over the band,
        relative to its root mean square, or to an echo 40 dB below the strongest body's, or to a
        tenth of the receiver's noise, whichever is larger: triangles are divided until their
        estimated errors, added as independent, stay below it at each stage, or to a deepest
        division. What all stages come to is told of every body (`Propagation.bodies`, the report),
        times three: 95 of 100 bodies' errors are within that (`python -m benchmarks
        radar_estimates`: of 133 bodies of random scenes 99, 98 and 96 % at 0.3, 0.1 and 0.03; all
        of the yard and the street). It is warned of from six tolerances on, where the error itself
        most likely exceeds one. `twin trade` measures the errors themselves, body by body. What the
        estimate misses: bodies narrower than the rays within a facet that shows them by reflection
        (80 000 more rays than there are facets, where these are larger than half a wavelength);
        what facets, which are flat, leave of a curved mirror. Of plates at half their size from
        the radar the echo is off by 1 to 3 times the tolerance, and is warned of.
    radar_bounces
        Between objects that scatter by physical optics: what is reflected more often is lost. A
        trihedral needs 3.
    radar_images
        Reflections at large surfaces on the way to an object, and as many back. Of ways out by one
        image and home by another both directions are computed, each with its own currents, since
        physical optics is not reciprocal; what is met once answers in each with the mean of both.
    radar_edges
        Pieces of sharp edges that diffract, all objects and images together; 0: none. Without them
        small bodies with edges are off by 10 dB, mean over all angles (the Austin plates). Where
        pieces are longer than an eighth of a wavelength, the band's edges suffer first. On the
        street 250 000 more contributions, and 1 s more to find them.
    radar_shadow_db
        Depth to which shadows of obstacles are computed on the way to a declared target: what comes
        round an edge, one way, fainter than this beside the straight wave is lost. 0: shadows
        are silent and their borders hard, off by 6 to 12 dB in the echo right there and by up to
        2.7 dB on the lit side.
    radar_shadowed
        Facets that answer over obstacles' edges, all bodies together, the brightest ones, down to
        shadows of 30 dB; 0: on bodies shadows are silent and their borders hard, as above. Some
        3 ms each, and 4 s for the street's car to be cut into facets of 2 cm.
    radar_table_nodes
        Of a table of physical optics at the level ``paths``, per lobe lambda / (2 D) of a target of
        extent D: an echo from its rim is off by 0.6 / n^2 of itself at most. At 4 a plate's rms
        error is 0.7 % of its peak, 0.06 dB.
    radar_scatterers
        Of all rough surfaces together: below some 10 in a resolution cell speckle is no speckle.
    """

    radar: RadarModel | str | Callable[..., Any] = field(default="optics", metadata=_solver())
    nufft_tolerance: float = field(default=1e-6, metadata=_tolerance(1e-14, _BELOW_1))
    radar_tolerance: float = field(default=0.1, metadata=_tolerance(1e-3, 1.0))
    radar_bounces: int = field(default=3, metadata=_whole(1))
    radar_images: int = field(default=1, metadata=_whole(0))
    radar_edges: int = field(default=0, metadata=_whole(0))
    radar_shadow_db: float = field(default=40.0, metadata=_depth(0.0))
    radar_shadowed: int = field(default=0, metadata=_whole(0))
    radar_table_nodes: int = field(default=4, metadata=_whole(1))
    radar_scatterers: int = field(default=50_000, metadata=_whole(1))


@dataclass(frozen=True)
class Fidelity(RadarFidelity, LightFidelity):
    """Knobs of both chains, those of light first. ``a | b`` takes the stricter of each.

    >>> fine = PRESETS["draft"] | Fidelity(radar_tolerance=0.03)
    >>> fine.samples, fine.radar_tolerance
    (64, 0.03)
    """

    @classmethod
    def within(cls, share: float) -> "Fidelity":
        """Knobs for a model error of a share of the sensors' own noise, 0.002 to 2.

        Light: as `light_tolerance`, root mean square over the image. Radar: half of it as
        `radar_tolerance`, relative to each body's own echo: echoes may stand far above the noise,
        and their model as exact as that would take hours.

        >>> knobs = Fidelity.within(0.2)
        >>> knobs.light_tolerance, knobs.radar_tolerance
        (0.2, 0.1)
        """
        if not _is_number(share) or not 0.002 <= share <= 2:
            raise InputError(f"tolerance: {share!r:.60} is not in 0.002 to 2")
        return cls(light_tolerance=share, radar_tolerance=share / 2)


#: Knobs of earlier versions, and what became of them.
REPLACED = {"radar_rays": "gave way to radar_tolerance, the error of the echo of every body"}

#: A look at a design; most cells far below the sensor's own noise, though on the yard the rms over
#: cells is half of it (`twin trade` measures that); comparison.
PRESETS = {
    "draft": Fidelity(
        samples=4, max_depth=1, nufft_tolerance=1e-3, noise="gaussian", radar_tolerance=0.3
    ),
    "standard": Fidelity(),
    "reference": Fidelity(
        samples=1024,
        max_depth=8,
        nufft_tolerance=1e-10,
        radar="rough",
        radar_tolerance=0.03,
        radar_edges=2_000_000,
        radar_shadow_db=60.0,
        radar_shadowed=2000,
    ),
}


def preset(name: str | Fidelity) -> Fidelity:
    """A preset by name; a fidelity as it is. Raises InputError for a name that is none."""
    if isinstance(name, Fidelity):
        return name
    if name not in PRESETS:
        raise InputError(f"fidelity: {name!r} is none of {', '.join(PRESETS)}")
    return PRESETS[name]

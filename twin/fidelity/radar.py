"""Knobs of the radar chain."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

from hardware.own_functions import OwnFunction, OwnFunctionError, own_function
from twin.errors import InputError
from twin.fidelity.knobs import Knobs, Rule, depth, optional_tolerance, tolerance, whole

RadarModel = Literal["targets", "paths", "optics", "auto", "rough"]

_BELOW_1 = math.nextafter(1.0, 0.0)

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

    def told(value: Any) -> Any:
        own = own_solver(value)
        return own.label if own else value

    return {"rule": Rule(check, stricter, told=told)}


@dataclass(frozen=True)
class RadarFidelity(Knobs):
    """Knobs of the radar chain.

    radar
        ``targets``: declared targets straight ahead, without the scene: no multipath, no clutter,
        no shadows. ``paths``: traced through the scene, where small far meshes answer from tables.
        ``optics``: meshes scatter by physical optics instead of a declared cross-section, over the
        ground and large walls too; surfaces are smooth, which is warned of with its size where
        roughness would take more than `radar_tolerance`. ``rough``: surfaces scatter as well, and
        reflect the less, and so do bodies of a material with a gamma.
        ``auto``, under a tolerance: those do whose clutter may exceed a tenth of a cell's noise, or
        whose mirror images may lose more than a tenth of `radar_tolerance`.
        Or a model of a user's own (`twin.PropagationModel`): a function, ``file.py:function``, or
        the name of an entry point of the group ``twin.propagation``.
    nufft_tolerance
        Largest error of the radar's channel against the direct sum, relative to the channel's root
        mean square: not to the noise. Of one strong contribution, such as the leakage between
        antennas, this error is no noise either, but echoes that are not there, at delays on
        either side of its own. Their power is below a thousandth of the tolerance's
        square: 91 dB below the contribution at 1e-3, where `hybrid-79-mimo` shows two targets of 14
        and 16 dB in every burst, 148 dB at 1e-6. No preset is coarser than that; it costs 1 and 8 %
        of a frame of the yard by `draft` with one antenna and with 3 x 4.
    radar_tolerance
        Of physical optics, 0.001 to 1. Estimated error of the echo of every body over the band,
        relative to its root mean square, or to an echo 40 dB below the strongest body's, or to a
        tenth of the receiver's noise over the tolerance (the noise itself at 0.1), whichever is
        larger (``level_amplitude`` of `Propagation.bodies`): triangles are divided until their
        estimated errors, added as independent, stay below it at each stage, or to a deepest
        division. What all stages come to is told of every body (`Propagation.bodies`, the report),
        times three: 95 of 100 bodies' errors are within that (`python -m benchmarks
        radar_estimates`: of 264, 654 and 264 bodies of random scenes 100, 98 and 98 % at 0.3, 0.1
        and 0.03, at worst off by 6 times as much; all of the yard and the street). It is warned of
        from six tolerances on, where the error itself most likely exceeds one. `twin trade`
        measures the errors themselves, body by body. What the estimate misses: bodies narrower than
        the rays within a facet that shows them by reflection
        (80 000 more rays than there are facets, where these are larger than half a wavelength);
        what facets, which are flat, leave of a curved mirror. Of eight plates
        at half their size from the radar seven are within the tolerance, and one with a corner at
        8 cm is off by 10 times, 65 times stated.
    radar_motion_tolerance
        Change of a body's echo within an interval, relative to it, that delays of second order in
        time do not hold: what is lit changes as it turns (1.5 times its angle, of dihedrals, boxes
        and balls), and delays have higher orders. Up to there the scene is traced once, in the
        interval's middle; beyond, at up to 132 instants, each as dear as the first, and the echo
        between two of them is compared with one traced half way, in up to 5 places. Where one
        instant is taken, echoes traced at its ends check it, direct ones and coarsely those of up
        to three reflections (`crossing` takes 1.5 times as long as at rest): what they change by
        counts in stated errors and is warned of, and traced where a number is asked for. None: as
        `radar_tolerance`, and never traced for what such a check finds alone.
    radar_bounces
        Between objects that scatter by physical optics: what is reflected more often is lost. A
        trihedral needs 3. None: of every body as many, up to 6, as may add more than a tenth of
        `radar_tolerance` to its echo, as a coarse pass bounds it (`Propagation.decisions`).
    radar_images
        Reflections at large surfaces on the way to an object, and as many back. None: up to 16, or
        2 where images or facets are many, of every body as many as may add more than a tenth of
        `radar_tolerance`. Of ways out by one image and home by another both directions are
        computed, each with its own currents, since physical optics is not reciprocal; what is met
        once answers in each with the mean of both. From 2 on an InputError where these are more
        than 17 million paths, or than 1 million where bounds decide on bounces or edges, as in a
        city.
    radar_edges
        Pieces of sharp edges that diffract, all objects and images together; 0: none. Without them
        small bodies with edges are off by 10 dB, mean over all angles (the Austin plates). Where
        pieces are longer than an eighth of a wavelength, the band's edges suffer first. On the
        street 250 000 more contributions, and 1 s more to find them. None: edges of those bodies to
        whose echo they may add more than a tenth of `radar_tolerance`, in pieces of a wavelength,
        from 0.1 of that down to 0.0125 shorter ones, to an eighth.
    radar_shadow_db
        Depth to which shadows of obstacles are computed on the way to a declared target, and to
        those parts of bodies where so faint a wave may count: what comes round an edge, one way,
        fainter than this beside the straight wave is lost. 0: shadows are silent and their borders
        hard, off by 6 to 12 dB in the echo right there and by up to 2.7 dB on the lit side.
    radar_shadowed
        Parts of bodies, 1 to 10 cm in size, that answer over obstacles' edges, all bodies together,
        those that may change the most, down to shadows of 30 dB (at a `radar_tolerance` of 0.1; 40
        dB at 0.03), of `radar_shadow_db`, or 45 dB, where it counts, also beside what the stronger
        waves are off by; 0: on bodies shadows are silent and their borders hard, as above. None: up
        to 1000, of those bodies to whose echo they may add more than a tenth of `radar_tolerance`;
        what is left out is told of every body. A third of the yard's trace.
    radar_table_nodes
        Of a table of physical optics at the level ``paths``, per lobe lambda / (2 D) of a target of
        extent D: an echo from its rim is off by 0.6 / n^2 of itself at most. At 4 a plate's rms
        error is 0.7 % of its peak, 0.06 dB.
    radar_scatterers
        Of all rough surfaces together: below some 10 in a resolution cell speckle is no speckle.
        Each has 64 at least.
    radar_surface_seed
        Of the places and phases of these scatterers: they belong to the scene, and are the same at
        all times, whatever the seed of a measurement. Other seeds are other surfaces of the kind.
    """

    radar: RadarModel | str | Callable[..., Any] = field(default="optics", metadata=_solver())
    nufft_tolerance: float = field(default=1e-6, metadata=tolerance(1e-14, _BELOW_1))
    radar_tolerance: float = field(default=0.1, metadata=tolerance(1e-3, 1.0))
    radar_motion_tolerance: float | None = field(
        default=None, metadata=optional_tolerance(1e-3, 1.0)
    )
    radar_bounces: int | None = field(default=3, metadata=whole(1, optional=True))
    radar_images: int | None = field(default=1, metadata=whole(0, optional=True))
    radar_edges: int | None = field(default=0, metadata=whole(0, optional=True))
    radar_shadow_db: float = field(default=40.0, metadata=depth(0.0))
    radar_shadowed: int | None = field(default=0, metadata=whole(0, optional=True))
    radar_table_nodes: int = field(default=4, metadata=whole(1))
    radar_scatterers: int = field(default=50_000, metadata=whole(1))
    radar_surface_seed: int = field(default=0, metadata=whole(0))

"""How closely the twin follows physics: every knob in one object, each with the error it bounds."""

from dataclasses import dataclass, fields, replace
from typing import Any, Literal, get_args

from twin.optics.paths import Quality

Noise = Literal["none", "gaussian", "full"]
Start = Literal["auto", "dual", "scatter"]
RadarRung = Literal["targets", "paths", "optics", "rough"]


@dataclass(frozen=True)
class Fidelity:
    """Knobs of both chains. ``a | b`` takes the stricter of each.

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
    noise
        ``none``: counts of the mean, rounded. ``gaussian``: shot noise as a normal distribution,
        wrong in shape below some 100 electrons. ``full``: Poisson.
    radar
        ``targets``: declared targets straight ahead, without the scene: no multipath, no clutter,
        no shadows. ``paths``: traced through the scene, where small far meshes answer from tables.
        ``optics``: meshes scatter by physical optics instead of a declared cross-section, over the
        ground and large walls too. ``rough``: surfaces scatter as well, and reflect the less.
    nufft_tolerance
        Relative error of the radar's channel against the direct sum.
    radar_tolerance
        Of physical optics, 0.001 to 1. Estimated error of the echo of every body over the band,
        relative to its root mean square, or to an echo 40 dB below the strongest body's, or to a
        tenth of the receiver's noise, whichever is larger: triangles are divided until their
        estimated errors, added as independent, stay below it at each stage, or to a deepest
        division. What all stages come to is told of every body (`Propagation.bodies`, the report)
        and warned of where it exceeds the tolerance: at 0.1 on the yard 4 to 17 % are estimated, 2
        to 11 % measured. `twin trade` measures the errors themselves, body by body. What the
        estimate misses: bodies narrower than the rays within a facet that shows them by reflection
        (20 000 more rays than there are facets, where these are larger than two wavelengths); where
        borders of shadows cross a triangle more than once (plates that cut each other: 12 % at 0.1,
        10 % at 0.03); what facets, which are flat, leave of a curved mirror.
    radar_bounces
        Between objects that scatter by physical optics: what is reflected more often is lost. A
        trihedral needs 3.
    radar_images
        Reflections at large surfaces on the way to an object, and as many back.
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
        Of a table of physical optics on the rung ``paths``, per lobe lambda / (2 D) of a target of
        extent D: an echo from its rim is off by 0.6 / n^2 of itself at most. At 4 a plate's rms
        error is 0.7 % of its peak, 0.06 dB.
    radar_scatterers
        Of all rough surfaces together: below some 10 in a resolution cell speckle is no speckle.
    air_orders
        Scatterings that are followed in the air on the way to a surface, and as many back: light of
        more is lost, 1e-10 of it at an optical depth of 1 and 2e-5 at 3. 0: what is scattered
        forward stays in its cell, whose contrast is then too high by the optical depth.
    """

    samples: int = 64
    max_depth: int = 4
    indirect_samples: int | None = None
    start: Start = "auto"
    noise: Noise = "full"
    radar: RadarRung = "optics"
    nufft_tolerance: float = 1e-6
    radar_tolerance: float = 0.1
    radar_bounces: int = 3
    radar_images: int = 1
    radar_edges: int = 0
    radar_shadow_db: float = 40.0
    radar_shadowed: int = 0
    radar_table_nodes: int = 4
    radar_scatterers: int = 50_000
    air_orders: int = 12

    def __post_init__(self) -> None:
        _ = self.quality  # has its own checks
        for name, kind in (("start", Start), ("noise", Noise), ("radar", RadarRung)):
            value = getattr(self, name)
            if value not in get_args(kind):
                raise ValueError(f"{name}: {value!r} is none of {', '.join(get_args(kind))}")
        for name, least in (
            ("radar_bounces", 1),
            ("radar_images", 0),
            ("radar_edges", 0),
            ("radar_shadow_db", 0),
            ("radar_shadowed", 0),
            ("radar_table_nodes", 1),
            ("radar_scatterers", 1),
        ):
            if getattr(self, name) < least:
                raise ValueError(f"{name}: {getattr(self, name)} is less than {least}")
        if not 1e-3 <= self.radar_tolerance <= 1:
            raise ValueError(f"radar_tolerance: {self.radar_tolerance} is not in 0.001 to 1")
        if not 1e-14 <= self.nufft_tolerance < 1:
            raise ValueError(f"nufft_tolerance: {self.nufft_tolerance} is not in 1e-14 to 1")

    @property
    def quality(self) -> Quality:
        """Knobs of the path tracer."""
        return Quality(self.samples, self.max_depth, self.indirect_samples, self.air_orders)

    def __or__(self, other: "Fidelity") -> "Fidelity":
        """The stricter of each knob; a side to start from, when only one of the two names it."""
        further = max(self.quality.further_samples, other.quality.further_samples)
        return Fidelity(
            samples=max(self.samples, other.samples),
            max_depth=max(self.max_depth, other.max_depth),
            indirect_samples=further,
            start=self.start if other.start == "auto" else other.start,
            noise=max(self.noise, other.noise, key=get_args(Noise).index),
            radar=max(self.radar, other.radar, key=get_args(RadarRung).index),
            radar_tolerance=min(self.radar_tolerance, other.radar_tolerance),
            radar_bounces=max(self.radar_bounces, other.radar_bounces),
            radar_images=max(self.radar_images, other.radar_images),
            radar_edges=max(self.radar_edges, other.radar_edges),
            radar_shadowed=max(self.radar_shadowed, other.radar_shadowed),
            radar_shadow_db=max(self.radar_shadow_db, other.radar_shadow_db),
            radar_table_nodes=max(self.radar_table_nodes, other.radar_table_nodes),
            radar_scatterers=max(self.radar_scatterers, other.radar_scatterers),
            nufft_tolerance=min(self.nufft_tolerance, other.nufft_tolerance),
            air_orders=max(self.air_orders, other.air_orders),
        )

    def with_(self, **changes: Any) -> "Fidelity":
        """The same with some knobs changed. Raises ValueError for a knob that is none."""
        unknown = changes.keys() - {field.name for field in fields(self)}
        if unknown:
            raise ValueError(f"fidelity: no knob {', '.join(sorted(unknown))}")
        return replace(self, **changes)


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


def preset(name: "str | Fidelity") -> Fidelity:
    """A preset by name. Raises ValueError for one that is none."""
    if isinstance(name, Fidelity):
        return name
    if name not in PRESETS:
        raise ValueError(f"fidelity: {name!r} is none of {', '.join(PRESETS)}")
    return PRESETS[name]

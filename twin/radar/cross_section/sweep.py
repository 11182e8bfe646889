"""Radar cross-section of a mesh, and where the figure is not to be trusted."""

from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.constants import speed_of_light

from twin.radar.cross_section.aspects import Aspects
from twin.radar.cross_section.optics import Quality, ScatteringAmplitudes, portions, scattered
from twin.radar.scattering.diffraction import EdgeQuality, edge_diffraction
from twin.radar.scattering.edges import Edges, sharp_edges
from twin.radar.scattering.surface import PEC
from twin.radar.scattering.target import MeshTarget
from twin.radar.scattering.wave import Polarization, Radar

Array = NDArray[np.float64]

# From here on a figure comes with a warning.
_SMALL = 3.0  # wavelengths that a target measures: at 2.6 the Austin plates are 10 dB off
_NARROW = 1.0
#: Wavelengths between facets and the surface they stand for, 22 deg of phase: at 0.05, a cylinder
#: of 32 sides, echoes are off by up to 1.8 dB.
_FACETED = 1 / 32
_MOST_LOOKED_AT = 16  # aspects at which edges that are left out are computed
_GRAZED = 0.5  # share of the lit wavefront
_UNFINISHED = 0.01


@dataclass(frozen=True, eq=False)
class Sweep:
    """Cross-section over aspect: complex amplitude S (n,) in metres with sigma = 4 pi |S|^2, and
    what to know before using it.
    """

    azimuth_deg: Array
    elevation_deg: Array
    amplitude_m: NDArray[np.complex128]
    warnings: tuple[str, ...]

    @property
    def cross_section_m2(self) -> Array:
        """4 pi |S|^2."""
        return 4 * np.pi * np.abs(self.amplitude_m) ** 2

    @property
    def cross_section_dbsm(self) -> Array:
        """In dB over 1 m^2; -inf where nothing comes back."""
        with np.errstate(divide="ignore"):
            decibel: Array = 10 * np.log10(self.cross_section_m2)
        return decibel


def sweep(
    target: MeshTarget,
    carrier_hz: float,
    azimuth_deg: Iterable[float],
    elevation_deg: float = 0.0,
    *,
    distance_m: float = np.inf,
    transmit: Polarization = "V",
    receive: Polarization | None = None,
    edges: bool = False,
    quality: Quality | None = None,
    edge_quality: EdgeQuality | None = None,
    stage: Callable[[str], AbstractContextManager[None]] = lambda _: nullcontext(),
) -> Sweep:
    """Monostatic cross-section from each azimuth.

    Parameters
    ----------
    distance_m
        Of the radar from the target's origin; finite: what the radar equation with that distance
        needs to give the echo of a target in the near field.
    transmit, receive
        Polarisations; ``receive`` defaults to ``transmit``.
    edges
        Adds the diffraction of sharp edges.
    stage
        Entered for each part of the azimuths with its name: progress.
    """
    quality = quality or Quality()
    edge_quality = edge_quality or EdgeQuality()
    azimuths = np.array(list(azimuth_deg), dtype=np.float64)
    sharp = sharp_edges(target, edge_quality.sharp_angle_deg)
    port = 0 if (receive or transmit) == "V" else 1
    radars = [Radar.at(azimuth, elevation_deg, distance_m) for azimuth in azimuths]
    amplitudes, echoes = np.zeros(len(radars), dtype=np.complex128), []
    for rows in portions(target, len(radars)):
        with stage(_name(azimuths[rows])):
            aspects = Aspects.monostatic(radars[rows], transmit)
            echoes.append(scattered(target, aspects, carrier_hz, quality))
            amplitudes[rows] = echoes[-1].amplitude[:, port]
            if edges:
                amplitudes[rows] += [
                    edge_diffraction(target, sharp, radar, carrier_hz, transmit, edge_quality)[port]
                    for radar in radars[rows]
                ]
    diffracting = edges and len(sharp.length_m) > 0
    remarks = [
        *_on_target(target, sharp, speed_of_light / carrier_hz, edges),
        *_on_distance(target, distance_m),
        *_on_aspects(azimuths, echoes, quality, diffracting),
    ]
    if not edges and len(sharp.length_m) and radars:
        some = np.unique(np.linspace(0, len(radars) - 1, _MOST_LOOKED_AT).astype(int))
        left_out = [
            edge_diffraction(target, sharp, radars[i], carrier_hz, transmit, edge_quality)[port]
            for i in some
        ]
        remarks += _on_edges(azimuths, some, amplitudes, np.array(left_out), quality.tolerance)
    return Sweep(
        azimuths,
        np.full(len(azimuths), float(elevation_deg)),
        amplitudes,
        tuple(remarks),
    )


def _on_edges(
    azimuths: Array,
    some: NDArray[np.int_],
    facets: NDArray[np.complex128],
    edges: NDArray[np.complex128],
    tolerance: float,
) -> list[str]:
    """Warning where edges, which are left out, exceed the tolerance of the facets' echo."""
    exceeds = np.abs(edges) > tolerance * np.abs(facets[some])
    if not exceeds.any():
        return []
    share = np.abs(edges[exceeds]) / np.maximum(np.abs(facets[some][exceeds]), 1e-300)
    worst = some[exceeds][np.argmax(share)]
    return [
        f"sharp edges, left out, have up to {min(share.max(), 1e3):.2g} of the facets' amplitude, "
        f"at azimuth {azimuths[worst]:g} deg: --edges adds them ({len(some)} azimuths looked at)"
    ]


def _on_target(target: MeshTarget, edges: Edges, wavelength: float, diffraction: bool) -> list[str]:
    points = target.geometry.used_m - target.geometry.used_m.mean(axis=0)
    sizes = np.ptp(points @ np.linalg.svd(points, full_matrices=False)[2].T, axis=0) / wavelength
    sizes = np.sort(sizes)[::-1]
    remarks = []
    if sizes[0] < _SMALL:
        remarks.append(
            f"the target measures {sizes[0]:.2g} wavelengths: below {_SMALL:g} physical optics is "
            "no more than an order of magnitude"
        )
    elif sizes[1] < _NARROW:
        remarks.append(
            f"the target is {sizes[1]:.2g} wavelengths wide: currents around it are not followed"
        )
    if edges.sagitta_m > _FACETED * wavelength:
        remarks.append(
            f"facets lie up to {edges.sagitta_m / wavelength:.2g} wavelengths off a smooth surface:"
            " each reflects for itself; a finer mesh is needed"
        )
    if diffraction and edges.non_manifold:
        remarks.append(f"{edges.non_manifold} edges of more than two faces diffract nothing")
    if diffraction and any(surface != PEC for surface in target.surfaces):
        remarks.append("edges diffract as if they were conducting")
    return remarks


def _on_distance(target: MeshTarget, distance_m: float) -> list[str]:
    center, radius = target.geometry.sphere
    if distance_m < float(np.linalg.norm(center)) + radius:
        return ["the radar may stand within the target: the figure is an echo, no cross-section"]
    return []


def _on_aspects(
    azimuths: Array, parts: list[ScatteringAmplitudes], quality: Quality, diffracting: bool
) -> list[str]:
    if not parts:
        return []
    grazing, left, undersampling = (
        np.concatenate([getattr(part, name) for part in parts])
        for name in ("grazing", "unfinished", "undersampling")
    )
    remarks = []
    grazed, unfinished = (grazing > _GRAZED) & (not diffracting), left > _UNFINISHED
    if grazed.any():
        remarks.append(
            f"{_where(azimuths, grazed)}: most of the target is met within 15 deg of grazing, "
            "where creeping and travelling waves, outside physical optics, decide the echo"
        )
    if unfinished.any():
        remarks.append(
            f"{_where(azimuths, unfinished)}: up to {100 * left.max():.0f} % of the rays go on "
            f"after {quality.max_bounces} bounces"
        )
    if undersampling.max() > 1:
        remarks.append(
            f"rays within the target up to {undersampling.max():.2g} times wider apart than asked "
            f"for: {quality.max_rays} at most"
        )
    return remarks


def _name(azimuths: Array) -> str:
    if len(azimuths) == 1:
        return f"azimuth {azimuths[0]:g} deg"
    return f"azimuths {azimuths[0]:g} to {azimuths[-1]:g} deg"


def _where(azimuths: Array, flags: NDArray[np.bool_]) -> str:
    at = azimuths[flags]
    if len(at) == 1:
        return f"azimuth {at[0]:g} deg"
    return f"{len(at)} azimuths from {at.min():g} to {at.max():g} deg"

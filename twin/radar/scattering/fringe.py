"""Fringe current of a wedge's face: what the true current is beyond that of physical optics.

A wedge of exterior angle N pi fills the space behind its faces; the edge is the z axis, x lies on
the face and points into it, y away from the wedge. A wave comes from the angle phi0 above the face,
travelling at the angle beta0 to the edge. Its current on the face is known exactly (Sommerfeld).
Integrated along the direction in which a diffracted ray grazes the face (Michaeli, IEEE Trans. AP
34, 1986), the exact current minus that of physical optics has a closed form; here it is written as
the moment of the surface current per length of edge, instead of a pair of electric and magnetic
line currents: both radiate the same field.

The face ends at a distance: what the fringe current would radiate from beyond is taken out
(Johansen, IEEE Trans. AP 44, 1996). For half-planes (N = 2) that is exact; for other wedges the
half-plane's current beyond the end is scaled to the wedge's own diffraction coefficient.

Fields go with exp(+j omega t); the impedance of free space is taken out.
"""

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray
from scipy.special import wofz

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

_NEAR_POLE = 1e-4  # both parts have a pole where they cancel: passed by the mean of both sides


@dataclass(frozen=True, eq=False)
class Incidence:
    """How a wave meets an edge and is looked at; all (n,).

    ``n`` is the wedge number N, ``phi0`` in rad, ``cos_beta0`` of the direction of travel, ``mu``
    the phase that the observer adds along the face over that of a wave grazing it (1: they cancel),
    ``end_m`` where the face ends.
    """

    n: Array
    phi0: Array
    cos_beta0: Array
    mu: Array
    end_m: Array

    def take(self, rows: NDArray[np.intp]) -> "Incidence":
        """Only some of them, by index."""
        return Incidence(*(getattr(self, f.name)[rows] for f in fields(Incidence)))


def observed(
    n: Array, phi0: Array, cos_beta0: Array, towards_x: Array, towards_z: Array, end_m: Array
) -> Incidence:
    """The incidence for an observer in a direction whose components along x and z are given."""
    sine2 = 1 - cos_beta0**2
    mu = (np.sqrt(sine2) * towards_x + cos_beta0 * (towards_z - cos_beta0)) / sine2
    return Incidence(n, phi0, cos_beta0, mu, end_m)


def moment(
    at: Incidence, e_z: Array | Complex, h_z: Array | Complex, wavenumber: float
) -> tuple[Complex, Complex]:
    """Components x and z of the fringe current's moment per length of edge, in metres.

    ``e_z`` and ``h_z`` are the incident fields along the edge, (n,).
    """
    sine = np.sqrt(1 - at.cos_beta0**2)
    k = wavenumber * sine
    pole = -np.cos(at.phi0)
    near = np.flatnonzero(np.abs(at.mu - pole) < _NEAR_POLE)
    mu = at.mu.copy()
    mu[near] = pole[near] + _NEAR_POLE
    hard, slope, soft = _integrals(at, mu, k)
    if len(near):  # the mean of both sides of the pole
        other = _integrals(at.take(near), pole[near] - _NEAR_POLE, k[near])
        for values, beyond in zip((hard, slope, soft), other, strict=True):
            values[near] = (values[near] + beyond) / 2
    x = h_z * hard
    z = 1j * wavenumber / k**2 * (at.cos_beta0 * h_z * slope - e_z * soft)
    return x, z


def _integrals(at: Incidence, mu: Array, k: Array) -> tuple[Complex, Complex, Complex]:
    """Fringe part of H_z, dH_z/dx and (1/x) dE_z/dphi, times exp(j k mu x), from 0 to the end."""
    mu = np.minimum(mu, 1 - 1e-9)  # at 1 the endless integral has no value
    hard, slope, soft = _endless(at, mu, k)
    hard_rest, slope_rest, soft_rest = _beyond(at, mu, k)
    return hard - hard_rest, slope - slope_rest, soft - soft_rest


def _endless(at: Incidence, mu: Array, k: Array) -> tuple[Complex, Complex, Complex]:
    """On an endless face: Laplace transforms of Sommerfeld's series, less those of the optics."""
    lit = at.phi0 < np.pi
    alpha = np.arccos(mu + 0j)
    psi, theta = (np.pi - alpha) / at.n, at.phi0 / at.n
    between = np.cos(theta) - np.cos(psi)
    mirror = np.cos(at.phi0) + mu
    hard = 2j / k * (np.sin(psi) / (at.n * np.sin(alpha) * between) - lit / mirror)
    soft = -2 / at.n * np.sin(theta) / between + 2 * lit * np.sin(at.phi0) / mirror
    slope = 2 * lit - 2 / at.n - 1j * k * mu * hard
    return hard, slope, soft


def _beyond(at: Incidence, mu: Array, k: Array) -> tuple[Complex, Complex, Complex]:
    """The same from the face's end to infinity, with Fresnel integrals."""
    end = at.end_m
    open_ended = ~np.isfinite(end)
    end = np.where(open_ended, 1.0, end)
    half_cosine = np.cos(at.phi0 / 2)
    side = np.where(half_cosine > 0, -1.0, 1.0)
    a, b, g = k * (np.cos(at.phi0) + mu), k * (1 - mu), 2 * k * half_cosine**2
    here, there = _fresnel(np.sqrt(g * end)), _fresnel(np.sqrt(b * end))
    reached = np.exp(1j * a * end) * here
    tail = (np.sqrt(g / b) * there - reached) / (1j * a)
    hard_scale, soft_scale = _scales(at)
    hard = 2 * side * hard_scale * tail
    slope = -2 * side * hard_scale * reached - 1j * k * mu * hard
    direct = 2 * np.sqrt(2 * k / b) * np.sin(at.phi0 / 2) * there
    soft = soft_scale * (2j * side * k * np.sin(at.phi0) * tail + direct)
    hard, slope, soft = (np.where(open_ended, 0, part) for part in (hard, slope, soft))
    return hard, slope, soft


def _scales(at: Incidence) -> tuple[Array, Array]:
    """Diffraction coefficient on the face over that of a half-plane: across and along the edge.

    Keller's (J. Opt. Soc. Am. 52, 1962), along the edge by its slope, since it vanishes itself.
    """
    phi0 = np.where(np.abs(at.phi0 - np.pi) < 1e-6, np.pi + 1e-6, at.phi0)
    theta, whole, half = phi0 / at.n, np.pi / at.n, np.cos(phi0 / 2)
    gap = np.cos(whole) - np.cos(theta)
    hard = -2 / at.n * np.sin(whole) * half / gap
    angles = np.sin(theta) / np.maximum(np.sin(phi0 / 2), 1e-12)
    angles = np.where(phi0 < 1e-9, 2 / at.n, angles)
    soft = 4 * angles * np.sin(whole) * half**2 / (at.n * gap) ** 2
    return hard, soft


def _fresnel(x: Array) -> Complex:
    """exp(j pi/4) / sqrt(pi) times the integral of exp(-j t^2) from x >= 0 to infinity."""
    # Half of erfc(exp(j pi/4) x), by its scaled form: the exponential is a pure phase.
    values: Complex = 0.5 * np.exp(-1j * x**2) * wofz(np.exp(0.75j * np.pi) * x)
    return values

"""The rungs of physical optics: every echo of a scene, as paths by name and as dense echoes."""

from collections.abc import Sequence

import numpy as np

from hardware.waveform import C_M_PER_S
from twin.fidelity import Fidelity
from twin.radar.device.design import RadarDesign
from twin.radar.propagation.environment import PointEchoes, mirror_echoes
from twin.radar.propagation.optics import (
    Stage,
    antenna_gain,
    contributions_of,
    scattered,
    set_stage,
    speckle,
)
from twin.radar.propagation.paths import Heard, Path, Propagation
from twin.radar.propagation.roles import Assignment, Role, assign_roles
from twin.radar.propagation.shooting import Rays
from twin.radar.synthesis import Contributions
from twin.scene import Scene, Target


def echoes(scene: Scene, radar: RadarDesign, fidelity: Fidelity, seed: int) -> Propagation:
    """Mirror images, declared points and scattering meshes, all over the same legs.

    Raises InputError where a material has no data at the carrier.
    """
    roles = assign_roles(scene, radar.ofdm.wavelength_m, fidelity.radar)
    declared = _declared(scene, roles)
    is_rough = fidelity.radar == "rough"
    stage = set_stage(scene, radar, roles, fidelity.radar_images, is_rough=is_rough)
    rays, remarks = scattered(stage, fidelity)
    if is_rough:
        more, further = speckle(scene, stage, fidelity, seed)
        rays, remarks = Rays.joined([rays, more]), [*remarks, *further]
    paths = [*_mirrors(scene, radar, roles, stage, fidelity), *_points(stage, radar, declared)]
    dense = contributions_of(rays, stage, radar)
    return Propagation(
        paths=tuple(sorted((p for p in paths if p.amplitude), key=lambda p: p.delay_s)),
        roles=tuple(roles),
        assumptions=(*stage.assumptions, *remarks),
        echoes=dense,
        heard=_heard(rays, dense, stage, radar),
    )


def _declared(scene: Scene, roles: Sequence[Assignment]) -> list[Target]:
    """Targets that answer with their declared cross-section: no mesh of theirs scatters."""
    silent = {a.name for a in roles if a.role is Role.TARGET}
    return [t for t in scene.targets if t.object is None or t.object in silent]


def _mirrors(
    scene: Scene, radar: RadarDesign, roles: Sequence[Assignment], stage: Stage, fidelity: Fidelity
) -> list[Path]:
    """The radar's own images: as many reflections as out and back together."""
    if fidelity.radar_images == 0 or len(stage.flats) == 0:
        return []
    further = set_stage(
        scene, radar, roles, 2 * fidelity.radar_images, is_rough=fidelity.radar == "rough"
    )
    number, amplitude, length, rate, departure, arrival = mirror_echoes(further.station)
    return [
        _path(
            further,
            radar,
            further.via(int(number[k])),
            None,
            complex(amplitude[k]),
            length[k] / C_M_PER_S,
            rate[k] / C_M_PER_S,
            departure[k],
            arrival[k],
        )
        for k in range(len(number))
    ]


def _points(stage: Stage, radar: RadarDesign, declared: Sequence[Target]) -> list[Path]:
    if not declared:
        return []
    legs = PointEchoes(stage.station, declared, stage.anchor_m)
    count = len(stage.images)
    return [
        _path(
            stage,
            radar,
            (*stage.via(i), target.name, *stage.via(j)[::-1]),
            target.name,
            *found,
        )
        for number, target in enumerate(declared)
        for i in range(count)
        for j in range(count)
        if (found := legs.echo(i, j, number, target)) is not None
    ]


def _path(
    stage: Stage,
    radar: RadarDesign,
    via: tuple[str, ...],
    target: str | None,
    amplitude: complex,
    delay_s: float,
    delay_rate: float,
    departure: np.ndarray,
    arrival: np.ndarray,
) -> Path:
    ways = np.stack([departure, arrival]) @ stage.axes.T
    loss = 10 ** (-radar.front_end.losses_db.value / 20)
    gain = float(np.sqrt(np.prod(antenna_gain(radar, ways))))
    out, back = ((float(x), float(y), float(z)) for x, y, z in ways)
    return Path(
        via=via,
        target=target,
        amplitude=amplitude * stage.wavelength_m * gain * loss,
        delay_s=float(delay_s),
        delay_rate=float(delay_rate),
        departure=out,
        arrival=back,
    )


def _heard(rays: Rays, dense: Contributions, stage: Stage, radar: RadarDesign) -> tuple[Heard, ...]:
    cycles = radar.ofdm.carrier_hz * dense.delay_s % 1.0
    wave = dense.amplitude * np.exp(-2j * np.pi * cycles)
    n = len(stage.items)
    count = np.bincount(rays.object, minlength=n)
    total = np.bincount(rays.object, wave.real, n) + 1j * np.bincount(rays.object, wave.imag, n)
    return tuple(
        Heard(item.name, int(count[i]), float(abs(total[i]) ** 2))
        for i, item in enumerate(stage.items)
        if count[i]
    )

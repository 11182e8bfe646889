"""Objects too small for physical optics, which only cast shadows: a bound of their left-out echoes.

A flat conductor of area A at normal incidence has a cross-section of 4 pi A^2 / lambda^2. Of a
closed body at most half the area faces the radar. A body of about a wavelength may resonate and
return a few times that.
"""

from collections.abc import Sequence

import numpy as np

from twin.geometry import shapes_of
from twin.radar.device.design import RadarDesign
from twin.radar.propagation.scene.culling import noise_amplitude
from twin.radar.propagation.scene.scattering_models import SMALLEST, Assignment, ScatteringModel
from twin.scene import Scene
from twin.scene.boxes import boxes_of


def silent_objects(
    scene: Scene, radar: RadarDesign, roles: Sequence[Assignment]
) -> tuple[str, ...]:
    """A warning about such objects whose echo could be stronger than the noise, if there are any.

    Objects that the scene declares to be obstacles are left out.
    """
    some = [
        (item, role)
        for item, role in zip(scene.objects, roles, strict=True)
        if role.role is ScatteringModel.OBSTACLE and not role.declared
    ]
    if not some:
        return ()
    items = [item for item, _ in some]
    shapes = shapes_of([item.geometry for item in items])
    offset_m, axes = scene.rig.device("radar")
    place = scene.rig.position_m + offset_m
    away = boxes_of(items).mean(axis=1) - place
    distance = np.maximum(np.linalg.norm(away, axis=1), radar.ofdm.wavelength_m)
    gain = radar.antenna.gain((away / distance[:, None]) @ np.asarray(axes).T)
    area = np.array([s.area_m2 * (0.5 if s.outward.all() else 1.0) for s in shapes])
    loss = 10 ** (-radar.front_end.losses_db.value / 20)
    level = loss * gain * area / (4 * np.pi * distance**2)
    over = 20 * np.log10(np.maximum(level / noise_amplitude(radar), 1e-30))
    n_over = np.count_nonzero(over > 0)
    if not n_over:
        return ()
    worst = int(np.argmax(over))
    others = f" (and {n_over - 1} more, by less)" if n_over > 1 else ""
    return (
        f"{items[worst].name} only casts a shadow, smaller than {SMALLEST:g} wavelengths "
        f"({1e3 * shapes[worst].size_m:.2g} mm), though its echo could stand {over[worst]:.0f} dB "
        f'over the noise, were it flat and facing the radar{others}: radar = "optics" makes such '
        "objects scatter",
    )

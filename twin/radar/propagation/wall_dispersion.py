"""What bodies behind absorbing walls err by over the band: walls absorb as at the carrier.

Rows of ITU-R P.2040 have a conductivity that grows with the frequency, sigma = c f^d, and in nepers
the loss in a wall grows as its conductivity does. Echoes have the carrier's loss at all
frequencies.
"""

from contextlib import suppress
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.constants import epsilon_0

from twin.engine import mitsuba_of_radar
from twin.errors import InputError
from twin.radar.device.design import RadarDesign
from twin.radar.propagation.one_way.points import paths_to_points
from twin.radar.propagation.prepared_scene import PreparedScene
from twin.radar.propagation.scene.materials import radio_properties
from twin.radar.propagation.scene.slabs import wall_table
from twin.scene import Scene
from twin.scene.boxes import boxes_of

Array = NDArray[np.float64]

_FREQUENCIES = 33  # over the band
#: Points of a body's box, of its half sizes: the middle, and halfway to the corners.
_POINTS = np.array([[0, 0, 0], *((x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1))]) / 2


def dispersion_errors(
    scene: Scene, prepared: PreparedScene, radar: RadarDesign, body: NDArray[np.int32]
) -> Array:
    """Of bodies, numbered by ``body`` for every object, the error of their echoes over the band,
    relative to these: by the straight paths to points of a body those that change most.
    """
    errors = np.zeros(body.max(initial=-1) + 1)
    context = prepared.context
    if context.walls is None or not len(errors):
        return errors
    carrier, half = radar.ofdm.carrier_hz, radar.ofdm.bandwidth_hz / 2
    tables = [
        wall_table(_lossy(scene, item.material, carrier, carrier + half), carrier).ravel()
        for item in prepared.items[len(prepared.world.items) :]
    ]
    walls = replace(context.walls, table=mitsuba_of_radar().Float64(np.concatenate(tables)))
    boxes = boxes_of(prepared.originals) - prepared.anchor_m
    places = []
    for number in range(len(errors)):
        mine = boxes[np.flatnonzero(body == number)]
        low, high = mine[:, 0].min(axis=0), mine[:, 1].max(axis=0)
        places.append((low + high) / 2 + _POINTS * (high - low) / 2)
    points = np.concatenate(places)
    level, above = (
        paths_to_points(c, 0, points, np.zeros_like(points), unshadowed=True).level
        for c in (context, replace(context, walls=walls))
    )
    # Walls through which nothing comes at all let nothing change.
    nothing = np.finfo(np.float64).tiny
    lost = np.maximum(level, nothing) / np.maximum(above, nothing)
    power = 2 * np.log(lost) / np.log(1 + half / carrier)
    ratio = 1 + np.linspace(-half, half, _FREQUENCIES) / carrier
    change = np.abs(ratio ** -power[:, None] - 1)
    of_points = np.sqrt((change**2).mean(axis=1))
    largest: Array = of_points.reshape(len(errors), -1).max(axis=1)
    return largest


def _lossy(scene: Scene, material: str, carrier_hz: float, frequency_hz: float) -> complex:
    """Permittivity at the carrier, with the loss that a wall has at another frequency: the product
    of its imaginary part and the wave number is in proportion to the conductivity.
    """
    radio = scene.materials[material]
    permittivity, conductivity, _ = radio_properties(material, radio, carrier_hz)
    with suppress(InputError):  # where the band reaches beyond the data: as at the carrier
        conductivity = radio_properties(material, radio, frequency_hz)[1]
    return permittivity - 1j * conductivity / (2 * np.pi * carrier_hz * epsilon_0)

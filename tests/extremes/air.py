"""Extremes of the weather: fog, rain and snow, for light and for the radar."""

from collections.abc import Mapping
from typing import Any

import mpmath as mp
import numpy as np

from tests.extremes import oracle
from tests.extremes.case import Case, Found
from tests.extremes.light import expected_electrons
from tests.extremes.waves import CHANNEL, radar, world
from tests.extremes.worlds import camera, light_stated, look, scene, square, validated
from twin.radar.acquisition import channel
from twin.radar.propagation.free_space import straight_paths
from twin.radar.propagation.scene.atmosphere import Atmosphere
from twin.system import Weather

_ABSORBED = "mpmath: integral over the field, Beer and Lambert"
_WALL_M, _WAVELENGTH_M = 5.0, 1550e-9


def _weather(**numbers: float | str) -> dict[str, Any]:
    """Air that absorbs and does not scatter, so that a closed form knows all of it."""
    fixed: Mapping[str, float | str] = {"single_scattering_albedo": 0.0, "asymmetry": 0.0}
    return {
        name: {"value": value, "assumed": "test"} for name, value in {**fixed, **numbers}.items()
    }


def _dimmed(extinction_per_m: mp.mpf, **numbers: float | str) -> Found:
    """A wall at 5 m in air of this extinction, which its weather must come to."""
    system = camera().with_({"weather": _weather(**numbers)})
    with scene(square((_WALL_M, 0, 0), 10.0), sun_lx=0.0) as found:
        taken = look(found, system)
    field = system.optics.field_of_view_deg.value
    light = oracle.plane_light(_WALL_M, 90.0, field, float(extinction_per_m))
    clear = oracle.plane_light(_WALL_M, 90.0, field)
    exact = expected_electrons(system, _WALL_M, 0.5) * light / clear
    error = oracle.relative(float(taken.cells_e.sum()), exact)
    return Found(error, light_stated(taken, exact), warnings=taken.warnings)


def _rain_on_radar(rate_mm_per_h: float) -> Found:
    """Echo in rain over that in the same air without: 2 R of P.838, relative to it."""
    design, scene_ = radar(), world()
    rainy, dry = (
        Atmosphere(validated(Weather, _weather(rain_mm_per_h=rate)))
        for rate in (rate_mm_per_h, 0.0)
    )
    paths = straight_paths(scene_, design)
    wet, without = (channel(paths, design, air)[0, 0, 0, 0] for air in (rainy, dry))
    distance = mp.norm(mp.matrix([mp.mpf(x) for x in scene_.targets[0].position_m]))
    loss_db = oracle.rain_radio_db_per_m(rate_mm_per_h, design.ofdm.carrier_hz) * 2 * distance
    exact = mp.mpf(10) ** (-loss_db / 20)
    return Found(oracle.relative(float(np.abs(wet / without)), exact), 10 * CHANNEL)


def cases() -> list[Case]:
    """All of this room."""
    fog = [
        Case("fog", f"visibility {v:g} m", _ABSORBED,
             lambda v=v: _dimmed(oracle.fog_per_m(v, _WAVELENGTH_M), visibility_m=v), says=says)
        for v, says in ((1.0, ""), (50.0, ""))
    ]  # fmt: skip
    rain = [
        Case("rain", f"{r:g} mm/h", _ABSORBED,
             lambda r=r: _dimmed(oracle.rain_light_per_m(r), rain_mm_per_h=r))
        for r in (1e-3, 1000.0)
    ]  # fmt: skip
    snow = [
        Case("snow", f"{s:g} mm/h, dry", _ABSORBED,
             lambda s=s: _dimmed(oracle.dry_snow_light_per_m(s, _WAVELENGTH_M), snow_mm_per_h=s,
                                 snow_kind="dry"))
        for s in (0.1, 100.0)
    ]  # fmt: skip
    return [
        *fog,
        Case("fog", "visibility 0.1 m", "-", lambda: _dimmed(mp.mpf(1), visibility_m=0.1), "error",
             "visibility_m"),
        *rain,
        Case("rain", "1001 mm/h", "-", lambda: _dimmed(mp.mpf(1), rain_mm_per_h=1001.0), "error",
             "rain_mm_per_h"),
        *snow,
        *[
            Case("rain", f"{r:g} mm/h on the radar", "mpmath: ITU-R P.838-3",
                 lambda r=r: _rain_on_radar(r))
            for r in (0.1, 1000.0)
        ],
    ]  # fmt: skip

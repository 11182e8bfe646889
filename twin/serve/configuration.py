"""A camera's system and the settings of its host, one from the other."""

import numpy as np

from hardware.drivers.settings import SpiSettings
from hardware.patterns import PatternSet
from twin.camera.shutters import shutters
from twin.errors import InputError
from twin.system import System
from twin.toml import plain

#: Limits of the integration time, s.
INTEGRATION_S = (1e-7, 1.0)


def settings_of(system: System) -> SpiSettings:
    """What a host sets where it measures as the system's file says: the inverse of
    `configure_system`.

    Raises InputError for grey patterns, which no camera takes.
    """
    shown, responses = system.acquisition, shutters(system)
    return SpiSettings(
        system.patterns,
        shown.integration_time_s.value,
        shown.pattern_period_s.value,
        shutters=tuple(response.recorded for response in responses),
        pulse_width_s=responses[0].pulse_width_s,
    )


def configure_system(system: System, settings: SpiSettings) -> System:
    """A system with the patterns, integration time and pattern period of a driver's settings.

    Cells, gain and shutters are the system's own; a pattern period of 0 is the shortest, with the
    system's own time for read-out. Raises InputError, which names the field, for what the camera
    cannot do.
    """
    own, asked = system.patterns, settings.patterns
    if (asked.rows, asked.columns) != (own.rows, own.columns):
        raise InputError(f"rows, columns: the emitter has {own.rows} x {own.columns} cells")
    if settings.gain:
        raise InputError("gain: no such step")
    own_shutters = tuple(response.recorded for response in shutters(system))
    if len(settings.shutters) != len(own_shutters) or not np.allclose(
        settings.shutters, own_shutters, rtol=1e-12, atol=0
    ):
        raise InputError(f"shutters: this camera has {[tuple(one) for one in own_shutters]}")
    integration = settings.integration_time_s
    if not INTEGRATION_S[0] <= integration <= INTEGRATION_S[1]:
        raise InputError("integration_time_s: outside what this camera can do")
    shown = system.acquisition
    readout = shown.pattern_period_s.value - shown.integration_time_s.value
    period = settings.pattern_period_s or integration + readout
    if not integration + readout * (1 - 1e-9) <= period <= 1e3:
        raise InputError("pattern_period_s: shorter than integration and read-out, or no number")
    content = plain(system)
    given: dict[str, object] = {
        "n_patterns": asked.count,
        "order": asked.order,
        "mode": asked.mode,
        "patterns": asked,
        "integration_time_s": integration,
        "pattern_period_s": period,
    }
    if isinstance(asked, PatternSet):
        content["acquisition"]["patterns"] = None
        del given["patterns"]
    else:
        given["order"] = "natural"  # which does not count
    for name, value in given.items():
        content["acquisition"][name] = {"value": value, "assumed": "as the host asked"}
    return System.model_validate(content)

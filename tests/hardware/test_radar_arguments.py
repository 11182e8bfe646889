"""Arguments of the radar processing that cannot be: one line names each, and what was expected."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from radar_cubes import WIDE, Echo, cube

from hardware import Cfar, OfdmWaveform, Processing, process
from hardware.errors import InputError
from hardware.radar import cfar_threshold, channel, range_doppler
from hardware.records import RadarFrontEnd

WAVE = replace(WIDE, n_subcarriers=32, n_slots=16)
RECORD = cube(WAVE, [Echo((1.0, 0, 0))], noise_w=1e-12)
CHANNEL = channel(RECORD)


@pytest.mark.parametrize(
    ("kind", "field", "value"),
    [
        *(
            (Processing, name, value)
            for name, value in (
                ("window", np.nan),
                ("window", [1, 2]),
                ("window", 0),
                ("oversampling", 2**70),
                ("cfar", 0),
                ("precision", np.ones(2)),
                ("leakage", "x"),
                ("moving_only", None),
                ("resolve", 1),
                ("range_rate_m_per_s", 1e300),
                ("fastest_m_per_s", True),
            )
        ),
        *(
            (Cfar, name, value)
            for name, value in (
                ("false_alarm", 1e-300),
                ("method", np.ones(2)),
                ("shape", True),
                ("shape", 1e-5),
                ("shape", np.ones(2)),
            )
        ),
        *(
            (OfdmWaveform, name, value)
            for name, value in (
                ("n_subcarriers", np.nan),
                ("n_slots", np.inf),
                ("n_slots", 1e300),
                ("repeats", True),
                ("repeats", "x"),
                ("carrier_hz", "x"),
                ("slot_period_s", 1e308),
                ("prefix_s", None),
                ("symbols", np.ones(2)),
            )
        ),
        *(
            (RadarFrontEnd, name, value)
            for name, value in (
                ("antenna_gain_dbi", 1e300),
                ("losses_db", True),
                ("leakage_delay_s", 2**70),
                ("receivers_m", 0),
                ("transmitters_m", np.zeros(3)),
                ("root_watt_per_count", None),
                ("root_watt_per_count", 1e-308),
                ("root_watt_per_count", 1e-25),
                ("root_watt_per_count", 1e308),
                ("transmit_power_w", True),
            )
        ),
    ],
)
def test_settings_of_another_kind_are_refused(kind: type, field: str, value: object) -> None:
    needed = {OfdmWaveform: vars(WAVE), RadarFrontEnd: vars(RECORD.front_end)}
    with pytest.raises(InputError, match=f"^{field}: |^{field} = "):
        kind(**{**needed.get(kind, {}), field: value})


@pytest.mark.parametrize(
    ("call", "named"),
    [
        (lambda: process(RECORD, 0, 0), "how"),
        (lambda: process(RECORD, 0, Processing(cfar=Cfar(1e-30, "ca", shape=0.1))), "false_alarm"),
        (lambda: range_doppler(CHANNEL, "x"), "waveform"),
        (lambda: range_doppler(CHANNEL.real, WAVE), "channel"),
        (lambda: range_doppler(CHANNEL[None][:0], WAVE), "channel"),
        (lambda: range_doppler(CHANNEL, WAVE, np.inf), "window"),
        (lambda: range_doppler(CHANNEL, WAVE, relative_noise=0), "relative_noise"),
        (lambda: cfar_threshold(np.nan, Cfar()), "power"),
        (lambda: channel(RECORD, receiver=np.nan), "receiver"),
        (lambda: channel(RECORD, step=1), "step"),
        (lambda: replace(RECORD, carriers_hz=0), "carriers_hz"),
        (lambda: replace(RECORD, device=0), "device"),
    ],
)
def test_arguments_of_another_kind_are_refused(call: Callable[[], object], named: str) -> None:
    with pytest.raises(InputError, match=f"^{named}: |^{named} = "):
        call()

"""Receivers without signals of their own: dead ones, copies, slots without samples."""

from dataclasses import replace

import numpy as np
import pytest

from hardware.errors import InputError
from hardware.radar.process import process
from hardware.records.container import Flag
from tests.hardware.radar_cubes import HALF, WIDE, Echo, cube

WAVE = replace(WIDE, n_subcarriers=64, n_slots=32)
ARRAY = {"receivers_m": np.array([[0, i * HALF, k * HALF] for i in range(4) for k in range(2)])}
#: Noise of 30 counts, an echo 34 dB above it after all processing.
NOISE_W = 64 * 32 * 10**-3.4


def record_with(change, *, noise_w: float = NOISE_W, counts: float = 200.0):
    record = cube(WAVE, [Echo((5, 0.5, 0.5), 1.0)], noise_w=noise_w, counts=counts, **ARRAY)
    iq = record.iq.copy()
    change(iq)
    return replace(record, iq=iq)


def dead(iq) -> None:
    iq[..., 2, :, :] = 0


def copied(iq) -> None:
    iq[..., 2, :, :] = iq[..., 6, :, :]


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        (dead, "burst 0: receiver 2: all samples are 0, while others have signals of"),
        (copied, "burst 0: receivers 2 and 6: all samples are the same, their noise of"),
    ],
)
def test_a_receiver_without_signals_of_its_own_is_refused(change, fault) -> None:
    """Zeros had made up to 144 false detections of 145 dB and more in 50 records, copies 91."""
    record = record_with(change)
    with pytest.raises(InputError, match=fault):
        process(record)


def test_a_receiver_is_judged_by_what_is_processed() -> None:
    """One that is dead up to a lost slot, behind which the rest is left out."""
    record = record_with(lambda iq: iq[:, :, :20, 5].fill(0))
    flags = record.flags.copy()
    flags[0, 0, 20] = Flag.LOST
    with pytest.raises(InputError, match="receiver 5: all samples are 0"):
        process(replace(record, flags=flags))


def test_slots_of_one_receiver_without_samples_are_told() -> None:
    record = record_with(lambda iq: iq[:, :, 10:15, 6].fill(0))
    told = "burst 0: receiver 6: IQ of 5 slots is all zero, while others have signals"
    assert told in process(record).warnings
    assert not any("zero" in text for text in process(record_with(lambda iq: None)).warnings)


def test_an_echo_straight_ahead_without_noise_is_no_fault() -> None:
    """Eight receivers of one height have the same samples then."""
    record = cube(WAVE, [Echo((5, 0, 0), 1.0)], receivers_m=np.zeros((8, 3)))
    assert np.array_equal(record.iq[:, :, :, 0], record.iq[:, :, :, 7])
    assert process(record).detections[0].range_m == pytest.approx(5, abs=0.01)


def test_receivers_of_less_than_a_count_may_be_silent_by_rounding() -> None:
    """Noise of a quarter of a count leaves most slots without samples, in most receivers."""
    parts = np.random.default_rng(0).normal(0, 0.15, (1, 1, 32, 8, 64, 2))
    record = record_with(lambda iq: np.copyto(iq, np.rint(parts).astype(np.int16)))
    record.iq[..., 3, :, :] = 0
    assert not any("receiver" in text for text in process(record).warnings)

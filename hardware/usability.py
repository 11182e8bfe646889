"""Whether a record can be processed, by the checks of its processing, told while it is recorded."""

from dataclasses import dataclass

from hardware.errors import InputError
from hardware.radar.integrity import silence, unusable_bursts, usable_part
from hardware.reconstruction.imaging import measured_part
from hardware.reconstruction.no_light import without_light
from hardware.records import RadarRecord, SpiRecord


@dataclass(frozen=True)
class Usability:
    """What can be made of a record.

    ``fault``: why it cannot be processed, empty where it can. ``whole``: False where a loss of data
    leaves a part of its bursts. ``silence``: that its sensor delivered nothing, empty where it did.
    """

    fault: str = ""
    whole: bool = True
    silence: str = ""


def usability(record: SpiRecord | RadarRecord) -> Usability:
    """What can be made of a record of a camera or a radar."""
    try:
        return _of_radar(record) if isinstance(record, RadarRecord) else _of_camera(record)
    except InputError as error:
        return Usability(str(error))


def _of_camera(record: SpiRecord) -> Usability:
    return Usability(silence=next(without_light(*measured_part(record)), ""))


def _of_radar(record: RadarRecord) -> Usability:
    n_bursts, unusable = len(record.iq), unusable_bursts(record)
    silent = {burst: why for burst, why in unusable.items() if why == silence(record, burst)}
    if n_bursts and len(unusable) == n_bursts and not silent:
        return Usability(unusable[0])
    left = [burst for burst in range(n_bursts) if burst not in unusable]
    whole = [usable_part(record, burst).whole for burst in left]
    told = next(iter(silent.values()), "")
    return Usability(whole=len(unusable) == len(silent) and all(whole), silence=told)

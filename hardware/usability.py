"""Whether a record can be processed, by the checks of its processing, told while it is recorded."""

from dataclasses import dataclass

from hardware.errors import InputError
from hardware.radar.integrity import silence, usable_part
from hardware.reconstruction.imaging import measured_part
from hardware.reconstruction.no_light import without_light
from hardware.records import RadarRecord, SpiRecord


@dataclass(frozen=True)
class Usability:
    """What can be made of a record.

    ``fault``: why it cannot be processed, empty where it can. ``whole``: False where a loss of data
    leaves a part of a burst. ``silence``: that its sensor delivered nothing, empty where it did.
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
    """Of the bursts up to the first that is cut short, behind which none is processed."""
    told = ""
    for burst in range(len(record.iq)):
        whole = usable_part(record, burst).whole
        told = told or silence(record, burst)
        if not whole:
            return Usability(whole=False, silence=told)
    return Usability(silence=told)

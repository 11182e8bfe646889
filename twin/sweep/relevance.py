"""What a point does not depend on: such a parameter would be drawn, and constant."""

import re
from collections.abc import Iterable

from twin.errors import InputError
from twin.sweep.names import needs_image, needs_radar

#: All that the closed form looks at: one pixel, without air.
_CLOSED_FORM = re.compile(
    r"link\.(distance_m|reflectance)|system|"
    r"system\.emitter\.(part|radiant_intensity_w_per_sr|peak_wavelength_m|line_fwhm_m|spectrum_csv|"
    r"field_of_view_deg|intensity_noise)|"
    r"system\.filter\.(part|center_wavelength_m|width_m|transmission|transmission_csv|"
    r"effective_index|place)|"
    r"system\.optics\.(part|f_number|transmission|field_of_view_deg|field_stop)|"
    r"system\.detector\.(part|shape|width_m|height_m|responsivity_a_per_w|responsivity_csv|"
    r"dark_current_a|gain|excess_noise_factor|ionisation_ratio)|"
    r"system\.readout\.(part|read_noise_e|transimpedance_ohm|feedback_capacitance_f|full_well_e|"
    r"temperature_k|adc_bits|adc_full_scale_v|adc_offset_v)|system\.acquisition\.(part|integration_time_s)|"
    r"system\.sky\.(part|illuminance_lx|sun_elevation_deg)"
)
_OF_LINK = re.compile(r"link\..*")
_OF_RADAR = re.compile(
    r"radar(\..*)?|processing\.detection|fidelity\.(radar.*|nufft_tolerance)|scene\.targets\..*|"
    r"(system\.)?weather\.(temperature_k|pressure_pa|water_vapour_kg_per_m3)"
)
_OF_IMAGE = re.compile(r"processing\.method")


def check_effects(model: str, parameters: Iterable[str], metrics: tuple[str, ...]) -> None:
    """Raise InputError for a parameter that no metric of the study depends on."""
    rules = [(_CLOSED_FORM, False, 'the closed form does not depend on it: model = "rendered"')]
    if model == "rendered":
        rules = [(_OF_LINK, True, 'belongs to model = "closed-form"')]
        if not needs_radar(metrics):
            rules.append((_OF_RADAR, True, "no metric of this study looks at the radar"))
        if not needs_image(metrics):
            rules.append((_OF_IMAGE, True, "no metric of this study looks at an image"))
    for name in parameters:
        for pattern, refused, why in rules:
            if (pattern.fullmatch(name) is not None) is refused:
                raise InputError(f"{name}: has no effect here; {why}")

"""What a capture takes for granted: of the model, of what its system leaves out, of its scene."""

from twin.optics.solar_irradiance import SUN_ASSUMPTION
from twin.scene import Scene
from twin.system import System

#: Holds for every capture through air.
AIR_ASSUMPTION = (
    "air: homogeneous, with a phase function of two Henyey-Greenstein lobes; all scatterings are "
    "traced on the way to a surface and back, up to fidelity.air_orders; backscatter and airlight "
    "are scattered once"
)

#: Holds for a detector whose field follows the lit cell.
SCAN_ASSUMPTION = (
    "scanning receiver: its field is centred on the lit spot at every distance, as behind a common "
    "mirror; only light of the first bounce comes from there, all other is left out"
)

#: Holds for every capture; printed with it.
MODEL_ASSUMPTIONS = (
    "surfaces are Lambertian, two-sided and flat-shaded",
    SUN_ASSUMPTION,
    "amplifier: linear up to the rails",
)

#: Holds where light is rendered once for all exposures of a frame, and where it is not.
STILL_ASSUMPTION = "nothing moves during a frame"
MOVING_ASSUMPTION = "the truth of a frame in which things move is that of its middle"

#: Of a sun that moves, and of its brightness where the system has a sky.
SUN_MOVES_ASSUMPTION = (
    "sun: turns about the pole of the sky by 15 degrees an hour, without refraction and the course "
    "of the year, and stands still during a frame; of the scene's own one the spectrum is that of "
    "a clear sky at its elevation"
)
SKY_STAYS_ASSUMPTION = "sun: as bright as the system's sky says until it sets"


def assumptions(scene: Scene, system: System, *, moves: bool, detector: str) -> tuple[str, ...]:
    """All that hold for a capture; ``moves``: whether something moves during its frame;
    ``detector``: name of a user's own in place of the system's, empty for none.
    """
    air = (AIR_ASSUMPTION,) if system.weather else ()
    scan = (SCAN_ASSUMPTION,) if system.optics.is_scanned else ()
    sampled = (system.sampling_note,) if system.sampling_note else ()
    rest = (MOVING_ASSUMPTION if moves else STILL_ASSUMPTION,)
    sun = (SUN_MOVES_ASSUMPTION,) if scene.sun.moves else ()
    sky = (SKY_STAYS_ASSUMPTION,) if scene.sun.moves and system.sky else ()
    fixed = (*MODEL_ASSUMPTIONS, *rest, *sun, *sky, *air, *scan, *sampled)
    own = f"detector: {detector} in place of the system's detector and readout"
    given = (*_idealised(system), *scene.assumptions, *(said for _, said in system.assumed()))
    return (*fixed, *given, *((own,) if detector else ()))


def _idealised(system: System) -> tuple[str, ...]:
    """Idealisations of whatever the system's file leaves out."""
    emitter, optics = system.emitter, system.optics
    left_out = {
        "the emitter's field is flat": emitter.viewing_angle_deg,
        "its cells have sharp edges": emitter.blur_rms_deg if emitter.has_lens else True,
        "its cells are equal": emitter.intensity_spread,
        "dark cells emit nothing": emitter.contrast_ratio,
        "its power does not fluctuate": emitter.intensity_noise,
        "it switches at once": emitter.switching_time_s,
        "the filter does not shift with angle (a real one moves 6-11 nm at 10 deg)": (
            system.filter.effective_index
        ),
        "lens: cos^4 is its only vignetting": optics.edge_illumination,
        "it images sharply": optics.blur_rms_deg,
        "its pupil is a point, in focus everywhere": optics.focus_m,
        "amplifier: white noise": system.readout.flicker_corner_hz,
        "it settles within each exposure": system.readout.bandwidth_hz,
        "there is no air": system.weather,
    }
    ideal = [assumption for assumption, given in left_out.items() if given is None]
    return ("not in the system's file: " + "; ".join(ideal),) if ideal else ()

"""Every approximation of motion compensation, each with the error that it bounds."""

from dataclasses import dataclass

import numpy as np

from hardware.errors import InputError


@dataclass(frozen=True)
class Compensation:
    """Knobs of motion compensation.

    Parameters
    ----------
    oversampling
        Unknowns along each side of a cell; light is constant in each of them. A cell that moves by
        a fraction of itself shows detail that cells at rest do not tell apart: with 1 it is taken
        for noise. 2 costs four times the time of 1, and 4 gains less than 0.1 dB over 2.
    still_cells
        Motion that moves no cell by more than this within the frame is none: the result has the
        bits of one without motion. It leaves at most this share of a step between neighbours.
    step_cells
        Of warps that are no shift: between instants that lie this far apart images are
        interpolated in time; the error is at most step^2 / 8 of the image's second difference.
    within_pair_cells
        Pattern and complement are taken at their mean time where the image moves by less than this
        from one to the other; else each at its own. It bounds the change of the light of all cells
        that is left out: half this many columns of cells.
    least_noise
        Noise of a cell over the spread of the image that no record is taken to lie below: with
        less the solver's steps grow beyond ``most_iterations``, for detail that motion hides.
    residual
        Relative residual of the solver, in the norm of its preconditioner.
    most_iterations
        Of the solver; it warns where they did not suffice.
    prior_rows
        Measurements, at most, by which the prior's scale and steepness are chosen; 0, or fewer than
        64 measurements: power 1/f^2 with the scale of their mean square. 512 cost some 1.5 s of a
        64 x 64 image, and gain 1 to 2 dB in the mean over pictures (`python -m benchmarks
        moving_reconstruction`).
    error_samples
        Draws from the posterior that standard errors are taken from; 0: none are stated. With n of
        them, smoothed over 8 x 8 cells, they scatter by 1 / sqrt(128 n).
    seed
        Of those draws.
    """

    oversampling: int = 2
    still_cells: float = 1e-6
    step_cells: float = 0.25
    within_pair_cells: float = 0.05
    least_noise: float = 0.02
    residual: float = 1e-3
    most_iterations: int = 400
    prior_rows: int = 512
    error_samples: int = 2
    seed: int = 0

    def __post_init__(self) -> None:
        for name, least in (
            ("oversampling", 1),
            ("most_iterations", 1),
            ("error_samples", 0),
            ("prior_rows", 0),
            ("seed", 0),
        ):
            value = getattr(self, name)
            if not isinstance(value, int | np.integer) or value < least:
                raise InputError(f"{name}: {value!r:.60}, expected a whole number from {least} on")
        for name in ("still_cells", "step_cells", "within_pair_cells", "least_noise", "residual"):
            value = getattr(self, name)
            if not (
                isinstance(value, int | float | np.number) and np.isfinite(value) and value > 0
            ):
                raise InputError(f"{name}: {value!r:.60} is not a positive number")


#: As they are unless asked otherwise.
STANDARD = Compensation()

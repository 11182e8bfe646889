"""Types of arrays on the device, and complex vectors of two real ones.

`Real`, `Index` and `Mask` hold a number per ray, `Vector3` three. To a type checker they are
Dr.Jit's arrays with the operations of each; when the program runs they name Dr.Jit's base class,
since the variant is chosen then.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import drjit as dr

if TYPE_CHECKING:

    class Mask(dr.ArrayBase["Mask", "Mask | bool", bool, bool, "Mask", "Mask", "Mask"]):
        """True or false."""

    class Index(dr.ArrayBase["Index", "Index | int", int, int, "Index", "Index", "Mask"]):
        """Whole numbers."""

    class Real(dr.ArrayBase["Real", "Real | float", float, float, "Real", "Real", "Mask"]):
        """Float64."""

    class Vector3(
        dr.ArrayBase[
            "Vector3", "Vector3 | Real | float", "Real", "Real | float", "Real", "Real", "Mask"
        ]
    ):
        """Three of float64."""

else:
    Mask = Index = Real = Vector3 = dr.ArrayBase

#: Re and Im.
Complex = tuple[Real, Real]


@dataclass(eq=False)
class ComplexVector3:
    """Re and Im of a vector, such as the field of a wave.

    Can be made without either and is not frozen, as Dr.Jit wants of what its loops change.
    """

    re: Vector3 = None  # type: ignore[assignment]
    im: Vector3 = None  # type: ignore[assignment]

    def parts(self, function: Callable[[Vector3], Vector3]) -> "ComplexVector3":
        """A real linear function of both parts."""
        return ComplexVector3(function(self.re), function(self.im))

    def where(self, mask: Mask, other: "ComplexVector3") -> "ComplexVector3":
        """Itself where ``mask`` is true, else the other."""
        return ComplexVector3(
            dr.select(mask, self.re, other.re), dr.select(mask, self.im, other.im)
        )

    def dot(self, other: "ComplexVector3") -> Complex:
        """Product without conjugation, which a field has with the one that is received."""
        return (
            dr.dot(self.re, other.re) - dr.dot(self.im, other.im),
            dr.dot(self.re, other.im) + dr.dot(self.im, other.re),
        )

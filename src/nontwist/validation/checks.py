"""The checks of a validation: numbers with a known value, measured in this run.

A check holds when ``|measured - expected| <= tolerance``. An error or a drift has the expected value 0. The tolerance
is what the documentation promises, or the accuracy of the expected value.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Kind = Literal["printed", "closed form", "many digits", "independent", "invariant", "order"]

KINDS: dict[Kind, str] = {
    "printed": "digits that the paper prints",
    "closed form": "a formula, or its quadrature to round-off",
    "many digits": "computed once with 40 digits or more, by two methods that share no code with the package",
    "independent": "another method: DOP853 at a tolerance of 1e-13, another form of the equations, SciPy",
    "invariant": "a conserved quantity or an exact balance of the equations",
    "order": "the slope of the error against the step in logarithms; of all that were measured, the one furthest off",
}

# Each module has `CHECKS`, plain functions that yield checks; its docstring says what they are compared with.
GROUPS = {
    "paper": "paper_digits",
    "equations": "equations_of_motion",
    "geometry": "sphere_and_rotations",
    "free": "free_bodies",
    "loaded": "loaded_bodies",
    "suslov": "suslov_bodies",
    "tops": "tops",
    "orders": "measured_orders",
    "invariants": "conserved",
    "nonreversible": "nonreversible",
    "compiled": "compiled_steps",
    "frames": "sampled_frames",
    "twist": "known_twists",
}


@dataclass(frozen=True)
class Check:
    """One number with a known value.

    Attributes
    ----------
    name : str
        What is measured, with its unit.
    expected, measured : float
        0 and the largest error, where the expected value is not one number.
    tolerance : float
        Absolute; 0 for counts.
    source : str
        Equation labels of the paper, keys of `REFERENCES`, or the module with the derivation; semicolons between.
    kind : Kind
        Of the expected value: a key of `KINDS`.
    group : str
        A key of `GROUPS`.
    """

    name: str
    expected: float
    measured: float
    tolerance: float
    source: str
    kind: Kind
    group: str = ""

    @property
    def holds(self) -> bool:
        """Whether the measured number is the expected one, within the tolerance; never for NaN."""
        return bool(abs(self.measured - self.expected) <= self.tolerance)

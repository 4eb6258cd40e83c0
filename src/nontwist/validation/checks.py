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

# The literature that sources of checks name, beside the labels of the paper.
REFERENCES = {
    "Bishop 1975": "R. L. Bishop, There is more than one way to frame a curve, Amer. Math. Monthly 82 (1975) 246–251",
    "Blanes, Casas & Ros 2000": "S. Blanes, F. Casas, J. Ros, Improved high order integrators based on the Magnus "
    "expansion, BIT 40 (2000) 434–450",
    "Bloch": "A. M. Bloch, Nonholonomic Mechanics and Control, Springer",
    "Brüls, Cardona & Arnold 2012": "O. Brüls, A. Cardona, M. Arnold, Lie group generalized-α time integration of "
    "constrained flexible multibody systems, Mech. Mach. Theory 48 (2012) 121–137",
    "Codman 1934": "E. A. Codman, The Shoulder, Boston 1934",
    "Girard, Gauss–Bonnet": "the solid angle of a polygon is 2π less the sum of its exterior angles",
    "Hairer, Lubich & Wanner": "E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, 2nd ed., Springer "
    "2006",
    "Kahan & Li 1997": "W. Kahan, R.-C. Li, Composition constants for raising the orders of unconventional schemes for "
    "ordinary differential equations, Math. Comp. 66 (1997) 1089–1099",
    "Landau & Lifshitz": "L. D. Landau, E. M. Lifshitz, Mechanics, 3rd ed., Butterworth-Heinemann 1976",
    "Modin & Verdier 2020": "K. Modin, O. Verdier, What makes nonholonomic integrators work?, Numer. Math. 145 "
    "(2020) 405–435",
    "Montgomery 1991": "R. Montgomery, How much does the rigid body rotate? A Berry's phase from the 18th century, "
    "Amer. J. Phys. 59 (1991) 394–398",
    "Simo & Wong 1991": "J. C. Simo, K. K. Wong, Unconditionally stable algorithms for rigid body dynamics that "
    "exactly preserve energy and momentum, Int. J. Numer. Methods Eng. 31 (1991) 19–52",
    "Suslov 1946": "G. K. Suslov, Theoretical Mechanics, Moscow 1946 (in Russian)",
    "Suzuki 1990": "M. Suzuki, Fractal decomposition of exponential operators, Phys. Lett. A 146 (1990) 319–323",
    "Wang, Jüttler, Zheng & Liu 2008": "W. Wang, B. Jüttler, D. Zheng, Y. Liu, Computation of rotation minimizing "
    "frames, ACM Trans. Graph. 27 (2008) 2:1–2:18",
    "Whittaker": "E. T. Whittaker, Analytical Dynamics of Particles and Rigid Bodies, 4th ed., Cambridge 1937",
    "Wittenburg 1977": "J. Wittenburg, Dynamics of Systems of Rigid Bodies, Teubner 1977",
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

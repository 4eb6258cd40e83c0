"""exact: the closed-form solutions as an integrator; no stepping, output at any times.

Free standard body, also with rotors of constant momentum: elliptic and theta functions. Free non-twisting body:
rotation about a fixed axis. Non-twisting body under a moment in its moving frame: the same, wherever the axis stays
fixed in the body, that is in particular once the load has ended. `nontwist.exact` derives the formulas. Director
velocities are tangent, ``d_i' = w × d_i``.

The multiplier of the non-twisting body is μ = π_⊥·d3' + m^ext·d3 = Π·(W × E3) + M_3, its mean over an interval the
integral over the length; so are the mean moment Λ M and the work M·W. A standard body has no multiplier here.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

from ..loads.base import with_moments as moments_of
from .base import Integrator, Outcome, Prepared, Problem
from .costs import Cost

if TYPE_CHECKING:
    from ..loads import Load


@dataclass(frozen=True)
class Exact(Integrator):
    """Closed-form solutions: free bodies and gyrostats; the loaded non-twisting body that turns about one body axis.

    Raises
    ------
    ValueError
        Raised by a run without a closed-form solution; the message names a suitable integrator.

    Examples
    --------
    >>> from nontwist import Exact, simulate, standard
    >>> W = (0.1, 2, 0.1)
    >>> run = simulate(standard([3, 4, 5]), times=[0, 1, 1000], material_angular_velocity=W, integrator=Exact())
    >>> run.spatial_momentum.values.round(9)
    array([[0.3, 8. , 0.5],
           [0.3, 8. , 0.5],
           [0.3, 8. , 0.5]])
    """

    name: ClassVar[str] = "exact"
    any_times: ClassVar[bool] = True
    together: ClassVar[float] = 1.0

    def march(self, problem: Problem, threads: int = 1) -> Outcome:
        """Evaluate the solutions at the output times; under a load, one body after the other."""
        from .exact_march import march

        return march(with_moments(problem), threads)

    def can_prepare(self, load: Load) -> bool:
        """Whether `prepared` supports problems under this load: free motion only."""
        return not load.terms

    def prepared(self, problem: Problem) -> Prepared:
        """Return the solution of the free motion of one body, prepared once for any start."""
        from .prepared_solution import PreparedSolution

        return PreparedSolution(problem)

    def refusal(self, problem: Problem) -> str | None:
        """Return why there is no closed-form solution, as far as that is quick to decide."""
        from .exact_march import refusal

        return refusal(with_moments(problem))

    def cost(self, problem: Problem, states: int) -> Cost:
        """Return the estimated cost of `march`."""
        from .exact_march import cost

        return cost(with_moments(problem), states)


def with_moments(problem: Problem) -> Problem:
    """Return a problem with the moments of tables of forces along the directors in their place."""
    load = moments_of(problem.load)
    return problem if load == problem.load else replace(problem, load=load)

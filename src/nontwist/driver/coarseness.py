"""Whether a step is too coarse, in one sentence for `check`, which has a bound of |w|, and for a run that is done.

A step of a midpoint scheme turns a steadily rotating body not by θ = |w| h but, as a Cayley rotation, by 2 atan(θ/2),
one of Gauss collocation by the argument of a Padé approximation. The difference (`Integrator.lag`) times the number of
steps is the phase error of the whole run, h² |w|³ t / 12 for order 2. It is the size to expect of other motions as
well. A scheme that turns by exponentials has none (`Integrator.turns_exactly`). Above `Integrator.largest_turn`
equations are not solved as they should be.
"""

from __future__ import annotations

import math

from ..geometry.values import number_text
from ..integrators import IVP, Integrator

COARSE_STEP = "the step is coarse"
COARSE, FINE = 0.1, 0.002  # rad at the end: that is reported, and that of the step that is advised


def phase_error(scheme: Integrator, problem: IVP, fastest: float) -> float:
    """Return by how much a steady rotation at `fastest` rad/s is off at the end, rad."""
    if scheme.turns_exactly(problem):
        return 0.0
    grid = problem.grid
    turn = fastest * grid.longest
    rotation = turn * (problem.t_end - problem.t_start) / grid.longest
    if turn * turn * rotation < COARSE * 1e-3:  # of order 2 it is at most θ² / 12 of the whole rotation
        return turn * turn * rotation / 12
    return (problem.t_end - problem.t_start) / grid.longest * scheme.lag(turn)


def unremarkable(scheme: Integrator, step: float, span: float) -> float:
    """Return the angular velocity up to which there is nothing to say, as far as that is quick to decide, rad/s."""
    return min(scheme.largest_turn / step, math.cbrt(12 * COARSE / span) / math.cbrt(step) ** 2)


def coarseness(scheme: Integrator, problem: IVP, fastest: float) -> str | None:
    """Return what to say of a step in which a body that turns at up to `fastest` rad/s turns too far; else None."""
    if scheme.any_times or problem.asked is not None or (scheme.is_exact_without_load and problem.is_free):
        return None
    h = problem.grid.longest
    turn, off = fastest * h, phase_error(scheme, problem, fastest)
    if turn <= scheme.largest_turn * (1 + 1e-9) and off <= COARSE:
        return None
    order = getattr(scheme, "order", 2)
    fine = h * min(scheme.largest_turn / 2 / turn, (FINE / max(off, FINE)) ** (1 / order), 0.5)
    higher = ", the integrator gauss" if order < 4 else ""
    if scheme.orders and order < scheme.orders[-1]:
        higher = f", an order above {order}"
    phase = f", and a steady rotation as fast would be {number_text(math.degrees(off), '.2g')} degrees off at the end"
    if off == 0 and not scheme.turns_exactly(problem):  # its lag is unknown
        phase = ""
    return (
        f"{COARSE_STEP}: the body may turn by {number_text(math.degrees(turn), '.3g')} degrees in it{phase} "
        f"({scheme.name}, order {order}); try step <= {fine:.1g}{higher}, or tolerance = 1e-6"
    )

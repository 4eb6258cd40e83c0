"""What jumps with the state: dry friction of the body and in the bearings of wheels; what is refused, and marches."""

from __future__ import annotations

import numpy as np

from ..integrators.base import IVP, Integrator, Outcome
from ..integrators.members import one_by_one
from .pieces import InPieces
from .rubbing import STILL, Rubbed
from .tumbling import Tumbling
from .wheel_friction import Bearings

SCHEMES = "dry_friction needs an integrator that splits its steps, gauss or lie-midpoint; {} does not"
SPIN = "dry_friction does not act on a body whose spin is prescribed; leave spin= out"
WHEELS_SPIN = "coulomb= of a wheel does not act on a body whose spin is prescribed; leave spin= out, or use viscous="
ALONG = "dry_friction about the constrained axis does nothing, as the body does not turn about it; leave it out"
DISSIPATION = "dry_friction sticks by a constraint, under which dissipation= is not possible; leave it out"


def refusal(scheme: Integrator, problem: IVP) -> str | None:
    """Return why a problem is not accepted, for its dry friction or for the integrator's reasons; None if it is."""
    own = problem.load.frictions
    if not own:
        is_free = problem.systems.spin is None or not problem.load.is_dry
        return scheme.refusal(problem) if is_free else WHEELS_SPIN
    if not scheme.splits_steps:
        return SCHEMES.format(scheme.name)
    systems = problem.systems
    if systems.spin is not None:
        return SPIN
    if getattr(scheme, "dissipation", 0.0):
        return DISSIPATION
    if systems.axis is not None:
        across = [abs(np.cross(term.axis, systems.axis)).max(axis=1).min() for term in own if term.axis is not None]
        if min(across, default=1.0) <= STILL:
            return ALONG
    return scheme.refusal(problem)


def march(scheme: Integrator, problem: IVP, threads: int = 1) -> Outcome:
    """Integrate a stack of bodies under dry friction, or with wheels that have it, one after the other.

    Raises
    ------
    ValueError
        What `refusal` returns; statistics over steps are asked for; as the integrator.
    """
    if (reason := refusal(scheme, problem)) is not None:
        raise ValueError(reason)
    if problem.observed:
        raise ValueError("reduce= does not support dry friction; leave it out, and store states")
    return one_by_one(lambda one: _marching(scheme, one).march(), problem, threads)


def _marching(scheme: Integrator, problem: IVP) -> InPieces:
    """Return the march of a problem of one body."""
    if not problem.load.frictions:
        return Bearings(scheme, problem)
    return (Tumbling if problem.load.frictions[0].axis is None else Rubbed)(scheme, problem)

"""What a run will be like, forecast before it runs: steps, size, time, turn a step, and the phase error to expect.

With |w| the largest velocity that energy and impulse allow, the phase error (`driver.coarseness`) is a bound on the lag
of a steady rotation. `split` moves a free body exactly; `exact` and `continuous` do not step.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from ..integrators.compiled import Compiled
from ..integrators.costs import largest_velocity
from . import costs
from .coarseness import coarseness, phase_error
from .friction import refusal
from .grid import load_messages
from .prepared import Prepared


class Forecast(NamedTuple):
    """What to expect of a run, returned by `Problem.forecast`; nothing is run.

    Examples
    --------
    >>> from nontwist import Problem, standard
    >>> coming = Problem(standard([3, 4, 5]), t_end=20, step=0.01, angular_velocity=(0, 2, 0)).forecast()
    >>> coming.steps, coming.states, round(coming.turn, 3), coming.problems
    (2000, 2001, 1.146, ())
    """

    loads: tuple[str, ...]  #: in words, those of files with the extent of their tables
    steps: int
    step: float  #: s, the longest
    states: int  #: stored
    size: int  #: bytes of memory, about
    seconds: float  #: on one core, about; compilation left out
    turn: float  #: degrees a step, at most
    phase_error: float | None  #: degrees at the end, about; None where the integrator makes none by stepping
    sweep_seconds: float | None  #: on one core, of all members; None where there is no sweep
    warnings: tuple[str, ...]
    problems: tuple[Any, ...]  #: a body or a load that the integrator does not take, too little memory


def forecast(prepared: Prepared, members: int | None = None) -> Forecast:
    """Return what a run will be like, and a sweep of so many; problems are pairs of a keyword and the reason."""
    plan, begin, grid, states = prepared.plan, prepared.begin, prepared.grid, prepared.states
    scheme, load, N, h = prepared.scheme, plan.load, grid.steps, grid.longest
    fastest = largest_velocity(plan.systems, begin.velocity, load, plan.t_start, plan.t_end)
    degrees, phase = math.degrees(h * fastest), None
    task = plan.problem(begin, grid, np.array([0, N]))
    cost, problems = costs.run_cost(scheme, task, states), []
    if reason := refusal(scheme, task):
        problems.append(("integrator", reason))
    elif reason := costs.excess(cost):
        problems.append(("store", reason))
    swept = None if members is None else costs.members_cost(scheme, task, members, 2).seconds
    messages = load_messages(load, plan.systems, plan.t_start, plan.t_end, grid)
    if not problems and (notice := costs.notice(cost)) is not None:
        messages.append(notice)
    if not problems and (remark := scheme.remark(task)) is not None:
        messages.append(remark)
    if isinstance(scheme, Compiled) and not plan.is_controlled:
        phase = math.degrees(phase_error(scheme, task, fastest))
        if (text := coarseness(scheme, task, fastest)) is not None:
            messages.append(text)
    words = tuple(type(term).words(term.description) for term in load.terms)
    told = tuple(messages), tuple(problems)
    return Forecast(words, N, h, states, cost.size, cost.seconds, degrees, phase, swept, *told)

"""What a run will be like, forecast before it runs: steps, size, time, turn a step, and the phase error to expect.

With |w| the largest velocity that energy and impulse allow, the phase error (`driver.coarseness`) is a bound on the lag
of a steady rotation. `split` moves a free body exactly; `exact` and `continuous` do not step.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..driver import costs
from ..driver.coarseness import coarseness, phase_error
from ..driver.friction import refusal
from ..driver.grid import load_messages
from ..integrators import DEFAULT
from ..integrators.compiled import Compiled
from ..integrators.costs import largest_velocity
from .document import RunFile
from .problems import Problem, shown
from .tables import Time

CAPABLE = f"an integrator that can: {DEFAULT} takes every body and load"


class Forecast(NamedTuple):
    """What to expect."""

    loads: tuple[str, ...]  #: in words, those of files with the extent of their tables
    steps: int
    step: float  #: s
    states: int  #: stored
    size: int  #: bytes of memory, about
    seconds: float  #: on one core, about; compilation left out
    turn: float  #: degrees a step, at most
    phase_error: float | None  #: degrees at the end, about; None where the integrator makes none by stepping
    sweep_seconds: float | None  #: on one core, of all members; None where there is no sweep
    warnings: tuple[str, ...]
    problems: tuple[Problem, ...]  #: a body or a load that the integrator does not take, too little memory


def forecast(run_file: RunFile) -> Forecast:
    """Return what a run will be like; nothing is run."""
    prepared, time = run_file.prepared, run_file.time
    plan, begin, grid, states = prepared.plan, prepared.begin, prepared.grid, prepared.states
    scheme, load, N, h = prepared.scheme, plan.load, grid.steps, grid.longest
    fastest = largest_velocity(plan.systems, begin.velocity, load, plan.t_start, plan.t_end)
    degrees, phase = math.degrees(h * fastest), None
    task = plan.problem(begin, grid, np.array([0, N]))
    cost, problems = costs.run_cost(scheme, task, states), []
    if reason := refusal(scheme, task):
        problems.append(Problem("integrator.name", f"{shown(run_file.integrator.name)} ({reason})", CAPABLE))
    elif reason := costs.excess(cost):
        store = Time.model_fields["store"].description or ""
        problems.append(Problem("time.store", f"{shown(time.store)} ({reason})", store))
    sweep = run_file.sweep
    swept = None if sweep is None else costs.members_cost(scheme, task, sweep.members, 2).seconds
    messages = load_messages(load, plan.systems, plan.t_start, plan.t_end, grid)
    if not problems and (notice := costs.notice(cost)) is not None:
        messages.append(notice)
    if not problems and (remark := scheme.remark(task)) is not None:
        messages.append(remark)
    if isinstance(scheme, Compiled) and not plan.is_controlled:
        phase = math.degrees(phase_error(scheme, task, fastest))
        if (text := coarseness(scheme, task, fastest)) is not None:
            messages.append(text)
    loads, told = tuple(one.in_words(run_file._folder) for one in run_file.load), (tuple(messages), tuple(problems))
    return Forecast(loads, N, h, states, cost.size, cost.seconds, degrees, phase, swept, *told)

"""The plan of a run or an ensemble, without its start: integrator, bodies, load and times, checked once."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..geometry.arrays import Array, as_number
from ..geometry.values import nearest, shown
from ..integrators import INTEGRATORS, Integrator, Problem
from ..loads import Load, as_load
from ..models.stack import SystemStack, stacked
from ..models.system import DirectorSystem
from .grid import asked_times, count_steps, joined, stored_steps
from .starts import Starts

ENDS: NDArray[np.int64] = np.array([0, 1])


class Plan(NamedTuple):
    """A problem without its start and, where it is chosen for each start, without its step."""

    scheme: Integrator
    systems: SystemStack
    load: Load
    t_start: float
    t_end: float
    store: int | Literal["end"]
    steps: int | None  # None: chosen for the start
    asked: Array | None  # output times that need not lie on a grid

    def problem(self, begin: Starts, steps: int, stored: NDArray[np.int64] | None = None) -> Problem:
        """Return the problem of the plan with a start; `stored`: the numbers of the stored steps."""
        if stored is None:
            stored = ENDS if self.asked is not None else stored_steps(steps, self.store)
        before = None if self.asked is not None else joined(begin.grid, self.t_start, self.t_end, steps)
        return Problem(
            self.systems,
            begin.quaternion,
            begin.velocity,
            self.load,
            self.t_start,
            self.t_end,
            steps,
            stored,
            begin.load_scale,
            asked=self.asked,
            normal=begin.normal,
            memory=begin.memory,
            before=before,
        )


def planned(
    system: DirectorSystem | SystemStack,
    load: Load | None,
    integrator: str | Integrator,
    order: int | None,
    t_start: float | None,
    t_end: float | None,
    times: ArrayLike | None,
    step: float | None,
    store: int | Literal["end"],
    start_time: float | None = None,
) -> Plan:
    """Return the checked plan; parameters as in `nontwist.simulate`, `start_time` the end of the run to continue.

    Raises
    ------
    ValueError
        Wrong input; the message names the value.
    """
    scheme, systems = resolve_integrator(integrator, order), stacked(system)
    t0 = as_number(t_start, "t_start") if t_start is not None else start_time or 0.0
    asked = None if times is None else asked_times(scheme, times, t0, t_end, step, store)
    if asked is not None:
        t1 = float(asked[-1])
    elif t_end is not None:
        t1 = as_number(t_end, "t_end")
    else:
        raise ValueError("give t_end=" + (" or times=" if scheme.any_times else ""))
    if not t1 > t0:
        raise ValueError(f"t_end must be after t_start, got t_start = {t0:g} s, t_end = {t1:g} s")
    steps = 1 if asked is not None else None if step is None else count_steps(t1 - t0, step)
    return Plan(scheme, systems, as_load(load), t0, t1, store, steps, asked)


def resolve_integrator(integrator: str | Integrator, order: int | None) -> Integrator:
    """Return the integrator of a name or an instance, of the given order."""
    if isinstance(integrator, Integrator):
        if order is not None:
            raise ValueError("an integrator given as an instance brings its order; leave order= out")
        return integrator
    if not isinstance(integrator, str) or integrator not in INTEGRATORS:
        raise ValueError(f"unknown integrator {shown(integrator)}; {nearest(integrator, INTEGRATORS)}")
    scheme = INTEGRATORS[integrator]
    if order is None:
        return scheme()
    if not scheme.orders:
        raise ValueError(f"{integrator} has no option order; got order = {order!r}")
    return scheme(order=order)  # type: ignore[call-arg]

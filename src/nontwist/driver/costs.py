"""The time and memory of runs, forecast: long or large ones are announced, those beyond the free memory refused."""

from __future__ import annotations

import os

from ..integrators import IVP, Integrator
from ..integrators.costs import Cost
from . import grid

LONG, LARGE = 10.0, 1e9  # s and bytes above which a run is announced
STATE_NS, MEMBER_NS = 5_000, 100_000  # of a stored state; of a member that is integrated by itself


def run_cost(scheme: Integrator, problem: IVP, states: int) -> Cost:
    """Return the estimated cost of a run that stores `states`; `problem.stored` is ignored."""
    cost = scheme.cost(problem, states)
    return cost._replace(seconds=cost.seconds + states * STATE_NS * 1e-9, size=cost.size + states * grid.STATE)


def members_cost(scheme: Integrator, problem: IVP, members: int, states: int, size: int = 0, threads: int = 1) -> Cost:
    """Return the estimated cost of `members` like `problem`, whose states need `size` bytes."""
    one, threads = scheme.cost(problem, states), min(threads, members)
    together = scheme.together > 0 and problem.load.is_compiled
    each = one.seconds / scheme.together if together else one.seconds + MEMBER_NS * 1e-9
    seconds = members * each / (threads if problem.load.is_compiled else 1)
    return Cost(members * one.parts, one.unit, seconds, size + threads * one.size)


def excess(cost: Cost) -> str | None:
    """Return the message for a run that exceeds the free memory, with what fits; None where it fits."""
    if cost.size <= grid.SMALL or cost.size <= (free := grid.free_memory()):
        return None
    fits = float(f"{0.95 * cost.parts * free / cost.size:.1e}")
    return (
        f"{cost.parts:.3g} {cost.unit} need {amount(cost.size)}, {amount(free)} are free; {fits:g} {cost.unit} fit: "
        "store fewer states, shorten the run, or use the integrator split"
    )


def notice(cost: Cost, what: str = "run", where: str = "of memory") -> str | None:
    """Return the announcement of what will take more than 10 s or 1 GB, None for less."""
    if cost.seconds <= LONG and cost.size <= LARGE:
        return None
    return (
        f"the {what} will take about {duration(cost.seconds)} and {amount(cost.size)} {where}, for {cost.parts:.3g} "
        f"{cost.unit}"
    )


def cores() -> int:
    """Return how many processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def amount(size: float) -> str:
    """Return a number of bytes in the unit that suits it."""
    for unit in ("B", "kB", "MB", "GB"):
        if size < 1000:
            return f"{size:.3g} {unit}"
        size /= 1000
    return f"{size:.3g} TB"


def duration(seconds: float) -> str:
    """Return a time span in two units at most: 70 µs, 1.2 s, 42 s, 3 min 5 s, 2 h 7 min, 3 d 4 h."""
    for size, unit in ((1e-3, "µs"), (1.0, "ms")):
        if 0 < seconds < size:
            return f"{float(f'{seconds / size * 1000:.2g}'):g} {unit}"
    if seconds < 59.5:
        return f"{seconds:.2g} s" if seconds < 9.5 else f"{seconds:.0f} s"
    s = round(seconds)
    for size, unit, smaller, name in ((86400, "d", 3600, "h"), (3600, "h", 60, "min"), (60, "min", 1, "s")):
        if s >= size:
            return f"{s // size} {unit} {s % size // smaller} {name}"
    return f"{s} s"

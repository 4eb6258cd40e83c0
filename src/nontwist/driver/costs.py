"""Nothing costs unannounced: what will take long or much is said, what does not fit into the free memory is refused."""

from __future__ import annotations

from ..integrators import Integrator, Problem
from ..integrators.costs import Cost
from . import grid

LONG, LARGE = 10.0, 1e9  # s and bytes above which a run is announced
STATE_NS, MEMBER_NS = 5_000, 100_000  # of a stored state; of a member that is marched by itself


def run_cost(scheme: Integrator, problem: Problem, states: int) -> Cost:
    """Return what a run that stores `states` will take; `problem.stored` is not looked at."""
    cost = scheme.cost(problem, states)
    return cost._replace(seconds=cost.seconds + states * STATE_NS * 1e-9, size=cost.size + states * grid.STATE)


def members_cost(
    scheme: Integrator, problem: Problem, members: int, states: int, size: int = 0, threads: int = 1
) -> Cost:
    """Return what `members` alike will take, `problem` one of them, when their states need `size` bytes."""
    one, threads = scheme.cost(problem, states), min(threads, members)
    together = scheme.together > 0 and problem.load.is_compiled
    each = one.seconds / scheme.together if together else one.seconds + MEMBER_NS * 1e-9
    seconds = members * each / (threads if problem.load.is_compiled else 1)
    return Cost(members * one.parts, one.unit, seconds, size + threads * one.size)


def excess(cost: Cost) -> str | None:
    """Return that a run does not fit into the free memory, and what fits; None where it does."""
    if cost.size <= grid.SMALL or cost.size <= (free := grid.free_memory()):
        return None
    fits = float(f"{0.95 * cost.parts * free / cost.size:.1e}")
    return (
        f"{cost.parts:.3g} {cost.unit} need {amount(cost.size)}, {amount(free)} are free; {fits:g} {cost.unit} fit: "
        "store fewer states, shorten the run, or take integrator='split'"
    )


def notice(cost: Cost, what: str = "run", where: str = "of memory") -> str | None:
    """Return what to say of what will take more than 10 s or 1 GB, None of less."""
    if cost.seconds <= LONG and cost.size <= LARGE:
        return None
    return (
        f"the {what} will take about {duration(cost.seconds)} and {amount(cost.size)} {where}, for {cost.parts:.3g} "
        f"{cost.unit}"
    )


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

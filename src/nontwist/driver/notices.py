"""Warnings before a run, its progress, and the messages of failures.

The time and memory of runs, forecast, and how far off they are: what is announced, refused, or said of a step.

Long or large runs are announced, those beyond the free memory refused. Of a step it is said that it is too coarse.

SIGTERM and SIGHUP interrupt a run as Ctrl-C does, so that the completed part is kept.
"""

from __future__ import annotations

import math
import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from types import FrameType

import numpy as np

from ..errors import warn
from ..geometry.arrays import Dataset
from ..geometry.values import number_text
from ..integrators import IVP, Integrator, Status
from ..integrators.costs import Cost
from ..integrators.integrator import Failure, Outcome
from ..integrators.ivp import Segments
from ..loads import Load
from ..loads.load_derivatives import name_of_function
from ..models.stack import SystemStack
from . import grid
from .contacts import refusal
from .grid import load_messages

LONG, LARGE = 10.0, 1e9  # s and bytes above which a run is announced
STATE_NS = 5_000  # of a stored state
LEAST_NS, MEMBER_NS, WHEELS_NS = 3_000, 100_000, 1_000_000  # of a member; of one integrated by itself, and with wheels
# Of an ensemble of a sweep; where its load is compiled for it.
ENSEMBLE_NS, COMPILED_NS = 4_000_000, 25_000_000
COARSE_STEP = "the step is coarse"
SMOOTH = "make smooth, over a scale that steps resolve, what switches or saturates with the state"
COARSE, FINE = 0.1, 0.002  # rad at the end: that is reported, and that of the step that is advised


def run_cost(scheme: Integrator, problem: IVP, states: int) -> Cost:
    """Return the estimated cost of a run that stores `states`; `problem.stored` is ignored."""
    cost = scheme.cost(problem, states)
    return cost._replace(seconds=cost.seconds + states * STATE_NS * 1e-9, size=cost.size + states * grid.STATE)


def members_cost(scheme: Integrator, problem: IVP, members: int, states: int, size: int = 0, threads: int = 1) -> Cost:
    """Return the estimated cost of `members` like `problem`, whose states need `size` bytes."""
    one, threads, load = scheme.cost(problem, states), min(threads, members), problem.load
    each = one.seconds + (WHEELS_NS if load.wheels else MEMBER_NS) * 1e-9
    if scheme.together > 0 and load.is_compiled and not (load.wheels or load.is_dry):
        each = max(one.seconds / max(1.0, min(scheme.together, members)), LEAST_NS * 1e-9)
    seconds = members * each / (threads if load.is_compiled else 1)
    return Cost(members * one.parts, one.unit, seconds, size + threads * one.size)


def sweep_seconds(scheme: Integrator, problem: IVP, members: int, ensembles: int) -> float:
    """Return about how long members take in so many ensembles, s, each of which is laid out and sampled anew."""
    each = members_cost(scheme, problem, -(-members // ensembles), 2).seconds
    own = ENSEMBLE_NS + COMPILED_NS * (ensembles > 1 and bool(problem.load.memories))
    return members / -(-members // ensembles) * each + ensembles * own * 1e-9


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


# ---- whether a step is too coarse, in one sentence for `check`, which has a bound of |w|, and for a run that is done
#
# A step of a midpoint scheme turns a steadily rotating body not by θ = |w| h but, as a Cayley rotation, by 2
# atan(θ/2), one of Gauss collocation by the argument of a Padé approximation. The difference (`Integrator.lag`) times
# the number of steps is the phase error of the whole run, h² |w|³ t / 12 for order 2. It is the size to expect of
# other motions as well. A scheme that turns by exponentials has none (`Integrator.turns_exactly`). Above
# `Integrator.largest_turn` equations are not solved as they should be.


def phase_error(scheme: Integrator, problem: IVP, fastest: float) -> float:
    """Return by how much a steady rotation at `fastest` rad/s is off at the end, rad."""
    if scheme.turns_exactly(problem):
        return 0.0
    h = problem.grid.longest
    return (problem.t_end - problem.t_start) / h * scheme.lag(fastest * h)


def unremarkable(scheme: Integrator, step: float, span: float) -> float:
    """Return the angular velocity up to which there is nothing to say, as far as that is quick to decide, rad/s."""
    return min(scheme.largest_turn / step, math.cbrt(12 * COARSE / span) / math.cbrt(step) ** 2)


def coarseness(
    scheme: Integrator, problem: IVP, fastest: float, otherwise: str = ", or tolerance = 1e-6"
) -> str | None:
    """Return what to say of a step in which a body that turns at up to `fastest` rad/s turns too far; else None."""
    if scheme.any_times or problem.output_times is not None or (scheme.is_exact_without_load and problem.is_free):
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
        f"({scheme.name}, order {order}); try step <= {fine:.1g}{higher}{otherwise}"
    )


def failure_message(problem: IVP, failure: Failure) -> str:
    """Return where and why a march stopped, with a remedy."""
    h, on_grid, began = problem.step_at(failure.step), not problem.off_grid, problem.began(failure.step)
    if failure.status is Status.INTERRUPTED:
        steps = f", after {failure.step} of {problem.steps} steps" if on_grid else ""
        return f"{failure.reason or 'interrupted'} at t = {began:.12g} s{steps}"
    where = f"step {failure.step} at t = {began:.12g} s" if on_grid else f"after t = {began:.12g} s"
    if failure.reason:
        return f"{where}: {failure.reason}"
    broken = "the directors are no longer orthonormal"
    if failure.status is Status.BROKEN and not failure.turn > 0:
        return f"{where}: {broken} (defect {failure.residual:.3g}); try a smaller step"
    smooth, remedy = "", float(f"{h * min(0.5, 0.5 / max(failure.turn, 1e-3)):.0e}")
    cause = f"the body turns {failure.turn:.2g} rad in one step"
    if failure.status is Status.BROKEN:
        cause = f"{broken} ({cause})"
    if failure.status is Status.STALLED:
        cause = f"Newton's iteration stalled at a residual of {failure.residual:.3g} ({cause})"
        smooth = f", or {SMOOTH}" if problem.load.called.terms else ""
    return f"{where}: {cause}; try step <= {remedy:g}{smooth}"


def messages(problem: IVP, outcome: Outcome) -> dict[int, str]:
    """Return the messages of failed members, as `simulate` raises them."""
    failed = np.flatnonzero(outcome.failures[:, 0] != Status.OK).tolist()
    return {i: failure_message(problem, failure) for i in failed if (failure := outcome.failure(i)) is not None}


def with_messages(many: Dataset, problem: IVP, outcome: Outcome) -> Dataset:
    """Return an ensemble with the messages of failed members, and warn of them."""
    failed = messages(problem, outcome)
    if not failed:
        return many.assign_attrs(message="done")
    first = next(iter(failed))
    summary = f"{len(failed)} of {len(problem)} members have failed, the first is {first}: {failed[first]}"
    warn(summary)
    texts = [failed.get(i, "") for i in range(len(problem))]
    many["message"] = ("member", np.array(texts, dtype=object), {"long_name": "why the run of the member ended"})
    return many.assign_attrs(message=summary)


def say(messages: Sequence[str | None]) -> bool:
    """Warn of each message that there is, at the line of the caller of the package; return whether there is none."""
    said = [message for message in messages if message]
    for message in said:
        warn(message)
    return not said


def warn_of_grid(load: Load, systems: SystemStack, t0: float, t1: float, grid: Segments) -> bool:
    """Warn of breakpoints off the grid, of a load or of a prescribed spin, and of tables that end too early.

    Return whether there are none.
    """
    return say(load_messages(load, systems, t0, t1, grid))


def warn_of_cost(load: Load) -> bool:
    """Warn of loads that run in Python; return whether there are none."""
    slow = [name_of_function(term) for term in load.in_python]
    text = (
        f"the load {', '.join(slow)} runs in Python, 4 to 15 calls of it and about 0.1 ms a stage of a step; "
        "compiled=True, as in moment(function, compiled=True), is about 100 times faster"
    )
    return not slow or say([text])


def announce(cost: Cost, scheme: Integrator, problem: IVP) -> bool:
    """Refuse runs that exceed the free memory; warn of more than 10 s or 1 GB; return whether it is neither."""
    if (reason := excess(cost)) is not None:
        raise ValueError(reason)
    text = notice(cost)
    return text is None or refusal(scheme, problem) is not None or say([text])


@contextmanager
def progress_bar(total: float, what: str = "steps") -> Iterator[Callable[..., None]]:
    """Show a bar on stderr; yield the function that takes the completed fraction of `total`, and words about it.

    On a terminal it vanishes at the end; elsewhere its last state is printed. A terminal that closes meanwhile raises
    no error.
    """
    from rich.console import Console
    from rich.progress import Progress, TextColumn

    console, words = Console(stderr=True), TextColumn("{task.fields[words]}")
    bar = Progress(*Progress.get_default_columns(), words, console=console, transient=console.is_terminal)
    task = bar.add_task(what, total=total, words="")
    bar.start()
    try:
        yield lambda part, words="": bar.update(task, completed=part * total, words=words)
    finally:
        with suppress(OSError):
            bar.stop()


@contextmanager
def sigterm_interrupts() -> Iterator[None]:
    """Let SIGTERM and SIGHUP raise a KeyboardInterrupt in the block, in the main thread, so that partial runs are kept.

    The first signal counts; later ones are ignored until the block ends, because a terminal that closes and a service
    manager that stops a service send several. A signal that is ignored already, as under ``nohup``, stays ignored.

    Raises
    ------
    ValueError
        Outside of the main thread, where Python takes no signals.
    """
    known = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
    handlers = {number: signal.getsignal(number) for number in known}
    before = {number: handler for number, handler in handlers.items() if handler not in (signal.SIG_IGN, None)}

    def interrupt(number: int, frame: FrameType | None) -> None:
        for one in before:
            signal.signal(one, signal.SIG_IGN)
        raise KeyboardInterrupt(f"interrupted ({signal.Signals(number).name})")

    try:
        for number in before:
            signal.signal(number, interrupt)
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)

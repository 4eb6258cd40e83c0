"""Warnings before a run, its progress, and the messages of failures."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from ..errors import warn
from ..integrators import IVP, Integrator, Status
from ..integrators.base import Failure
from ..integrators.costs import Cost
from ..integrators.time_grid import Stretches
from ..loads import Load
from ..loads.calls import name_of
from ..models.stack import SystemStack
from . import costs
from .contacts import refusal
from .grid import load_messages
from .signals import shown_bar


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
    remedy = float(f"{h * min(0.5, 0.5 / max(failure.turn, 1e-3)):.0e}")
    cause = f"the body turns {failure.turn:.2g} rad in one step"
    if failure.status is Status.BROKEN:
        cause = f"{broken} ({cause})"
    if failure.status is Status.STALLED:
        cause = f"Newton's iteration stalled at a residual of {failure.residual:.3g} ({cause})"
    return f"{where}: {cause}; try step <= {remedy:g}"


def say(messages: list[str]) -> bool:
    """Warn of each message, at the line of the caller of the package; return whether there is none."""
    for message in messages:
        warn(message)
    return not messages


def warn_of_grid(load: Load, systems: SystemStack, t0: float, t1: float, grid: Stretches) -> bool:
    """Warn of breakpoints off the grid, of a load or of a prescribed spin, and of tables that end too early.

    Return whether there are none.
    """
    if not load.terms and systems.spin is None:
        return True
    return say(load_messages(load, systems, t0, t1, grid))


def warn_of_step(scheme: Integrator, problem: IVP) -> bool:
    """Warn of what the integrator says about the step; return whether it says nothing."""
    remark = scheme.remark(problem)
    return remark is None or say([remark])


def warn_of_cost(load: Load) -> bool:
    """Warn of loads that run in Python; return whether there are none."""
    slow = [name_of(term.called).removeprefix("__main__.") for term in load.called.terms if term.c_function is None]
    text = (
        f"the load {', '.join(slow)} runs in Python, 4 to 15 calls of it and about 0.1 ms a stage of a step; "
        "moment(function, compiled=True), or compiled=True of your own Term, is about 100 times faster"
    )
    return not slow or say([text])


def announce(cost: Cost, scheme: Integrator, problem: IVP) -> bool:
    """Refuse runs that exceed the free memory; warn of more than 10 s or 1 GB; return whether it is neither."""
    if (reason := costs.excess(cost)) is not None:
        raise ValueError(reason)
    text = costs.notice(cost)
    return text is None or refusal(scheme, problem) is not None or say([text])


@contextmanager
def progress_bar(total: int, what: str = "steps") -> Iterator[Callable[[float], None]]:
    """Show a bar on stderr; yield the function that sets the completed fraction of `total`.

    On a terminal it vanishes at the end; elsewhere its last state is printed.
    """
    from rich.console import Console
    from rich.progress import Progress

    console = Console(stderr=True)
    with shown_bar(Progress(console=console, transient=console.is_terminal)) as bar:
        task = bar.add_task(what, total=total)
        yield lambda part: bar.update(task, completed=part * total)

"""`validate`: every group of checks, one after the other or in parallel."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable
from dataclasses import replace
from importlib import import_module
from time import perf_counter

from .checks import GROUPS, Check
from .report import Validation


def validate(
    groups: str | Iterable[str] | None = None, *, workers: int = 1, progress: Callable[[str], None] | None = None
) -> Validation:
    """Validate the package against the paper, closed-form solutions, invariants and orders.

    Parameters
    ----------
    groups : str or iterable of str, optional
        Keys of `nontwist.validation.GROUPS`; all by default.
    workers : int
        Number of processes that share the groups. More than one requires a script that is safe to import
        (``if __name__ == "__main__":``).
    progress : callable, optional
        Called with a description of the next step.

    Returns
    -------
    Validation
        All checks, whether they pass, and notes on what was not checked.

    Raises
    ------
    ValueError
        There is no such group.

    Examples
    --------
    >>> from nontwist import validate
    >>> validation = validate("geometry")
    >>> validation.holds
    True
    >>> [check.name for check in validation.checks if check.source == "eq-dexp"][0]
    'SO(3): dexp against the integral of exp(s θ̂)'
    """
    from ..geometry.values import among, as_function, as_list, as_whole, nearest, shown

    named = list(GROUPS) if groups is None else [groups] if isinstance(groups, str) else as_list(groups, "groups")
    if unknown := [name for name in named if not among(name, GROUPS)]:
        raise ValueError(f"unknown group {shown(unknown[0])}; {nearest(unknown[0], GROUPS)}")
    chosen, workers = list(dict.fromkeys(named)), as_whole(workers, "workers", 1)
    say = (lambda text: None) if progress is None else as_function(progress, "progress")
    found: dict[str, tuple[list[Check], float]] = {}
    if workers == 1 or len(chosen) == 1:
        for name in chosen:
            say(f"{len(found)} of {len(chosen)} groups done: {name}")
            found[name] = checks_of(name)
    else:
        from concurrent.futures import ProcessPoolExecutor, as_completed
        from multiprocessing import get_context

        from ..sweeps.workers import own_modules

        context = get_context("spawn")
        with ProcessPoolExecutor(workers, context, imported, own_modules()) as pool:
            tasks = {pool.submit(checks_of, name): name for name in chosen}
            say(f"0 of {len(chosen)} groups done")
            for task in as_completed(tasks):
                found[tasks[task]] = task.result()
                say(f"{len(found)} of {len(chosen)} groups done")
    checks = tuple(check for name in chosen for check in found[name][0])
    return Validation(checks, notes_on(chosen), {name: found[name][1] for name in chosen})


def imported(*modules: str) -> None:
    """Import the modules that add bodies, loads and integrators, in a new process."""
    for name in modules:
        import_module(name)


def notes_on(groups: Iterable[str]) -> tuple[str, ...]:
    """Return what some groups do not check, and why; and which of them check bodies of one's own."""
    from .problems import own_kinds

    modules = {group: import_module(f"{__package__}.{GROUPS[group]}") for group in groups}
    notes = [note for module in modules.values() for note in getattr(module, "unchecked", tuple)()]
    checked = [group for group, module in modules.items() if {"sample_bodies", "random_kinds"} & vars(module).keys()]
    if checked and (own := own_kinds()):
        notes.append(f"the checks of all bodies in {', '.join(checked)} include your own: {', '.join(map(repr, own))}")
    return tuple(notes)


def checks_of(group: str) -> tuple[list[Check], float]:
    """Return all checks of a group, and the seconds that they took."""
    from ..driver.coarseness import COARSE_STEP

    module, start = import_module(f"{__package__}.{GROUPS[group]}"), perf_counter()
    with warnings.catch_warnings():  # orders are measured with coarse steps
        warnings.filterwarnings("ignore", COARSE_STEP)
        checks = [replace(check, group=group) for function in module.CHECKS for check in function()]
    return checks, perf_counter() - start

"""1001 outputs of each motion, to an error of 1e-9 at the end, compared with heyoka.py by ratios of times.

Outputs of `gauss` come from power series at the nodes, those of `exact` from its solution, those of heyoka.py from
polynomials at the loosest tolerance that reaches the error.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator
from typing import Any

import numpy as np

from nontwist import propagator
from nontwist.errors import SimulationError
from nontwist.integrators import INTEGRATORS

from .peers import heyoka_grid
from .rows import Row, digits
from .timing import shuffled
from .workloads import Array, Workload, attitude, workload

FAMILIES = {"A": ("exact", "gauss"), "B": ("split", "gauss"), "C": ("exact", "gauss"), "T": ("gauss",)}
TARGET, OUTPUTS = 1e-9, 1001
STEPS = (10, 20, 30, 40, 60, 80, 120, 160, 240, 320, 500, 1000)
Calls = dict[Hashable, Callable[[], Any]]


def rows() -> list[Row]:
    """Measure all."""
    return [against_heyoka(workload(key), names) for key, names in FAMILIES.items()]


def against_heyoka(w: Workload, names: tuple[str, ...]) -> Row:
    """Compare the fastest call that reaches the error with heyoka.py at the loosest tolerance that does."""
    times = np.linspace(0, w.t_end, OUTPUTS)
    ours = {label: call for name in names for label, call in settings(w, name, times) if reaches(w, call)}
    label = f"{w.key}, {OUTPUTS} outputs to {TARGET:.0e}: heyoka.py"
    seconds = shuffled(ours)
    best = min(seconds, key=lambda key: seconds[key])
    for tol in 10.0 ** np.arange(-8, -16.1, -0.5):
        theirs = heyoka_grid(w, float(tol), times)
        if w.error(attitude(theirs()[-1])) <= TARGET:
            both = shuffled({"ours": ours[best], "theirs": theirs}, 15)
            return Row(label, both["theirs"] / both["ours"], "×", note=f"{best}, {digits(1e6 * both['ours'])} µs")
    return Row(label, None, "×", note="heyoka.py does not reach this error")


def settings(w: Workload, name: str, times: Array) -> Iterator[tuple[str, Callable[[], Any]]]:
    """Yield calls of an integrator with their settings; for each order the first number of steps that is enough."""
    how = {"times": times, "load": w.load, "integrator": name}
    velocity = {"material_angular_velocity": w.velocity}
    if not INTEGRATORS[name].orders:
        run = propagator(w.system, **how)
        yield name, lambda: read(run(**velocity))
        return
    for order in INTEGRATORS[name].orders:
        for N in STEPS:
            stepped = propagator(w.system, **how, order=order, step=w.t_end / N)
            if reaches(w, call := lambda stepped=stepped: read(stepped(**velocity))):
                yield f"{name} {order}, {N} steps", call
                break


def read(run: Any) -> Any:
    """Return a run whose states have been read."""
    assert run.states.quaternion.shape[-2] == OUTPUTS
    return run


def reaches(w: Workload, call: Callable[[], Any]) -> bool:
    """Whether a call reaches the error."""
    try:
        return w.error(call().directors[-1].T) <= TARGET
    except SimulationError:
        return False

"""Which integrators and which steps are compared, and the times that all runs share."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import fields
from math import ceil, log2

import numpy as np

from ..driver.grid import count_steps, stretches_of
from ..driver.planning import resolve_integrator
from ..geometry.arrays import as_array
from ..geometry.values import as_list, shown
from ..integrators import INTEGRATORS, Integrator
from ..integrators.time_grid import Stretches, stretched
from ..loads import Load

Choice = str | tuple[str, int] | Integrator

COARSEST, SERIES, LEAST, FEWEST = 32, 7, 4, 10
SHARED, STORED = 1000, 10_000


def chosen(integrators: Sequence[Choice] | None) -> dict[str, Integrator]:
    """Return the integrators to compare, by label.

    None: every order of every integrator; one whose setting is a tolerance, at 1e-6, 1e-9 and 1e-12.

    Raises
    ------
    ValueError
        An unknown name or order, something that is no integrator, one given twice, or none at all.
    """
    if isinstance(integrators, str):
        raise ValueError(f"integrators must be a list, got {integrators!r}; write [{integrators!r}]")
    if integrators is None:
        schemes = [scheme for cls in INTEGRATORS.values() for scheme in cls.variants()]
    else:
        schemes = [_integrator(choice) for choice in as_list(integrators, "integrators")]
    if not schemes:
        raise ValueError("integrators is empty; leave it out to compare all that accept the body and the load")
    found: dict[str, Integrator] = {}
    for scheme in schemes:
        name = label(scheme)
        if name in found:
            raise ValueError(f"integrators contains {name!r} twice")
        found[name] = scheme
    return found


def label(scheme: Integrator, *, tolerance: bool = True) -> str:
    """Return the name of an integrator with its order, its tolerance and what else is not the default."""
    parts = [scheme.name]
    for field in fields(scheme):
        value = getattr(scheme, field.name)
        if field.name == "order":
            parts.append(f"{value}")
        elif field.name == "rtol":
            parts += [short(value)] * tolerance
        elif field.name == "atol":
            usual = math.isclose(value, scheme.rtol / 100)  # type: ignore[attr-defined]
            parts += [f"atol {short(value)}"] * (tolerance and not usual)
        elif value != field.default:
            parts.append(f"{field.name} {value:g}" if isinstance(value, float) else str(value))
    return " ".join(parts)


def short(x: float, digits: int = 1) -> str:
    """Return a small or large number in few characters: 1e-9, 3.2e-14."""
    mantissa, exponent = f"{x:.{digits}e}".split("e")
    return f"{mantissa.removesuffix('.0')}e{int(exponent)}"


def grids(
    steps: Sequence[float] | None, t_start: float, t_end: float, automatic: float, load: Load
) -> dict[float, Stretches]:
    """Return the time grids by their longest step, coarse to fine.

    None: up to seven, each with twice the steps of the one before; the first has about 32 times the automatic step, at
    least 10 steps, and the breakpoints of the load as nodes.

    Raises
    ------
    ValueError
        As `simulate` for one step; no steps.
    """
    span = t_end - t_start
    if steps is None:
        first = stretches_of(load, t_start, t_end, min(span / FEWEST, COARSEST * automatic), resolves=False)
        most = SERIES if len(first.sizes) == 1 else max(LEAST, 2 + ceil(log2(max(1.0, first.longest / automatic))))
        series = [stretched(first.borders, 2**k * np.diff(first.numbers)) for k in range(min(SERIES, most))]
        return {grid.longest: grid for grid in series}
    found = {float(h): stretched((t_start, t_end), (count_steps(span, h),)) for h in as_array(steps, "steps", (None,))}
    if not found:
        raise ValueError("steps is empty; leave it out for a series about the automatic step")
    return dict(sorted(found.items(), reverse=True))


def shared_intervals(numbers: Sequence[int]) -> int:
    """Return the most equal intervals, at most 1000, whose ends every grid of `numbers` steps holds."""
    return _divisor(math.gcd(*numbers), SHARED)


def stored_intervals(N: int, shared: int) -> int:
    """Return the most equal intervals that N steps make, the shared ones among them, at most 10 000."""
    return shared * _divisor(N // shared, STORED // shared)


def _divisor(n: int, most: int) -> int:
    return max(k for k in range(1, min(n, most) + 1) if n % k == 0)


def _integrator(choice: Choice) -> Integrator:
    if isinstance(choice, (str, Integrator)):
        return resolve_integrator(choice, None)
    if isinstance(choice, (tuple, list)) and len(choice) == 2 and isinstance(choice[0], str):
        return resolve_integrator(*choice)
    raise ValueError(f"an integrator is a name, a pair (name, order) or an instance, got {shown(choice)}")

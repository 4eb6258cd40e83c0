"""Which integrators and which steps are compared, and the times that all runs share."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import fields

from ..driver.grid import count_steps, refined_count
from ..driver.planning import resolve_integrator
from ..geometry.arrays import as_array
from ..geometry.values import as_list, shown
from ..integrators import INTEGRATORS, Integrator
from ..loads import Load

Choice = str | tuple[str, int] | Integrator

COARSEST, SERIES, FEWEST = 32, 7, 10
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
            raise ValueError(f"integrators holds {name!r} twice")
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
            parts.append(str(value))
    return " ".join(parts)


def short(x: float, digits: int = 1) -> str:
    """Return a small or large number in few characters: 1e-9, 3.2e-14."""
    mantissa, exponent = f"{x:.{digits}e}".split("e")
    return f"{mantissa.removesuffix('.0')}e{int(exponent)}"


def counts(steps: Sequence[float] | None, span: float, automatic: int, load: Load, t_start: float) -> dict[float, int]:
    """Return the numbers of steps by step size, coarse to fine.

    None: seven steps, each half of the one before, the first about 32 times the automatic one (at least 10 of it make
    the span), with the breakpoints of the load on its grid where that can be.

    Raises
    ------
    ValueError
        As `simulate` for one step; no steps.
    """
    if steps is None:
        first = refined_count(max(FEWEST, automatic / COARSEST), load, t_start, t_start + span)
        return {span / N: N for N in (first * 2**k for k in range(SERIES))}
    found = {float(h): count_steps(span, h) for h in as_array(steps, "steps", (None,))}
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

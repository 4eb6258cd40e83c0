"""What a table ``[sweep]`` may not hold though each of its values is of the right form.

`table_problems` looks at the table alone, `key_problems` at the file that it varies: whether its keys are numbers
there, and whether the values have their form.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from contextlib import suppress
from itertools import islice
from typing import TYPE_CHECKING, Any

import numpy as np

from ..geometry.values import guess
from ..integrators import INTEGRATORS, Integrator
from .problems import Problem, shown
from .sweep_table import Attitudes, Drawn, Grid, Normal, Sphere, Sweep, Uniform, Values

if TYPE_CHECKING:
    from ..driver.prepared import Prepared

MOST_MEMBERS, MOST_SOBOL = 10**11, 2**32
MOST_WORDS = 100  # keys that a misspelt one is compared with, and that are named
EXCLUDED = (
    "title",
    "output",
    "sweep",
    "event",
    "time.store",
    "time.times",
)  # no numbers of the motion, which cannot be swept
Tables = dict[str, Any]


def table_problems(sweep: Sweep) -> Iterator[Problem]:
    """Yield what is wrong with the table by itself."""
    valid = True
    for k, one in enumerate(sweep.over):
        for problem in _values(f"sweep.over.{k}", one):
            valid = False
            yield problem
        for other in sweep.over[:k]:
            if _within(one.key, other.key) or _within(other.key, one.key):
                given = f"{shown(one.key)}, beside {shown(other.key)}"
                yield Problem(f"sweep.over.{k}.key", given, "each number once")
    if sweep.samples > 1 and not sweep.drawn:
        yield Problem("sweep.samples", f"{sweep.samples} (nothing is drawn)", "left out, or a key that is drawn")
    if not valid:
        return
    lengths = [one.shape[0] for one in sweep.axes]
    if sweep.combine == "together" and len(set(lengths)) > 1:
        given = f'"together" ({", ".join(map(str, lengths))} values)'
        yield Problem("sweep.combine", given, 'grids and lists of one length; or "product"')
    most = MOST_SOBOL if sweep.sampling == "sobol" and sweep.drawn else MOST_MEMBERS
    if sweep.members > most:
        yield Problem("sweep", f"{min(sweep.members, 10**300):.3g} members", f"at most {most:.3g}")


def _within(key: str, outer: str) -> bool:
    return key == outer or key.startswith(f"{outer}.")


def _values(at: str, one: Any) -> Iterator[Problem]:
    fields = type(one).model_fields
    if isinstance(one, Grid) and one.spacing == "log" and not one.start * one.end > 0:
        yield Problem(f"{at}.start", f'{shown(one.start)} to {shown(one.end)}, spacing = "log"', "ends of one sign")
    if isinstance(one, Values):
        try:
            if not one.points().size:
                yield Problem(f"{at}.values", "an empty list", f"{fields['values'].description}")
        except ValueError as error:
            yield Problem(f"{at}.values", f"{shown(one.values)} ({error})", f"{fields['values'].description}")
    pairs: dict[type, tuple[str, str]] = {Uniform: ("low", "high"), Normal: ("mean", "deviation")}
    if type(one) in pairs:
        first, second = pairs[type(one)]
        a, b = np.array(getattr(one, first)), np.array(getattr(one, second))
        given = f"{shown(getattr(one, second))} ({first} = {shown(getattr(one, first))})"
        if a.shape != b.shape:
            yield Problem(f"{at}.{second}", given, f"of the same form as {first}")
        elif (b < (a if isinstance(one, Uniform) else 0)).any():
            yield Problem(f"{at}.{second}", given, f"{fields[second].description}")


def key_problems(sweep: Sweep, data: Tables, prepared: Prepared | None) -> Iterator[Problem]:
    """Yield what does not fit the rest of the file, which is in order.

    Parameters
    ----------
    sweep : Sweep
    data : dict
        The file with all defaults, as plain data.
    prepared : Prepared or None
        The run of the file without its sweep, if there is one.
    """
    known = numeric_keys(data)
    outer = [key for key in known if not any(key[: dot.start()] in known for dot in re.finditer(r"\.", key))]
    for k, one in enumerate(sweep.over):
        at, shape = f"sweep.over.{k}", _shape(one)
        if one.key == "start.rotation" or isinstance(one, Attitudes):
            if not (one.key == "start.rotation" and isinstance(one, Attitudes)):
                given = f"{shown(one.key)}, kind = {shown(one.kind)}"
                yield Problem(f"{at}.key", given, 'key = "start.rotation" and kind = "rotation" go together')
        elif one.key not in known:
            more = ", ..." if len(outer) > MOST_WORDS else ""
            words = ", ".join(["start.rotation", *outer[:MOST_WORDS]]) + more
            near = guess(one.key, islice(known, MOST_WORDS))
            accepted = f"{near}known are {words}, and entries of these, as in body.axis.0"
            yield Problem(f"{at}.key", shown(one.key), accepted)
        elif known[one.key] != shape:
            form = f"{_form(shape)} (the key holds {_form(known[one.key])})"
            yield Problem(f"{at}.kind", f"{shown(one.kind)}: {form}", "values of the form that the key has")
    integrator = INTEGRATORS[data["integrator"]["name"]]
    yield from step_problems(data["time"].get("step"), integrator, prepared)
    curved = [k for k, load in enumerate(data.get("load") or ()) if _is_curved(load)]
    if sweep.reduce and curved:
        accepted = f"no reductions with load.{curved[0]}, a potential that is not linear: leave reduce out"
        yield Problem("sweep.reduce", shown(sweep.reduce), accepted)
    if sweep.reduce and any(load["kind"] == "dry_friction" for load in data.get("load") or ()):
        yield Problem("sweep.reduce", shown(sweep.reduce), "no reductions under dry_friction: leave reduce out")
    if sweep.reduce and integrator.any_times:
        yield Problem("sweep.reduce", shown(sweep.reduce), f"left out: {integrator.name} takes no steps to reduce over")


def step_problems(step: float | None, integrator: type[Integrator], prepared: Prepared | None) -> Iterator[Problem]:
    """Yield that a step is missing, which all members take, with one that suits the run without the sweep."""
    if step is not None or integrator.any_times:
        return
    accepted = "a step, s, which all members take"
    with suppress(ValueError):  # too many steps
        if prepared is not None:
            prepared = prepared.on_grid  # members store the states at their steps
            order = getattr(prepared.scheme, "order", None)
            at = f" with integrator.order = {order}" if order else ""
            accepted += f"; {_suggested_step(prepared):.12g}{at} suits the file without [sweep], and "
            accepted += "nontwist precision FILE --target 1e-8 finds one that has this error"
    yield Problem("time.step", "missing", accepted)


def _suggested_step(prepared: Prepared) -> float:
    """Return a step that divides the span, no longer than those of the run, if possible with one digit."""
    span, longest = prepared.plan.t_end - prepared.plan.t_start, prepared.grid.longest
    power = 10.0 ** math.floor(math.log10(longest))
    for step in (5 * power, 2 * power, power, power / 2, power / 5, power / 10):
        if step <= longest and math.isclose(span / step, round(span / step), rel_tol=1e-12):
            return step
    return span / math.ceil(span / longest)


def _is_curved(load: dict[str, Any]) -> bool:
    """Whether a load is a potential that is not linear."""
    kind = load["kind"]
    if kind == "spring":
        return bool(load["rest_length"])
    return kind == "gravity_gradient" or (kind == "potential" and bool(np.any(load["quadratic"])))


def _shape(one: Any) -> tuple[int, ...]:
    if isinstance(one, Drawn):
        return (3,) if isinstance(one, Sphere) else np.shape(getattr(one, "low", getattr(one, "mean", ())))
    shape: tuple[int, ...] = one.shape[1:]
    return shape


def _form(shape: tuple[int, ...]) -> str:
    return f"{' × '.join(map(str, shape))} numbers" if shape else "a number"


def numeric_keys(data: Any, at: str = "") -> dict[str, tuple[int, ...]]:
    """Return the dotted paths of all numbers in plain data, and of all arrays of numbers, with their shapes."""
    found: dict[str, tuple[int, ...]] = {}
    if at in EXCLUDED or isinstance(data, (bool, str)):
        return found
    if isinstance(data, (int, float)):
        return {at: ()}
    entries = data.items() if isinstance(data, dict) else enumerate(data)
    if isinstance(data, list) and (shape := _regular(data)) is not None:
        found[at] = shape
    for key, value in entries:
        found |= numeric_keys(value, f"{at}.{key}" if at else str(key))
    return found


def _regular(data: list[Any]) -> tuple[int, ...] | None:
    """Return the shape of a list of numbers, or of lists of them, that is an array; None where it is none."""
    try:
        array = np.array(data)
    except ValueError:
        return None
    return array.shape if array.dtype.kind in "if" and array.size else None

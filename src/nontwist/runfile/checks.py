"""What a run file may not hold though each of its values is of the right form.

Bodies that do not exist, steps that do not fit, a spin about the held axis: every check yields its problems, so that
all are told at once.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from pydantic import ValidationError

from ..driver.grid import MOST_STEPS, count_steps, is_too_short, stored_count
from ..driver.starts import start_of_one
from ..integrators import INTEGRATORS
from ..models.bodies import BODIES
from ..models.system import DirectorSystem
from .body import Body
from .document import Integrator, Time, options_of
from .folder import Folder
from .loads import LoadSection, Place
from .makers import MAKERS, MadeInertia
from .problems import Problem, problems_of, shown
from .section import Section
from .start import Start
from .sweep_checks import sense


def findings(parts: dict[str, Any], folder: Folder) -> Iterator[Problem]:
    """Yield what is wrong with tables that are of the right form.

    Parameters
    ----------
    parts : dict
        Those of body, start, load (a dict of number to table), time, integrator, sweep that are of the right form.
    folder : Folder
        Where the run file lies.
    """
    body, start, time = parts.get("body"), parts.get("start"), parts.get("time")
    system = None
    if body is not None:
        unfit = list(_body(body))
        yield from unfit
        if not unfit:
            try:
                system = folder.system(body)
            except ValueError as error:
                yield _about("body.inertia", body.inertia, error, Body)
    if start is not None:
        yield from _start(start, system)
    wrong = [] if time is None else list(_time(time))
    place = None if time is None or wrong else Place(folder, time.t_start, time.t_end)
    for k, load in parts.get("load", {}).items():
        if place is not None or not load.needs_times:
            yield from _load(f"load.{k}", load, place or Place(folder, 0.0, 1.0))
    yield from wrong
    if "integrator" in parts:
        yield from _integrator(parts["integrator"])
    if parts.get("sweep") is not None:
        yield from sense(parts["sweep"])


def _body(body: Body) -> Iterator[Problem]:
    """Yield keys that this kind of body, or of inertia, lacks or does not have."""
    fields = Body.model_fields
    if "axis" in body.takes and not (body.axis and any(body.axis)):
        given = "missing" if body.axis is None else shown(body.axis)
        yield Problem("body.axis", given, f"{fields['axis'].description}")
    if "axis" not in body.takes and body.axis is not None:
        able = [f'"{name}"' for name, kind in BODIES.items() if "axis" in kind.takes]
        words = f"{' and '.join(able)} take{'s' * (len(able) == 1)} an axis"
        yield Problem("body.axis", shown(body.axis), f'left out for kind = "{body.kind}"; {words}')
    weight = {"mass": body.mass, "centre_of_mass": body.centre_of_mass}
    if isinstance(body.inertia, MadeInertia):
        if len(body.inertia.chosen) != 1:
            given = f"a table with {' and '.join(body.inertia.chosen) or 'no shape'}"
            yield Problem("body.inertia", given, f"a table with one of {', '.join(MAKERS)}")
        for key, value in weight.items():
            if value is not None:
                yield Problem(f"body.{key}", shown(value), "left out: the shape in body.inertia brings it")
    elif "mass" in body.takes or body.gravity is not None or any(value is not None for value in weight.values()):
        for key, value in weight.items():
            if value is None:
                yield Problem(f"body.{key}", "missing", f"{fields[key].description}, where gravity acts")


def _start(start: Start, system: DirectorSystem | None) -> Iterator[Problem]:
    try:
        arguments = start.arguments()
    except ValueError as error:
        key = next(iter(type(start.rotation).model_fields))
        yield _about(f"start.rotation.{key}", getattr(start.rotation, key), error, type(start.rotation))
        return
    if system is None:
        return
    spin: dict[str, Any] = {name: arguments.get(name) for name in ("material_angular_velocity", "angular_velocity")}
    try:
        start_of_one(system, None, arguments["rotation"], None, project=start.project, **spin)
    except ValueError as error:
        velocity = next(value for value in spin.values() if value is not None)
        accepted = "one without spin about the axis that the body holds; or project = true"
        yield Problem("start.angular_velocity", f"{shown(velocity)} ({error})", accepted)


def _load(key: str, load: LoadSection, place: Place) -> Iterator[Problem]:
    try:
        load.load(place)
    except ValueError as error:
        yield _about(f"{key}.{load.blamed}", getattr(load, load.blamed), error, type(load))


def _time(time: Time) -> Iterator[Problem]:
    span, fields = time.t_end - time.t_start, Time.model_fields
    if not 0 < span < math.inf:
        yield Problem(
            "time.t_end", f"{shown(time.t_end)} (t_start = {shown(time.t_start)})", f"{fields['t_end'].description}"
        )
    elif time.step is not None and is_too_short(span, time.step):
        given = f"{shown(time.step)} (that is {span / time.step:.3g} steps)"
        yield Problem("time.step", given, f"one that takes at most {MOST_STEPS:g} steps")
    elif time.step is not None:
        try:
            N = count_steps(span, time.step)
        except ValueError as error:
            yield _about("time.step", time.step, error, Time)
        else:
            yield from _store(N, time)


def _store(N: int, time: Time) -> Iterator[Problem]:
    try:
        stored_count(N, time.store)
    except ValueError as error:
        yield _about("time.store", time.store, error, Time)


def _integrator(integrator: Integrator) -> Iterator[Problem]:
    scheme, order = INTEGRATORS[integrator.name], integrator.order
    if order is not None and not scheme.orders:
        yield Problem("integrator.order", shown(order), f"left out: {integrator.name} has no order")
    elif order is not None:
        try:
            scheme(order=order)  # type: ignore[call-arg]
        except ValueError as error:
            yield Problem("integrator.order", f"{order} ({error})", f"one of {', '.join(map(str, scheme.orders))}")
    table = options_of(integrator.name)
    try:
        options = table.model_validate(integrator.options)
        scheme(**options.model_dump())
    except ValidationError as error:
        yield from problems_of(error, integrator.options, table, ("integrator", "options"))
    except ValueError as error:
        yield _about("integrator.options", integrator.options, error, Integrator)


def _about(key: str, value: Any, error: ValueError, table: type[Section]) -> Problem:
    """Return the problem of a value of which nothing could be made."""
    given = "missing" if value is None else shown(value)
    return Problem(key, f"{given} ({error})", table.model_fields[key.split(".")[-1]].description or "")

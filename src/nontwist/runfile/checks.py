"""From the tables of a run file, each of the right form, to what a run needs.

What makes no run is reported: bodies that do not exist, steps that do not fit, a spin about the constrained axis. Each
check makes what it can and appends its problems to those of the others, so that all are reported at once.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from pydantic import ValidationError

from ..driver.events import NamedEvent, as_events
from ..driver.grid import MOST_STEPS, asked_times, count_steps, is_too_short, stored_count
from ..driver.planning import Plan, candidates, known_body, require_possible
from ..driver.prepared import Prepared
from ..driver.starts import Starts, start_of_one
from ..geometry.arrays import Array
from ..integrators import INTEGRATORS
from ..integrators import Integrator as Scheme
from ..integrators.time_grid import stretched
from ..loads import Load
from ..models.bodies import BODIES
from ..models.spin import as_spin
from ..models.stack import stacked
from ..models.system import DirectorSystem
from .body import MAKERS, Body, MadeInertia, SpinTable
from .folder import Folder
from .loads import LoadSection, Place
from .section import Fault, Section, problems_of, shown
from .sweep_table import table_problems
from .tables import EventSection, Integrator, Start, Time, options_of


def prepare(tables: dict[str, Any], folder: Folder, problems: list[Fault]) -> Prepared | None:
    """Return what a run needs, made from tables that are of the right form; None where something is missing or wrong.

    Parameters
    ----------
    tables : dict
        Those of body, start, load and event (dicts of number to table), time, integrator, sweep that are of the right
        form.
    folder : Folder
        Where the run file lies.
    problems : list
        What is wrong is appended.
    """
    before, system, begin, scheme = len(problems), None, None, None
    if (body := tables.get("body")) is not None:
        system = _system(body, folder, problems)
    time, steps, wrong = tables.get("time"), None, list[Fault]()
    if (start := tables.get("start")) is not None:
        begin = _begin(start, system, 0.0 if time is None else time.t_start, folder, problems)
        if start.run is not None and tables.get("sweep") is not None:
            problems.append(Fault("start.run", shown(start.run), "left out: members of a sweep start from numbers"))
    if time is not None:
        steps = _steps(time, wrong)
    place = None if time is None or wrong else Place(folder, time.t_start, time.t_end)
    load = Load()
    for k, one in tables.get("load", {}).items():
        if place is not None or not one.needs_times:
            load = _with_load(load, f"load.{k}", one, place or Place(folder, 0.0, 1.0), problems)
    problems += wrong
    if "integrator" in tables:
        scheme = _scheme(tables["integrator"], problems)
    if time is not None and begin is not None and begin.time is not None and time.t_start != begin.time:
        accepted = f"{begin.time!r}, the last time of {tables['start'].run}"
        problems.append(Fault("time.t_start", shown(time.t_start), accepted))
    if time is not None and time.tolerance is not None:
        problems += _tolerance(time, scheme)
    asked = None if time is None or wrong or scheme is None else _times(time, scheme, folder, problems)
    events = [_event(f"event.{k}", one, problems) for k, one in tables.get("event", {}).items()]
    if tables.get("sweep") is not None:
        problems += table_problems(tables["sweep"])
        if events:
            problems.append(Fault("event", f"{len(events)} tables", "left out: a sweep looks for no events"))
    if len(problems) > before or time is None or system is None or begin is None or scheme is None:
        return None
    grid = None if steps is None else stretched((time.t_start, time.t_end), (steps,))
    if asked is not None and scheme.any_times:
        grid = stretched((time.t_start, time.t_end), (1,))
    is_open = tables["integrator"].order is None and not tables["integrator"].options
    schemes, t0, t1 = candidates(scheme, is_open), time.t_start, time.t_end
    systems = stacked(system)
    load = known_body(load, systems)
    try:
        require_possible(scheme, systems, load)
    except ValueError as error:
        problems.append(
            Fault("load", f"{len(load.terms)} tables ({error})", "loads that go with the body and each other")
        )
        return None
    plan = Plan(scheme, systems, load, t0, t1, time.store, grid, asked, time.tolerance, schemes)
    return Prepared(plan, begin, as_events([event for event in events if event is not None]))


def _system(body: Body, folder: Folder, problems: list[Fault]) -> DirectorSystem | None:
    unfit = list(_body(body))
    problems += unfit
    if not unfit:
        try:
            return folder.system(body)
        except ValueError as error:
            worded = ValueError(str(error).replace("physical=False", "body.physical = false"))
            problems.append(_about("body.inertia", body.inertia, worded, Body))
    return None


def _body(body: Body) -> Iterator[Fault]:
    """Yield keys that this kind of body, or of inertia, lacks or does not have."""
    fields = Body.model_fields
    if "axis" in body.takes and not (body.axis and any(body.axis)):
        given = "missing" if body.axis is None else shown(body.axis)
        yield Fault("body.axis", given, f"{fields['axis'].description}")
    if "axis" not in body.takes and body.axis is not None:
        able = [f'"{name}"' for name, kind in BODIES.items() if "axis" in kind.takes]
        words = f"{' and '.join(able)} take{'s' * (len(able) == 1)} an axis"
        yield Fault("body.axis", shown(body.axis), f'left out for kind = "{body.kind}"; {words}')
    if "physical" not in body.takes and body.physical is not None:
        yield Fault("body.physical", shown(body.physical), f'left out for kind = "{body.kind}", which does not take it')
    if "spin" not in body.takes and body.spin is not None:
        spun = " and ".join(f'"{name}"' for name, kind in BODIES.items() if "spin" in kind.takes)
        yield Fault("body.spin", shown(body.spin), f'left out for kind = "{body.kind}"; {spun} takes a spin')
    elif isinstance(body.spin, SpinTable):
        try:
            as_spin((body.spin.times, body.spin.values))
        except ValueError as error:
            yield _about("body.spin", body.spin, error, Body)
    weight = {"mass": body.mass, "centre_of_mass": body.centre_of_mass}
    if isinstance(body.inertia, MadeInertia):
        if len(body.inertia.chosen) != 1:
            given = f"a table with {' and '.join(body.inertia.chosen) or 'no shape'}"
            yield Fault("body.inertia", given, f"a table with one of {', '.join(MAKERS)}")
        for key, value in weight.items():
            if value is not None:
                yield Fault(f"body.{key}", shown(value), "left out: the shape in body.inertia brings it")
    elif "mass" in body.takes or body.gravity is not None or any(value is not None for value in weight.values()):
        for key, value in weight.items():
            if value is None:
                yield Fault(f"body.{key}", "missing", f"{fields[key].description}, where gravity acts")


def _continued(start: Start, system: DirectorSystem | None, folder: Folder, problems: list[Fault]) -> Starts | None:
    """Return the end of the run that is continued."""
    for key in sorted({"rotation", "angular_velocity"} & start.model_fields_set):
        problems.append(Fault(f"start.{key}", "given", "left out beside start.run, which brings it"))
    try:
        arguments = start.arguments(folder)
        if system is None:
            return None
        return start_of_one(system, arguments["start"], None, None, None, None, start.project)
    except ValueError as error:
        problems.append(Fault("start.run", f"{shown(start.run)} ({error})", "a result file of a run of this body"))
        return None


def _begin(
    start: Start, system: DirectorSystem | None, t_start: float, folder: Folder, problems: list[Fault]
) -> Starts | None:
    if start.run is not None:
        return _continued(start, system, folder, problems)
    try:
        arguments = start.arguments(folder)
    except ValueError as error:
        key = next(iter(type(start.rotation).model_fields))
        problems.append(_about(f"start.rotation.{key}", getattr(start.rotation, key), error, type(start.rotation)))
        return None
    if system is None:
        return None
    rotation, W, w = (arguments.get(name) for name in ("rotation", "material_angular_velocity", "angular_velocity"))
    try:
        return start_of_one(system, None, rotation, None, W, w, start.project, t_start)
    except ValueError as error:
        reason = str(error).removesuffix("; project=True removes it")  # which is Python
        accepted = "one without spin about the constrained axis of the body; start.project = true removes it"
        problems.append(Fault("start.angular_velocity", f"{shown(W or w)} ({reason})", accepted))
        return None


def _with_load(others: Load, key: str, load: LoadSection, place: Place, problems: list[Fault]) -> Load:
    try:
        return others + load.load(place)
    except ValueError as error:
        if not any(problem.key.startswith(f"{key}.") for problem in problems):  # else it follows from what is reported
            wrong = _named(error, load, load.wrong_key)
            problems.append(_about(f"{key}.{wrong}", getattr(load, wrong), error, type(load)))
        return others


def _steps(time: Time, problems: list[Fault]) -> int | None:
    """Return how many steps there are, None where they are not given, or wrong."""
    span, end = time.t_end - time.t_start, Time.model_fields["t_end"].description
    if not 0 < span < math.inf:
        problems.append(Fault("time.t_end", f"{shown(time.t_end)} (t_start = {shown(time.t_start)})", f"{end}"))
    elif time.step is not None and is_too_short(span, time.step):
        given = f"{shown(time.step)} (that is {span / time.step:.3g} steps)"
        problems.append(Fault("time.step", given, f"a step for at most {MOST_STEPS:g} steps"))
    elif time.step is not None:
        error_key = "step"
        try:
            N = count_steps(span, time.step)
            error_key = "store"
            stored_count(N, time.store)
            return N
        except ValueError as error:
            problems.append(_about(f"time.{error_key}", getattr(time, error_key), error, Time))
    return None


def _tolerance(time: Time, scheme: Scheme | None) -> Iterator[Fault]:
    """Yield why the tolerance is not possible beside the step, or with the integrator."""
    if time.step is not None:
        yield Fault("time.tolerance", shown(time.tolerance), "left out beside step, or step left out")
    elif scheme is not None and scheme.any_times:
        yield Fault("time.tolerance", shown(time.tolerance), f"left out: {scheme.name} has no steps to choose")


def _times(time: Time, scheme: Scheme, folder: Folder, problems: list[Fault]) -> Array | None:
    """Return the output times, None where they are not given, or wrong."""
    try:
        times = time.output_times(folder)
        if times is None:
            return None
        return asked_times(scheme, times, time.t_start, time.t_end, time.step, time.store)
    except ValueError as error:
        problems.append(_about("time.times", time.times, error, Time))
    return None


def _event(key: str, event: EventSection, problems: list[Fault]) -> NamedEvent | None:
    try:
        return event.event()
    except ValueError as error:
        wrong = _named(error, event)
        problems.append(_about(f"{key}.{wrong}", getattr(event, wrong), error, type(event)))
        return None


def _scheme(integrator: Integrator, problems: list[Fault]) -> Scheme | None:
    kind: Any = INTEGRATORS[integrator.name]
    order, before = integrator.order, len(problems)
    if order is not None and not kind.orders:
        problems.append(Fault("integrator.order", shown(order), f"left out: {integrator.name} has no order"))
        order = None
    options, table = dict[str, Any](), options_of(kind)
    try:
        kind(**(options := table.model_validate(integrator.options).model_dump()))
    except ValidationError as error:
        problems += problems_of(error, integrator.options, table, ("integrator", "options"))
    except ValueError as error:
        problems.append(_about("integrator.options", integrator.options, error, Integrator))
        options = {}
    if order is not None:
        try:
            kind(order=order, **options)
        except ValueError as error:
            accepted = "one of " * (len(kind.orders) > 1) + ", ".join(map(str, kind.orders))
            problems.insert(before, Fault("integrator.order", f"{order} ({error})", accepted))
    return integrator.scheme() if len(problems) == before else None


def _named(error: ValueError, section: Section, other: str = "") -> str:
    """Return the key of a table with which a message begins, or another one."""
    first = str(error).partition(" ")[0]
    return first if first in type(section).model_fields else other


def _about(key: str, value: Any, error: ValueError, table: type[Section]) -> Fault:
    """Return the problem of a value of which nothing could be made."""
    given = "missing" if value is None else shown(value)
    return Fault(key, f"{given} ({error})", table.model_fields[key.split(".")[-1]].description or "")

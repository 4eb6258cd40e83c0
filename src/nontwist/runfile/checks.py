"""From the tables of a run file, each of the right form, to a problem.

Each table is made into keywords of `simulate`, and these are checked by the functions that `simulate` calls. A
ValueError on the way is reported with its place in the file; what is wrong is then left out, so that all is reported at
once.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from pydantic import ValidationError

from ..driver.planning import planned
from ..driver.prepared import Prepared
from ..driver.problem import Problem, prepared, problem_with
from ..driver.starts import start_of_one
from ..integrators import INTEGRATORS
from ..loads import Load
from ..models.catalogue import standard
from ..models.spin import as_spin
from ..models.system import DirectorSystem
from .body import Body, SpinTable
from .folder import Folder
from .loads import Place
from .section import Faults, Section, problems_of
from .sweep_table import table_problems
from .tables import Integrator, Start, Time, options_of
from .toml_data import Fault, shown


def posed(tables: dict[str, Any], folder: Folder, faults: Faults) -> tuple[Problem, Prepared] | None:
    """Return the problem of tables that are of the right form, and what is ready to run; None where that is wrong.

    Parameters
    ----------
    tables : dict
        Those of body, start, load and event (dicts of number to table), time, integrator, sweep that are of the right
        form.
    folder : Folder
        Where the run file lies.
    faults : Faults
        What is wrong is appended.
    """
    before = len(faults)
    body, start, time, integrator, sweep = map(tables.get, ("body", "start", "time", "integrator", "sweep"))
    system = None if body is None else _system(body, folder, faults)
    given = {} if start is None else _start(start, time, system, folder, faults)
    load, events = Load(), []
    lasts = time is not None and time.t_end > time.t_start
    place = Place(folder, time.t_start, time.t_end) if time is not None and lasts else Place(folder, 0.0, 1.0)
    for k, one in tables["load"].items():
        if lasts or not one.needs_times:
            with faults.of(f"load.{k}", one, one.error_key):
                load += one.load(place)
    given |= {} if integrator is None else _integrator(integrator, faults)
    if time is not None:
        given |= time.model_dump(exclude={"times"}, exclude_none=True)
        with faults.of("time", time, "times"):
            given |= {} if time.times is None else {"times": time.output_times(folder)}
    for k, one in tables["event"].items():
        with faults.of(f"event.{k}", one, "name"):
            events.append(one.event())
    if sweep is not None:
        table_problems(sweep, faults)
        if start is not None and start.run is not None:
            faults.append(Fault("start.run", shown(start.run), "left out: members of a sweep start from numbers"))
        if events:
            faults.append(Fault("event", f"{len(events)} tables", "left out: a sweep looks for no events"))
    reason = ""
    if system is not None and len(faults) == before and None not in (start, time, integrator):
        problem = problem_with(system, given | {"load": load} | ({"events": events} if events else {}))
        try:
            return problem, prepared(problem)
        except ValueError as error:
            reason = f"{len(load.terms)} tables ({error})"
    if time is not None:
        _locate(time, system, given, faults)
    if reason and len(faults) == before:
        faults.append(Fault("load", reason, "loads that go with the body and each other"))
    return None


def _system(body: Body, folder: Folder, faults: Faults) -> DirectorSystem | None:
    before = len(faults)
    faults += body.unfit()
    if isinstance(body.spin, SpinTable):
        with faults.of("body", body, "spin"):
            as_spin((body.spin.times, body.spin.values))
    if len(faults) == before:
        with faults.of("body", body, "inertia"):
            return folder.system(body)
    return None


def _start(
    start: Start, time: Time | None, system: DirectorSystem | None, folder: Folder, faults: Faults
) -> dict[str, Any]:
    """Return what `simulate` takes for the start."""
    form, run = start.rotation, start.run
    at: tuple[str, Section, str] = ("start.rotation", form, next(iter(type(form).model_fields)))
    name, accepted = "angular_velocity", ""
    if run is not None:
        at, name, accepted = ("start", start, "run"), "run", "a result file of a run of this body"
        for key in sorted({"rotation", "angular_velocity"} & start.model_fields_set):
            faults.append(Fault(f"start.{key}", "given", "left out beside start.run, which brings it"))
    given = dict[str, Any]()
    with faults.of(*at, accepted):
        given = {key: one for key, one in start.arguments(folder).items() if one is not None}
    if system is not None and given:
        t_start = None if run is not None or time is None else time.t_start
        with faults.of("start", start, name, accepted):
            begin = start_of_one(system, **given, t_start=t_start)
            if time is not None and begin.time not in (None, time.t_start):
                faults.append(Fault("time.t_start", shown(time.t_start), f"{begin.time!r}, the last time of {run}"))
    return given


def _integrator(integrator: Integrator, faults: Faults) -> dict[str, Any]:
    """Return what `simulate` takes for the integrator: its name where the order is open."""
    kind: Any = INTEGRATORS[integrator.name]
    before, order, table = len(faults), integrator.order, options_of(kind)
    given, options = dict[str, Any](), dict[str, Any]()
    try:
        given = table.model_validate(integrator.options).model_dump()
    except ValidationError as error:
        faults += problems_of(error, integrator.options, table, ("integrator", "options"))
    with faults.of("integrator", integrator, "options"):
        kind(**given)
        options = given
    if order is not None:
        known = ", ".join(map(str, kind.orders))
        accepted = "one of " * (len(kind.orders) > 1) + known if known else f"left out: {kind.name} has no order"
        with faults.of("integrator", integrator, "order", accepted):
            if not known:
                raise ValueError("there is none")
            kind(**(options := {"order": order, **options}))
    if len(faults) > before:
        return {}
    return {"integrator": kind(**options) if order is not None or integrator.options else kind.name}


STAND_INS = {"store": 1}  # of keys of [time] that are wrong; others are left out


def _locate(time: Time, system: DirectorSystem | None, given: dict[str, Any], faults: Faults) -> None:
    """Find the keys of [time] that make no plan; where one is wrong, those that are wrong without it as well."""
    how = {name: given[name] for name in ("integrator", "times", *Time.model_fields) if name in given}
    for _ in Time.model_fields:
        with faults.of("time", time, "t_end"):
            planned(system or standard(np.ones(3)), **how)
            return
        name = faults[-1].key.removeprefix("time.")
        if name in ("t_end", "t_start"):
            return
        how[name] = STAND_INS.get(name)

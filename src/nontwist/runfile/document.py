"""A run file as an object: all tables, checked, and the way to a run.

From the tables of a run file, each of the right form, to a problem.

Each table is made into keywords of `simulate`, and these are checked by the functions that `simulate` calls. A
ValueError on the way is reported with its place in the file; what is wrong is then left out, so that all is reported at
once.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Self, cast

import numpy as np
from pydantic import Field, PrivateAttr, TypeAdapter, ValidationError
from pydantic.json_schema import GenerateJsonSchema

from ..analysis.variables import require_no_wheels
from ..driver.planning import known_body, planned, require_observed
from ..driver.problem import Problem, prepared, problem_with
from ..driver.single_run import Forecast, Prepared
from ..driver.single_run import forecast as forecast_of
from ..driver.starts import starts
from ..errors import RunFileError
from ..geometry.values import as_list, as_path
from ..geometry.values import short_repr as in_python
from ..integrators import DEFAULT, INTEGRATORS
from ..io.whole import require_regular
from ..loads import Load
from ..models.bodies import standard
from ..models.spin import as_spin
from ..models.system import DirectorSystem
from ..spec import Spec
from ..units import in_datasets
from .basic_tables import AnyEvent, Integrator, Output, Start, Time, options_of
from .body import AnyBody, Body, SpinTable
from .files import LARGEST, Fault, Folder, Keys, document, overridden, parsed, shown, toml_text
from .load_tables import AnyLoad, LoadSection
from .section import MOST_PROBLEMS, Faults, Section, entry, found_in, problems_of
from .sweep_table import Sweep, key_problems, step_problems, table_problems


def posed(file: Any, faults: Faults) -> tuple[Problem, Prepared] | None:
    """Return the problem of a run file, and what is ready to run; None where that is wrong, and `faults` say why.

    Of the file tables, and entries of lists, may be None that are not of the right form.
    """
    before, folder, time, loads = len(faults), file._folder, file.time, _entries(file.load)
    system = None if file.body is None else _system(file.body, folder, faults)
    given = {} if file.start is None else _start(file.start, time, system, folder, faults)
    load, events = Load(), []
    for k, one in loads:
        with faults.of(f"load.{k}", one, one.error_key):
            load += one.load(folder)
    given |= {} if file.integrator is None else _integrator(file.integrator, faults)
    if time is not None:
        given |= time.model_dump(exclude={"times"}, exclude_none=True)
        with faults.of("time", time, "times"):
            given |= {} if time.times is None else {"times": time.output_times(folder)}
    for k, one in _entries(file.event):
        with faults.of(f"event.{k}", one, "name"):
            events.append(one.event())
    if file.sweep is not None:
        table_problems(file.sweep, faults)
    reason: Fault | None = None
    if system is not None and len(faults) == before and None not in (file.start, time, file.integrator):
        problem = problem_with(system, given | {"load": load} | ({"events": events} if events else {}), file)
        try:
            return problem, prepared(problem)
        except ValueError as error:
            reason = misfit(len(loads), error)
            with suppress(ValueError):
                prepared(problem.replace(integrator=DEFAULT, order=None))
                reason = Fault("integrator.name", f"{shown(file.integrator.name)} ({error})", CAPABLE)
    if time is not None:
        _locate(time, system, given, faults)
    if reason and len(faults) == before:
        faults.append(reason)
    return None


def _entries(tables: list[Any]) -> list[tuple[int, Any]]:
    return [(k, one) for k, one in enumerate(tables) if one is not None]


def misfit(loads: int, reason: object) -> Fault:
    """Return the fault of tables of loads that act together."""
    return Fault("load", f"{loads} tables ({reason})", "loads that go with the body and each other")


def _system(body: Body, folder: Folder, faults: Faults) -> DirectorSystem | None:
    before = len(faults)
    faults += body.unfit()
    if isinstance(body.spin, SpinTable):
        with faults.of("body", body, "spin"):
            as_spin((body.spin.times, body.spin.values))
    if len(faults) == before:
        with faults.of("body", body, body.error_key):
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
            begin = starts(system, **given, t_start=t_start)
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
        faults += problems_of(error, ("integrator", "options"))
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


def _locate(time: Time, system: DirectorSystem | None, given: dict[str, Any], faults: Faults) -> None:
    """Find the first key of [time] that makes no plan."""
    how = {name: given[name] for name in ("integrator", "times", *Time.model_fields) if name in given}
    with faults.of("time", time, "t_end"):
        planned(system or standard(np.ones(3)), **how)


MOST_LOADS, MOST_EVENTS = 1000, 100


class RunFile(Section):
    """A run as described by a file; returned by `nontwist.runfile.read_run_file`.

    Attributes
    ----------
    title : str or None
    body, start, load, time, integrator, event, output, sweep
        The tables of the file with defaults filled in; `sweep` is None if there is no such table.
    """

    is_whole = True
    title: Annotated[str, Field(max_length=200, pattern=r"^[^\x00-\x1f\x7f-\x9f]*$")] | None = entry(
        "a line of text in quotes, at most 200 characters", None
    )
    body: AnyBody = entry("a table [body]")
    start: Start = entry("a table [start]", Start())
    load: list[AnyLoad] = entry(f"tables [[load]], in double brackets, at most {MOST_LOADS}", [], max_length=MOST_LOADS)
    time: Time = entry("a table [time]")
    integrator: Integrator = entry("a table [integrator]", Integrator())
    event: list[AnyEvent] = entry(
        f"tables [[event]], in double brackets, at most {MOST_EVENTS}", [], max_length=MOST_EVENTS
    )
    output: Output = entry("a table [output]", Output())
    sweep: Sweep | None = entry("a table [sweep]: many runs, each with numbers of its own, for nontwist sweep", None)
    _folder: Folder = PrivateAttr(default_factory=lambda: Folder(Path()))

    def __copy__(self) -> Self:
        copied = super().__copy__()
        for made in ("prepared", "problem"):  # `model_copy` changes tables
            vars(copied).pop(made, None)
        return copied

    def __reduce__(self) -> tuple[Any, ...]:
        return file_of_text, ("the run file", self.text(), self.folder)  # tables of loads are made as they are read

    @property
    def folder(self) -> Path:
        """Folder of the file, to which paths in the file are relative."""
        return self._folder.path

    @cached_property
    def problem(self) -> Problem:
        """The problem that the file describes; a RunFileError lists all problems of tables that define none."""
        faults = Faults()
        made = posed(self, faults)
        if made is None:
            raise RunFileError("the run file", tuple(faults))
        return made[0]

    @cached_property
    def prepared(self) -> Prepared:
        """The problem made ready to run, once."""
        return prepared(self.problem)

    def record(self) -> dict[str, Any]:
        """Return attributes that record how a run was made: `run_file`, the file with all defaults, and its hash.

        Of a body that weighs also `mass`, kg, and `centre_of_mass`, m, which are those of its shape if it has one.
        """
        text, weight = self.text(sweep=False), self.body.weight(self._folder)
        title = {} if self.title is None else {"title": self.title}
        heavy = {} if weight is None else {"mass": float(weight[0]), "centre_of_mass": weight[1].tolist()}
        return {**title, **heavy, "run_file": text, "run_file_sha256": hashlib.sha256(text.encode()).hexdigest()}

    def text(self, *, sweep: bool = True) -> str:
        """Return the run file with all defaults filled in and the hashes of its CSV files, as TOML.

        Options of the integrator are left out where there are none.

        Parameters
        ----------
        sweep : bool
            Include the table [sweep].

        Returns
        -------
        str

        Raises
        ------
        ValueError
            `sweep` is neither true nor false.
        """
        data = self.model_dump(exclude_none=True, exclude=None if sweep else {"sweep"})
        for one, table in zip(self.load, data["load"], strict=True):
            table |= one.recorded(self._folder)
        data["start"] = self.start.recorded(data["start"], self._folder)
        data["time"] |= self.time.recorded(self._folder)
        if not self.integrator.options:
            del data["integrator"]["options"]
        return toml_text(data)


def with_loads(file: RunFile, loads: list[LoadSection]) -> RunFile:
    """Return a copy with other loads, all else as it was prepared; a ValueError where their numbers make none."""
    copied, plan = file.model_copy(update={"load": loads}), file.prepared.plan
    load = sum((one.load(file._folder) for one in loads), Load())
    vars(copied)["prepared"] = replace(file.prepared, plan=plan._replace(load=known_body(load, plan.systems)))
    return copied


# `read_run_file`: bytes, plain data, tables, checks; all problems are reported at once.


def read_run_file(path: str | os.PathLike[str], overrides: Iterable[str] = ()) -> RunFile:
    """Read and check a run file without running it; parameters and errors as `nontwist.Problem.read`."""
    path, texts = as_path(path, "path"), as_list(overrides, "set")
    if wrong := [text for text in texts if not isinstance(text, str)]:
        raise ValueError(f"set must be strings 'key=value', got {in_python(wrong[0])}")
    require_regular(path)
    with path.open("rb") as file:
        data = document(str(path), file.read(LARGEST + 1), path.stat().st_size)
    return checked(str(path), overridden(str(path), data, texts), Folder(path.parent))


def file_of_text(name: str, text: str, folder: Path) -> RunFile:
    """Return the run file of a text made by `RunFile.text`; the files that it names are in `folder`."""
    return checked(name, parsed(name, text), Folder(folder))


def checked(name: str, data: dict[str, Any], folder: Folder) -> RunFile:
    """Return plain data as a run file; a RunFileError names all that is wrong."""
    faults, further, whole = Faults(), Faults(), None
    try:
        file = whole = RunFile.model_validate(data)
    except ValidationError as error:
        file = _standing(data, [one.path for one in found_in(error)])
        faults += problems_of(error)
    file._folder = folder
    made, sweep = posed(file, further), file.sweep
    ready = None if made is None else made[1]
    if data.get("sweep") is not None and None not in (file.time, file.integrator):
        further += step_problems(file.time.step, INTEGRATORS[file.integrator.name], ready)
    if sweep is not None and all(fault.key.partition(".")[0] == "sweep" for fault in faults):
        whole = whole or RunFile.model_validate({key: one for key, one in data.items() if key != "sweep"})
        further += key_problems(sweep, whole.model_dump(exclude_none=True))
    if ready is not None and sweep is not None:
        with further.of("sweep", sweep, "variables"):
            if not ready.plan.load.wheels and all(fault.key.partition(".")[0] != "load" for fault in faults):
                require_no_wheels(sweep.variables)
        with further.of("sweep", sweep, "reduce"):
            if sweep.reduce:
                require_observed(ready.plan.scheme, ready.plan.load)
    if ready is not None and not further:
        with further.of("time", file.time, "step" if file.time.tolerance is None else "tolerance"):
            _ = ready.states
    named = {fault.key for fault in faults}
    faults += (fault for fault in further if fault.key not in named)
    if len(faults) >= MOST_PROBLEMS:
        more = Fault("the file", f"at least {MOST_PROBLEMS} problems", "none; the first are listed")
        faults[MOST_PROBLEMS - 1 :] = [more]
    if made is None or faults:
        raise RunFileError(name, tuple(faults))
    vars(file).update(problem=made[0], prepared=ready)
    return file


def _standing(data: dict[str, Any], wrong: list[Keys]) -> Any:
    """Return the file once wrong keys are left out; tables that are still not of the right form are None."""
    lists: dict[str, Any] = {"load": TypeAdapter(AnyLoad), "event": TypeAdapter(AnyEvent)}
    tables = dict[str, Any]()
    for key, field in RunFile.model_fields.items():
        value, form = data.get(key, {}), cast(Any, AnyBody if key == "body" else field.annotation)
        if key in lists:
            entries = enumerate(value if isinstance(value, list) else [])
            tables[key] = [_stands(lists[key], one, (key, k), wrong) for k, one in entries]
        else:
            tables[key] = _stands(TypeAdapter(form), value, (key,), wrong)
    return RunFile.model_construct(**tables)


def _stands(form: TypeAdapter[Any], value: Any, at: Keys, wrong: list[Keys]) -> Any:
    """Return a table, or None; the other keys of an integrator belong to its name, if that is wrong."""
    keys = {path[len(at)] for path in wrong if path[: len(at)] == at and len(path) > len(at)}
    with suppress(ValidationError):
        if isinstance(value, dict) and "name" not in keys and len(keys) < MOST_PROBLEMS:
            return form.validate_python({key: one for key, one in value.items() if key not in keys})
    return None


# What a run file will be like, in the words of its keys.


CAPABLE = f"an integrator that can: {DEFAULT} takes every body and load"


def forecast(run_file: RunFile) -> Forecast:
    """Return what a run will be like; nothing is run."""
    sweep = run_file.sweep
    swept = None if sweep is None else (sweep.members, sweep.ensembles(run_file.load), "extrema" in sweep.reduce)
    coming = forecast_of(run_file.prepared, swept)
    keys = {
        "integrator": ("integrator.name", run_file.integrator.name, CAPABLE),
        "store": ("time.store", run_file.time.store, Time.model_fields["store"].description or ""),
    }
    problems = []
    for name, reason in coming.problems:
        if name == "load":
            problems.append(misfit(len(run_file.load), reason))
            continue
        key, value, accepted = keys[name]
        problems.append(Fault(key, f"{shown(value)} ({reason})", accepted))
    loads = tuple(one.in_words(run_file._folder) for one in run_file.load)
    return coming._replace(loads=loads, problems=tuple(problems))


# The JSON Schema of run files, made from the tables themselves; committed as docs/runfile.schema.json.


class _Schema(GenerateJsonSchema):
    """TOML has no null, so neither has the schema: such keys are left out."""

    def nullable_schema(self, schema: Any) -> dict[str, Any]:
        return self.generate_inner(schema["schema"])

    def default_schema(self, schema: Any) -> dict[str, Any]:
        return (
            self.generate_inner(schema["schema"]) if schema.get("default") is None else super().default_schema(schema)
        )

    def encode_default(self, dft: Any) -> Any:
        found = super().encode_default(dft)
        return {key: one for key, one in found.items() if one is not None} if isinstance(found, dict) else found


def json_schema() -> dict[str, Any]:
    """Return the schema (draft 2020-12)."""
    schema = RunFile.model_json_schema(schema_generator=_Schema)
    own = {"title": "nontwist run file", "description": "A run as a file describes it."}
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema, **own}


# Units of the numbers of a run file.


DEGREES = {"deg": "degree", "degrees": "degree", "radians": "rad"}


def unit_of(file: RunFile, key: str) -> str | None:
    """Return the unit of the numbers under a dotted key, as ``load.0.frequency``; None where they have none."""
    value, unit = file, ""
    for part in key.split("."):
        if isinstance(value, list) and part.isdecimal() and int(part) < len(value):
            value = value[int(part)]
        elif isinstance(value, Section) and part in type(value).model_fields:
            described = [one for one in type(value).model_fields[part].metadata if isinstance(one, Spec)]
            unit = getattr(value, "unit", "") or next((one.unit for one in described), "")
            value = getattr(value, part)
    return DEGREES.get(unit, in_datasets(unit)) or None

"""A run file as an object: all tables, checked, and the way to a run."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Iterable
from dataclasses import replace
from functools import cache, cached_property
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Self

from pydantic import Field, PrivateAttr, TypeAdapter, ValidationError

from ..driver import simulate
from ..driver.planning import known_body
from ..driver.prepared import Forecast, Prepared
from ..driver.prepared import forecast as forecast_of
from ..driver.problem import Problem, problem_with
from ..errors import RunFileError
from ..geometry.values import as_list, as_path
from ..geometry.values import shown as in_python
from ..integrators import DEFAULT, INTEGRATORS
from ..io.whole import require_regular
from ..loads import Load
from ..units import RATE, in_datasets
from .body import Body
from .checks import prepare
from .folder import Folder
from .loads import AnyLoad, LoadSection, Place
from .section import Fault, Keys, Section, path_in, problems_of, shown, toml_text
from .sweep_table import Sweep, key_problems, step_problems
from .tables import AnyEvent, Integrator, Output, Start, Time
from .toml_data import LARGEST, document, overridden, parsed

if TYPE_CHECKING:
    import xarray

MOST_LOADS, MOST_EVENTS = 1000, 100


class RunFile(Section):
    """A run as described by a file; returned by `nontwist.runfile.read_run_file`.

    Attributes
    ----------
    title : str or None
    body, start, load, time, integrator, event, output, sweep
        The tables of the file with defaults filled in; `sweep` is None if there is no such table.
    """

    title: Annotated[str, Field(max_length=200, pattern=r"^[^\x00-\x1f\x7f-\x9f]*$")] | None = Field(
        default=None, description="a line of text in quotes, at most 200 characters"
    )
    body: Body = Field(description="a table [body]")
    start: Start = Field(default=Start(), description="a table [start]")
    load: Annotated[list[AnyLoad], Field(max_length=MOST_LOADS)] = Field(
        default=[], description=f"tables [[load]], in double brackets, at most {MOST_LOADS}"
    )
    time: Time = Field(description="a table [time]")
    integrator: Integrator = Field(default=Integrator(), description="a table [integrator]")
    event: Annotated[list[AnyEvent], Field(max_length=MOST_EVENTS)] = Field(
        default=[], description=f"tables [[event]], in double brackets, at most {MOST_EVENTS}"
    )
    output: Output = Field(default=Output(), description="a table [output]")
    sweep: Sweep | None = Field(
        default=None, description="a table [sweep]: many runs, each with numbers of its own, for nontwist sweep"
    )
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
    def prepared(self) -> Prepared:
        """The objects that a run needs, made once; a RunFileError lists all problems of tables that define no run."""
        problems: list[Fault] = []
        tables = {key: getattr(self, key) for key in RunFile.model_fields}
        many = {"load": dict(enumerate(self.load)), "event": dict(enumerate(self.event))}
        made = prepare(tables | many, self._folder, problems)
        if made is None:
            raise RunFileError("the run file", tuple(problems))
        return made

    @property
    def has_lasting_loads(self) -> bool:
        """Whether a load begins or ends with the run, where the file does not say when."""
        return any(one.is_lasting for one in self.load)

    @cached_property
    def problem(self) -> Problem:
        """The problem that the file describes."""
        plan, system = self.prepared.plan, self._folder.system(self.body)
        integrator = plan.scheme.name if plan.is_controlled and len(plan.schemes) > 1 else plan.scheme
        time = self.time.model_dump(exclude={"times"}) | ({} if plan.asked is None else {"times": plan.asked})
        events = {"events": [one.event() for one in self.event]} if self.event else {}
        given = {"load": plan.load, "integrator": integrator, **self.start.arguments(self._folder), **time, **events}
        return problem_with(system, {key: value for key, value in given.items() if value is not None}, self)

    def simulate(self, *, progress: bool = False, **changes: Any) -> xarray.Dataset:
        """Run the problem of the file, with changes, recorded as the file; errors as `nontwist.simulate`."""
        return simulate(self.problem, **changes, progress=progress).assign_attrs(self.record())

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
    place = Place(file._folder, plan.t_start, plan.t_end)
    load = sum((one.load(place) for one in loads), Load())
    vars(copied)["prepared"] = replace(file.prepared, plan=plan._replace(load=known_body(load, plan.systems)))
    return copied


# `read_run_file`: bytes, plain data, tables, checks; all problems are reported at once.


MOST_PROBLEMS = 100  # that are reported


def read_run_file(path: str | os.PathLike[str], overrides: Iterable[str] = ()) -> RunFile:
    """Read and check a run file without running it; parameters and errors as `nontwist.Problem.read`."""
    path, texts = as_path(path, "path"), as_list(overrides, "overrides")
    if wrong := [text for text in texts if not isinstance(text, str)]:
        raise ValueError(f"overrides must be strings 'key=value', got {in_python(wrong[0])}")
    require_regular(path)
    with path.open("rb") as file:
        data = document(str(path), file.read(LARGEST + 1), path.stat().st_size)
    return checked(str(path), overridden(str(path), data, texts), Folder(path.parent))


def file_of_text(name: str, text: str, folder: Path) -> RunFile:
    """Return the run file of a text made by `RunFile.text`; the files that it names are in `folder`."""
    return checked(name, parsed(name, text), Folder(folder))


def checked(name: str, data: dict[str, Any], folder: Folder) -> RunFile:
    """Return plain data as a run file; a RunFileError names all that is wrong."""
    try:
        run_file = RunFile.model_validate(data)
    except ValidationError as error:
        problems = list(islice(problems_of(error, data, RunFile), MOST_PROBLEMS))
        named, further = {problem.key for problem in problems}, list[Fault]()
        if len(named) < MOST_PROBLEMS:
            wrong = [path_in(data, one["loc"]) for one in error.errors()]
            tables = _valid_tables(data, wrong)
            prepared = prepare(tables, folder, further)
            if data.get("sweep") is not None and (time := tables.get("time")) and (scheme := tables.get("integrator")):
                further += step_problems(time.step, INTEGRATORS[scheme.name], prepared)
        problems += [problem for problem in further if problem.key not in named]
        raise RunFileError(name, _first(problems)) from error
    run_file._folder, problems = folder, []
    prepared = None
    try:
        prepared = run_file.prepared
    except RunFileError as error:
        problems += error.problems
    if run_file.sweep is not None and not any(problem.key.startswith("sweep") for problem in problems):
        problems += key_problems(run_file.sweep, run_file.model_dump(exclude_none=True), prepared)
    if problems:
        raise RunFileError(name, _first(problems))
    try:
        _ = run_file.prepared.states
    except ValueError as error:
        tolerance = run_file.time.tolerance
        key, given = ("step", "missing") if tolerance is None else ("tolerance", shown(tolerance))
        accepted = Time.model_fields[key].description or ""
        raise RunFileError(name, (Fault(f"time.{key}", f"{given} ({error})", accepted),)) from error
    return run_file


def _first(problems: list[Fault]) -> tuple[Fault, ...]:
    """Return the first problems; where there are many, that these are not all."""
    if len(problems) < MOST_PROBLEMS:
        return tuple(problems)
    more = Fault("the file", f"at least {MOST_PROBLEMS} problems", "none; the first are listed")
    return (*problems[: MOST_PROBLEMS - 1], more)


def _valid_tables(data: dict[str, Any], wrong: list[Keys]) -> dict[str, Any]:
    """Return the tables that are of the right form once the keys at `wrong` are left out; loads by their number."""
    tables = {key: data.get(key, {}) for key in ("body", "start", "time", "integrator", "sweep")}
    loads = data.get("load", [])
    entries = dict(enumerate(loads)) if isinstance(loads, list) else {}
    for place in wrong:
        if place[:2] == ("integrator", "name"):  # order and options belong to it
            tables["integrator"] = None
        elif place[:1] == ("load",):
            entries = _without(entries, place[1:3])
        else:
            tables = _without(tables, place[:2])
    parts = {key: _valid(key, value) for key, value in tables.items()}
    load = {k: one for k, value in entries.items() if (one := _valid("load", value)) is not None}
    return {key: part for key, part in parts.items() if part is not None} | {"load": load}


def _without(tables: dict[Any, Any], place: Keys) -> dict[Any, Any]:
    if len(place) == 2 and isinstance(tables.get(place[0]), dict):
        rest = {key: value for key, value in tables[place[0]].items() if key != place[1]}
        return tables | {place[0]: rest}
    return tables


def _valid(key: str, value: Any) -> Any:
    try:
        return _adapter(key).validate_python(value)
    except ValidationError:
        return None


@cache
def _adapter(key: str) -> TypeAdapter[Any]:
    form: Any = AnyLoad if key == "load" else RunFile.model_fields[key].annotation
    return TypeAdapter(form)


# What a run file will be like, in the words of its keys.


CAPABLE = f"an integrator that can: {DEFAULT} takes every body and load"


def forecast(run_file: RunFile) -> Forecast:
    """Return what a run will be like; nothing is run."""
    coming = forecast_of(run_file.prepared, None if run_file.sweep is None else run_file.sweep.members)
    keys = {
        "integrator": ("integrator.name", run_file.integrator.name, CAPABLE),
        "store": ("time.store", run_file.time.store, Time.model_fields["store"].description or ""),
    }
    problems = []
    for name, reason in coming.problems:
        key, value, accepted = keys[name]
        problems.append(Fault(key, f"{shown(value)} ({reason})", accepted))
    loads = tuple(one.in_words(run_file._folder) for one in run_file.load)
    return coming._replace(loads=loads, problems=tuple(problems))


# The JSON Schema of run files, made from the tables themselves; committed as docs/runfile.schema.json.


Schema = dict[str, Any]


def json_schema() -> Schema:
    """Return the schema (draft 2020-12). TOML has no null, so neither has the schema: such keys are left out."""
    schema: Schema = _without_null(RunFile.model_json_schema())
    own = {"title": "nontwist run file", "description": "A run as a file describes it."}
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema, **own}


def _without_null(schema: Any) -> Any:
    if isinstance(schema, list):
        return [_without_null(part) for part in schema]
    if not isinstance(schema, dict):
        return schema
    kept = {key: _without_null(part) for key, part in schema.items() if part is not None}
    if {"type": "null"} in (forms := kept.get("anyOf", [])):
        forms = [form for form in forms if form != {"type": "null"}]
        rest = {key: part for key, part in kept.items() if key != "anyOf"}
        return {**forms[0], **rest} if len(forms) == 1 else {"anyOf": forms, **rest}
    return kept


# Units of the numbers of a run file, from the descriptions of their keys.


UNITS = ("kg m² s⁻¹", "kg m²", "N m s", "N m", "N/m", "rad/s", "m/s²", "Hz", "rad", "kg/m³", "kg", "m", "s")
UNIT = re.compile(rf"(?:^|, )({'|'.join(map(re.escape, UNITS))})(?=[:;,]|$)")


def unit_of(file: RunFile, key: str) -> str | None:
    """Return the unit of the numbers under a dotted key, as ``load.0.frequency``; None if it is not one of these."""
    value, text = file, ""
    for part in key.split("."):
        if isinstance(value, list) and part.isdecimal() and int(part) < len(value):
            value = value[int(part)]
        elif isinstance(value, Section) and part in type(value).model_fields:
            if (unit := getattr(value, "unit", None)) in RATE:
                return in_datasets(unit)
            text = type(value).model_fields[part].description or text
            value = getattr(value, part)
    found = UNIT.search(text)
    return in_datasets(found[1]) if found else None

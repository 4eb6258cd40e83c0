"""`read_run_file`: bytes, plain data, tables, checks; all problems are reported at once."""

from __future__ import annotations

import os
from collections.abc import Iterable
from functools import cache
from itertools import islice
from typing import Any

from pydantic import TypeAdapter, ValidationError

from ..errors import RunFileError
from ..geometry.values import as_list, as_path, shown
from ..integrators import INTEGRATORS
from ..io.regular import require_regular
from .checks import prepare
from .document import RunFile
from .folder import Folder
from .loads import AnyLoad
from .problems import Keys, Problem, path_in, problems_of
from .sweep_checks import key_problems, step_problems
from .tables import Time
from .toml_data import LARGEST, document, overridden

MOST_PROBLEMS = 100  # that are reported


def read_run_file(path: str | os.PathLike[str], overrides: Iterable[str] = ()) -> RunFile:
    """Read and check a run file without running it.

    Parameters
    ----------
    path : path
        A TOML file; see the page of run files, or ``nontwist example``.
    overrides : iterable of str
        Values to set, as "key=value" with the value in TOML: ``"body.mass=2.5"``, ``"load.0.amplitude=[0, 0, 1]"``;
        ``"key="`` removes a key. A step replaces the tolerance of the file, and the other way round.

    Returns
    -------
    RunFile

    Raises
    ------
    RunFileError
        A ValueError with one line for each problem: "file: key: what was given -> what is accepted".
    ValueError
        `path` is not a path, or overrides are not strings.
    OSError
        The file cannot be read; it is a FIFO or a device.

    Examples
    --------
    >>> from pathlib import Path
    >>> from nontwist.runfile import read_run_file
    >>> text = '''
    ... body = { kind = "nontwisting", inertia = [3, 4, 5] }
    ... start.angular_velocity.body = [6, -18, 0]
    ... time.t_end = 1
    ... '''
    >>> _ = Path("run.toml").write_text(text)
    >>> run_file = read_run_file("run.toml", ["time.t_end=2"])
    >>> run_file.time.t_end
    2.0
    >>> run_file.problem.system.name
    'nontwisting'
    """
    path, texts = as_path(path, "path"), as_list(overrides, "overrides")
    if wrong := [text for text in texts if not isinstance(text, str)]:
        raise ValueError(f"overrides must be strings 'key=value', got {shown(wrong[0])}")
    require_regular(path)
    with path.open("rb") as file:
        data = document(str(path), file.read(LARGEST + 1), path.stat().st_size)
    return checked(str(path), overridden(str(path), data, texts), Folder(path.parent))


def checked(name: str, data: dict[str, Any], folder: Folder) -> RunFile:
    """Return plain data as a run file; a RunFileError names all that is wrong."""
    try:
        run_file = RunFile.model_validate(data)
    except ValidationError as error:
        problems = list(islice(problems_of(error, data, RunFile), MOST_PROBLEMS))
        named, further = {problem.key for problem in problems}, list[Problem]()
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
        raise RunFileError(name, (Problem(f"time.{key}", f"{given} ({error})", accepted),)) from error
    return run_file


def _first(problems: list[Problem]) -> tuple[Problem, ...]:
    """Return the first problems; where there are many, that these are not all."""
    if len(problems) < MOST_PROBLEMS:
        return tuple(problems)
    more = Problem("the file", f"at least {MOST_PROBLEMS} problems", "none; the first are listed")
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

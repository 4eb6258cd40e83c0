"""A run file as an object: all tables, checked, and the way to a run."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Self

from pydantic import Field, PrivateAttr

from ..driver import simulate
from ..driver.planning import known_body
from ..driver.prepared import Prepared
from ..driver.problem import Problem, problem_with
from ..driver.runs import dataset_of
from ..errors import RunFileError
from ..loads import Load
from .body import Body
from .checks import prepare
from .events import AnyEvent
from .folder import Folder
from .loads import AnyLoad, LoadSection, Place
from .problems import Problem as KeyProblem
from .section import Section
from .start import Start
from .sweep_table import Sweep
from .tables import Integrator, Output, Time
from .toml_text import toml_text

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

    @property
    def folder(self) -> Path:
        """Folder of the file, to which paths in the file are relative."""
        return self._folder.path

    @cached_property
    def prepared(self) -> Prepared:
        """The objects that a run needs, made once; a RunFileError lists all problems of tables that define no run."""
        problems: list[KeyProblem] = []
        tables = {key: getattr(self, key) for key in RunFile.model_fields}
        many = {"load": dict(enumerate(self.load)), "event": dict(enumerate(self.event))}
        made = prepare(tables | many, self._folder, problems)
        if made is None:
            raise RunFileError("the run file", tuple(problems))
        return made

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
        """Run the file.

        Parameters
        ----------
        progress : bool
            Show a progress bar on stderr.
        **changes
            Arguments of `nontwist.simulate` that replace those of the file.

        Returns
        -------
        Dataset
            As returned by `nontwist.simulate`, with `record` among its attributes. A table [sweep] is ignored.

        Raises
        ------
        ValueError, SimulationError
            As `nontwist.simulate`.

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
        >>> run = read_run_file("run.toml").simulate(integrator="exact")
        >>> run.material_momentum.values[-1, :2].round(9)
        array([ 18., -72.])
        """
        if changes:
            run = simulate(self.problem, **changes, progress=progress)
        else:
            run = dataset_of(self.prepared.run(progress))
        return run.assign_attrs(self.record())

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

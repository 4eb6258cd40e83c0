"""A run file as an object: all tables, checked, and the way to a run."""

from __future__ import annotations

import hashlib
from dataclasses import MISSING, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_type_hints

from pydantic import Field, PrivateAttr, create_model

from ..driver import simulate
from ..integrators import INTEGRATORS, LieMidpoint
from ..integrators import Integrator as Scheme
from ..loads import Load
from .body import Body
from .folder import Folder
from .loads import AnyLoad, Place
from .section import Listed, Positive, Section
from .start import Start
from .sweep_table import Sweep
from .toml_text import toml_text

if TYPE_CHECKING:
    import xarray

MOST_LOADS = 1000


class Time(Section):
    """From when to when, in which steps."""

    t_end: float = Field(description="a number after t_start, s")
    t_start: float = Field(default=0.0, description="a number, s")
    step: Positive | None = Field(
        default=None, description="a positive number that divides the span, s; left out: at most 0.05 rad a step"
    )
    store: Annotated[int, Field(ge=1)] | Literal["end"] = Field(
        default=1, description='a whole number of steps >= 1, or "end" for the first and the last state only'
    )


class Integrator(Section):
    """The integrator, its order and its own options."""

    name: Annotated[str, Listed(INTEGRATORS, ", ")] = LieMidpoint.name
    order: int | None = Field(default=None, description="a whole number: an order that the integrator has")
    options: dict[str, Any] = Field(default={}, description="a table of the integrator's own options")

    def scheme(self) -> Scheme:
        """Return the integrator; a ValueError where it has no such order or option."""
        order = {} if self.order is None else {"order": self.order}
        return INTEGRATORS[self.name](**order, **self.options)


class Output(Section):
    """Where the result goes."""

    path: Annotated[str, Field(pattern=r"^[^\x00]+\.nc$")] | None = Field(
        default=None, description='a file name with the ending ".nc", like result.nc, relative to the run file'
    )
    figures: list[Literal["momenta", "energy", "path"]] = Field(
        default=[], description='a list of "momenta", "energy", "path": figures drawn beside the result'
    )


class RunFile(Section):
    """A run as a file describes it; made by `nontwist.read_run_file`.

    Attributes
    ----------
    title : str or None
    body, start, load, time, integrator, output, sweep
        The tables of the file, defaults filled in; `sweep` is None where there is none.
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
    output: Output = Field(default=Output(), description="a table [output]")
    sweep: Sweep | None = Field(
        default=None, description="a table [sweep]: many runs, each with numbers of its own, for nontwist sweep"
    )
    _folder: Folder = PrivateAttr(default_factory=lambda: Folder(Path()))

    @property
    def place(self) -> Place:
        """What the loads need to know."""
        return Place(self._folder, self.time.t_start, self.time.t_end)

    @property
    def folder(self) -> Path:
        """Where the file lies; its paths are relative to it."""
        return self._folder.path

    def arguments(self) -> dict[str, Any]:
        """Return what `nontwist.simulate` takes: ``simulate(**run_file.arguments())``."""
        load = Load()
        for one in self.load:
            load = load + one.load(self.place)
        time = self.time.model_dump()
        system, scheme = self._folder.system(self.body), self.integrator.scheme()
        return {"system": system, "load": load, "integrator": scheme, **self.start.arguments(), **time}

    def simulate(self, *, progress: bool = False, **changes: Any) -> xarray.Dataset:
        """Run it.

        Parameters
        ----------
        progress : bool
            Show a bar on stderr.
        **changes
            Arguments of `nontwist.simulate` that take the place of those of the file.

        Returns
        -------
        Dataset
            As `nontwist.simulate` returns it; `record` is among its attributes. A table [sweep] is left aside.

        Raises
        ------
        ValueError, SimulationError
            As `nontwist.simulate`.

        Examples
        --------
        >>> from pathlib import Path
        >>> from nontwist import read_run_file
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
        arguments = {**self.arguments(), **changes}
        return simulate(arguments.pop("system"), progress=progress, **arguments).assign_attrs(self.record())

    def record(self) -> dict[str, str]:
        """Return the attributes that say how a run was made: `run_file`, the file with all defaults, and its hash."""
        text = self.text(sweep=False)
        title = {} if self.title is None else {"title": self.title}
        return {**title, "run_file": text, "run_file_sha256": hashlib.sha256(text.encode()).hexdigest()}

    def text(self, *, sweep: bool = True) -> str:
        """Return the run file with all defaults filled in and the hashes of its CSV files, as TOML.

        Parameters
        ----------
        sweep : bool
            With the table [sweep].

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
        return toml_text(data)


def options_of(name: str) -> type[Section]:
    """Return the table of the options of an integrator, `order` left out."""
    scheme = INTEGRATORS[name]
    hints = get_type_hints(scheme)
    own: dict[str, Any] = {
        f.name: (hints[f.name], ... if f.default is MISSING else f.default) for f in fields(scheme) if f.name != "order"
    }
    return create_model("Options", __base__=Section, **own)

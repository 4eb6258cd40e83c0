"""Errors: of inputs, with a code, facts and a sentence that names options as they are typed; of runs, files, sweeps.

`SENTENCES` has a template for each code, to which the rooms of the package add theirs. ``{option[body]}`` is the option
`body`, in Python ``body=``, in a shell ``--body``; ``{option[rate=50]}`` one with its value. A field of the type
`Option` is an option as well. Tests and programs read `code` and `fields`.
"""

from __future__ import annotations

import sys
import warnings
from enum import IntEnum
from functools import partial
from typing import Any

__all__ = [
    "InputError",
    "InputWarning",
    "ResultFileError",
    "RunFileError",
    "SimulationError",
    "SimulationInterrupt",
    "Status",
    "SweepError",
    "SweepStoreError",
]


def __dir__() -> list[str]:
    return __all__


SENTENCES = {
    "type": "{name} must be {words}, got {value}",
    "euler": "{option[euler]} requires 3 axes, neighbours unlike: ZYX about moving, zyx fixed axes; got {letters!r}",
    "gimbal-lock": "{letters} is in gimbal lock at {count} states, the first at {along} = {first}: the rates of its "
    "first and third angle are infinite there; another {option[euler]} avoids it",
    "option-without-effect": "{name} has no effect, as {why}; omit it",
    "exists": "{path} exists; choose another name, or overwrite it: {option[force=True]}",
}


class Option(str):
    """The name of an option, among the fields of an error."""


SHELL = {  # options whose words on a command line do not follow from those in Python
    "scalar_first=False": "--scalar-last",
    "physical=False": "--unphysical",
    "interval": "--from and --to",
    "interval='all'": "--all",
}


class PythonOptions:
    """The words for options in Python: ``body=``, ``inverse=True``."""

    def __getitem__(self, key: str) -> str:
        """Return the words for an option, or an option with its value."""
        return key if "=" in key else f"{key}="


class ShellOptions:
    """The words for options on a command line: ``--body``, ``--inverse``; `names` maps those that differ."""

    def __init__(self, **names: str) -> None:
        self.names = SHELL | names

    def __getitem__(self, key: str) -> str:
        """Return the words for an option, or an option with its value."""
        if key in self.names:
            return self.names[key]
        name, _, value = key.partition("=")
        word = self.names.get(name, f"--{name.replace('_', '-')}")
        value = value.strip("'")
        return word if value in ("", "True") else f"{word} {value}"


class Worded:
    """What is said of an input: `code`, the key of its sentence; `fields`, the facts; `within`, what it is about."""

    def __init__(self, code: str, within: str = "", **fields: Any) -> None:
        self.code, self.within, self.fields = code, within, fields
        super().__init__(self.worded(PythonOptions()))  # type: ignore[call-arg]

    def worded(self, option: Any) -> str:
        """Return the sentence with the words that `option` has for options."""
        fields = {key: option[one] if isinstance(one, Option) else one for key, one in self.fields.items()}
        return (f"{self.within}: " if self.within else "") + SENTENCES[self.code].format(option=option, **fields)

    def about(self, within: str) -> Any:
        """Return the same about an input that is named."""
        return type(self)(self.code, within, **self.fields)

    def __reduce__(self) -> Any:
        """Return what makes a copy, as pickle needs it."""
        return partial(type(self), self.code, self.within, **self.fields), ()


class InputError(Worded, ValueError):
    r"""An input that cannot be used.

    Attributes
    ----------
    code : str
        Which error it is, as ``no-body``.
    fields : dict
        The facts that its sentence states.

    Examples
    --------
    >>> from io import StringIO
    >>> from nontwist import read_motion
    >>> from nontwist.errors import InputError
    >>> try:
    ...     read_motion(StringIO("time,timestamp,qw,qx,qy,qz\n0,0,1,0,0,0\n1,2,0,0,0,1\n"))
    ... except InputError as error:
    ...     print(error.code, error.fields)
    several-times {'names': 'time, timestamp'}
    """


class ExistingFileError(Worded, FileExistsError):
    """A file that exists, and is overwritten only where that is asked for."""


class InputWarning(Worded, UserWarning):
    """Something about an input that its user should know; with a `code` and `fields`, as those of an `InputError`."""


class Status(IntEnum):
    """How a run ended.

    Examples
    --------
    >>> from nontwist import nontwisting, simulate
    >>> from nontwist.errors import Status
    >>> run = simulate(nontwisting([3, 4, 5]), t_end=1, angular_velocity=(0, 1, 0))
    >>> Status(run.attrs["status"]).name, run.attrs["message"]
    ('OK', 'done')
    """

    OK = 0  #: t_end reached, all numbers finite, times increasing
    TURN = 1  #: more than half a turn in one step
    STALLED = 2  #: Newton's iteration does not converge
    BROKEN = 3  #: the directors are no longer a right-handed orthonormal triad
    LOAD = 4  #: a load that depends on the state failed
    SOLVER = 5  #: SciPy's solver gave up
    INTERRUPTED = 6  #: stopped from outside: Ctrl-C, SIGTERM, SIGHUP
    NOT_FINITE = 7  #: a number of the result is infinite or NaN
    INCOMPLETE = 8  #: the integrator returned without an error and without all states
    JUMP = 9  #: a load jumps with the state, and a step has no solution
    TOO_MANY = 10  #: SciPy's solver needs more steps than a run may take


class SimulationError(RuntimeError):
    """Raised when a run fails.

    Attributes
    ----------
    status : int
        See `Status`.
    time : float, s
        Start of the failed step.
    step : float, s
        The step size.
    residual : float
        Residual of the equations of the failed step.
    partial : Trajectory
        The run up to the failure.
    __cause__ : ValueError or None
        What names the function that raised, with its exception as the cause, where a load in Python did.

    Examples
    --------
    >>> from nontwist import simulate, standard
    >>> from nontwist.errors import SimulationError
    >>> try:
    ...     run = simulate(standard([3, 4, 5]), t_end=1, step=0.5, material_angular_velocity=(0, 0, 20))
    ... except SimulationError as error:
    ...     print(error)
    ...     run = error.partial.to_dataset()  # here the start alone
    step 0 at t = 0 s: the body turns 10 rad in one step; try step <= 0.03
    """

    def __init__(
        self, message: str, status: int, time: float, step: float, residual: float, partial: Any = None
    ) -> None:
        super().__init__(message)
        self.status, self.partial = status, partial
        self.time, self.step, self.residual = float(time), float(step), float(residual)

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (str(self), self.status, self.time, self.step, self.residual, self.partial)


class SimulationInterrupt(KeyboardInterrupt):
    """Raised when a run is interrupted, by Ctrl-C or any other `KeyboardInterrupt`.

    Attributes
    ----------
    partial : Trajectory
        The completed part; ``start=partial`` resumes the run. Its status is `Status.INTERRUPTED`, or `Status.OK` if the
        run was complete and only its dataset was missing.

    Examples
    --------
    A load interrupts the run as Ctrl-C would; the run is then resumed without this load:

    >>> from nontwist import moment, nontwisting, simulate
    >>> from nontwist.errors import SimulationInterrupt
    >>> def interrupting(t, directors, angular_velocity):
    ...     if t > 1:
    ...         raise KeyboardInterrupt
    ...     return 0, 0, 0
    >>> body, how = nontwisting([3, 4, 5]), {"t_end": 2, "step": 0.25, "integrator": "continuous"}
    >>> try:
    ...     simulate(body, angular_velocity=(0, 5, 0), load=moment(interrupting), **how)
    ... except SimulationInterrupt as stop:
    ...     print(stop)
    ...     rest = simulate(body, start=stop.partial, **how)
    interrupted at t = 0.75 s, after 3 of 8 steps
    >>> rest.time.values[[0, -1]]
    array([0.75, 2.  ])
    """

    def __init__(self, message: str, partial: Any) -> None:
        super().__init__(message)
        self.partial = partial

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (str(self), self.partial)


class ResultFileError(ValueError):
    """Raised for a file that is not a run, or was changed after it was written; the message has one line.

    Examples
    --------
    >>> from pathlib import Path
    >>> from nontwist import open_run
    >>> from nontwist.errors import ResultFileError
    >>> _ = Path("notes.nc").write_text("Case 1: ...")
    >>> try:
    ...     open_run("notes.nc")
    ... except ResultFileError as error:
    ...     print(error)
    notes.nc is not a NetCDF-4 file but text, 'Case 1:' ...
    """


class RunFileError(ValueError):
    """Raised for a run file that cannot be used.

    Attributes
    ----------
    file : str
    problems : tuple of Fault
        All problems, each with `key`, `given`, `accepted`.

    Examples
    --------
    >>> from pathlib import Path
    >>> from nontwist.runfile import read_run_file
    >>> from nontwist.errors import RunFileError
    >>> _ = Path("run.toml").write_text('body = { kind = "standart", inertia = [3, 4, 5] }')
    >>> try:
    ...     read_run_file("run.toml")
    ... except RunFileError as error:
    ...     print(error)
    run.toml: body.kind: "standart" -> did you mean "standard"? "standard", "nontwisting", "suslov" or "heavy_top"
    run.toml: time: missing -> a table [time]
    """

    def __init__(self, file: str, problems: tuple[Any, ...]) -> None:
        super().__init__(file, problems)
        self.file, self.problems = file, problems

    def __str__(self) -> str:
        return "\n".join(f"{self.file}: {problem}" for problem in self.problems)


class SweepError(RuntimeError):
    """Raised if blocks of a sweep fail; the others are complete. `failed` maps block numbers to reasons."""

    def __init__(self, message: str, failed: dict[int, str]) -> None:
        super().__init__(message, failed)
        self.failed = failed

    def __str__(self) -> str:
        return str(self.args[0])


class SweepStoreError(ValueError):
    """Raised for a folder that is not the store of this sweep, or was changed; the message has one line.

    Examples
    --------
    >>> from pathlib import Path
    >>> from nontwist import open_sweep
    >>> from nontwist.errors import SweepStoreError
    >>> Path("empty").mkdir()
    >>> try:
    ...     open_sweep("empty")
    ... except SweepStoreError as error:
    ...     print(error)
    empty is not the store of a sweep: it is not a Zarr group with a folder blocks
    """


def warn(message: str | Warning) -> None:
    """Warn at the line of the caller of the package."""
    warnings.warn(message, UserWarning, stacklevel=callers_level())


def callers_level() -> int:
    """Return the stack level, seen from the caller of this function, of the first frame outside the package."""
    level, frame = 1, sys._getframe(1)
    while frame.f_back is not None and frame.f_globals.get("__name__", "").startswith("nontwist."):
        level, frame = level + 1, frame.f_back
    return level

"""How commands end: the one place that says which exception has which exit status, and how it is reported.

====  ==========================================================
0     done
1     a number does not agree; blocks of a sweep are missing or damaged
2     usage
3     a run file, or data, that cannot be used
4     the solver failed, or blocks of a sweep failed; the completed part is saved
5     input or output
130   interrupted
====  ==========================================================

Data goes to stdout, all else to stderr. A reader that stops reading (``| head``) is no error; a stream that is closed
(``>&-``) is taken as /dev/null. Any other exception is a mistake of this package and keeps its traceback.
"""

from __future__ import annotations

import errno
import io
import os
import re
import sys
import traceback
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer
from typer.core import TyperGroup

import nontwist as package

from ..errors import ShellOptions, SimulationError, SweepError, Worded

if TYPE_CHECKING:
    import xarray
    from rich.console import Console

    from ..loads import Load

COMMON = {  # words that people try, and the command that does it
    **dict.fromkeys(("plot", "show", "animate", "film"), "view"),
    **dict.fromkeys(("simulate", "start", "resume"), "run"),
    **dict.fromkeys(("new", "init"), "example"),
    **{"convert": "export", "test": "validate", "identify": "fit", "paper": "reproduce"},
}
ELSEWHERE = "; --out names another place to write to"  # than a file system that is read-only
PICTURES = (".html", ".htm", ".gif", ".mp4", ".png", ".svg", ".pdf")
DIFFERS, USAGE, BAD_DATA, SOLVER, IO, INTERRUPTED = 1, 2, 3, 4, 5, 130
CODES: dict[type[BaseException], int] = {
    **dict.fromkeys((SimulationError, SweepError, MemoryError), SOLVER),
    OSError: IO,
    ValueError: BAD_DATA,
    ImportError: USAGE,  # an extra that is not installed
    KeyboardInterrupt: INTERRUPTED,
}


def code_of(error: BaseException) -> int | None:
    """Return the exit status of an exception, None for one that should not happen."""
    if isinstance(error, CommandError):
        return error.code
    return next((code for kind, code in CODES.items() if isinstance(error, kind)), None)


class CommandError(Exception):
    """An error of a command: its message and its exit status."""

    def __init__(self, message: str, code: int) -> None:
        super().__init__(message)
        self.code = code


@contextmanager
def about(subject: str, *kinds: type[Exception]) -> Iterator[None]:
    """Put `subject` and a colon in front of the message of these exceptions."""
    try:
        yield
    except kinds as error:
        if isinstance(error, BrokenPipeError):
            raise
        reason = error.strerror if isinstance(error, OSError) and error.strerror else words(error)
        if isinstance(error, OSError) and error.errno == errno.EROFS:
            reason += ELSEWHERE
        raise CommandError(f"{subject}: {reason}", code_of(error) or DIFFERS) from error


def imports_first(args: list[str]) -> list[str]:
    """Return the words of a command with its options --import MODULE in front of all others."""
    end = args.index("--") if "--" in args else len(args)
    first, rest = list[str](), list(args)
    for k in reversed([k for k, word in enumerate(args[:end]) if word.partition("=")[0] == "--import"]):
        size = 1 if "=" in args[k] else 2
        if k + size > end:  # its value is missing, which is said where it stands
            continue
        first[:0] = rest[k : k + size]
        del rest[k : k + size]
    return [*first, *rest]


class Commands(TyperGroup):
    """The group of all commands; each ends here."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """List the commands with their first sentences, which are wrapped and not cut."""
        with formatter.section("Commands"):
            names = self.list_commands(ctx)
            formatter.write_dl([(name, self.commands[name].get_short_help_str(10**4)) for name in names])

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Read the options of all commands, which may stand anywhere."""
        found: list[str] = super().parse_args(ctx, imports_first(args))
        return found

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Return a command; one that is unknown is refused with the command or the Python function that does it."""
        word = args[0] if args else ""
        try:
            return super().resolve_command(ctx, args)
        except Exception as error:
            if word in COMMON:
                error.message = f"No such command {word!r}. Did you mean {COMMON[word]!r}?"  # type: ignore[attr-defined]
            elif word in dir(package) and word.isidentifier() and not word.startswith("_"):
                error.message = f"No such command {word!r}. In Python: nontwist.{word}"  # type: ignore[attr-defined]
            raise

    def main(self, *args: Any, **kwargs: Any) -> Any:
        """Run the command line; a terminal that cannot show a letter shows a question mark."""
        _open_closed()
        for stream in (sys.stdout, sys.stderr):
            if isinstance(stream, io.TextIOWrapper):
                stream.reconfigure(errors="replace")
        return super().main(*args, **kwargs)

    def invoke(self, ctx: Any) -> Any:
        """Run a command, and turn what it raises into its exit status and a message."""
        try:
            with printed_warnings():
                result = super().invoke(ctx)
            sys.stdout.flush()
            return result
        except BrokenPipeError as error:
            _drop_stdout()
            raise typer.Exit from error
        except (Exception, KeyboardInterrupt) as error:
            if isinstance(found := getattr(error, "message", None), str):
                error.message = for_terminals(found.removeprefix("Value error, "))  # type: ignore[union-attr]
            code = None if isinstance(error, typer.Exit) else code_of(error)
            if code is None:
                raise
            if (ctx.find_root().obj or {}).get("debug"):
                traceback.print_exc()
            say(_message(error), "red")
            _drop_stdout()
            raise typer.Exit(code) from error


def require_readable(path: Path, wanted: str = "a result") -> None:
    """Refuse a run file, a page or a picture where a result or a recording is wanted."""
    if path.suffix.lower() == ".toml" and path.is_file():
        raise CommandError(f"{path} is a run file, not {wanted}: nontwist run {path} runs it", BAD_DATA)
    if path.suffix.lower() in PICTURES and path.is_file():
        raise CommandError(f"{path} is a page or a picture, not {wanted}: open it in a browser", BAD_DATA)


def _open_closed() -> None:
    """Open standard streams that are closed, so that no other file gets their number and what is printed in it."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: SIM115, it stays open


def _drop_stdout() -> None:
    """Redirect stdout to the null device where it cannot be written, or Python tries again when it exits."""
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _message(error: BaseException) -> str:
    if isinstance(error, KeyboardInterrupt):
        return str(error) or "interrupted"
    if isinstance(error, OSError) and error.filename is not None:
        is_store = isinstance(error, IsADirectoryError) and os.path.exists(os.path.join(error.filename, "zarr.json"))
        remedy = "; nontwist sweep-show reads the store of a sweep" * is_store
        remedy += ELSEWHERE * (error.errno == errno.EROFS)
        return f"{error.filename}: {error.strerror}{remedy}"
    if isinstance(error, MemoryError):
        return f"not enough memory ({error}); store fewer states: time.store"
    return words(error)


def words(said: Any) -> str:
    """Return an error or a warning in the words of a command line."""
    return said.worded(ShellOptions()) if isinstance(said, Worded) else str(said)


def for_terminals(text: str) -> str:
    """Return a text without the names in Python that stand behind options, as in ``--inverse (inverse=True)``."""
    text = re.sub(r"(?<![\w./\\-])relative_to(?![\w./=-])", "the second recording", text)
    return re.sub(r"(--[a-z][a-z-]*(?: [A-Z][A-Z0-9,]*)?) \((?:\w+=[^(),]*(?:, )?)+\)", r"\1", text)


def say(text: str, style: str = "") -> None:
    """Print a message on stderr, in colour where that is wanted; one that cannot be shown is no error."""
    from rich.console import Console

    with suppress(OSError):
        Console(stderr=True, highlight=False).print(
            for_terminals(text), style=style, markup=False, emoji=False, soft_wrap=True
        )


def stdout() -> Console:
    """Return where data is printed; a closed pipe raises BrokenPipeError there."""
    from rich.console import Console

    class Stdout(Console):
        def on_broken_pipe(self) -> None:
            raise BrokenPipeError

    return Stdout(highlight=False)


def show(text: str) -> None:
    """Print a line of data as it is, but for line breaks."""
    stdout().print(text, markup=False, emoji=False)


@contextmanager
def printed_warnings(subject: object = "") -> Iterator[None]:
    """Print warnings on stderr as they come, each once, with what they are about, as the name of a file."""
    printed, about_it = set[str](), f"{subject}: " if str(subject) else ""

    def told(message: Warning | str, *where: Any, **more: Any) -> None:
        if str(message) not in printed:
            say(f"{about_it}warning: {words(message)}", "yellow")
        printed.add(str(message))

    with warnings.catch_warnings():
        warnings.simplefilter("always", UserWarning)
        warnings.showwarning = told
        yield


# Runs with more states than they store, for what is drawn of them.


FAR, DRAWN = 0.1, 20_000  # rad between states that are drawn as they are; states that are drawn, and steps for them


def largest_turn(run: xarray.Dataset) -> float:
    """Return the largest rotation from one state of a run to the next, rad."""
    from ..recordings.motions import rotation

    attitudes = rotation(run)
    return float((attitudes[:-1].inv() * attitudes[1:]).magnitude().max()) if run.sizes["time"] > 1 else 0.0


def smooth(
    run: xarray.Dataset, load: Load | None = None, span: tuple[float, float] | None = None, most: int = DRAWN
) -> xarray.Dataset:
    """Return a run, or a span of it, with more states where its own lie far apart; at most about `most`.

    A ValueError or a SimulationError says why there can be none: a load of functions, or one that ends here.
    """
    import numpy as np

    from ..driver.runs import resample

    time = run["time"].values
    first, last = (time[0], time[-1]) if span is None else np.clip(span, time[0], time[-1])
    part = run.sel(time=slice(first, last))
    if first == last or len(part["time"]) >= most or largest_turn(run) <= FAR:
        return part
    speed = float(np.linalg.norm(run["material_angular_velocity"], axis=1).max())
    count, own = min(np.ceil((last - first) * speed / FAR), most), np.unique([first, *part["time"].values, last])
    parts = np.ceil(np.diff(own) * (count / (last - first)))  # of each interval between stored states
    ends = np.append(0.0, np.cumsum(parts))
    found = resample(run, np.interp(np.arange(ends[-1] + 1), ends, own), load)
    return found.assign({name: one for name, one in run.items() if name not in found and "time" not in one.dims})

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
import sys
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, ClassVar

import typer
from typer.core import TyperGroup

import nontwist

from ..errors import SimulationError, SweepError
from ..geometry.values import MadeByName
from .printing import imported, printed_warnings, say, words

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


@contextmanager
def on_file(path: object) -> Iterator[None]:
    """Name a file in front of warnings and of ValueErrors."""
    with about(str(path), ValueError), printed_warnings(path):
        yield


class Commands(TyperGroup):
    """The group of all commands; each ends here."""

    functions: ClassVar[dict[str, Callable[..., None]]]
    by_name: ClassVar[MadeByName]  # since the options of all take longer than the start

    def __init__(self, **how: Any) -> None:
        super().__init__(**how)
        self.commands: Any = self.by_name

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names of all commands."""
        return list(self.commands)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """List the commands with their first sentences, which are wrapped and not cut."""
        docs = {name: " ".join((f.__doc__ or "").split()) for name, f in self.functions.items()}
        with formatter.section("Commands"):
            formatter.write_dl([(name, doc.partition(". ")[0].removesuffix(".") + ".") for name, doc in docs.items()])

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Return a command; one that is unknown is refused with the command or the Python function that does it."""
        word = args[0] if args else ""
        try:
            return super().resolve_command(ctx, args)
        except Exception as error:
            if word in COMMON or word in dir(nontwist):
                advice = f"Did you mean {COMMON[word]!r}?" if word in COMMON else f"In Python: nontwist.{word}"
                error.message = f"No such command {word!r}. {advice}"  # type: ignore[attr-defined]
            raise

    def main(self, *args: Any, **kwargs: Any) -> Any:
        """Run the command line; a terminal that cannot show a letter shows a question mark."""
        imported.clear()
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
                error.message = found.removeprefix("Value error, ")  # type: ignore[union-attr]
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

"""Options that more than one command has."""

from __future__ import annotations

import inspect
import re
import shlex
from collections.abc import Callable, Iterable
from functools import wraps
from pathlib import Path
from typing import Annotated, Any, Optional, TypeVar, get_type_hints

import typer
from typer import BadParameter
from typer.core import TyperCommand

from ..errors import InputError, ShellOptions
from ..recordings.options import ReadOptions
from ..spec import specs

# How help is laid out: plain text, in lines that are broken between words only, never within a name or an option.
#
# And how a value is refused that an option cannot take: Typer hands on the words of pydantic, which say neither what
# was given nor what would do.

HYPHEN = "\N{NON-BREAKING HYPHEN}"  # stands for the hyphen while lines are broken
COMMON = "--import"  # the option of all commands, which the program reads
NARROW = 70  # columns; below them only short names stand beside what they mean


def whole(text: str) -> str:
    """Return a text in which no line is broken at a hyphen, and none between an option and its value."""
    return text.replace("-", HYPHEN)


def place(parameter: Any) -> str:
    """Return how an argument or an option is written: ``FILE...``, ``-q, --quiet``, ``--out PATH``.

    Short names are first: Typer hands on those of help in the order of a set, another one in each process.
    """
    value = parameter.metavar or ""
    if parameter.param_type_name == "argument":
        return value if parameter.required or value.startswith("[") else f"[{value}]"
    names = ", ".join([*sorted(parameter.opts, key=len), *parameter.secondary_opts])
    return f"{names} {value}".rstrip() if not parameter.is_flag else names


def meaning(parameter: Any) -> str:
    """Return what an argument or an option means, and what it is where it is left out."""
    text, default = parameter.help or "", parameter.show_default
    if not isinstance(default, str):
        value = getattr(parameter.default, "value", parameter.default)
        default = "" if not default or value is None or isinstance(value, bool) else str(value)
    return f"{text} Default: {default}." if default else text


def refusal(error: Any) -> str:
    """Return what is wrong with the value of an option, of an error of pydantic."""
    found = error.errors(include_url=False)[0]
    given, limits = found["input"], found.get("ctx", {})
    match found["type"]:
        case "int_parsing" | "int_from_float" | "int_type":
            return f"{given} is not a whole number"
        case "float_parsing" | "float_type":
            return f"{given} is not a number"
        case "greater_than_equal":
            return f"{given} is below {limits['ge']:g}, the smallest value"
        case "less_than_equal":
            return f"{given} is above {limits['le']:g}, the largest value"
        case "value_error":
            return str(limits["error"])
        case _:
            return f"{given} is not {found['msg'].removeprefix('Input should be ')}"


class Command(TyperCommand):
    """A command of `nontwist`."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Read the arguments of a command line; a value that is refused is shown."""
        try:
            return super().parse_args(ctx, args)
        except BadParameter as error:
            if (cause := error.__cause__) is not None and hasattr(cause, "errors"):
                error.message = refusal(cause)
            raise

    def format_usage(self, ctx: Any, formatter: Any) -> None:
        """Write how the command is called."""
        places = [place(one) + "..." * (one.nargs == -1) for one in self.params if one.param_type_name == "argument"]
        formatter.write_usage(ctx.command_path, " ".join(["[OPTIONS]", *places]))

    def format_help_text(self, ctx: Any, formatter: Any) -> None:
        """Write what the command does, paragraph by paragraph."""
        with formatter.indentation():
            for paragraph in (self.help or "").split("\n\n"):
                formatter.write_paragraph()
                formatter.write_text(whole(paragraph))

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write the arguments and the options, that of all commands last."""
        params: list[Any] = [*self.get_params(ctx), *(one for one in ctx.parent.command.params if COMMON in one.opts)]
        for title, kind in (("Arguments", "argument"), ("Options", "option")):
            shown = [one for one in params if one.param_type_name == kind and not one.hidden]
            rows = [(whole(place(one)), whole(meaning(one))) for one in shown]
            if rows:
                with formatter.section(title):
                    formatter.write_dl(rows, col_max=18 if formatter.width < NARROW else 30)

    def get_help(self, ctx: Any) -> str:
        """Return the help, with its hyphens."""
        return str(super().get_help(ctx)).replace(HYPHEN, "-")


F = TypeVar("F", bound=Callable[..., Any])
SHELL = ShellOptions()


def _remember(ctx: typer.Context, value: bool) -> bool:
    if value:
        ctx.find_root().ensure_object(dict)["debug"] = True
    return value


def _checked(overrides: list[str] | None) -> list[str] | None:
    for override in overrides or ():
        from ..runfile.toml_data import split_override

        try:
            split_override(override)
        except ValueError as error:
            raise typer.BadParameter(str(error)) from error
    return overrides


RunFiles = Annotated[list[Path], typer.Argument(metavar="FILE", help="Run files (TOML).", show_default=False)]
OneRunFile = Annotated[Path, typer.Argument(metavar="FILE", help="A run file (TOML).", show_default=False)]
Overrides = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Set a value of the run file (TOML), as in --set body.mass=2.5 or --set load.0.scale=2; KEY= removes one. "
        "Repeatable.",
        callback=_checked,
    ),
]
Force = Annotated[bool, typer.Option("--force", help="Overwrite existing files.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object per line.")]
Quiet = Annotated[
    bool, typer.Option("--quiet", "-q", help="Print no results and no progress; warnings and --json are still printed.")
]
DecimalComma = Annotated[
    bool, typer.Option("--decimal-comma", help="Write CSV with decimal commas, and semicolons between columns.")
]
Debug = Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.", callback=_remember)]


def reads(*names: str, **helps: str) -> Callable[[F], F]:
    """Give a command the options of `ReadOptions`, all or those that are named, in place of its parameter `reading`.

    `helps` replace their descriptions.
    """

    def described(command: F) -> F:
        options = {}
        for name, (kind, default, spec) in specs(ReadOptions).items():
            if not names or name in names:
                kind = Optional[str] if name == "columns" else kind  # noqa: UP045
                words = (helps.get(name) or spec.text).format(option=SHELL)
                flags = spec.option or f"--{name.replace('_', '-')}"
                about = typer.Option(flags, metavar=spec.metavar or None, help=words, show_default=False)
                keyword, annotation = inspect.Parameter.KEYWORD_ONLY, Annotated[kind, about]
                options[name] = inspect.Parameter(name, keyword, default=default, annotation=annotation)

        @wraps(command)
        def wrapper(**given: Any) -> Any:
            reading = {name: given.pop(name) for name in options}
            if reading.get("columns") is not None:
                reading["columns"] = [name.strip() for name in reading["columns"].split(",")]
            try:
                ReadOptions(**reading)
            except InputError as error:
                raise typer.BadParameter(error.worded(SHELL)) from error
            return command(**given, reading=reading)

        hints = get_type_hints(command, include_extras=True)
        own = [one.replace(annotation=hints[one.name]) for one in inspect.signature(command).parameters.values()]
        all_of_them = [part for one in own for part in (options.values() if one.name == "reading" else [one])]
        of_wrapper: Any = wrapper
        of_wrapper.__signature__ = inspect.Signature([one.replace(kind=one.KEYWORD_ONLY) for one in all_of_them])
        of_wrapper.__annotations__ = {one.name: one.annotation for one in all_of_them}
        return of_wrapper  # type: ignore[no-any-return]

    return described


def given_again(ctx: typer.Context, names: Iterable[str]) -> list[str]:
    """Return those of these options that a command line has, as words to be typed again."""
    words = []
    for option in ctx.command.params:
        source = ctx.get_parameter_source(option.name or "")
        if option.name in names and getattr(source, "name", "") == "COMMANDLINE":
            value = ctx.params[option.name]
            if isinstance(value, bool):
                words.append((option.opts if value else option.secondary_opts)[0])
            else:
                words += [option.opts[0], shlex.quote(str(value))]
    return words


def require_suffix(path: Path, *suffixes: str, option: str = "--out", instead: str = "") -> None:
    """Refuse a file whose suffix promises another format than it would have."""
    if path.suffix.lower() not in suffixes:
        raise typer.BadParameter(f"{path} does not end in {' or '.join(suffixes)}{instead}", param_hint=option)


def looks_like_a_file(path: Path) -> bool:
    """Return whether a path ends in what is a suffix of files, and is not a folder: ``a.csv``, but not ``v1.2``."""
    return re.fullmatch(r"\.[A-Za-z]\w{1,4}", path.suffix) is not None and not path.is_dir()


def require_folder(path: Path, option: str = "--out", instead: str = "") -> None:
    """Refuse the name of a file where a folder is wanted."""
    if looks_like_a_file(path):
        raise typer.BadParameter(f"{path} would be a folder{instead}", param_hint=option)

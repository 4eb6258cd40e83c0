"""Options that more than one command has."""

from __future__ import annotations

import inspect
import json
import re
import shlex
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, is_dataclass
from functools import wraps
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any, Literal, Optional, get_args, get_origin, get_type_hints

import typer
from typer import BadParameter
from typer.core import TyperCommand

from ..errors import InputError, ShellOptions
from ..recordings.options import ReadOptions
from ..spec import Spec, specs
from .printing import imported, say_written

# How help is laid out: plain text, in lines that are broken between words only, never within a name or an option.
#
# And how a value is refused that an option cannot take: Typer hands on the words of pydantic, which say neither what
# was given nor what would do.

HYPHEN = "\N{NON-BREAKING HYPHEN}"  # stands for the hyphen while lines are broken
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
        """Write the arguments and the options."""
        params: list[Any] = self.get_params(ctx)
        for title, kind in (("Arguments", "argument"), ("Options", "option")):
            shown = [one for one in params if one.param_type_name == kind and not one.hidden]
            rows = [(whole(place(one)), whole(meaning(one))) for one in shown]
            if rows:
                with formatter.section(title):
                    formatter.write_dl(rows, col_max=18 if formatter.width < NARROW else 30)

    def get_help(self, ctx: Any) -> str:
        """Return the help, with its hyphens."""
        return str(super().get_help(ctx)).replace(HYPHEN, "-")


SHELL = ShellOptions()


def _remember(ctx: typer.Context, value: bool) -> bool:
    if value:
        ctx.find_root().ensure_object(dict)["debug"] = True
    return value


def _import(modules: list[str] | None) -> list[str] | None:
    for name in modules or ():
        if not all(part.isidentifier() for part in name.split(".")) or name.endswith(".py"):
            raise BadParameter(f"{name!r} is not the name of a module, as own_load", param_hint="--import")
        imported.append(name)
        sys.path.insert(0, "")  # the current folder, as of python -c
        try:
            import_module(name)
        except Exception as error:  # whatever the module does
            reason = f"{name} cannot be imported: {type(error).__name__}: {error}"
            raise BadParameter(reason, param_hint="--import") from error
    return modules


def _checked(overrides: list[str] | None) -> list[str] | None:
    for override in overrides or ():
        from ..runfile.files import split_override

        try:
            split_override(override)
        except ValueError as error:
            raise BadParameter(str(error)) from error
    return overrides


@dataclass(frozen=True)
class Opt(Spec):
    """What a parameter of a command means: as of a field, and what only command lines have.

    `default` says in words what an option is where it is left out. Numbers are from `least` to `most`. `parser` reads a
    text, `check` looks at a value; both raise a BadParameter. Its name is that of the parameter unless `option` is
    another; of a flag that is on unless it is turned off, `option` has both names. The words of a `Literal` are its
    `metavar`.
    """

    default: str = ""
    least: float | None = None
    most: float | None = None
    parser: Callable[[str], Any] | None = None
    check: Callable[..., Any] | None = None


def names_of(text: str | None) -> list[str] | None:
    """Return the names of a text that separates them by commas, None where there is none."""
    return [name.strip() for name in text.split(",")] if text else None


IMPORT = Opt(
    "Import this module first, from here or the Python path. It adds bodies, loads, integrators or readers. "
    "Repeatable.",
    "MODULE",
    "--import",
    check=_import,
)


def _option(name: str, kind: Any, default: Any, spec: Spec, words: str = "") -> inspect.Parameter:
    """Return a parameter as Typer reads it, by default with its own words; of a list of names it is a text."""
    own = spec if isinstance(spec, Opt) else Opt(**vars(spec))
    kinds = (kind, *get_args(kind))
    choices = [one for part in kinds if get_origin(part) is Literal for one in get_args(part)]
    about = typer.Option(
        *(own.option or f"--{name.replace('_', '-')}").split(),
        metavar=own.metavar or "|".join(choices) or None,
        help=words or own.text.format(option=SHELL),
        show_default=own.default or True,
        min=own.least,
        max=own.most,
        parser=own.parser,
        callback=names_of if Sequence[str] in kinds else own.check,
    )
    form: Any = Optional[str] if Sequence[str] in kinds else kind  # noqa: UP045
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=Annotated[form, about])


def command(function: Callable[..., None]) -> Callable[..., None]:
    """Return a command with the options that the descriptions of its parameters make, --debug and --import.

    A parameter that is a record stands for options: its fields, or those among them that it names with other words.
    """
    hints = get_type_hints(function, include_extras=True)
    made, records = list[inspect.Parameter](), dict[str, tuple[Any, list[str]]]()
    for name, one in inspect.signature(function).parameters.items():
        kind, *about = get_args(hints[name]) or (hints[name],)
        if isinstance(kind, type) and is_dataclass(kind):
            words = about[0] if about else dict.fromkeys(specs(kind), "")
            own = {key: one for key, one in specs(kind).items() if key in words}
            made += [_option(key, *one, words[key]) for key, one in own.items()]
            records[name] = kind, [*own]
        elif about and isinstance(about[0], Spec):
            made.append(_option(name, kind, one.default, about[0]))
        else:
            made.append(one.replace(annotation=hints[name], kind=one.KEYWORD_ONLY))
    made.append(_option("debug", bool, False, Opt("Show the traceback of an error.", check=_remember)))
    made.append(_option("modules", Optional[list[str]], None, IMPORT))  # noqa: UP045

    @wraps(function)
    def called(*, debug: bool, modules: Any, **given: Any) -> None:
        try:
            found = {name: kind(**{key: given.pop(key) for key in own}) for name, (kind, own) in records.items()}
        except InputError as error:
            raise BadParameter(error.worded(SHELL)) from error
        function(**found, **given)

    called.__signature__ = inspect.Signature(made)  # type: ignore[attr-defined]
    called.__annotations__ = {one.name: one.annotation for one in made}
    return called


def argument(metavar: str, text: str, **more: Any) -> Any:
    """Return what a word of a command line that is no option means."""
    return typer.Argument(metavar=metavar, help=text, **({"show_default": False} | more))


Overrides = Annotated[
    list[str] | None,
    Opt(
        "Set a value of the run file (TOML), as in --set body.mass=2.5 or --set load.0.scale=2; KEY= removes one. "
        "Repeatable.",
        "KEY=VALUE",
        "--set",
        check=_checked,
    ),
]
RunFiles = Annotated[list[Path], argument("FILE", "Run files (TOML).")]
OneRunFile = Annotated[Path, argument("FILE", "A run file (TOML).")]
Force = Annotated[bool, Opt("Overwrite existing files.")]
DecimalComma = Annotated[bool, Opt("Write CSV with decimal commas, and semicolons between columns.")]


@dataclass(frozen=True)
class Answer:
    """How a command answers: over existing files, with one line of JSON, quietly."""

    force: Force = False
    json: Annotated[bool, Opt("Print one JSON object per line.")] = False
    quiet: Annotated[
        bool, Opt("Print no results and no progress; warnings and --json are still printed.", option="--quiet -q")
    ] = False

    @property
    def bar(self) -> bool:
        """Whether progress is shown."""
        return not self.quiet and sys.stderr.isatty()

    def in_words(self, numbers: dict[str, Any]) -> bool:
        """Print what a command has found as one line of JSON where that is asked for; return whether people read it."""
        from ..io.run_files import finite

        if self.json:
            print(json.dumps(finite(numbers), allow_nan=False))
        return not (self.json or self.quiet)

    def written(self, places: Iterable[object], *commands: Sequence[object]) -> None:
        """Say which files were written, and what may be typed next."""
        if not self.quiet:
            say_written(places, *commands)


AsJson = Annotated[Answer, {"json": ""}]
Quiet = Annotated[Answer, {"json": "", "quiet": ""}]


def read_otherwise(ctx: typer.Context, file: str, text: str) -> dict[str, Any]:
    """Return how the second file is read, from its options as they stand on a command line."""
    hint = "--relative-options"
    try:
        words = shlex.split(text)
    except ValueError as error:
        raise BadParameter(f"{text!r} has a quotation mark too few", param_hint=hint) from error
    refused = "it accepts options that define how a file is read; nontwist twist -h lists them"
    refuse(({"-h", "--help"} & set(words), hint, refused))
    names = [name for name in specs(ReadOptions) if name not in ("columns", "body")]
    own = ctx.command.make_context("twist", [file, *words], parent=ctx.parent)
    known = ", ".join(one.opts[0] for one in ctx.command.params if one.name in names)
    for one in given(own):
        advice = f"; use --relative-{one.name}" if one.name in ("columns", "body") else ""
        is_other = one.name not in (*names, "data")
        refuse((is_other, hint, f"{one.opts[0]} is not one of {known}{advice}"))
    return {name: own.params[name] for name in names}


def given(ctx: Any) -> list[Any]:
    """Return the parameters that a command line has."""
    sources = ((one, ctx.get_parameter_source(one.name or "")) for one in ctx.command.params)
    return [one for one, source in sources if getattr(source, "name", "") == "COMMANDLINE"]


def given_again(ctx: typer.Context, names: Iterable[str]) -> list[str]:
    """Return those of these options that a command line has, as words to be typed again."""
    words = []
    for option in (one for one in given(ctx) if one.name in names):
        value = ctx.params[option.name]
        words.append((option.secondary_opts if value is False else option.opts)[0])
        words += [] if isinstance(value, bool) else [",".join(value) if isinstance(value, list) else str(value)]
    return words


def refuse(*cases: tuple[object, str, str]) -> None:
    """Raise a BadParameter for the first case that is one: whether it is, the option, and why it is refused."""
    for is_wrong, option, why in cases:
        if is_wrong:
            raise BadParameter(why, param_hint=option)


def numbers_of(text: str, wanted: str, option: str | None = None) -> Any:
    """Return two numbers that are separated by a comma; a BadParameter where these are others."""
    try:
        numbers = tuple(float(part) for part in text.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) != 2:
        raise BadParameter(f"{text!r} is not {wanted}", param_hint=option)
    return numbers


WORDS = ("gravity", "rotor", "orientation")  # whose text without settings is one word


def settings(text: str | None, name: str) -> Any:
    """Return the value of an option such as ``mass=0.35,centre=0,0,-0.1``: a mapping of what is set, or one value."""
    option, found, key = f"--{name.replace('_', '-')}", dict[str, list[str]](), ""
    if text is None or ("=" not in text and name in WORDS):
        return text
    if "=" not in text:
        return _value(text.split(","), option)
    for part in text.split(","):
        setting, is_set, value = part.rpartition("=")
        refuse((not is_set and not key, option, f"{part.strip()!r} is before the first NAME="))
        if is_set:
            key = setting.strip()
            refuse((key in found, option, f"{key} is set twice"))
        found.setdefault(key, []).append(value.strip() if is_set else part.strip())
    return {key: _value(values, f"{key} of {option}") for key, values in found.items()}


def _value(parts: list[str], name: str) -> Any:
    """Return a word, a number, or a list of numbers."""
    try:
        numbers = [float(part) for part in parts]
    except ValueError as error:
        if len(parts) == 1:
            return parts[0]
        raise BadParameter(f"{name} must be numbers, got {','.join(parts)!r}") from error
    return numbers[0] if len(numbers) == 1 else numbers


def require_suffix(path: Path, *suffixes: str, option: str = "--out", instead: str = "") -> None:
    """Refuse a file whose suffix promises another format than it would have."""
    is_other = path.suffix.lower() not in suffixes
    refuse((is_other, option, f"{path} does not end in {' or '.join(suffixes)}{instead}"))


def looks_like_a_file(path: Path) -> bool:
    """Return whether a path ends in what is a suffix of files, and is not a folder: ``a.csv``, but not ``v1.2``."""
    return re.fullmatch(r"\.[A-Za-z]\w{1,4}", path.suffix) is not None and not path.is_dir()


def require_folder(path: Path, option: str = "--out", instead: str = "") -> None:
    """Refuse the name of a file where a folder is wanted."""
    refuse((looks_like_a_file(path), option, f"{path} would be a folder{instead}"))

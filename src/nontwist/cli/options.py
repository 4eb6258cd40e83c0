"""Options that more than one command has."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Literal

import typer


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
Columns = Annotated[
    str | None,
    typer.Option(
        metavar="HEADERS",
        help="Columns to use, separated by commas: [TIME,] 4 of a quaternion or 9 of a matrix; 3 with --euler or "
        "--rotation-vector. Without headers, their numbers from 1.",
    ),
]
TimeColumn = Annotated[str | None, typer.Option(metavar="NAME", help="Header of the time column.")]
Body = Annotated[
    str | None,
    typer.Option(metavar="NAME", help="Segment, sensor, joint, topic or array to use, if there are several."),
]
ScalarFirst = Annotated[
    bool | None,
    typer.Option("--scalar-first/--scalar-last", help="Order of quaternions whose headers do not show it."),
]
Inverse = Annotated[
    bool, typer.Option("--inverse", help="Invert every attitude: the sensor reports the earth relative to itself.")
]
Euler = Annotated[
    str | None,
    typer.Option(metavar="AXES", help="Read Euler angles: ZYX about moving axes in this order, zyx about fixed axes."),
]
RotationVector = Annotated[bool, typer.Option("--rotation-vector", help="Read rotation vectors, axis times angle.")]
AngleUnit = Annotated[
    Literal["deg", "rad"] | None,
    typer.Option(metavar="deg|rad", help="Unit of angles, if the file does not name it."),
]
Normalize = Annotated[
    bool,
    typer.Option("--normalize", help="Scale rounded quaternions to length 1, and matrices to the nearest rotation."),
]
Rate = Annotated[
    float | None,
    typer.Option(
        metavar="HZ",
        min=1e-9,
        help="Samples per second, if the file has no time, or to ignore its times.",
    ),
]
TimeUnit = Annotated[
    str | None,
    typer.Option(metavar="UNIT", help="Unit of the time column: s, ms, us, ns, min, h, or seconds per count."),
]
READING = (
    "time_column",
    "scalar_first",
    "euler",
    "rotation_vector",
    "angle_unit",
    "time_unit",
    "rate",
    "normalize",
    "inverse",
)
Debug = Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.", callback=_remember)]


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


def names_of(text: str | None) -> list[str] | None:
    """Return the headers in a text, separated by commas; None where there are none."""
    return [name.strip() for name in text.split(",")] if text else None

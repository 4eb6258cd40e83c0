"""Options that more than one command has."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

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
        help="Put a value (TOML) in: --set body.mass=2.5, --set load.0.scale=2; repeatable.",
        callback=_checked,
    ),
]
Force = Annotated[bool, typer.Option("--force", help="Replace files that exist.")]
Json = Annotated[bool, typer.Option("--json", help="Print JSON, one object a line.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only (and JSON where asked for).")]
Debug = Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.", callback=_remember)]

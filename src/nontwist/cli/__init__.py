"""The command `nontwist`. Data goes to stdout, progress and messages to stderr.

What each command may end with stands in `outcomes`.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Annotated, Any

import typer

import nontwist

from ..geometry.values import MadeByName
from . import (
    check_commands,
    recording_commands,
    result_commands,
    run_commands,
    sweep_commands,
    view_commands,
)
from .outcomes import Commands
from .shared_options import Command, Opt, command

app = typer.Typer(
    cls=Commands,
    no_args_is_help=True,
    rich_markup_mode=None,  # help as plain text: names of options are never cut
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _version(show: bool) -> None:
    if show:
        typer.echo(f"nontwist {nontwist.__version__}")
        raise typer.Exit


@app.callback()
@command
def main(version: Annotated[bool, Opt("Print the version and exit.", check=_version)] = False) -> None:
    """Simulate rotating rigid bodies, with or without twist, and measure the twist of recorded motions.

    New here? Try nontwist play; or nontwist example standard, then nontwist run standard.toml.
    """


COMMANDS: dict[str, Callable[..., None]] = {
    "play": view_commands.play_command,
    "example": run_commands.example_command,
    "check": check_commands.check_command,
    "run": run_commands.run_command,
    "view": view_commands.view_command,
    "info": result_commands.info_command,
    "export": result_commands.export_command,
    "twist": recording_commands.twist_command,
    "fit": recording_commands.fit_command,
    "precision": check_commands.precision_command,
    "compare": check_commands.compare_command,
    "sweep": sweep_commands.sweep_command,
    "sweep-show": sweep_commands.show_command,
    "sweep-verify": sweep_commands.verify_command,
    "reproduce": check_commands.reproduce_command,
    "validate": check_commands.validate_command,
    "schema": run_commands.schema_command,
}


@cache
def _made(name: str) -> Any:
    """Return the command of a name."""
    alone = typer.Typer(add_completion=False, rich_markup_mode=None)
    alone.command(name, cls=Command)(command(COMMANDS[name]))
    return typer.main.get_command(alone)


Commands.functions, Commands.by_name = COMMANDS, MadeByName(lambda: COMMANDS, _made)

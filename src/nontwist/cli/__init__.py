"""The command `nontwist`. Data goes to stdout, progress and messages to stderr.

What each command may end with stands in `outcomes`.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from importlib import import_module
from typing import Annotated

import typer

from . import (
    check_commands,
    fit_commands,
    result_commands,
    run_commands,
    sweep_commands,
    twist_commands,
    view_commands,
)
from .options import Command, command
from .outcomes import Commands
from .printing import imported

app = typer.Typer(
    cls=Commands,
    no_args_is_help=True,
    rich_markup_mode=None,  # help as plain text: names of options are never cut
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _version(show: bool) -> None:
    if show:
        import nontwist

        typer.echo(f"nontwist {nontwist.__version__}")
        raise typer.Exit


def _import(modules: list[str] | None) -> list[str] | None:
    imported[:] = modules or ()
    if imported:
        sys.path.insert(0, "")  # the current folder, as of python -c
    for name in imported:
        if not all(part.isidentifier() for part in name.split(".")) or name.endswith(".py"):
            raise typer.BadParameter(f"{name!r} is not the name of a module, as own_load", param_hint="--import")
        try:
            import_module(name)
        except Exception as error:  # whatever the module does
            reason = f"{name} cannot be imported: {type(error).__name__}: {error}"
            raise typer.BadParameter(reason, param_hint="--import") from error
    return modules


@app.callback()
def main(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and exit.")
    ] = False,
    modules: Annotated[
        list[str] | None,
        typer.Option(
            "--import",
            metavar="MODULE",
            callback=_import,
            help="Import this module first, from here or the Python path. It adds bodies, loads, integrators or "
            "readers. Repeatable; may follow the command.",
            show_default=False,
        ),
    ] = None,
) -> None:
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
    "twist": twist_commands.twist_command,
    "fit": fit_commands.fit_command,
    "precision": check_commands.precision_command,
    "compare": check_commands.compare_command,
    "sweep": sweep_commands.sweep_command,
    "sweep-show": sweep_commands.show_command,
    "sweep-verify": sweep_commands.verify_command,
    "reproduce": check_commands.reproduce_command,
    "validate": check_commands.validate_command,
    "schema": run_commands.schema_command,
}
for _name, _function in COMMANDS.items():
    app.command(_name, cls=Command)(command(_function))

"""The command `nontwist`. Data goes to stdout, progress and messages to stderr.

What each command may end with stands in `outcomes`.
"""

from __future__ import annotations

from typing import Annotated

import typer

from . import (
    check_commands,
    compare_commands,
    file_commands,
    paper_commands,
    result_commands,
    run_commands,
    sweep_commands,
    twist_commands,
    validation_commands,
    view_commands,
)
from .outcomes import Commands

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


@app.callback()
def main(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """Rigid bodies described by directors, non-twisting frames, and integrators that keep their invariants."""


app.command("run")(run_commands.run_command)
app.command("check")(check_commands.check_command)
app.command("precision")(check_commands.precision_command)
app.command("compare")(compare_commands.compare_command)
app.command("example")(file_commands.example_command)
app.command("schema")(file_commands.schema_command)
app.command("info")(result_commands.info_command)
app.command("export")(result_commands.export_command)
app.command("reproduce")(paper_commands.reproduce_command)
app.command("twist")(twist_commands.twist_command)
app.command("sweep")(sweep_commands.sweep_command)
app.command("sweep-verify")(sweep_commands.verify_command)
app.command("sweep-show")(sweep_commands.show_command)
app.command("view")(view_commands.view_command)
app.command("play")(view_commands.play_command)
app.command("validate")(validation_commands.validate_command)

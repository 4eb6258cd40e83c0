"""The command `nontwist`. Data goes to stdout, progress and messages to stderr.

Exit codes: 0 done, 1 a number does not agree, 2 usage, 3 data that cannot be used, 5 input or output.
"""

from __future__ import annotations

from typing import Annotated

import typer

from . import paper_commands, twist_commands

app = typer.Typer(
    no_args_is_help=True, pretty_exceptions_enable=False, context_settings={"help_option_names": ["-h", "--help"]}
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


app.command("reproduce")(paper_commands.reproduce_command)
app.command("twist")(twist_commands.twist_command)

"""`.. commands::` writes a section for each command, from the same texts as `nontwist COMMAND --help`."""

from typing import Any

import typer
from docutils.nodes import Node
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from nontwist.cli.shared_options import meaning, place


def literal(text: str) -> str:
    """Return words of a terminal as reStructuredText."""
    return f"``{text}``"


def plain(text: str) -> str:
    """Return prose in which nothing is markup."""
    return "".join(f"\\{c}" if c in "*`|_\\" else c for c in text)


def row(parameter: Any) -> list[str]:
    """Return one line of the table of arguments and options."""
    return [f"   * - {literal(place(parameter))}", f"     - {plain(meaning(parameter))}"]


def section(name: str, command: Any) -> list[str]:
    """Return the section of a command."""
    title = f"nontwist {name}"
    arguments = [p for p in command.params if p.param_type_name == "argument"]
    usage = " ".join(map(place, arguments))
    head = [title, "-" * len(title), "", ".. code-block:: text", "", f"   {title} [OPTIONS] {usage}".rstrip(), ""]
    words = [plain(paragraph.replace("\n", " ")) + "\n" for paragraph in command.help.split("\n\n")]
    table = [".. list-table::", "   :widths: 35 65", "   :class: options", ""]
    rows = [line for p in command.params if not p.hidden for line in row(p)]
    return [*head, *words, *table, *rows, ""]


class Commands(SphinxDirective):
    """All commands, in the order of `nontwist --help`."""

    def run(self) -> list[Node]:
        """Return the sections."""
        from nontwist.cli import app

        commands = typer.main.get_command(app).commands  # type: ignore[attr-defined]
        lines = [line for name, command in commands.items() for line in section(name, command)]
        return self.parse_text_to_nodes("\n".join(lines), allow_section_headings=True)


def setup(app: Sphinx) -> dict[str, bool]:
    """Offer the directive."""
    app.add_directive("commands", Commands)
    return {"parallel_read_safe": True}

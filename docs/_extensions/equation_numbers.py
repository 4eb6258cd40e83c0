"""The printed number of each label of the paper, on every page and in every docstring: "eq-stwo" is written "eq. 1".

A row that follows its label becomes a part of the number: "eq-standard (b)" is written "eq. 51b". The label is what the
pointer shows. On pages about labels, in titles, and in formulas of docstrings, which are literal blocks, it stays, with
the number behind it: "eq-stwo (1)". Labels in literal text within a line are spoken of as code and left alone.
"""

import re

from docutils import nodes
from sphinx.application import Sphinx

from nontwist.paper.tables import LABEL, printed, printed_numbers

CITED = re.compile(LABEL.pattern + r"(?: \(([a-d])\))?")
CLASS = "paper-number"
OF_LABELS = ("theory/concordance", "errata", "design", "contributing/integrator")  # pages


def cited(text: str) -> list[tuple[str, str, str]]:
    """Return a text in pieces: what stands there, a label that follows, and its printed number."""
    pieces, end = [], 0
    for match in CITED.finditer(text):
        label = match[0].partition(" ")[0]
        if label in printed_numbers():
            pieces.append((text[end : match.start()], label, printed(label, match[1] or "")))
            end = match.end()
    return [*pieces, (text[end:], "", "")]


def numbered(text: str) -> str:
    """Return a text with the numbers in it."""
    return "".join(f"{before}{label} {number}" if number else before for before, label, number in cited(text))


def named(number: str) -> str:
    """Return a printed number as it stands in a sentence: "eq. 51b", "Section 2.1"."""
    return f"eq.\N{NO-BREAK SPACE}{number[1:-1]}" if number.startswith("(") else number


def write_numbers(app: Sphinx, doctree: nodes.document) -> None:
    """Put numbers in the place of the labels of a page, or behind them."""
    for text in list(doctree.findall(nodes.Text)):
        parent, pieces = text.parent, cited(text.astext())
        if len(pieces) == 1 or isinstance(parent, (nodes.literal, nodes.raw, nodes.comment)) or ">>>" in text:
            continue
        if isinstance(parent, (nodes.FixedTextElement, nodes.title)):  # literal blocks; titles stand in menus as well
            parent.replace(text, nodes.Text(numbered(text.astext())))
            if isinstance(parent, nodes.literal_block):
                parent.rawsource = parent.astext()
            continue
        new: list[nodes.Node] = []
        for before, label, number in pieces:
            if number and app.env.docname not in OF_LABELS:
                about = nodes.abbreviation("", named(number), explanation=label, classes=[CLASS])
                new += [nodes.Text(before), about]
                continue
            new.append(nodes.Text(before + label))
            if number:
                new += [nodes.Text("\N{NO-BREAK SPACE}"), nodes.inline("", number, classes=[CLASS])]
        parent.replace(text, new)


def setup(app: Sphinx) -> dict[str, bool]:
    """Count labels when a page has been read, its docstrings included, and before menus are made of its titles."""
    app.connect("doctree-read", write_numbers, priority=100)
    return {"parallel_read_safe": True}

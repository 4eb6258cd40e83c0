"""The printed number beside each label of the paper, on every page and in every docstring: "eq-stwo (1)".

A row that follows its label becomes a part of the number: "eq-standard (b)" is written "eq-standard (51b)". Labels in
literal text within a line are spoken of as code and left alone; in formulas of docstrings, which are literal blocks, they
have their numbers.
"""

import re

from docutils import nodes
from sphinx.application import Sphinx

from nontwist.paper.labels import LABEL, printed, printed_numbers

CITED = re.compile(LABEL.pattern + r"(?: \(([a-d])\))?")
CLASS = "paper-number"


def cited(text: str) -> list[tuple[str, str]]:
    """Return a text in pieces: what stands there, and the number to be written behind it."""
    pieces, end = [], 0
    for match in CITED.finditer(text):
        label = match[0].partition(" ")[0]
        if label in printed_numbers():
            pieces.append((text[end : match.start()] + label, printed(label, match[1] or "")))
            end = match.end()
    return [*pieces, (text[end:], "")]


def numbered(text: str) -> str:
    """Return a text with the numbers in it."""
    return "".join(f"{before} {number}" if number else before for before, number in cited(text))


def write_numbers(app: Sphinx, doctree: nodes.document) -> None:
    """Put the numbers behind the labels of a page."""
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
        for before, number in pieces:
            new.append(nodes.Text(before))
            if number:
                new += [nodes.Text("\N{NO-BREAK SPACE}"), nodes.inline("", number, classes=[CLASS])]
        parent.replace(text, new)


def setup(app: Sphinx) -> dict[str, bool]:
    """Number labels when a page has been read, its docstrings included, and before menus are made of its titles."""
    app.connect("doctree-read", write_numbers, priority=100)
    return {"parallel_read_safe": True}

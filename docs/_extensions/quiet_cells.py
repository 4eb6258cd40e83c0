"""Cells do not say what they wait for: the lines that tell a reader at a terminal come and go with the load."""

import re

from docutils import nodes
from sphinx.application import Sphinx

WAITING = re.compile(r"^nontwist: (loading|compiling) .*\.\.\.\n?", re.MULTILINE)


def without_waiting(app: Sphinx, doctree: nodes.document) -> None:
    """Take the lines out of the output of cells, and the output with them where nothing else is left."""
    for block in list(doctree.findall(nodes.literal_block)):
        if "stream" in block["classes"] and WAITING.search(text := block.astext()):
            if rest := WAITING.sub("", text):
                block.rawsource = rest
                block[:] = [nodes.Text(rest)]
            else:
                block.parent.remove(block)


def setup(app: Sphinx) -> dict[str, bool]:
    """Do so when a page has been read."""
    app.connect("doctree-read", without_waiting)
    return {"parallel_read_safe": True}

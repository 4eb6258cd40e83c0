"""What cells print: not what they wait for, since those lines come and go with the load; figures have a text for all.

The alternative text of a figure that a cell has drawn is the title of its section.
"""

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


def with_texts(app: Sphinx, doctree: nodes.document) -> None:
    """Give the figures of cells a text."""
    for image in doctree.findall(nodes.image):
        section = image.parent
        while section is not None and not isinstance(section, nodes.section):
            section = section.parent
        if section is not None and not image.get("alt"):
            image["alt"] = f"Figure: {section.next_node(nodes.title).astext()}"


def setup(app: Sphinx) -> dict[str, bool]:
    """Do both when a page has been read."""
    app.connect("doctree-read", without_waiting)
    app.connect("doctree-read", with_texts)
    return {"parallel_read_safe": True}

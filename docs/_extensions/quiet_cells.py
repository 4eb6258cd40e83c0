"""What cells print, without lines that depend on the machine: what they wait for, and where warnings were raised.

The alternative text of a figure that a cell draws is the title of its section.
"""

import re

from docutils import nodes
from sphinx.application import Sphinx

WAITING = re.compile(r"^nontwist: (loading|compiling) .*\.\.\.\n?", re.MULTILINE)
PLACE = re.compile(r"^\S*ipykernel_\d+\S*: (\w*Warning: .*)\n  .*\n?", re.MULTILINE)


def tidy(app: Sphinx, doctree: nodes.document) -> None:
    """Remove lines of waiting from the output of cells, the output if nothing else is left, and places of warnings."""
    for block in list(doctree.findall(nodes.literal_block)):
        if not {"stream", "stderr"} & set(block["classes"]):
            continue
        text = block.astext()
        rest = PLACE.sub(r"\1\n", WAITING.sub("", text))
        if not rest.strip():
            block.parent.remove(block)
        elif rest != text:
            block.rawsource = rest
            block[:] = [nodes.Text(rest)]


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
    app.connect("doctree-read", tidy)
    app.connect("doctree-read", with_texts)
    return {"parallel_read_safe": True}

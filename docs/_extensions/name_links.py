"""Public names in literal text lead to the reference: `simulate`, `twist(motion)`, `exact.free_standard`."""

import re

from docutils import nodes
from sphinx.application import Sphinx

NAME = re.compile(r"(?:nontwist\.)?([A-Za-z_][\w.]*)(?:\(.*\))?", re.DOTALL)


def link_names(app: Sphinx, doctree: nodes.document, docname: str) -> None:
    """Put the links into a page, headings and the entries of the reference themselves left alone."""
    known = app.env.domains.python_domain.objects
    for literal in list(doctree.findall(nodes.literal)):
        match = NAME.fullmatch(literal.astext())
        entry = known.get(f"nontwist.{match[1]}") if match else None
        if entry is None or isinstance(literal.parent, (nodes.reference, nodes.title)):
            continue
        uri = f"{app.builder.get_relative_uri(docname, entry.docname)}#{entry.node_id}"
        link = nodes.reference("", "", internal=True, refuri=uri, reftitle=f"nontwist.{match[1]}")
        literal.parent.replace(literal, link)
        link += literal


def setup(app: Sphinx) -> dict[str, bool]:
    """Link when all names are known."""
    app.connect("doctree-resolved", link_names)
    return {"parallel_read_safe": True, "parallel_write_safe": True}

"""The first use of each term of the glossary on a page leads to the glossary.

Pages that explain are linked, not tables of numbers and the reference; words of everyday use are left alone.
"""

import re

from docutils import nodes
from sphinx.application import Sphinx

LINKED = re.compile(r"index|getting-started|faq|conventions|run-files|(tutorials|howto)/.*|theory/(?!concordance).*")
PLAIN = {"run", "member", "run file", "sweep", "tolerance", "orientation", "attitude", "angular velocity", "triad"}
PLAIN |= {"first integral", "torsion", "body frame", "moving frame", "invariant", "twist rate"}
PLAIN |= {"kernel", "node", "order", "stage", "step", "store"}
ALONE = (nodes.literal, nodes.reference, nodes.title, nodes.FixedTextElement, nodes.math, nodes.math_block, nodes.raw)


def is_prose(text: nodes.Text) -> bool:
    """Return whether a text is part of a sentence: no code, no heading, no link, and not written by a cell."""
    parent: nodes.Node | None = text.parent
    while parent is not None:
        if isinstance(parent, ALONE) or (isinstance(parent, nodes.container) and "cell" in parent.get("classes", ())):
            return False
        parent = parent.parent
    return True


def link_terms(app: Sphinx, doctree: nodes.document, docname: str) -> None:
    """Put the links into a page."""
    known = app.env.domains.standard_domain.objects
    places = {name.lower(): place for (kind, name), place in known.items() if kind == "term" and name not in PLAIN}
    if not LINKED.fullmatch(docname) or not places:
        return
    left = dict(places)
    for text in list(doctree.findall(nodes.Text)):
        if not left or not is_prose(text):
            continue
        words = "|".join(map(re.escape, sorted(left, key=len, reverse=True)))
        match = re.search(rf"\b({words})(?=s?\b)", text.astext(), re.IGNORECASE)
        if match is None:
            continue
        page, label = left[match[1].lower()]
        left = {name: place for name, place in left.items() if place != (page, label)}
        uri = f"{app.builder.get_relative_uri(docname, page)}#{label}"
        link = nodes.reference("", match[1], internal=True, refuri=uri, classes=["glossary-link"])
        whole = text.astext()
        text.parent.replace(text, [nodes.Text(whole[: match.start()]), link, nodes.Text(whole[match.end() :])])


def setup(app: Sphinx) -> dict[str, bool]:
    """Link when references have been resolved, and so all terms are known."""
    app.connect("doctree-resolved", link_terms)
    return {"parallel_read_safe": True, "parallel_write_safe": True}

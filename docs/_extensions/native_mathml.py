"""Formulas as MathML, which browsers draw themselves: pages need no script and no network."""

from xml.etree.ElementTree import SubElement, tostring
from xml.sax.saxutils import unescape

from docutils.nodes import SkipNode
from latex2mathml.converter import convert_to_element
from sphinx.application import Sphinx

PRIME, DOT = "&#x02032;", "&#x002D9;"  # as latex2mathml writes them
TIGHT = {"lspace": "0", "rspace": "0"}


def mathml(latex: str, display: str = "inline") -> str:
    """Return a formula as browsers draw it best: primes, which fonts raise, on the line, dots close to letters."""
    formula = convert_to_element(latex, display=display)
    for part in list(formula.iter()):
        if part.tag == "mover" and part[1].text == DOT:
            part.set("accent", "true")
        elif part.tag in ("msup", "msubsup") and part[-1].text == PRIME:
            base = list(part)[:-1]
            for child in list(part):
                part.remove(child)
            place = part if part.tag == "msup" else SubElement(part, "msub")
            place.extend(base)
            part.tag = "mrow"
            SubElement(part, "mo", TIGHT).text = PRIME
    return unescape(tostring(formula, encoding="unicode"))


def inline(self, node) -> None:
    """Write a formula within a line."""
    self.body.append(mathml(node.astext()))
    raise SkipNode


def block(self, node) -> None:
    """Write a formula of its own."""
    self.body.append(f'<div class="math">{mathml(node.astext(), "block")}</div>')
    raise SkipNode


def setup(app: Sphinx) -> dict[str, bool]:
    """Offer the renderer and choose it."""
    app.add_html_math_renderer("mathml", inline_renderers=(inline, None), block_renderers=(block, None))
    app.config.html_math_renderer = "mathml"
    return {"parallel_read_safe": True}

"""A page on which two bodies can be kicked, integrated live in the browser: `nontwist play`, and first in the docs.

The browser integrates: `step.js` is the step of `lie_midpoint` in JavaScript; a test compares it with the compiled one.
Sphere, dial, colours and themes are those of the viewer.
"""

from __future__ import annotations

import html
from functools import partial
from string import Template

from ..viewer import SHARED, View, own_text

__all__ = ["playground"]

TITLE = "Same kick, two bodies. One may not twist."
OWN = tuple(
    f"{name}.js" for name in ("step", "world", "presets", "words", "kick", "loop", "loop_hand", "sliders", "playground")
)


def playground() -> View:
    """Return the page, one HTML document that uses no network.

    Examples
    --------
    >>> from nontwist.playground import playground
    >>> playground().title
    'Same kick, two bodies. One may not twist.'
    """
    own = partial(own_text, package=__package__)
    page = Template(own("playground.html")).substitute(
        title=html.escape(TITLE),
        style=own_text("common.css") + own("playground.css"),
        script="\n".join([*map(own_text, SHARED), *map(own, OWN)]),
    )
    return View(page, TITLE)

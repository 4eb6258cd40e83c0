"""A page on which two bodies can be kicked, integrated live in the browser: `nontwist play`, and first in the docs.

The browser integrates: `step.js` is the step of `lie_midpoint` in JavaScript; a test compares it with the compiled one.
Sphere, dial, colours and themes are those of the viewer.
"""

from __future__ import annotations

import html
from importlib.resources import files
from string import Template

from ..viewer import SHARED, View

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
    own = files(__package__)
    shared = own.joinpath("..", "viewer")
    scripts = [*(shared.joinpath(name) for name in SHARED), *(own.joinpath(name) for name in OWN)]
    page = Template(own.joinpath("playground.html").read_text("utf-8")).substitute(
        title=html.escape(TITLE),
        style="".join(place.read_text("utf-8") for place in (shared / "common.css", own / "playground.css")),
        script="\n".join(place.read_text("utf-8") for place in scripts),
    )
    return View(page, TITLE)

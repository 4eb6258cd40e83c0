"""Figures for publication: one function each, drawn on given axes or on a new figure.

Each function takes a run, or several to compare with their labels, ``{"standard": run, "non-twisting": run2}``, and
returns its axes, which a notebook shows. `new_axes` makes figures one or two columns wide, `style` takes the widths and
the type of other journals, `save` writes files.
"""

from ..geometry.values import public
from .comparisons import work_precision
from .histories import (
    directors,
    energy,
    energy_drift,
    momenta,
    multipliers,
    orthonormality,
    reaction_moment,
    second_quotient,
)
from .journals import new_axes, save, style
from .spheres import path, polhode
from .timelines import twist_angle
from .tubes import ribbon, tube

__all__ = [
    "directors",
    "energy",
    "energy_drift",
    "momenta",
    "multipliers",
    "new_axes",
    "orthonormality",
    "path",
    "polhode",
    "reaction_moment",
    "ribbon",
    "save",
    "second_quotient",
    "style",
    "tube",
    "twist_angle",
    "work_precision",
]
public(__name__)

"""Figures that go into a paper unchanged: one function each, drawn on given axes or on a new figure."""

from .histories import energy, momenta, second_quotient
from .paths import path
from .twists import twist_angles, twist_path

__all__ = ["energy", "momenta", "path", "second_quotient", "twist_angles", "twist_path"]

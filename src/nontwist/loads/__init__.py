"""Loads as data: external moments along moving or fixed directions, or functions of the state."""

from .base import Load, as_load
from .catalogue import body_moment, damping, moment, pulse, sine, space_moment
from .terms import TERMS, Term

__all__ = ["TERMS", "Load", "Term", "as_load", "body_moment", "damping", "moment", "pulse", "sine", "space_moment"]

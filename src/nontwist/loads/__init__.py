"""Loads as data: external moments along moving or fixed directions, or functions of the state."""

from .base import Load
from .catalogue import body_moment, damping, moment, pulse, sine, space_moment

__all__ = ["Load", "body_moment", "damping", "moment", "pulse", "sine", "space_moment"]

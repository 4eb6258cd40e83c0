"""Inertias by recordings: least squares on the motion of a body that nobody touches."""

from .fits import fit_inertia
from .result import Fit

__all__ = ["Fit", "fit_inertia"]

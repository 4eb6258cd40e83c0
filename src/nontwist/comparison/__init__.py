"""Integrators side by side on one problem: `compare`, and what prints it, `summary` and `table`."""

from .choice import summary
from .comparing import compare
from .tables import table

__all__ = ["compare", "summary", "table"]

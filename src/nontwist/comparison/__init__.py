"""Comparison of integrators on one problem: `compare`, and its tables `summary` and `table`."""

from .choice import summary
from .comparing import compare
from .tables import table

__all__ = ["compare", "summary", "table"]

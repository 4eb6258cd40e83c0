"""Comparison of integrators on one problem: `compare`, and its tables `summary` and `table`."""

from ..analysis.precision import observed_order, second_quotient
from .choice import summary
from .comparing import compare
from .tables import table

__all__ = ["compare", "observed_order", "second_quotient", "summary", "table"]

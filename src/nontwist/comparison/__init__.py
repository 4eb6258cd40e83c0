"""Comparison of integrators on one problem: `compare`, and its tables `summary` and `table`."""

from ..analysis.statistics import observed_order, second_quotient
from ..geometry.values import public
from .comparing import compare
from .comparison_table import summary, table

__all__ = ["compare", "observed_order", "second_quotient", "summary", "table"]
public(__name__)

"""Verification of the package against known results: `validate`, its checks and their report."""

from .checks import GROUPS, KINDS, Check
from .references import REFERENCES
from .report import Validation
from .running import validate

__all__ = ["GROUPS", "KINDS", "REFERENCES", "Check", "Validation", "validate"]

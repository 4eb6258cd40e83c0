"""Verification of the package against known results: `validate`, its checks and their report."""

from .checks import GROUPS, KINDS, REFERENCES, Check, Validation, validate

__all__ = ["GROUPS", "KINDS", "REFERENCES", "Check", "Validation", "validate"]

"""Every oracle of the package, measured afresh: `validate`, and what it is made of."""

from .checks import GROUPS, KINDS, Check
from .references import REFERENCES
from .report import Validation
from .running import validate

__all__ = ["GROUPS", "KINDS", "REFERENCES", "Check", "Validation", "validate"]

"""One self-contained page on which a run can be watched."""

from .viewer import View, view

__all__ = ["View", "view"]

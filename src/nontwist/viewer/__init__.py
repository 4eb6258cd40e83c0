"""A self-contained HTML page that animates a run."""

from .viewer import View, view

__all__ = ["View", "view"]

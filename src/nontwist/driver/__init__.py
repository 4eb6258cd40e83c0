"""From a system, a start, a load and times to a run."""

from .runs import integrate, simulate

__all__ = ["integrate", "simulate"]

"""From a system, a start, a load and times to a run, or to many."""

from .ensembles import simulate_ensemble
from .runs import integrate, simulate
from .signals import sigterm_interrupts

__all__ = ["integrate", "sigterm_interrupts", "simulate", "simulate_ensemble"]

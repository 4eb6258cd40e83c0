"""From a system, a start, a load and times to a run, or to many."""

from .closed_loop import Stepper, StepperState, stepper
from .ensembles import simulate_ensemble
from .runs import integrate, simulate
from .signals import sigterm_interrupts

__all__ = ["Stepper", "StepperState", "integrate", "sigterm_interrupts", "simulate", "simulate_ensemble", "stepper"]

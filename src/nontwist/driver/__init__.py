"""From a system, a start, a load and times to a run, or to many."""

from .closed_loop import Stepper, StepperState, stepper
from .ensembles import simulate_ensemble
from .propagation import Propagator, propagator
from .runs import integrate, simulate
from .signals import sigterm_interrupts

__all__ = [
    "Propagator",
    "Stepper",
    "StepperState",
    "integrate",
    "propagator",
    "sigterm_interrupts",
    "simulate",
    "simulate_ensemble",
    "stepper",
]

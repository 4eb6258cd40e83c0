"""From a system, a start, a load and times to a run, or to many."""

from .closed_loop import Stepper, StepperState, stepper
from .derivatives import gradient, sensitivities
from .effort import LeastEffort, least_effort
from .ensembles import simulate_ensemble
from .events import axis_crosses, spin_below
from .exponents import lyapunov, lyapunov_ensemble
from .problem import Problem
from .propagation import Propagator, propagator
from .resampling import resample
from .runs import integrate, simulate
from .signals import sigterm_interrupts
from .starts import BodyState

__all__ = [
    "BodyState",
    "LeastEffort",
    "Problem",
    "Propagator",
    "Stepper",
    "StepperState",
    "axis_crosses",
    "gradient",
    "integrate",
    "least_effort",
    "lyapunov",
    "lyapunov_ensemble",
    "propagator",
    "resample",
    "sensitivities",
    "sigterm_interrupts",
    "simulate",
    "simulate_ensemble",
    "spin_below",
    "stepper",
]

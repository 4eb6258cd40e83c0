"""Classes of what functions return: runs, states, steppers, propagators, controls, fits."""

from .analysis.trajectory import Trajectory
from .driver.closed_loop import Stepper, StepperState
from .driver.effort import LeastEffort
from .driver.ensembles import Propagator
from .driver.starts import BodyState
from .driver.steering import Steering
from .fitting.result import Fit
from .geometry.values import public

__all__ = ["BodyState", "Fit", "LeastEffort", "Propagator", "Steering", "Stepper", "StepperState", "Trajectory"]
public(__name__)

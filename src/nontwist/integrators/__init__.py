"""Integrators: a visible dict of frozen dataclasses, each with one march."""

from .base import Integrator, Problem, SimulationError, Status
from .continuous import Continuous
from .energy_momentum import EnergyMomentum
from .lie_midpoint import LieMidpoint

INTEGRATORS: dict[str, type[Integrator]] = {
    LieMidpoint.name: LieMidpoint,
    EnergyMomentum.name: EnergyMomentum,
    Continuous.name: Continuous,
}

__all__ = [
    "INTEGRATORS",
    "Continuous",
    "EnergyMomentum",
    "Integrator",
    "LieMidpoint",
    "Problem",
    "SimulationError",
    "Status",
]

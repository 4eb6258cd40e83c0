"""Integrators: a visible dict of frozen dataclasses, each with one march."""

from .base import Integrator, Problem, SimulationError, Status
from .reference import EnergyMomentum

INTEGRATORS: dict[str, type[Integrator]] = {EnergyMomentum.name: EnergyMomentum}

__all__ = ["INTEGRATORS", "EnergyMomentum", "Integrator", "Problem", "SimulationError", "Status"]

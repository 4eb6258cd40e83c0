"""Loads as data: external moments, forces on directors, potentials."""

from .catalogue import (
    body_moment,
    constant,
    damping,
    director_forces,
    dry_friction,
    memory_load,
    moment,
    pulse,
    rotor,
    sine,
    space_moment,
    wheel,
)
from .conservative import dipole, gravity_gradient, potential, spring
from .kinds import LOADS
from .load import Load, as_load
from .memory_terms import Memory
from .potentials import DirectorForces, Potential
from .terms import Term

__all__ = [
    "LOADS",
    "DirectorForces",
    "Load",
    "Memory",
    "Potential",
    "Term",
    "as_load",
    "body_moment",
    "constant",
    "damping",
    "dipole",
    "director_forces",
    "dry_friction",
    "gravity_gradient",
    "memory_load",
    "moment",
    "potential",
    "pulse",
    "rotor",
    "sine",
    "space_moment",
    "spring",
    "wheel",
]

"""Loads as data: external moments, forces on directors, potentials."""

from .base import Load, as_load
from .catalogue import body_moment, damping, dry_friction, moment, pulse, rotor, sine, space_moment
from .forces import DirectorForces
from .generalised import dipole, director_forces, gravity_gradient, potential, spring
from .kinds import LOADS
from .potentials import Potential
from .terms import Term

__all__ = [
    "LOADS",
    "DirectorForces",
    "Load",
    "Potential",
    "Term",
    "as_load",
    "body_moment",
    "damping",
    "dipole",
    "director_forces",
    "dry_friction",
    "gravity_gradient",
    "moment",
    "potential",
    "pulse",
    "rotor",
    "sine",
    "space_moment",
    "spring",
]

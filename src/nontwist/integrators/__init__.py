"""Integrators: the dict `INTEGRATORS` of frozen dataclasses, each with one `march`, and the name of the default."""

from ..errors import SimulationError as SimulationError
from ..errors import SimulationInterrupt as SimulationInterrupt
from ..errors import Status as Status
from ..geometry.values import Registry, public
from .continuous import Continuous
from .energy_momentum import EnergyMomentum
from .exact_solution import Exact
from .gauss import Gauss
from .integrator import IVP as IVP
from .integrator import Integrator as Integrator
from .integrator import unregistrable
from .lie_midpoint import LieMidpoint
from .split import Split

_known = {scheme.name: scheme for scheme in (Gauss, LieMidpoint, EnergyMomentum, Split, Exact, Continuous)}
INTEGRATORS: Registry[type[Integrator]] = Registry(_known, unregistrable, "give the integrator another name")
"""The integrators by name, as accepted by `integrator=`."""

DEFAULT = Gauss.name
"""The integrator of runs, ensembles, propagators, run files and sweeps that name none."""

__all__ = ["INTEGRATORS", "Continuous", "EnergyMomentum", "Exact", "Gauss", "LieMidpoint", "Split"]
public(__name__)

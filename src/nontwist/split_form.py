"""The split form of the equations: a part in the tangent plane at the director of the axis, and a part along it."""

from .geometry.values import public
from .models.equations import energy, momentum, rates, velocity
from .models.system import split_inertia

__all__ = ["energy", "momentum", "rates", "split_inertia", "velocity"]
public(__name__)

"""The changes of a prescribed spin in the steps of a march.

In a step W3 goes along the chord between c at both ends, a polynomial of a degree not above the number of stages, so
W3 = c at every node, whatever the grid is: of a table whose kinks are nodes it is c itself, and the order is that of
the scheme.
"""

from __future__ import annotations

import numpy as np

from ..geometry.arrays import Array
from ..models.stack import SystemStack

REFUSAL = "{} does not accept a prescribed spin; use the integrator gauss"


def at_nodes(systems: SystemStack, begin: Array, end: Array, middles: Array, unit: float) -> Array | None:
    """Return the change of the shared spin in steps, times the unit of time, at all nodes, (nodes,); None: constant."""
    if systems.spin is None or systems.spin.is_constant:
        return None
    return np.repeat((systems.spin.at(end) - systems.spin.at(begin)) * unit, len(middles))

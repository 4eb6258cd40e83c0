"""The momenta of rotors at the nodes of a march.

Within a step the momentum c(t) of the rotors is taken as the chord between its values at both ends,

    c(t_n + θh) = c_n + θ (c_{n+1} - c_n),        c' = (c_{n+1} - c_n)/h,

which it is anyway where the kinks of its table are nodes. So the impulses of the steps add up to c at every node,
whatever the grid is, and with them the schemes keep the total momentum π + Λc exactly: with the mean momentum Q of the
step `lie_midpoint` has ``ΔP + Δc = h (Q + c_m) × Ω``, the free step of the total momentum, and `gauss` a bilinear
function Λ (P + c), as c is a polynomial of a degree not above the number of stages. A rotor of constant momentum is
drag with a skew matrix, ``c × W``, and does no work; as it spins up its work is ``-h c'·W``, W of the step.
"""

from __future__ import annotations

import numpy as np

from ..geometry.arrays import Array
from ..loads import Load


def at_nodes(load: Load, begin: Array, end: Array, length: Array, middles: Array, unit: float) -> Array:
    """Return the momentum of the rotors over the unit of time, and its rate, at the nodes of some steps, (nodes, 6).

    `begin`, `end` and `length` are those of the steps, `middles` the nodes of one, as fractions.
    """
    first = load.rotor_momentum(begin)
    change = load.rotor_momentum(end) - first
    found = np.empty((len(begin), len(middles), 6))
    found[:, :, :3] = (first[:, None] + middles[:, None] * change[:, None]) / unit
    found[:, :, 3:] = (change / length[:, None])[:, None]
    return found.reshape(-1, 6)

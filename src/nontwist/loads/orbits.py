"""Where a body is on an elliptic orbit, by Kepler's equation.

The eccentric anomaly E belongs to the mean one M by ``f(E) = E - e sin E - M = 0``, 0 <= e < 1. In the plane, perigee
first, radius and distance over the major half-axis are

    r/a = (cos E - e, sqrt(1 - e²) sin E),        |r|/a = 1 - e cos E = 1 - e + 2e sin²(E/2).

Newton's iteration. E is odd and ``E - M`` has the period 2π, so let 0 <= M <= π; then f' >= 1 - e > 0 and f'' = e sin E
>= 0 on [0, π]. M + e, M/(1 - e) and π bound the solution: f >= 0 there, as sin E <= 1, sin E <= E, and f(π) = π - M.
From the least of them each iterate of a convex growing function lies between the solution and the one before, so the
iterates fall, each at least to 2/3 of its distance (f near cubic, e near 1) and quadratically in the end, until f is 0
up to the round-off of its terms: after at most 32 iterations for any e that is a double, 3 to 5 up to e = 0.9. One more
on the numbers as they are, with derivatives or without, gives derivatives by M and e.

The moment of the gravity gradient, 3 n² (a/|r|)³ c × J c, is that of a circular orbit whose vector c has the length
(a/|r|)^{3/2}; n = sqrt(GM/a³).
"""

from __future__ import annotations

import math
from typing import Any

from ..kernels.control import Variables, whilst
from ..kernels.dual import plain
from ..kernels.elements import any_of, copysign, cos, floor, larger, sin, smaller, sqrt

NOISE = 2.0**-51  # of f, over E: above the round-off of its terms


def on_orbit(M: Any, e: Any) -> tuple[Any, Any]:
    """Return (a/|r|)^{3/2} times the direction of the radius, along perigee and along the velocity there."""
    turns = 2.0 * math.pi * floor(plain(M) / (2.0 * math.pi) + 0.5)
    m, k = plain(M) - turns, plain(e)
    size = abs(m)

    v = Variables(E=smaller(smaller(size + k, size / (1.0 - k)), 0.0 * size + math.pi))
    v.f = v.E - k * sin(v.E) - size
    for _ in whilst(lambda: any_of(v.f > NOISE * v.E)):
        v.E = v.E - larger(v.f, 0.0 * v.f) / (1.0 - k * cos(v.E))
        v.f = v.E - k * sin(v.E) - size
    E = copysign(v.E, m)
    E = E - (E - e * sin(E) - (M - turns)) / (1.0 - e * cos(E))
    half = 2.0 * sin(0.5 * E) * sin(0.5 * E)
    distance = 1.0 - e + e * half
    length = 1.0 / (distance * distance * sqrt(distance))
    return length * (1.0 - e - half), length * sqrt((1.0 - e) * (1.0 + e)) * sin(E)

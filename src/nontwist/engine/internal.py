"""Internal states z of loads with memory in the middle of a step, which is all that midpoint steps ask for.

    z_m = z_n + ½ h f(t_m, z_m, Λ_m, w_m),        z_{n+1} = z_n + h f(t_m, z_m, Λ_m, w_m).

The first line is solved wherever moments are asked for, always from z_n on: what is found depends on Λ_m and w_m alone.
So the unknowns of a step stay three, and differences of its moments know how z follows Ω. It is solved by fixed points;
where they contract by less than a quarter, by Newton's iteration.

A moment M along the frame is Λ_m M in space. That of a part that turns in the body with the momentum n z, on which the
moment f acts, is M = n z_m × Ω - n f. As z_m is the mean of z_n and z_{n+1}, and h f their difference, it is what
rotors of momentum n z do in a step: the total momentum Λ (P + n z) changes by moments from outside alone
(`integrators.lie_midpoint`, `energy_momentum`). The work of M is -h f n·Ω, and ``½ Δ(z²/I) = h f z_m/I`` for a wheel of
moment of inertia I: together h f (z_m/I - n·Ω), the work on it at its speed relative to the body.
"""

from __future__ import annotations

from typing import Any

from ..kernels.control import Variables, loop, when, whilst
from ..kernels.elements import larger, logical_not, select, without
from ..kernels.kernel import part
from ..kernels.memory import View, call, put, scratch, size_of, vector_at
from ..kernels.vectors import Vector
from ..loads.functions import MOMENTS
from ..loads.memory_terms import STATE
from .newton import EPS, Blocks, Scratch
from .records import Called, Parts
from .workspace import NAN, internal

DIFFERENCE, CONTRACTS, CLOSE, ITERATIONS = 2.0**-26, 0.25, 1e-9, 40  # CLOSE: a change before one that is round-off


def call_all(functions: Any, count: int, states: int, t: Any, first: Any, second: Any, found: Any) -> None:
    """Write the sum of so many numbers of each function times its factor; z' of one and the other follow.

    It is no part: a passage more, and a sum of one, take as long as a short function itself.
    """
    own, v, number = scratch(count + states), Variables(place=0), functions.shifted(0, True)[0]
    for c in range(count):
        found[c] = 0.0
    only = View(Called, functions.shifted(1))
    is_alone = (number == 1) & (only.factor == 1.0)
    for _ in when(is_alone):
        call(only.function, t, first, second, found)
    for k in loop(select(is_alone, 0, number)):
        one = View(Called, functions.shifted(1 + size_of(Called) * k))
        call(one.function, t, first, second.shifted(v.place), own)
        for c in range(count):
            found[c] = one.factor * own[c] + found[c]
        for c in loop(one.states if states else 0):
            found[count + v.place + c] = own[count + c]
        v.place = v.place + one.states


@part
def respond(parts: Parts, b: View, state: View, W: Vector) -> tuple[Vector, Vector, Any]:
    """Return the moments in space and along the frame, and NaN where z is not found, else 0; set the change of z.

    `state` has time, directors and w of one body; W is w along its frame. Changes count relative to the scale of z, or
    to z where it is larger.
    """
    k, own, scales, f = parts.memory, internal(b), b.internal_scales, 0.5 * b.step[0] / b.step[1]
    n = -(-k // 3) * 3  # as elimination needs it
    given, z, change, found = scratch(STATE), scratch(k), scratch(k), scratch(MOMENTS + k)
    equations = Blocks(Scratch(scratch(n * (n + 1)), 1), n, n + 1)
    put(given, (*state.directors, state.w, W))
    for c in loop(k):
        change[c] = 0.0
    for c in loop(n * (n + 1)):
        equations.memory[c] = 0.0

    def size(c: Any) -> Any:
        return larger(abs(own[c] + change[c]), scales[c])

    v = Variables(count=0, now=0.0, before=EPS, zero=0.0, is_newton=False, is_found=False, ends=False, goes=True)
    for _ in whilst(lambda: v.goes):
        v.goes = logical_not(v.ends)
        is_new = v.goes & v.is_newton
        for q in loop(select(is_new, 0, k), k + 1):  # after a change of each of z, and without
            for c in loop(k):
                z[c] = own[c] + change[c] + select(c == q, DIFFERENCE * size(c), 0.0)
            call_all(b.responses, MOMENTS, k, state.t, given, z, found)
            for c in loop(k):
                equations.row(c)[select(q == k, n, q)] = f * found[MOMENTS + c] - change[c]
        for _ in when(is_new):
            for c in loop(n):
                row = equations.row(c)
                for q in loop(k):
                    row[q] = (row[n] - row[q]) / (DIFFERENCE * size(q))
                row[c] = row[c] + 1.0
            equations.solve()
        for _ in when(v.goes):
            v.now = 0.0
            for c in loop(k):
                v.now = v.now + abs(equations.row(c)[n]) / size(c)
            v.is_found = (v.now * v.now <= EPS * v.before) | (v.is_newton & (v.now <= CLOSE))
            is_slow = logical_not((v.now <= CONTRACTS * v.before) | (v.count == 0) | v.is_found | v.is_newton)
            for c in loop(k):  # Newton's iteration begins anew
                change[c] = select(is_slow, 0.0, change[c] + equations.row(c)[n])
            v.ends = v.is_found | without(v.is_newton, v.now > CLOSE) | (v.count >= ITERATIONS)
            v.before, v.count, v.is_newton = select(is_slow, EPS, v.now), v.count + 1, v.is_newton | is_slow
    for c in loop(k):
        own[2 * k + c] = 2.0 * f * found[MOMENTS + c]
        v.zero = v.zero + 0.0 * found[MOMENTS + c]
    space = Vector(*(x + v.zero for x in vector_at(found)))
    return space, vector_at(found, 3), select(v.is_found, 0.0, NAN)

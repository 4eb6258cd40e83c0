"""Between what a caller sees of states and what a march carries."""

from __future__ import annotations

from typing import Any

from ..kernels.control import Variables, loop, when
from ..kernels.elements import larger, select
from ..kernels.kernel import kernel
from ..kernels.memory import View, doubles, fields, put, vector_at
from ..kernels.vectors import Quaternion, Symmetric, Vector
from .records import Block, Body, State
from .workspace import carried_internal, turned_into

EPS = 2.0**-52
ROUND_OFF = 16.0 * EPS
AUXILIARY = fields(State)["auxiliary"].place


@kernel("i8")
def enter(address: Any) -> None:
    """Set the states of all members from the first of those stored, in the frames and units of the bodies.

    Round-off of N, and of W along a constrained axis without spin, is taken away; all of the latter unless N is
    carried. With N goes W, else the momentum.
    """
    b = View(Block, doubles(address))
    unit, has_normal, is_constrained = 1.0 / b.step[1], b.director != 0, b.is_constrained != 0
    for i in loop(b.members):
        body, row = View(Body, b.bodies.shifted(i * b.body_stride)), b.states.shifted(i * b.state_size)
        q, w = b.quaternions.shifted(4 * i * b.kept), b.velocities.shifted(3 * i * b.kept)
        state, B = View(State, row), body.basis
        for k in loop(b.state_size):
            row[k] = 0.0
        z, own = b.internals.shifted(i * b.kept * b.internal), carried_internal(b, i)
        for k in loop(b.internal):
            own[k] = z[k]
        state.p = Quaternion(q[3], q[0], q[1], q[2]) @ body.frame
        W = unit * (vector_at(w) @ B)
        largest = larger(abs(W[0]), larger(abs(W[1]), abs(W[2])))
        is_noise = is_constrained & (body.k[2] == 0.0) & ((b.director == 0) | (abs(W[2]) <= ROUND_OFF * largest))
        W = Vector(W[0], W[1], select(is_noise, 0.0, W[2]))
        v = Variables(s=W)
        for _ in when(b.director == 0):
            v.s = body.read().momentum_of(W)
        state.s = v.s
        for _ in when(has_normal & (b.normals.address != 0)):
            given = b.normals.shifted(6 * i * b.kept)
            N = turned_into(B.T, Symmetric(*(given[k] for k in range(6))))
            put(row, tuple(select(abs(unit * x) > ROUND_OFF * largest, unit * x, 0.0) for x in N), AUXILIARY)

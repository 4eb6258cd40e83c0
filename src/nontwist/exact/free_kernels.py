"""Compiled free motions: of a rigid body in theta functions, and about a fixed axis; `free_bodies` derives them.

`free_top` gives rotations, `free_members`, which the integrator calls, quaternions. All states are the start and
increments (`free_step`). Chained calls must not drift: each starts from an orthonormal attitude, and adds to W what the
motion changes it by, ``W + Vᵀ ΔP/I`` along the principal axes V, so that neither the round-off of V, which would
multiply W by Vᵀ V at every call, nor a normalisation of the momentum adds up.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ..geometry.arrays import Array
from ..kernels.control import Variables, loop, when
from ..kernels.elements import select, sin, sqrt
from ..kernels.kernel import kernel
from ..kernels.memory import View, matrix_at, put, scratch, vector_at, view_in
from ..kernels.vectors import Matrix, Quaternion, Vector, cross
from .free_constants import BAD_TIME, CONSTANTS, FARTHEST, OK, Constants, principal_axes, to_orthonormal
from .free_step import Motion, free_motion, free_until, set_origin

Moved = Callable[[Any], tuple[Any, Any, Any, Vector]]  # from the time to a status, W, and less and v of the turn


def _prepared(J: Matrix, W: Vector, c: View) -> tuple[Matrix, Vector, Motion]:
    """Set the constants; return the principal axes and moments, and the motion."""
    V, I = principal_axes(J)
    motion = free_motion(I, I * (V @ W), c)
    set_origin(motion, c)
    return V, I, motion


@kernel("f8[:, :], f8[:], f8[:]")
def prepare(J: Any, W: Any, c: Any) -> None:
    """Set the constants `c` (CONSTANTS,) of a free body."""
    _prepared(matrix_at(J), vector_at(W), view_in(Constants, c))


def _free(J: Matrix, W: Vector) -> Moved:
    """Return what moves a free body."""
    c = View(Constants, scratch(CONSTANTS))
    V, I, motion = _prepared(J, W, c)
    D = Matrix(*(row / moment for row, moment in zip(V, I, strict=True)))  # ΔW = ΔP D

    def moved(t: Any) -> tuple[Any, Any, Any, Vector]:
        status, dP, less, v = free_until(motion, t, c)
        return status, W + dP @ D, less, v @ V

    return moved


def _steady(W: Vector) -> Moved:
    """Return what turns a body about the constant W."""
    rate = sqrt(W @ W)

    def moved(t: Any) -> tuple[Any, Any, Any, Vector]:
        half = 0.5 * rate * t
        quarter = sin(0.5 * half)
        turn = select(rate > 0.0, sin(half) / rate, 0.5 * t) * W
        return select(abs(t) * rate <= FARTHEST, OK, BAD_TIME), W, -2.0 * quarter * quarter, turn

    return moved


@kernel("f8[:, :], f8[:], f8[:, :], f8[:], i8, f8[:, :, :], f8[:, :] -> i8")
def free_top(J: Any, W: Any, R: Any, times: Any, is_constrained: Any, attitudes: Any, velocities: Any) -> Any:
    """Set the attitudes (k, 3, 3) and the material angular velocities (k, 3) of a free body; return a status."""
    W, R = vector_at(W), matrix_at(R)
    v, D = Variables(status=OK), to_orthonormal(R)

    def follow(moved: Moved) -> None:
        for k in loop(times.shape[0], whilst=lambda: v.status == OK):
            v.status, velocity, less, turn = moved(times[k])
            put(velocities[k], velocity)
            for i, (row, rest) in enumerate(zip(R, D, strict=True)):  # R (I + 2 (1 + less) v̂ + 2 v̂²), row by row
                a = cross(row, turn)
                put(attitudes[k, i], row + (rest + 2.0 * (1.0 + less) * a + 2.0 * cross(a, turn)))

    for _ in when(is_constrained == 0):
        follow(_free(matrix_at(J), W))
    for _ in when(is_constrained != 0):
        follow(_steady(W))
    return v.status


def turns(R: Array, axis: Array, angles: Array) -> Array:
    """Return the attitudes ``R exp(angle hat(axis))``, (k, 3, 3), for a unit `axis` in the body (eq-rodrigues)."""
    once, twice = np.cross(R, axis), np.outer(R @ axis, axis) - R
    half = np.sin(0.5 * angles)
    s, c = 2.0 * half * half, 2.0 * half * np.cos(0.5 * angles)
    found: Array = R.ravel() + c[:, None] * once.ravel() + s[:, None] * twice.ravel()
    return found.reshape(-1, 3, 3)


@kernel("f8[:, :, :], i8, f8[:], i8, i8, i8, f8[:, :, :], f8[:, :, :] -> i8, i8")
def free_members(
    bodies: Any, is_constrained: Any, times: Any, place: Any, first: Any, last: Any, attitudes: Any, velocities: Any
) -> tuple[Any, Any]:
    """Set the quaternions (m, k, 4), scalar last, and W (m, k, 3) of free bodies at `times` since the start.

    The starts are at index 0; the states at `times` begin at index `place`. `bodies` (m or 1, 3, 3): convected inertia.
    Returns a status and the member that it is about.
    """
    v = Variables(status=OK, member=0)
    for i in loop(first, last, whilst=lambda: v.status == OK):
        J, W, row = bodies[select(bodies.shape[0] > 1, i, 0)], vector_at(velocities[i, 0]), attitudes[i, 0]
        p = Quaternion(row[3], row[0], row[1], row[2])
        p = p / sqrt(p[0] * p[0] + p.vector @ p.vector)

        def follow(moved: Moved, i: Any = i, p: Quaternion = p) -> None:
            s = Variables(p=p, status=OK)
            for k in loop(times.shape[0], whilst=lambda: s.status == OK):
                s.status, velocity, less, turn = moved(times[k])
                u = p.vector
                q = p + Quaternion(less * p[0] - u @ turn, *(less * u + p[0] * turn + cross(u, turn)))
                s.p = select(q[0] * s.p[0] + q.vector @ s.p.vector < 0.0, -q, q)  # no jump of sign
                put(attitudes[i, place + k], (*s.p[1:], s.p[0]))
                put(velocities[i, place + k], velocity)
            v.status = s.status

        for _ in when(is_constrained != 0):
            follow(_steady(W))
        for _ in when(is_constrained == 0):
            follow(_free(matrix_at(J), W))
        for _ in when(v.status != OK):
            v.member = i
    return v.status, v.member

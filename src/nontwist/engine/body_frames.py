"""What the march knows of bodies: frames in which the equations are short, units in which numbers are near 1.

Units. A power of two times a number changes no bit of it, and none of what is made of it by + - * / and square roots.
So lengths of time are counted in the largest power of two T below the step, inertias in the one, M, below the trace of
E: multiply all masses, lengths or times of a problem by powers of two and every number of the march is the same. Nor
can a square overflow or vanish where the numbers of a problem are far from 1.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from ..geometry.arrays import Array
from ..geometry.attitudes import quaternion_column
from ..loads import Load
from ..models.stack import SystemStack
from ..models.system import HingedSystem
from .records import BODY

ONE = np.ones(1)
ROUND_OFF = 16 * float(np.finfo(np.float64).eps)


def power_of_two(x: Array) -> Array:
    """Return the largest power of two that is not above x > 0, within 2^±480, whose squares are numbers."""
    return np.ldexp(1.0, np.clip(np.frexp(x)[1] - 1, -480, 480))


def body_rows(systems: SystemStack, load: Load, time_unit: float, scale: Array = ONE, principal: bool = False) -> Array:
    """Return the numbers of each body, (m, BODY.size); damping is times `scale`.

    `principal`: the scheme takes constrained axes for principal ones, and wants principal moments in ascending order.
    """
    fixed, basis, M = (_fixed_of_one if len(systems) == 1 else _fixed_rows)(systems, principal)
    rows, force = fixed.copy(), time_unit * time_unit / M
    rows[:, BODY.dead : BODY.damping] *= force[:, None]
    rows[:, BODY.unit] = 1 / force
    if load.terms:
        C = load.damping
        if C.any():
            turned = basis.swapaxes(1, 2) @ (scale[:, None, None] * C) @ basis
            rows = np.broadcast_to(rows, (len(turned), BODY.size)).copy()
            rows[:, BODY.damping : BODY.axis] = turned.reshape(len(rows), 9) * force[:, None] / time_unit
    return rows


def _fixed_rows(systems: SystemStack, principal: bool) -> tuple[Array, Array, Array]:
    """Return rows whatever loads act and however long steps are, dead forces as they are; the frames, and M."""
    basis, E, M = frames(systems)
    m, free = len(systems), systems.axis is None
    e = E[:, range(3), range(3)]
    e[(e < 0) & (e > -ROUND_OFF)] = 0.0
    if principal and free:
        order = np.argsort(-e, axis=1, kind="stable")
        e, basis = np.take_along_axis(e, order, 1), np.take_along_axis(basis, order[:, None], 2)
        basis[:, :, 0] *= np.sign(np.linalg.det(basis))[:, None]
    J = e[:, [1, 2, 0]] + e[:, [2, 0, 1]]
    off = -E[:, 2, :2] * (not free)
    off[abs(off) <= ROUND_OFF * J.max(1)[:, None]] = 0.0
    row = np.zeros((m, BODY.size))
    spins = systems.spin is not None
    row[:, BODY.k : BODY.off] = 1 / np.where([False, hinged_of(systems) is not None, not (free or spins)], np.inf, J)
    row[:, BODY.spin] = systems.spin_factor if spins else 0.0
    row[:, BODY.off : BODY.free], row[:, BODY.free], row[:, BODY.E : BODY.basis] = off, free, e
    row[:, BODY.basis : BODY.frame] = basis.reshape(m, 9)
    row[:, BODY.frame : BODY.dead] = quaternions_scalar_first(basis)
    row[:, BODY.dead : BODY.damping] = (basis.swapaxes(1, 2) @ systems.dead_force).reshape(m, 9)
    row[:, BODY.axis : BODY.vertical] = basis[:, 2] if free else (0, 0, 1)
    row[:, BODY.vertical : BODY.dissipation] = systems.vertical
    return row, basis, M


_fixed_of_one = lru_cache(maxsize=64)(_fixed_rows)


def hinged_of(systems: SystemStack) -> HingedSystem | None:
    """Return the body if it is one that can turn about one axis of it alone."""
    return one if len(systems) == 1 and isinstance(one := systems[0], HingedSystem) else None


def frames(systems: SystemStack) -> tuple[Array, Array, Array]:
    """Return the frames b, columns in body components, the Euler inertias in them over M, and M: (m, 3, 3) and (m,)."""
    M = power_of_two(np.trace(systems.euler_inertia, axis1=1, axis2=2))
    E = systems.euler_inertia / M[:, None, None]
    if systems.axis is None:
        basis = principal_frames(E)
    elif (hinged := hinged_of(systems)) is not None:
        basis = hinged.frame[None]
    else:
        basis = bases_of(systems.axis)
        basis[:, :, :2] = basis[:, :, :2] @ principal_frames((basis.swapaxes(1, 2) @ E @ basis)[:, :2, :2])
    return basis, basis.swapaxes(1, 2) @ E @ basis, M


def principal_frames(A: Array) -> Array:
    """Return the eigenvectors of symmetric matrices as columns of rotations; those of diagonal ones are left alone."""
    n = A.shape[1]
    vectors: Array = np.broadcast_to(np.eye(n), A.shape).copy()
    full = np.flatnonzero((A * (1 - np.eye(n))).any(axis=(1, 2)))
    if len(full):
        found = np.linalg.eigh(A[full])[1]
        found[:, :, 0] *= np.where(np.linalg.det(found) < 0, -1.0, 1.0)[:, None]
        vectors[full] = found
    return vectors


def bases_of(axis: Array) -> Array:
    """Return the frames, as columns, that the smallest rotations of E3 to ±`axis` give, (m, 3, 3)."""
    sign = np.where(axis[:, 2] >= 0, 1.0, -1.0)
    x, y, z = (axis * sign[:, None]).T
    f = 1 / (1 + z)
    rows = (1 - x * x * f, -x * y * f, x, -x * y * f, 1 - y * y * f, y, -x, -y, z)
    basis: Array = np.stack(rows, axis=1).reshape(-1, 3, 3)
    basis[:, :, 1:] *= sign[:, None, None]
    return basis


def quaternions_scalar_first(R: Array) -> Array:
    """Return unit quaternions, scalar first, of rotations (m, 3, 3)."""
    p = quaternion_column(R)
    p /= np.sqrt((p * p).sum(1))[:, None]
    return p

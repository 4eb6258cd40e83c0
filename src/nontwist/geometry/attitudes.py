"""States of a body: the unit quaternion of Λ (scalar last), W, and N; and the directors that they stand for.

Director velocities are tangent, ``d_i' = w × d_i``, but for the symmetric matrix N of the energy-momentum scheme:
``d_i' = Λ (W × e_i + N e_i)``. N is given by its entries 11, 22, 33, 23, 13, 12. All is done by plain sums over
components, so that each state has bits of its own, whatever its neighbours.

**Euler angles**, and their rates, in SciPy's letters. Capitals are axes that turn with the body, Λ = R_a(φ1) R_b(φ2)
R_c(φ3), so that in body components

    W = T φ',        T = [(R_b R_c)ᵀ a, R_cᵀ b, c],        det T = (R_bᵀ a)·(b × c):

± sin φ2 where a and c are one axis, else ± cos φ2. Small letters are fixed axes, and the reverse order: those of
``xyz`` are φ3, φ2, φ1 of ``ZYX``. In gimbal lock, det T = 0, the outer axes are parallel: of their angles only the sum
or difference is determined, SciPy makes the third 0, and their rates are infinite for a velocity across.
"""

from __future__ import annotations

import re
import warnings
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from .arrays import Array, axial, cross, dot

LEVI = np.zeros((3, 3, 3))  # (a × b)_c = LEVI[c, i, j] a_i b_j
for _i, _j, _k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
    LEVI[_i, _j, _k], LEVI[_i, _k, _j] = 1.0, -1.0
ENTRIES = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))  # of a symmetric matrix, in this order everywhere
BASIS = np.zeros((6, 3, 3))  # the derivatives of a symmetric matrix by these
for _n, (_i, _j) in enumerate(ENTRIES):
    BASIS[_n, _i, _j] = BASIS[_n, _j, _i] = 1.0


def hats(a: Array) -> Array:
    """Return the matrices of ``a ×``, (n, 3, 3), of vectors (n, 3)."""
    return np.einsum("cij,ni->ncj", LEVI, a)


ROWS, COLUMNS = map(list, zip(*ENTRIES, strict=True))  # of the entries of a symmetric matrix
PLACES = [[0, 5, 4], [5, 1, 3], [4, 3, 2]]  # of the entries in the matrix


class States(NamedTuple):
    """States along any leading axes."""

    quaternion: Array  # (..., 4) scalar last, of unit length
    velocity: Array  # (..., 3) W
    normal: Array | None = None  # (..., 6) N, None where it is zero
    directors: Array | None = None  # (..., 2, 3, 3) d_i and d_i' where they are carried, and leave SO(3) by an error
    internal: Array | None = None  # (..., k) internal states of loads with memory

    def part(self, *index: Any) -> States:
        """Return the indexed states."""
        return States(*(None if array is None else array[index] for array in self))  # type: ignore[arg-type]


def attitudes(quaternion: Array) -> Array:
    """Return Λ (..., 3, 3) of quaternions (..., 4), scalar last: orthonormal to round-off whatever their length."""
    return np.ascontiguousarray(np.moveaxis(entries(quaternion), (0, 1), (-2, -1)))


def entries(quaternion: Array) -> Array:
    """Return the entries of Λ, (3, 3, ...), as `attitudes` does: each lies in one piece."""
    x, y, z, w = np.moveaxis(quaternion, -1, 0).copy()
    f = 2 / (x * x + y * y + z * z + w * w)
    products = x * x, y * y, z * z, x * y, x * z, y * z, w * x, w * y, w * z
    xx, yy, zz, xy, xz, yz, wx, wy, wz = (f * product for product in products)
    rows = (1 - (yy + zz), xy - wz, xz + wy), (xy + wz, 1 - (xx + zz), yz - wx), (xz - wy, yz + wx, 1 - (xx + yy))
    return np.array(rows)


def quaternion_product(p: Array, q: Array) -> Array:
    """Return the products of quaternions (..., 4), scalar last: q turns first."""
    v = p[..., 3:] * q[..., :3] + q[..., 3:] * p[..., :3] + cross(p[..., :3], q[..., :3])
    return np.concatenate([v, p[..., 3:] * q[..., 3:] - (p[..., :3] * q[..., :3]).sum(axis=-1, keepdims=True)], axis=-1)


def directors(quaternion: Array) -> Array:
    """Return the directors, rows of (..., 3, 3), of unit quaternions (..., 4), scalar last."""
    return np.ascontiguousarray(attitudes(quaternion).swapaxes(-1, -2))


def director_velocities(q: Array, W: Array, N: Array | None) -> Array:
    """Return the velocities of the directors `q`, rows of (..., 3, 3), for W (..., 3) and N (..., 6)."""
    x, y, z = np.moveaxis(W, -1, 0)
    V = np.zeros((3, 3, *x.shape))  # rows W × e_i
    V[0, 1], V[0, 2], V[1, 0], V[1, 2], V[2, 0], V[2, 1] = z, -y, -z, x, y, -x
    if N is not None:
        V = V + np.moveaxis(N, -1, 0)[PLACES]
    d = np.moveaxis(q, (-2, -1), (0, 1)).copy()
    found = V[:, 0, None] * d[0] + V[:, 1, None] * d[1] + V[:, 2, None] * d[2]
    return np.ascontiguousarray(np.moveaxis(found, (0, 1), (-2, -1)))


def states_of(q: Array, v: Array) -> tuple[Array, Array, Array]:
    """Return quaternions (..., 4), W (..., 3) and N (..., 6) of directors and their velocities, rows of (..., 3, 3).

    Along the first of several axes the quaternions have no jumps of sign.
    """
    V = v @ q.swapaxes(-1, -2)
    W = axial(V.mT) / 2
    return quaternions(q), W, ((V + V.swapaxes(-1, -2)) / 2)[..., ROWS, COLUMNS]


def quaternions(q: Array) -> Array:
    """Return unit quaternions (..., 4), scalar last, of directors, rows of (..., 3, 3), without jumps of sign."""
    from scipy.spatial.transform import Rotation

    p: Array = Rotation.from_matrix(np.swapaxes(q, -1, -2)).as_quat()
    return without_jumps(p) if p.ndim > 1 else p


def quaternion_column(R: Array) -> Array:
    """Return quaternions q (..., 4), scalar first and not negative, of Λ (..., 3, 3), up to a positive factor.

    That is the column of 4 q qᵀ with the largest diagonal.
    """
    trace, Q = np.trace(R, axis1=-2, axis2=-1)[..., None, None], np.empty((*R.shape[:-2], 4, 4))
    Q[..., 0, 0] = 1.0 + trace[..., 0, 0]
    Q[..., 0, 1:] = Q[..., 1:, 0] = axial(R)
    Q[..., 1:, 1:] = (np.eye(3) + (R + R.mT)) - trace * np.eye(3)
    largest = np.argmax(np.diagonal(Q, axis1=-2, axis2=-1), axis=-1)
    q = np.take_along_axis(Q, largest[..., None, None], axis=-1)[..., 0]
    return np.where(q[..., :1] < 0.0, -q, q)


def turns(p: Array, q: Array) -> Array:
    """Return the angles between attitudes, rad, of unit quaternions (n, 4)."""
    near = np.where(dot(p, q) < 0, -1.0, 1.0)[:, None]
    return np.asarray(4 * np.arcsin(np.minimum(np.linalg.norm(q - near * p, axis=1) / 2, 1.0)))


def without_jumps(p: Array) -> Array:
    """Return quaternions (n, 4) with signs such that each is the nearer one to that before; the first is kept."""
    flips = np.where(np.sum(p[1:] * p[:-1], axis=-1) < 0, -1.0, 1.0)
    p[1:] *= np.cumprod(flips, axis=0)[..., None]
    return p


LOCK = 1e-7  # of det T: SciPy's


def require_sequence(letters: str) -> None:
    """Raise an InputError where letters are no axes of Euler angles."""
    if not re.fullmatch(r"(?!.*(.)\1)([xyz]{3}|[XYZ]{3})", letters):
        raise InputError("euler", letters=letters)


def euler_angles(quaternion: Array, W: Array, letters: str) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return angles and their rates, and which attitudes are in gimbal lock.

    Parameters
    ----------
    quaternion : (n, 4) array
        Of Λ, scalar last.
    W : (n, 3) array, rad/s
        In body components.
    letters : str
        Three axes, as "ZXZ" (of the body) or "zxz" (fixed).

    Returns
    -------
    angles : (n, 3) array, rad
        In the order of the letters, as ``scipy.spatial.transform.Rotation.as_euler`` has them.
    rates : (n, 3) array, rad/s
        Infinite for the outer angles in gimbal lock.
    is_locked : (n,) array

    Raises
    ------
    InputError
        Code "euler": the letters are wrong, mixed, or equal side by side.
    """
    from scipy.spatial.transform import Rotation

    require_sequence(letters)
    is_known: NDArray[np.bool_] = np.asarray(np.isfinite(quaternion).all(axis=1))
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Gimbal lock")
        turned = Rotation.from_quat(np.where(is_known[:, None], quaternion, [0.0, 0.0, 0.0, 1.0]))
        angles: Array = np.where(is_known[:, None], turned.as_euler(letters), np.nan)
    way = 1 if letters.isupper() else -1
    a, b, c = np.eye(3)[["XYZ".index(x) for x in letters.upper()[::way]]]
    _, second, third = angles[:, ::way].T
    halves = (b, second / 2), (c, third / 2)
    R_b, R_c = (attitudes(np.column_stack([np.outer(np.sin(x), n), np.cos(x)])) for n, x in halves)
    T = np.stack([((a @ R_b)[:, None] @ R_c)[:, 0], b @ R_c, np.broadcast_to(c, W.shape)], axis=2)
    is_locked: NDArray[np.bool_] = abs(np.linalg.det(T)) <= LOCK
    solvable = np.where((is_known & ~is_locked)[:, None, None], T, np.eye(3))
    rates: Array = np.linalg.solve(solvable, W[:, :, None])[:, ::way, 0].astype(np.float64)
    rates[~is_known] = np.nan
    rates[is_locked, ::2] = np.inf
    rates[is_locked, 1] = np.sum(b @ R_c * W, axis=1)[is_locked]
    return angles, rates, is_locked

"""Euler angles of attitudes, and their rates, in SciPy's letters.

Capitals are axes that turn with the body, Λ = R_a(φ1) R_b(φ2) R_c(φ3), so that in body components

    W = T φ',        T = [(R_b R_c)ᵀ a, R_cᵀ b, c],        det T = (R_bᵀ a)·(b × c):

± sin φ2 where a and c are one axis, else ± cos φ2. Small letters are fixed axes, and the reverse order: those of
``xyz`` are φ3, φ2, φ1 of ``ZYX``. In gimbal lock, det T = 0, the outer axes are parallel: of their angles only the sum
or difference is determined, SciPy makes the third 0, and their rates are infinite for a velocity across.
"""

from __future__ import annotations

import re
import warnings

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from .arrays import Array
from .attitudes import attitudes

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

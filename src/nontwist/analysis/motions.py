"""Every form of a motion, as a SciPy Rotation: the one place that knows them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..geometry.arrays import Array, as_array, require_finite

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

ORTHONORMAL, UNIT = 1e-9, 1e-3


def rotation(motion: Any, *, scalar_first: bool | None = None) -> Rotation:
    """Return a motion as a SciPy Rotation that maps body to space.

    Parameters
    ----------
    motion : Rotation, (..., 3, 3) or (..., 4) array, Dataset, DataArray or Trajectory
        Arrays of shape (..., 3, 3) are Λ, with the directors as columns; of shape (..., 4) quaternions. Runs,
        trajectories and DataArrays named or laid out as `directors` or `quaternion` are known by their names.
    scalar_first : bool, optional
        Order of quaternions given as a plain array; needed there, since the two orders cannot be told apart.

    Returns
    -------
    scipy.spatial.transform.Rotation

    Raises
    ------
    ValueError
        Not orthonormal to 1e-9, left-handed, not finite, quaternions of no stated order, or nothing known.
    """
    from scipy.spatial.transform import Rotation

    if isinstance(motion, Rotation):
        return motion
    if hasattr(motion, "data_vars"):
        known = [name for name in ("directors", "quaternion") if name in motion.data_vars]
        if not known:
            raise ValueError(f"the dataset holds neither directors nor quaternion, but {', '.join(motion.data_vars)}")
        motion = motion[known[0]]
    if hasattr(motion, "dims"):
        return _of_dataarray(motion)
    if hasattr(motion, "directors"):
        return Rotation.from_matrix(_checked(np.swapaxes(motion.directors, -1, -2)))
    array = np.array(motion, dtype=np.float64)
    if array.shape[-1:] == (4,) and array.shape[-2:] != (3, 3):
        if scalar_first is None:
            raise ValueError("quaternions need scalar_first=True (w, x, y, z) or scalar_first=False (x, y, z, w)")
        return Rotation.from_quat(_unit(array), scalar_first=scalar_first)
    return Rotation.from_matrix(_checked(array))


def _of_dataarray(motion: Any) -> Rotation:
    from scipy.spatial.transform import Rotation

    if "quat" in motion.dims:
        array = motion.transpose(..., "quat")
        order = [str(x) for x in array.coords["quat"].values] if "quat" in array.coords else list("xyzw")
        return Rotation.from_quat(_unit(array.values[..., [order.index(x) for x in "xyzw"]]))
    if {"director", "axis"} <= set(motion.dims):
        return Rotation.from_matrix(_checked(motion.transpose(..., "axis", "director").values))
    raise ValueError(f"a DataArray needs the dims director and axis, or quat; got {', '.join(map(str, motion.dims))}")


def _checked(matrices: Array) -> Array:
    if matrices.shape[-2:] != (3, 3):
        raise ValueError(f"rotations must be (..., 3, 3) matrices or (..., 4) quaternions, got {matrices.shape}")
    matrices = as_array(matrices, "rotation", matrices.shape)
    defect = abs(np.swapaxes(matrices, -1, -2) @ matrices - np.eye(3)).max(axis=(-2, -1))
    worst = np.unravel_index(int(np.argmax(defect)), defect.shape)
    where = f"[{', '.join(str(int(i)) for i in worst)}]" if worst else ""
    if defect[worst] > ORTHONORMAL:
        raise ValueError(f"rotation{where} is not orthonormal: the largest entry of |ΛᵀΛ - I| is {defect[worst]:.3g}")
    det = np.linalg.det(matrices)
    if det.min() < 0:
        left = np.unravel_index(int(np.argmin(det)), det.shape)
        where = f"[{', '.join(str(int(i)) for i in left)}]" if left else ""
        raise ValueError(f"rotation{where} is left-handed: its determinant is {det[left]:.6g}")
    return matrices


def _unit(quaternions: Array) -> Array:
    quaternions = np.asarray(quaternions, dtype=np.float64)
    require_finite(quaternions, "quaternion")
    length = np.linalg.norm(quaternions, axis=-1)
    k = int(np.argmax(abs(length - 1).ravel()))
    if abs(length.ravel()[k] - 1) > UNIT:
        raise ValueError(f"quaternion {k} has the length {length.ravel()[k]:.6g}; it must be 1 to {UNIT:g}")
    return quaternions

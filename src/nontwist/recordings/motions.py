"""Every form of a motion as a SciPy Rotation, with its times.

SciPy's rotations take a third of a second to import: quaternions that are given pass without them.
"""

from __future__ import annotations

from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..geometry.arrays import Array, as_floats
from .attitudes import of_table
from .formats.content import Content
from .options import ReadOptions
from .rotations import MEASURED, Motion
from .table import Lines, Table, place

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

EXACT = 1e-9  # accepted departure from orthonormality


def rotation(motion: Any, *, scalar_first: bool | None = None) -> Rotation:
    """Return a motion as a SciPy Rotation that maps body to space.

    Parameters
    ----------
    motion : Rotation, (..., 3, 3) or (..., 4) array, Dataset, DataArray, Trajectory or DataFrame
        Arrays of shape (..., 3, 3) are Λ, with the directors as columns; of shape (..., 4) quaternions. Runs,
        trajectories and DataArrays named or laid out as `directors` or `quaternion` are recognised by their names, and
        so are the columns of a DataFrame (``qw qx qy qz``, ``W X Y Z``, ``r11 ... r33`` and the like).
    scalar_first : bool, optional
        Order of quaternions given as a plain array; needed there, since the two orders cannot be distinguished.

    Returns
    -------
    scipy.spatial.transform.Rotation

    Raises
    ------
    ValueError
        A matrix is not orthonormal to 1e-9 or is left-handed, a number is not finite, quaternions have no stated order,
        or the form is unknown. Only `twist` drops rows that are not finite, since it has the times of the others.

    Examples
    --------
    >>> from nontwist import rotation
    >>> rotation([[0.8, 0, 0, 0.6]], scalar_first=True).as_rotvec().round(6)  # 2 acos 0.8 about z
    array([[0.      , 0.      , 1.287002]])

    The last attitude of a run:

    >>> from nontwist import nontwisting, simulate
    >>> run = simulate(nontwisting([3, 4, 5]), t_end=1, angular_velocity=(0, 2, 0), integrator="split")
    >>> rotation(run)[-1].as_rotvec().round(6)
    array([0., 2., 0.])
    """
    return as_rotation(raw_motion(motion, scalar_first).values, EXACT)


def raw_motion(motion: Any, scalar_first: bool | None) -> Motion:
    """Return a motion of any form; only that is checked, so that the caller can treat rows that are not finite."""
    if hasattr(motion, "as_quat"):
        return Motion(motion)
    if hasattr(motion, "columns") and hasattr(motion, "iloc"):
        content = Content(Table({str(name): motion[name].to_numpy() for name in motion.columns}))
        try:
            found = of_table(content, ReadOptions())
        except InputError as error:
            if error.code != "scalar-unknown" or scalar_first is None:
                raise
            found = of_table(content, ReadOptions(scalar_first=scalar_first))
        return Motion(found.values, found.time)
    if hasattr(motion, "data_vars"):
        known = [name for name in ("directors", "quaternion") if name in motion.data_vars]
        if not known and "twist_angle" in motion.data_vars:
            raise ValueError("it is already the result of a twist; nontwist view and nontwist info show it")
        if not known:
            raise ValueError(f"the dataset has neither directors nor quaternion; it has {', '.join(motion.data_vars)}")
        motion = motion[known[0]]
    if hasattr(motion, "dims"):
        time, line = (motion[name].values if name in motion.coords else None for name in ("time", "line"))
        lines = line if line is not None and line.ndim == 1 else None
        return Motion(_of_dataarray(motion), time, motion.attrs.get("start"), lines)
    if hasattr(motion, "directors"):
        return Motion(np.swapaxes(motion.directors, -1, -2), motion.time)
    if isinstance(motion, (str, PathLike)):
        raise ValueError(f"the motion must be an array of numbers, got {str(motion)!r}; read_motion reads a file")
    array = as_floats(motion, "the motion")
    if array.shape[-2:] == (3, 3):
        return Motion(array)
    if array.shape[-1:] == (4,):
        if scalar_first is None:
            raise ValueError("quaternions need scalar_first=True (w, x, y, z) or scalar_first=False (x, y, z, w)")
        return Motion(np.roll(array, -1, axis=-1) if scalar_first else array)
    raise ValueError(f"rotations must be (..., 3, 3) matrices or (..., 4) quaternions, got {array.shape}")


def as_rotation(
    values: Any, tolerance: float, rows: NDArray[np.int64] | None = None, lines: Lines | None = None
) -> Rotation:
    """Return the values of `raw_motion` as a Rotation; a ValueError names what is no rotation within `tolerance`.

    With `rows` only these are taken, and messages name them by their numbers in `values`, or by the `lines` of these.
    """
    values = values if rows is None else values[rows]
    if not isinstance(values, np.ndarray):
        return values
    _check(values, tolerance, rows, lines)
    from scipy.spatial.transform import Rotation

    return Rotation.from_quat(values) if values.shape[-1] == 4 else Rotation.from_matrix(values)


def measured_quaternions(motion: Motion, rows: NDArray[np.int64]) -> Array:
    """Return `rows` of a motion as quaternions, (k, 4), scalar last; errors as `as_rotation`.

    Quaternions that are given are left as they are.
    """
    values = motion.values
    if not isinstance(values, np.ndarray) or values.shape[-1] != 4:
        return np.asarray(as_rotation(values, MEASURED, rows, motion.lines).as_quat())
    _check(values[rows], MEASURED, rows, motion.lines)
    return np.ascontiguousarray(values[rows])


def _check(values: Array, tolerance: float, rows: NDArray[np.int64] | None, lines: Lines | None = None) -> None:
    """Raise a ValueError where matrices or quaternions are no rotations."""

    def refuse(bad: Any, message: str, shown: Any) -> None:
        if np.any(bad):
            index = tuple(int(i) for i in np.argwhere(bad)[0])
            named = index if rows is None else (int(rows[index[0]]), *index[1:])
            where = f"[{', '.join(map(str, named))}]" if named else ""
            where = where if lines is None else f" in {place(named[0], lines)}"
            raise ValueError(message.format(where, np.asarray(shown)[index].tolist()))

    with np.errstate(over="ignore", invalid="ignore"):
        if values.shape[-1] == 4:
            refuse(~np.isfinite(values).all(axis=-1), "quaternion{} is not finite: {}", values)
            length = np.linalg.norm(values, axis=-1)
            refuse(abs(length - 1) > MEASURED, "quaternion{} must have the length 1, it has {:.6g}", length)
            return
        refuse(~np.isfinite(values).all(axis=(-2, -1)), "rotation{} is not finite: {}", values)
        defect = abs(np.swapaxes(values, -1, -2) @ values - np.eye(3)).max(axis=(-2, -1))
    refuse(~(defect <= tolerance), "rotation{} is not orthonormal: the largest entry of |ΛᵀΛ - I| is {:.3g}", defect)
    det = np.linalg.det(values)
    refuse(det < 0, "rotation{} is left-handed: its determinant is {:.6g}", det)


def _of_dataarray(motion: Any) -> Array:
    if "quat" in motion.dims:
        array = motion.transpose(..., "quat")
        order = [str(x) for x in array.coords["quat"].values] if "quat" in array.coords else list("xyzw")
        quaternions: Array = array.values[..., [order.index(x) for x in "xyzw"]]
        return quaternions
    if {"director", "axis"} <= set(motion.dims):
        matrices: Array = motion.transpose(..., "axis", "director").values
        return matrices
    raise ValueError(f"a DataArray needs the dims director and axis, or quat; got {', '.join(map(str, motion.dims))}")

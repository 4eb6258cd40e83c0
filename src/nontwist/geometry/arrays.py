"""Validation of numeric arguments: the type alias, and conversion to checked arrays.

`as_floats` is the one conversion of arguments to floats. It refuses what NumPy would convert with
a loss: complex numbers, masked values, dates and durations, objects, text.

Behind it: stacks of vectors, matrices and angles with leading axes, their lengths, and the angles between them.
"""

from __future__ import annotations

import numbers
import sys
from collections.abc import Callable
from decimal import Decimal
from math import prod
from types import EllipsisType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .values import short_repr

if TYPE_CHECKING:
    from matplotlib.axes import Axes as Axes
    from scipy.spatial.transform import Rotation as Rotation
    from xarray import DataArray as DataArray
    from xarray import Dataset as Dataset
else:  # which are slow to import, for annotations
    Axes = DataArray = Dataset = Rotation = Any

Array = NDArray[np.float64]

Shape = tuple[int | EllipsisType | None, ...]

FLOAT, PLAIN = np.dtype(np.float64), frozenset({float, int})
_NEXT, _LAST = np.array([1, 2, 0]), np.array([2, 0, 1])
FEW = 2**12  # numbers that BLAS sums in one thread
LINE = 8  # numbers
UNIT = 8 * float(np.finfo(np.float64).eps)  # from length 1, up to which a direction is taken as it is
ORDERS = ("0 1 2", "1 2 3", "d1 d2 d3", "x y z", "x y z w")  # of the labels of directors, axes and quaternions
LARGEST = 1e100  # energies, products of three such numbers, do not overflow
_REFUSED = {
    "c": "is complex; real numbers are taken: np.real({name}) drops the imaginary part",
    "M": "holds dates (datetime64); numbers are taken: (t - t[0]) / np.timedelta64(1, 's') gives seconds",
    "m": "holds durations (timedelta64); numbers are taken: t / np.timedelta64(1, 's') gives seconds",
    "O": "is an array of objects; numbers are taken: {name}.astype(float) converts it",
}


def aligned(*shape: int, empty: bool = False) -> Array:
    """Return zeros that begin with a line of the cache, 64 bytes: a vector of eight numbers then lies in one line.

    Numbers are what they happen to be where it is to be `empty`.
    """
    count = prod(shape)
    scratch = (np.empty if empty else np.zeros)(count + LINE - 1)
    first = -(scratch.__array_interface__["data"][0] // scratch.itemsize) % LINE
    return scratch[first : first + count].reshape(shape)


def as_flag(value: Any, name: str) -> bool:
    """Return `value` as a bool; a ValueError where it is neither True nor False."""
    if not isinstance(value, (bool, np.bool_)):
        raise ValueError(f"{name} must be True or False, got {short_repr(value)}")
    return bool(value)


def as_floats(value: ArrayLike, name: str, ndmin: int = 0) -> Array:
    """Return `value` as a new array of floats in C order, of any shape, finite or not.

    Booleans count as 0 and 1; whole numbers, fractions and decimals of Python as the nearest floats.

    Raises
    ------
    ValueError
        Complex numbers, masked values, dates, durations, text, objects, or a number too large for a float.
    """
    if type(value) is np.ndarray and value.dtype == FLOAT:
        return np.array(value, order="C", ndmin=ndmin)
    array = as_plain(value, name)
    kind = array.dtype.kind
    if kind in _REFUSED and (kind != "O" or getattr(value, "dtype", None) is array.dtype):
        raise ValueError(f"{name} {_REFUSED[kind].format(name=name)}")
    if kind not in "fiubO":
        raise ValueError(f"{name} must consist of numbers, got {short_repr(value)}")
    if kind == "O":
        array = _of_objects(array, name)
    if array.dtype.itemsize > 8:  # extended precision: overflow gives infinity
        with np.errstate(over="ignore"):
            array = array.astype(np.float64)
    return np.array(array, dtype=np.float64, order="C", ndmin=ndmin)


def as_plain(value: Any, name: str) -> NDArray[Any]:
    """Return `value` as an array of whatever it holds; a ValueError where it is not an array, or has masked values."""
    try:
        masked = _masked(value)
        is_labelled = hasattr(value, "dims") or hasattr(value, "iloc")
        array = np.asarray(0.0 if masked else in_order(value) if is_labelled else value)
    except Exception as error:  # conversions of foreign objects raise exceptions of any kind
        raise ValueError(f"{name} must consist of numbers, got {short_repr(value)}") from error
    if masked:
        raise ValueError(f"{name} has masked values; np.ma.filled({name}, number) puts a number in their place")
    return array


def in_order(data: Any) -> Any:
    """Return data of xarray with directors, axes and components of quaternions in the order of their labels.

    So are Series and DataFrames of pandas whose labels are such letters; numbers there count rows.
    """
    if hasattr(data, "iloc"):
        for k, labels in enumerate(data.axes):
            if len(labels) <= 4 and all(isinstance(label, str) for label in labels):
                data = data.take(_places(labels), axis=k)
        return data
    for dim in ("director", "axis", "quat"):
        if dim in data.dims and dim in data.coords:
            places = _places(data[dim].values)
            data = data if places == sorted(places) else data.isel({dim: places})
    return data


def _places(labels: Any) -> list[int]:
    own = [str(label) for label in labels]
    order = next((one for one in map(str.split, ORDERS) if sorted(own) == sorted(one)), None)
    return [own.index(label) for label in order] if order else list(range(len(own)))


def as_array(value: ArrayLike, name: str, shape: Shape, largest: float = LARGEST) -> Array:
    """Return `value` as a new array of finite floats of the given shape.

    Parameters
    ----------
    value : array_like
    name : str
        Name of the argument; messages begin with it.
    shape : tuple
        Lengths that must match; ``None`` stands for any, an ellipsis at the front for any number of leading axes.
    largest : float
        Size above which an entry is refused: 1e100 where bodies move, so that no energy overflows; inf in geometry.

    Raises
    ------
    ValueError
        As `as_floats`; another shape, or an entry that is not finite or too large (the message names its index).
    """
    if shape == () and isinstance(value, (bool, np.bool_)):
        raise ValueError(f"{name} must be a number, got {value}")
    array = as_floats(value, name)
    tail = shape[1:] if shape[:1] == (...,) else shape
    given = array.shape if tail == shape else array.shape[max(0, array.ndim - len(tail)) :]
    if given != tail and (len(given) != len(tail) or any(n not in (None, m) for n, m in zip(tail, given, strict=True))):
        words = ("n" if n is None else "..." if n is ... else str(n) for n in shape)
        expected = "(" + ", ".join(words) + (",)" if len(shape) == 1 else ")")
        raise ValueError(f"{name} must have the shape {expected}, got {array.shape}")
    if (np.isfinite(array) if largest == np.inf else abs(array) <= largest).all():
        return array
    require_finite(array, name)
    found = array.flat[int(abs(array).argmax())]
    raise ValueError(f"{name} holds {found:g}, which is too large; the largest accepted number is {largest:g}")


def as_tensor(value: ArrayLike, name: str, accepted: str) -> Array:
    """Return `value`, 3 entries of a diagonal or a matrix, as a (3, 3) array; errors as in `as_array`.

    A wrong shape is refused with what is `accepted`, in words.
    """
    if callable(value):
        raise ValueError(f"{name} must be {accepted}, got {short_repr(value)}")
    array = as_floats(value, name)
    if array.shape == (3,):
        return np.diag(as_array(array, name, (3,)))
    if array.shape != (3, 3):
        raise ValueError(f"{name} must be {accepted}, got the shape {array.shape}")
    return as_array(array, name, (3, 3))


AXES = {sign + x: [one * (x == y) + 0.0 for y in "xyz"] for sign, one in (("", 1.0), ("-", -1.0)) for x in "xyz"}


def as_axis(value: Any, name: str) -> Array:
    """Return `value`, 3 numbers or a letter, as "x" or "-Z", as a (3,) array; errors as in `as_array`."""
    if not isinstance(value, str):
        return as_array(value, name, (3,))
    if value.lower() not in AXES:
        raise ValueError(f"{name} must be x, y or z, with a minus or without, or 3 numbers; got {short_repr(value)}")
    return np.array(AXES[value.lower()])


def as_direction(value: Any, name: str, place: str = "the body") -> Array:
    """Return `value`, of any length but 0, as a unit vector; errors as in `as_axis`."""
    axis = as_axis(value, name)
    if not axis.any():
        raise ValueError(f"{name} is zero: it must be a direction in {place}")
    if abs(np.linalg.norm(axis) - 1) > UNIT:
        axis = axis / abs(axis).max()  # whose square may underflow
        axis = axis / np.linalg.norm(axis)
    return axis


def increasing(times: Array, name: str = "", table: str = "a table", jumps: bool = False) -> float:
    """Return the smallest gap of the times of a table, which may jump; a ValueError where they do not increase."""
    if times.size < 2:
        raise ValueError(f"{table} needs at least 2 times, got {times.size}")
    if (gaps := np.diff(times)).min() <= 0:
        k = int(np.argmax(gaps <= 0))
        after = f"; for a jump there, give {times[k] + 1e-9 * max(1.0, abs(times[k])):.12g} as the second"
        raise ValueError(
            f"times{name} must increase, but times[{k + 1}] = {times[k + 1]:g} follows times[{k}] = {times[k]:g}"
            + after * bool(jumps and gaps[k] == 0)
        )
    return float(gaps.min())


def distinct(values: NDArray[Any]) -> NDArray[Any]:
    """Return what `np.unique` does of values that are all numbers, without the import of `numpy.ma`, 15 ms, by it."""
    found = np.sort(values)
    return found[np.append(True, found[1:] != found[:-1])]


def largest_size(vectors: Array) -> float:
    """Return the length of the longest of vectors (..., n) that are numbers; 0 without any."""
    return float(np.sqrt(np.fmax.reduce(np.einsum("...i,...i", vectors, vectors), axis=None, initial=0.0)))


def as_number(value: ArrayLike, name: str) -> float:
    """Return `value` as a finite float; errors as in `as_array`."""
    if type(value) is float and abs(value) <= LARGEST:
        return value
    return float(as_array(value, name, ()))


def as_positive(value: ArrayLike, name: str, shape: Shape, unit: str) -> Array:
    """Return `value` as `as_array` does; a ValueError that names the first entry which is not positive."""
    array = as_array(value, name, shape)
    refuse(array <= 0, name, lambda i: f"must be positive, got {array[i]:g} {unit}".rstrip())
    return array


def require_finite(array: Array, name: str) -> None:
    """Raise a ValueError that names the first entry of `array` which is not finite."""
    refuse(~np.isfinite(array), name, lambda i: f"= {array[i]} is not finite")


def refuse(bad: NDArray[np.bool_], name: str, reason: str | Callable[[tuple[int, ...]], str]) -> None:
    """Raise the ValueError "`name`[index] `reason`" for the first true entry of `bad`; of its index where it asks."""
    if np.any(bad):
        index = tuple(np.argwhere(bad)[0].tolist())
        raise ValueError(f"{name}{_place(index)} {reason if isinstance(reason, str) else reason(index)}")


def _place(index: tuple[int, ...]) -> str:
    return f"[{', '.join(map(str, index))}]" if index else ""


def _masked(value: Any) -> bool:
    """Return whether an array, or an array in a list, has masked values: NumPy would use what lies under the mask."""
    masked = sys.modules.get("numpy.ma")  # NumPy imports it when it is first used, 50 ms
    if masked is not None and isinstance(value, masked.MaskedArray):
        return bool(masked.is_masked(value))
    if not isinstance(value, (list, tuple)):
        return False
    return any(_masked(entry) for entry in value if type(entry) not in (float, int))


def _of_objects(array: NDArray[Any], name: str) -> Array:
    """Return the numbers of Python in an array of objects as floats."""
    numbers_found = np.empty(array.shape)
    for index, entry in np.ndenumerate(array):
        if not isinstance(entry, (numbers.Real, Decimal)) or isinstance(entry, np.timedelta64):
            raise ValueError(f"{name}{_place(index)} must be a number, got {short_repr(entry)}")
        try:
            numbers_found[index] = float(entry)
        except (OverflowError, ValueError) as error:
            raise ValueError(f"{name}{_place(index)} is too large for a float") from error
    return numbers_found


def vector(value: ArrayLike, name: str) -> tuple[float, float, float]:
    """Return 3 finite numbers; tuples, lists and arrays of floats take a fast path."""
    plain: Any = value
    if type(value) is np.ndarray and value.dtype is FLOAT and value.shape == (3,):
        plain = value.tolist()
    if type(plain) in (tuple, list) and len(plain) == 3:
        x, y, z = plain
        fine = type(x) in PLAIN and type(y) in PLAIN and type(z) in PLAIN
        if fine and abs(x) <= LARGEST and abs(y) <= LARGEST and abs(z) <= LARGEST:
            return x, y, z
    x, y, z = as_array(value, name, (3,)).tolist()
    return x, y, z


def cross(a: Array, b: Array) -> Array:
    """Return ``a × b`` over the last axis, as `numpy.cross` does in five times the time."""
    return a.take(_NEXT, -1) * b.take(_LAST, -1) - a.take(_LAST, -1) * b.take(_NEXT, -1)


def axial(A: Array) -> Array:
    """Return A32 - A23, A13 - A31, A21 - A12 of matrices (..., 3, 3), the transpose of the map to skew ones."""
    return np.stack([A[..., i, j] - A[..., j, i] for i, j in ((2, 1), (0, 2), (1, 0))], axis=-1)


def sum_of_squares(array: Array) -> float:
    """Return Σ x² of (n,) numbers; for many without BLAS, whose threads compete with other processes."""
    if array.size < FEW:
        return float(np.vdot(array, array))
    with np.errstate(all="ignore"):
        return float(np.einsum("i,i", array, array))


TOLERANCE = 1e-9  # departure from unit length, tangency or orthogonality up to which an argument is accepted
EPS = float(np.finfo(np.float64).eps)
TINY = float(np.finfo(np.float64).tiny)


def stack(value: ArrayLike, name: str, tail: tuple[int, ...]) -> Array:
    """Return `value` as finite floats of the shape (..., *tail), with any number of leading axes."""
    return as_array(value, name, (..., *tail), np.inf)


def unit_vectors(value: ArrayLike, name: str) -> Array:
    """Return `value` (..., 3) as floats; ValueError where it is not a unit vector."""
    d = stack(value, name, (3,))
    refuse(np.abs(norm(d) - 1.0) > TOLERANCE, name, "is not a unit vector")
    return d


def norm(v: Array) -> Array:
    """Length of the vectors `v` (..., 3), accurate also where their squares overflow or underflow."""
    with np.errstate(over="ignore"):
        return np.asarray(np.hypot(np.hypot(v[..., 0], v[..., 1]), v[..., 2]))


def dot(a: Array, b: Array) -> Array:
    """Scalar product of the vectors `a` and `b` (..., 3)."""
    return np.asarray((a * b).sum(axis=-1))


def arcs(d: Array) -> Array:
    """Angles between neighbouring unit vectors (n, 3), rad."""
    chord = np.linalg.norm(np.diff(d, axis=0), axis=1)
    return np.asarray(2 * np.arcsin(np.minimum(chord / 2, 1.0)))


def principal_angle(angle: ArrayLike) -> Array:
    """Return `angle`, rad, modulo 2π in (-π, π]."""
    full = np.asarray(angle, dtype=np.float64)
    rest = full - 2 * np.pi * np.rint(full / (2 * np.pi))
    return np.where(rest <= -np.pi, np.pi, rest)


def ratio(a: Array, b: Array, at_zero: float) -> Array:
    """Quotient a/b, `at_zero` where b = 0."""
    return np.asarray(np.divide(a, b, out=np.full(np.broadcast(a, b).shape, at_zero), where=b != 0.0))

"""Arrays at the border: the type alias, and what turns a caller's numbers into checked arrays."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

LARGEST = 1e100  # energies, products of three such numbers, still are floats


def as_array(value: ArrayLike, name: str, shape: tuple[int | None, ...], largest: float = LARGEST) -> Array:
    """Return `value` as a new array of finite floats of the given shape.

    Parameters
    ----------
    value : array_like
    name : str
        What the caller calls it; messages begin with it.
    shape : tuple
        Lengths that must match; ``None`` stands for any.
    largest : float
        Size above which an entry is refused: 1e100 where bodies move, so that no energy overflows; inf in geometry.

    Raises
    ------
    ValueError
        Not numbers, another shape, or an entry that is not finite or too large (the message names its index).
    """
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} must be an array of numbers, got {value!r}") from error
    if array.ndim != len(shape) or any(n not in (None, m) for n, m in zip(shape, array.shape, strict=True)):
        wanted = "(" + ", ".join("n" if n is None else str(n) for n in shape) + (",)" if len(shape) == 1 else ")")
        raise ValueError(f"{name} must have the shape {wanted}, got {array.shape}")
    require_finite(array, name)
    if array.size and abs(array).max() > largest:
        found = array.flat[int(abs(array).argmax())]
        raise ValueError(f"{name} holds {found:g}, which is too large; numbers up to {largest:g} are taken")
    return array


def as_number(value: ArrayLike, name: str) -> float:
    """Return `value` as a finite float; errors as in `as_array`."""
    if type(value) is float and abs(value) <= LARGEST:
        return value
    return float(as_array(value, name, ()))


def as_positive(value: ArrayLike, name: str, shape: tuple[int | None, ...], unit: str) -> Array:
    """Return `value` as `as_array` does; a ValueError that names the first entry which is not positive."""
    array = as_array(value, name, shape)
    bad = np.argwhere(array <= 0)
    if len(bad):
        index = tuple(int(i) for i in bad[0])
        where = f"[{', '.join(map(str, index))}]" if index else ""
        raise ValueError(f"{name}{where} must be positive, got {array[index]:g} {unit}")
    return array


def require_finite(array: Array, name: str) -> None:
    """Raise a ValueError that names the first entry of `array` which is not finite."""
    finite = np.isfinite(array)
    if not finite.all():
        bad = np.argwhere(~finite)
        index = tuple(int(i) for i in bad[0])
        where = f"[{', '.join(map(str, index))}]" if index else ""
        raise ValueError(f"{name}{where} = {array[index]} is not finite")

"""Vectors, matrices and quaternions of numbers of any kind."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Self

from .elements import fma


class Entries(tuple[Any, ...]):
    """Numbers side by side: + -, and products and quotients with a number.

    Attributes
    ----------
    size : int
        How many numbers, entries of entries counted.
    """

    __slots__ = ()
    __array_ufunc__ = None  # a number of NumPy leaves the product to us
    size = 0

    def __new__(cls, *entries: Any) -> Self:
        return tuple.__new__(cls, entries)

    @classmethod
    def _make(cls, entries: Iterable[Any]) -> Self:
        return tuple.__new__(cls, entries)

    def __add__(self, o: Any) -> Self:
        return self._make(a + b for a, b in zip(self, o, strict=True))

    def __sub__(self, o: Any) -> Self:
        return self._make(a - b for a, b in zip(self, o, strict=True))

    def __neg__(self) -> Self:
        return self._make(-a for a in self)

    def __mul__(self, o: Any) -> Self:
        return self._make(a * o for a in self)

    def __rmul__(self, o: Any) -> Self:
        return self._make(o * a for a in self)

    def __truediv__(self, o: Any) -> Self:
        return self._make(a / o for a in self)


class Vector(Entries):
    """Three numbers: ``x * y`` entry by entry, ``x @ y`` the scalar product, ``x @ A`` is Aᵀ x."""

    __slots__ = ()
    size = 3

    def __new__(cls, x: Any, y: Any, z: Any) -> Self:
        return tuple.__new__(cls, (x, y, z))

    def __mul__(self, o: Any) -> Self:
        return self._make(a * b for a, b in zip(self, o, strict=True)) if isinstance(o, tuple) else super().__mul__(o)

    def __matmul__(self, o: Any) -> Any:
        if isinstance(o, Matrix):
            return fma(self[0], o[0], fma(self[1], o[1], self[2] * o[2]))
        return fma(self[2], o[2], fma(self[1], o[1], self[0] * o[0]))


class Matrix(Entries):
    """Three rows, vectors."""

    __slots__ = ()
    size = 9

    def __new__(cls, *rows: Any) -> Self:
        return cls._make(rows)

    @classmethod
    def _make(cls, rows: Iterable[Any]) -> Self:
        return tuple.__new__(cls, (row if isinstance(row, Vector) else Vector(*row) for row in rows))

    def __matmul__(self, o: Any) -> Any:
        return type(o)._make(row @ o for row in self)

    @property
    def T(self) -> Self:
        """The transposed matrix."""
        return self._make(zip(*self, strict=True))

    @property
    def symmetric(self) -> Symmetric:
        """Its entries, where it is symmetric."""
        return Symmetric(self[0][0], self[1][1], self[2][2], self[1][2], self[0][2], self[0][1])

    @property
    def trace(self) -> Any:
        """The sum of the diagonal."""
        return self[0][0] + self[1][1] + self[2][2]


class Symmetric(Entries):
    """The entries 11, 22, 33, 23, 13, 12 of a symmetric matrix."""

    __slots__ = ()
    size = 6

    @property
    def matrix(self) -> Matrix:
        """The matrix."""
        a, b, c, d, e, f = self
        return Matrix((a, f, e), (f, b, d), (e, d, c))


class Quaternion(Entries):
    """w, x, y, z; ``p @ q`` is the product."""

    __slots__ = ()
    size = 4

    @property
    def vector(self) -> Vector:
        """The vector part."""
        return Vector(*self[1:])

    def rotate(self, x: Vector) -> Vector:
        """Return Λ x of a quaternion of unit length."""
        t = cross(self.vector, x) * 2.0
        return x + t * self[0] + cross(self.vector, t)

    @property
    def inverse(self) -> Quaternion:
        """The inverse of a quaternion of unit length."""
        return Quaternion(self[0], *(-self.vector))

    def __matmul__(self, o: Any) -> Quaternion:
        u, v = self.vector, o.vector
        return Quaternion(fma(self[0], o[0], -(u @ v)), *(fma(self[0], v, o[0] * u) + cross(u, v)))


AXES = (Vector(1.0, 0.0, 0.0), Vector(0.0, 1.0, 0.0), Vector(0.0, 0.0, 1.0))


def cross(a: Any, b: Any) -> Vector:
    """Return a × b."""
    return Vector(a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def taxicab(a: Any) -> Any:
    """Return the sum of the absolute values of three numbers."""
    return abs(a[0]) + abs(a[1]) + abs(a[2])


def first_moment(F: Matrix) -> Vector:
    """Return Σ e_i × F_i of the rows of F."""
    return Vector(F[1][2] - F[2][1], F[2][0] - F[0][2], F[0][1] - F[1][0])


def inverse_of(c0: Vector, c1: Vector, c2: Vector) -> Matrix:
    """Return the inverse of the matrix with these columns."""
    n = cross(c1, c2)
    d = 1.0 / (c0 @ n)
    return Matrix(d * n, d * cross(c2, c0), d * cross(c0, c1))


def attitude(p: Quaternion) -> Matrix:
    """Return Λ of a unit quaternion."""
    w, x, y, z = p
    x2, y2, z2 = 2.0 * x, 2.0 * y, 2.0 * z
    wx, wy, wz = w * x2, w * y2, w * z2
    xx, xy, xz, yy, yz, zz = x * x2, x * y2, x * z2, y * y2, y * z2, z * z2
    return Matrix(
        (1.0 - (yy + zz), xy - wz, xz + wy),
        (xy + wz, 1.0 - (xx + zz), yz - wx),
        (xz - wy, yz + wx, 1.0 - (xx + yy)),
    )


def compensated(x: Any, c: Any, d: Any) -> tuple[Any, Any]:
    """Return x + d + c and what it is rounded by (Kahan); of tuples entry by entry."""
    if isinstance(x, Entries):
        pairs = [compensated(*each) for each in zip(x, c, d, strict=True)]
        return x._make(a for a, _ in pairs), x._make(b for _, b in pairs)
    d = d + c
    total = x + d
    return total, d - (total - x)


def sum_of(*terms: Any) -> Any:
    """Return the sum of what there is, None where there is nothing."""
    found = [term for term in terms if term is not None]
    for term in found[1:]:
        found[0] = found[0] + term
    return found[0] if found else None

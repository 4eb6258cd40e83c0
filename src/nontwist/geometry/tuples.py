"""Vector algebra on tuples, for every kernel of the package.

A vector is a tuple of three elements, a matrix a tuple of three rows, a quaternion (w, x, y, z) has the scalar first.
Elements are doubles or vectors of doubles (`elements`): every function here serves both.
"""

from math import sqrt

from .compiled import inlined
from .elements import fused, select

EPS = 2.220446049250313e-16
NAN = float("nan")


@inlined
def dot(a, b):
    return fused(a[2], b[2], fused(a[1], b[1], a[0] * b[0]))


@inlined
def cross(a, b):
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


@inlined
def add(a, b):
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


@inlined
def minus(a, b):
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


@inlined
def axpy(c, a, b):
    """Return c a + b."""
    return (fused(c, a[0], b[0]), fused(c, a[1], b[1]), fused(c, a[2], b[2]))


@inlined
def scaled(c, a):
    return (c * a[0], c * a[1], c * a[2])


@inlined
def each(a, b):
    """Return the products of the entries."""
    return (a[0] * b[0], a[1] * b[1], a[2] * b[2])


@inlined
def times(A, x):
    return (dot(A[0], x), dot(A[1], x), dot(A[2], x))


@inlined
def transposed_times(A, x):
    return axpy(x[0], A[0], axpy(x[1], A[1], scaled(x[2], A[2])))


@inlined
def transposed(A):
    return (column(A, 0), column(A, 1), column(A, 2))


@inlined
def unit(k):
    return (1.0 if k == 0 else 0.0, 1.0 if k == 1 else 0.0, 1.0 if k == 2 else 0.0)


@inlined
def rows(A):
    return (
        (float(A[0, 0]), float(A[0, 1]), float(A[0, 2])),
        (float(A[1, 0]), float(A[1, 1]), float(A[1, 2])),
        (float(A[2, 0]), float(A[2, 1]), float(A[2, 2])),
    )


@inlined
def size(a):
    """Return Σ |a_i|, which is NaN where an entry is."""
    return abs(a[0]) + abs(a[1]) + abs(a[2])


@inlined
def column(A, k):
    return (A[0][k], A[1][k], A[2][k])


@inlined
def inverse_of(c0, c1, c2):
    """Return the inverse, as rows, of the matrix with these columns; NaN or infinite where there is none."""
    n = cross(c1, c2)
    d = 1.0 / dot(c0, n)
    return (scaled(d, n), scaled(d, cross(c2, c0)), scaled(d, cross(c0, c1)))


@inlined
def chosen(mask, a, b):
    """Return the vector a where the mask is set, else b."""
    return (select(mask, a[0], b[0]), select(mask, a[1], b[1]), select(mask, a[2], b[2]))


@inlined
def larger(a, b):
    return select(a > b, a, b)


@inlined
def attitude(p):
    """Return Λ of a unit quaternion, as rows."""
    return rotation_by(p, 2.0)


@inlined
def rotation_by(p, f):
    """Return Λ of a quaternion p, as rows; f is two over its square."""
    w, x, y, z = p
    x2, y2, z2 = f * x, f * y, f * z
    wx, wy, wz = w * x2, w * y2, w * z2
    xx, xy, xz, yy, yz, zz = x * x2, x * y2, x * z2, y * y2, y * z2, z * z2
    return (
        (1.0 - (yy + zz), xy - wz, xz + wy),
        (xy + wz, 1.0 - (xx + zz), yz - wx),
        (xz - wy, yz + wx, 1.0 - (xx + yy)),
    )


@inlined
def quaternion(R):
    """Return the unit quaternion of a rotation given as rows (Shepperd): by its largest component, up to its sign."""
    (a, b, c), (d, e, f), (g, h, i) = R
    trace = a + e + i
    if trace >= max(a, e, i):
        p = (1.0 + trace, h - f, c - g, d - b)
    elif a >= max(e, i):
        p = (h - f, 1.0 - trace + 2.0 * a, b + d, c + g)
    elif e >= i:
        p = (c - g, b + d, 1.0 - trace + 2.0 * e, f + h)
    else:
        p = (d - b, c + g, f + h, 1.0 - trace + 2.0 * i)
    length = sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2] + p[3] * p[3])
    return (p[0] / length, p[1] / length, p[2] / length, p[3] / length)


@inlined
def product(p, q):
    """Return the product of two quaternions."""
    u, v = (p[1], p[2], p[3]), (q[1], q[2], q[3])
    w = add(axpy(p[0], v, scaled(q[0], u)), cross(u, v))
    return (fused(p[0], q[0], -dot(u, v)), w[0], w[1], w[2])


@inlined
def turned_into(basis, A):
    """Return ``basis A``: of rows that belong to the directions of a frame, those of the body's own directions."""
    return (transposed_times(A, basis[0]), transposed_times(A, basis[1]), transposed_times(A, basis[2]))


@inlined
def first_moment(F):
    """Return Σ e_i × F_i."""
    return (F[1][2] - F[2][1], F[2][0] - F[0][2], F[0][1] - F[1][0])


@inlined
def compensated(x, d):
    """Return x + d, and the rounding error that the next sum takes up (Kahan)."""
    total = x + d
    return total, d - (total - x)


@inlined
def summed(x, c, d):
    x0, c0 = compensated(x[0], d[0] + c[0])
    x1, c1 = compensated(x[1], d[1] + c[1])
    x2, c2 = compensated(x[2], d[2] + c[2])
    return (x0, x1, x2), (c0, c1, c2)

"""The unit sphere S² as a Riemannian manifold in R³ (subs-stwo).

Points are unit vectors d (eq-stwo), tangent vectors v at d have v·d = 0 (eq-tstwo), and the connection is the
orthogonal projection of the derivative in R³ (eq-cov-projection):

    exp_d0(v) = cos|v| d0 + sin|v| v/|v|                            (eq-exp-2-sphere)
    log_d0(d) = θ n × d0,   θ = atan2(|d0 × d|, d0·d),   n = d0 × d / |d0 × d|
    w = cos θ w0 + sin θ n × w0 + (1 − cos θ)(n·w0) n               (eq-parallel-transport-2-sphere)

Transport along the geodesic from d0 to d is the smallest rotation that takes d0 to d, hence an isometry. The cross
product is taken as d0 × (d ∓ d0), which loses no digit, neither near d = d0 nor near d = −d0.

All functions broadcast over leading axes; an index in a message is that of the leading axes. Points may depart from
unit length, and tangent vectors from tangency, by a relative 1e-9; they are used as given: `exp` and `geodesic` are
the formulas at these numbers, the other functions depend on the directions of d0 and d alone.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .arrays import EPS, TINY, TOLERANCE, Array, as_array, as_number, dot, norm, ratio, refuse, stack, unit_vectors
from .values import as_function, public

public(__name__)

# Central difference of order 8
_OFFSETS = np.array([-4, -3, -2, -1, 1, 2, 3, 4])
_WEIGHTS = np.array([3, -32, 168, -672, 672, -168, 32, -3]) / 840


def on_sphere(d: ArrayLike, tolerance: float = TOLERANCE) -> NDArray[np.bool_]:
    """Return whether vectors have unit length (eq-stwo).

    Parameters
    ----------
    d : (..., 3) array
    tolerance : float
        Bound for the difference between the length and 1.

    Returns
    -------
    (...) array of bool

    Raises
    ------
    ValueError
        An argument is not an array of finite numbers of this shape.

    Examples
    --------
    >>> from nontwist import sphere
    >>> sphere.on_sphere([[0, 0.6, 0.8], [0, 1, 1]])
    array([ True, False])
    """
    return np.asarray(np.abs(norm(stack(d, "d", (3,))) - 1.0) <= as_number(tolerance, "tolerance"))


def in_tangent_bundle(d: ArrayLike, v: ArrayLike, tolerance: float = TOLERANCE) -> NDArray[np.bool_]:
    """Return whether (d, v) is in TS² (eq-tstwo): |d| = 1 and v·d = 0, the latter relative to |v|.

    Parameters
    ----------
    d, v : (..., 3) arrays
    tolerance : float
        Bound for both.

    Returns
    -------
    (...) array of bool

    Raises
    ------
    ValueError
        An argument is not an array of finite numbers of this shape.

    Examples
    --------
    >>> from nontwist import sphere
    >>> sphere.in_tangent_bundle([0, 0, 1], [[1, 2, 0], [0, 0, 1]])
    array([ True, False])
    """
    tolerance = as_number(tolerance, "tolerance")
    return np.asarray(on_sphere(d, tolerance) & ~_is_not_tangent(stack(d, "d", (3,)), stack(v, "v", (3,)), tolerance))


def project(d: ArrayLike, v: ArrayLike) -> Array:
    """Project a vector orthogonally onto the tangent plane at d: (I − d ⊗ d) v (eq-cov-projection).

    The rest, v − project(d, v), is in span(d) (eq-s2-isomorphism).

    Parameters
    ----------
    d, v : (..., 3) arrays
        Point, and a vector there in any unit.

    Returns
    -------
    (..., 3) array, in the unit of v

    Raises
    ------
    ValueError
        d is not a unit vector (the message names the index).

    Examples
    --------
    >>> from nontwist import sphere
    >>> sphere.project([0, 0, 1], [1, 2, 3])
    array([1., 2., 0.])
    """
    d, v = unit_vectors(d, "d"), stack(v, "v", (3,))
    w = v - dot(v, d)[..., None] * d
    return w - dot(w, d)[..., None] * d  # twice is enough: the first pass leaves round-off of v along d


def covariant_derivative(d: ArrayLike, v: ArrayLike, time: ArrayLike) -> Array:
    """Return the covariant derivative of a field sampled along a curve: (v∘d)' − ((v∘d)'·d) d (eq-cov-projection).

    The derivative is that of the polynomial through the five nearest samples. It is of fourth order in the step on any
    grid, including the ends. With n < 5 samples it is of order n − 1.

    Parameters
    ----------
    d, v : (..., n, 3) arrays
        Points of the curve, and the field there. A part of v along d is allowed, and enters the derivative.
    time : (n,) array
        Strictly increasing, n ≥ 2.

    Returns
    -------
    (..., n, 3) array, unit of v over unit of time
        Tangent vectors at d.

    Raises
    ------
    ValueError
        Times do not increase, or a d is not a unit vector (the message names the index).

    Examples
    --------
    The velocity along a circle of colatitude 60° turns towards the pole, at sin 60° cos 60°:

    >>> import numpy as np
    >>> from nontwist import sphere
    >>> t, a = np.linspace(0, 1, 101), np.radians(60)
    >>> d = np.stack([np.sin(a) * np.cos(t), np.sin(a) * np.sin(t), np.full(101, np.cos(a))], axis=1)
    >>> v = np.cross([0, 0, 1], d)
    >>> np.linalg.norm(sphere.covariant_derivative(d, v, t), axis=1)[[0, 50]].round(6)
    array([0.433013, 0.433013])
    """
    d, v, t = unit_vectors(d, "d"), stack(v, "v", (3,)), as_array(time, "time", (None,))
    n = t.size
    if n < 2 or d.shape[-2:] != (n, 3) or v.shape[-2:] != (n, 3):
        raise ValueError(f"d and v must have the shape (..., n, 3) of {n} >= 2 times, got {d.shape} and {v.shape}")
    refuse(np.append(False, np.diff(t) <= 0.0), "time", "is not later than the time before it")
    m = min(5, n)
    start = np.clip(np.arange(n) - m // 2, 0, n - m)
    near, own = start[:, None] + np.arange(m), (np.arange(n) - start)[:, None]
    span = t[near[:, -1]] - t[near[:, 0]]
    x = (t[near] - t[:, None]) / span[:, None]
    # derivatives at node i of the Lagrange polynomials: (prod_k (x_i − x_k) / prod_k (x_j − x_k)) / (x_i − x_j)
    prod = np.prod(x[:, :, None] - x[:, None, :] + np.eye(m), axis=-1)
    weight = ratio(np.take_along_axis(prod, own, -1), -x * prod, 0.0)
    slope = np.einsum("ij,...ijx->...ix", weight, v[..., near, :] - v[..., :, None, :])
    return project(d, slope / span[:, None])


def covariant_derivative_of_field(
    field: Callable[[Array], ArrayLike], d: ArrayLike, w: ArrayLike, step: float = 0.01
) -> Array:
    """Return the covariant derivative of a tangent field in a direction: ∇_w v = (I − d ⊗ d) Dv·w (eq-cov-projection).

    Dv·w is the derivative at d along the geodesic that leaves d with the velocity w, by a central difference of order
    8. For a field sampled along a curve use `covariant_derivative`.

    Parameters
    ----------
    field : callable
        ``field(d)`` returns the vector of the field at the unit vector d, both of shape (3,).
    d, w : (..., 3) arrays
        Points, and tangent vectors there.
    step : float, rad
        Spacing of the eight points of the difference. For a field that varies as sin(k s) along the geodesic the
        relative error is (k step)⁸/630; round-off adds about 2e-16/step.

    Returns
    -------
    (..., 3) array, unit of the field times unit of w
        Tangent vectors at d.

    Raises
    ------
    ValueError
        d is not a unit vector, w is not tangent at d, `field` is not a function or returns a vector that is not tangent
        (the message states where), or `step` is not between 1e-6 and 0.3.

    Examples
    --------
    For the velocity field of a rotation about z, ∇_w (e3 × d) = (e3·d) d × w:

    >>> import numpy as np
    >>> from nontwist import sphere
    >>> spin = lambda d: np.cross([0, 0, 1], d)
    >>> sphere.covariant_derivative_of_field(spin, [0.6, 0, 0.8], [0, 1, 0])[[0, 2]].round(6)
    array([-0.64,  0.48])
    """
    function, step = as_function(field, "field"), as_number(step, "step")
    if not 1e-6 <= step <= 0.3:
        raise ValueError(f"step must be between 1e-6 and 0.3 rad, got {step:g}")
    d, w = np.broadcast_arrays(*_tangent(d, w, "w", "d"))
    speed = norm(w)[..., None]
    points = geodesic(d[..., None, :], ratio(w, speed, 0.0)[..., None, :], step * _OFFSETS)
    values = np.empty(points.shape)
    for index in np.ndindex(points.shape[:-1]):
        point = points[index] / norm(points[index])
        values[index] = as_array(function(point.copy()), "field(d)", (3,), np.inf)
        if _is_not_tangent(point, values[index], TOLERANCE):
            raise ValueError(
                f"field({point.tolist()}) is not tangent to the sphere: its part along d is "
                f"{values[index] @ point:.6g}; sphere.project returns the tangent part"
            )
    slope = np.einsum("j,...jx->...x", _WEIGHTS / step, values)
    return speed * project(d, slope)


def exp(d0: ArrayLike, v: ArrayLike) -> Array:
    """Return the exponential map: the end of the geodesic that leaves `d0` with the velocity `v` (eq-exp-2-sphere).

    Parameters
    ----------
    d0, v : (..., 3) arrays
        Point and tangent vector there, |v| in rad, of any length.

    Raises
    ------
    ValueError
        d0 is not a unit vector or v not tangent at d0 (the message names the index).

    Examples
    --------
    >>> import numpy as np
    >>> from nontwist import sphere
    >>> sphere.exp([0, 0, 1], [np.pi / 3, 0, 0]).round(6)  # 60° from the pole
    array([0.866025, 0.      , 0.5     ])
    """
    d0, v = _tangent(d0, v, "v")
    angle = norm(v)
    return np.cos(angle)[..., None] * d0 + ratio(np.sin(angle), angle, 1.0)[..., None] * v


def geodesic(d0: ArrayLike, v: ArrayLike, s: ArrayLike) -> Array:
    """Return the point at parameter s of the geodesic that leaves d0 with the velocity v: exp_d0(s v).

    Parameters
    ----------
    d0, v : (..., 3) arrays
        Point and tangent vector there, |v| in rad per unit of s.
    s : (...) array
        Broadcasts against the leading axes of d0 and v.

    Returns
    -------
    (..., 3) array

    Raises
    ------
    ValueError
        As `exp`.

    Examples
    --------
    >>> import numpy as np
    >>> from nontwist import sphere
    >>> sphere.geodesic([0, 0, 1], [np.pi / 3, 0, 0], [1, 2]).round(6)
    array([[ 0.866025,  0.      ,  0.5     ],
           [ 0.866025,  0.      , -0.5     ]])
    """
    d0, v = _tangent(d0, v, "v")
    return exp(d0, stack(s, "s", ())[..., None] * v)


def distance(d0: ArrayLike, d: ArrayLike) -> Array:
    """Return the length of the shortest geodesic between two points, from 0 to π.

    Parameters
    ----------
    d0, d : (..., 3) arrays

    Returns
    -------
    (...) array, rad

    Raises
    ------
    ValueError
        d0 or d is not a unit vector (the message names the index).

    Examples
    --------
    >>> import numpy as np
    >>> from nontwist import sphere
    >>> round(float(np.degrees(sphere.distance([0, 0, 1], [0, 0.6, 0.8]))), 6)  # acos 0.8
    36.869898
    """
    n, c = _cross_and_dot(unit_vectors(d0, "d0"), unit_vectors(d, "d"))
    return np.asarray(np.arctan2(norm(n), c))


def log(d0: ArrayLike, d: ArrayLike) -> Array:
    """Return the logarithm: the shortest tangent vector v at d0 with exp_d0(v) = d, |v| < π (subs-stwo).

    For given d0 and d the error is a few ulp; a change of d0 or d by one ulp turns the result by one ulp over π − |v|.

    Parameters
    ----------
    d0, d : (..., 3) arrays

    Returns
    -------
    (..., 3) array, rad

    Raises
    ------
    ValueError
        d0 or d is not a unit vector, or they are antipodal, to 2 eps (the message names the index).

    Examples
    --------
    >>> from nontwist import sphere
    >>> sphere.log([0, 0, 1], [1, 0, 0])[:2].round(6)  # from the pole a quarter of a great circle along x
    array([1.570796, 0.      ])
    """
    d0, d = unit_vectors(d0, "d0"), unit_vectors(d, "d")
    n, s, c = _checked_cross_and_dot(d0, d)
    return ratio(np.arctan2(s, c), s * norm(d0), 1.0)[..., None] * np.cross(n, d0)


def transport(d0: ArrayLike, d: ArrayLike, w: ArrayLike) -> Array:
    """Transport `w` parallel along the shortest geodesic, from the tangent plane at `d0` to that at `d`.

    This applies the smallest rotation from d0 to d; on tangent vectors it equals eq-parallel-transport-2-sphere.

    Parameters
    ----------
    d0, d, w : (..., 3) arrays
        Two points and a tangent vector at d0, in any unit.

    Raises
    ------
    ValueError
        d0 or d is not a unit vector, w is not tangent at d0, or d0 and d are antipodal, to 2 eps (the message names
        the index).

    Examples
    --------
    Around an octant a tangent vector returns turned by a right angle:

    >>> from nontwist import sphere
    >>> x, y, z = [1, 0, 0], [0, 1, 0], [0, 0, 1]
    >>> w = sphere.transport(x, y, [0, 1, 0])
    >>> sphere.transport(z, x, sphere.transport(y, z, w))
    array([0., 0., 1.])
    """
    d0, w = _tangent(d0, w, "w")
    n, s, c = _checked_cross_and_dot(d0, unit_vectors(d, "d"))
    n, length = ratio(n, s[..., None], 0.0), np.hypot(s, c)
    s, c = (s / length)[..., None], (c / length)[..., None]
    return c * w + s * np.cross(n, w) + (1.0 - c) * dot(n, w)[..., None] * n


def splits(T: ArrayLike, d: ArrayLike, d_tilde: ArrayLike) -> NDArray[np.bool_]:
    """Return whether tensors split from d to d̃ in the sense of eq-t-split.

    T must map d to a multiple of d̃ and the tangent plane at d to that at d̃ (to 1e-9 of the largest entry of T), and
    be invertible on both (singular values above 8 eps of that entry).

    Parameters
    ----------
    T : (..., 3, 3) array
    d, d_tilde : (..., 3) arrays

    Returns
    -------
    (...) array of bool

    Raises
    ------
    ValueError
        d or d̃ is not a unit vector (the message names the index).

    Examples
    --------
    An inertia splits only along its principal axes:

    >>> from nontwist import sphere
    >>> axes = [[0, 0, 1], [1, 0, 0]]
    >>> sphere.splits([[3, 0.1, 0], [0.1, 4, 0], [0, 0, 5]], axes, axes)
    array([ True, False])
    """
    T = stack(T, "T", (3, 3))
    T = ratio(T, np.abs(T).max(axis=(-2, -1), keepdims=True), 0.0)
    perp, parallel = _parts(T, unit_vectors(d, "d"), unit_vectors(d_tilde, "d_tilde"))
    mixed = np.abs(T - perp - parallel).max(axis=(-2, -1))
    least = np.minimum(np.linalg.norm(parallel, axis=(-2, -1)), np.linalg.svd(perp, compute_uv=False)[..., 1])
    return np.asarray((mixed <= TOLERANCE) & (least > 8 * EPS))


def split_tensor(T: ArrayLike, d: ArrayLike, d_tilde: ArrayLike) -> tuple[Array, Array]:
    """Split `T` into the part between the tangent planes and the part between the normals (eq-t-split).

    Parameters
    ----------
    T : (..., 3, 3) array
        Tensor that splits from d to d̃, in any unit.
    d, d_tilde : (..., 3) arrays

    Returns
    -------
    T_perp, T_parallel : (..., 3, 3) arrays
        (I − d̃ ⊗ d̃) T (I − d ⊗ d), with kernel span(d), and (d̃·T d) d̃ ⊗ d, with kernel the tangent plane at d.

    Raises
    ------
    ValueError
        T does not split from d to d̃ (see `splits`), or d or d̃ is not a unit vector (the message names the index).

    Examples
    --------
    >>> from nontwist import sphere
    >>> e3 = [0, 0, 1]
    >>> perp, parallel = sphere.split_tensor([[3, 0.1, 0], [0.1, 4, 0], [0, 0, 5]], e3, e3)
    >>> perp
    array([[3. , 0.1, 0. ],
           [0.1, 4. , 0. ],
           [0. , 0. , 0. ]])
    """
    refuse(~splits(T, d, d_tilde), "T", "does not split from d to d_tilde")
    return _parts(stack(T, "T", (3, 3)), stack(d, "d", (3,)), stack(d_tilde, "d_tilde", (3,)))


def _parts(T: Array, d: Array, d_tilde: Array) -> tuple[Array, Array]:
    d, d_tilde = d / norm(d)[..., None], d_tilde / norm(d_tilde)[..., None]
    normal, normal_tilde = d[..., :, None] * d[..., None, :], d_tilde[..., :, None] * d_tilde[..., None, :]
    perp = (np.eye(3) - normal_tilde) @ T @ (np.eye(3) - normal)
    return perp, normal_tilde @ T @ normal


def _tangent(d: ArrayLike, v: ArrayLike, name: str, point: str = "d0") -> tuple[Array, Array]:
    d, v = unit_vectors(d, point), stack(v, name, (3,))
    refuse(_is_not_tangent(d, v, TOLERANCE), name, f"is not tangent to the sphere at {point}")
    return d, v


def _is_not_tangent(d: Array, v: Array, tolerance: float) -> NDArray[np.bool_]:
    return np.asarray(np.abs(dot(d, v)) > tolerance * norm(v) + TINY)


def _cross_and_dot(d0: Array, d: Array) -> tuple[Array, Array]:
    """d0 × d and d0·d, the former to relative precision."""
    c = dot(d0, d)
    return np.cross(d0, np.where(c[..., None] < 0.0, d + d0, d - d0)), c


def _checked_cross_and_dot(d0: Array, d: Array) -> tuple[Array, Array, Array]:
    """d0 × d, its length and d0·d, antipodal points refused."""
    n, c = _cross_and_dot(d0, d)
    s = norm(n)
    refuse(s <= -2 * EPS * c, "d", "is antipodal to d0: the geodesic between them is not unique")
    return n, s, c

"""The rotation group SO(3), and frames that move with or without twist (subs-rotation, subs-non-twisting-frame).

A rotation R (eq-sothree) maps column vectors; frames are arrays with d1, d2, d3 as **rows**. Rotation vectors θ are in
rad, and hat(w) a = w × a (eq-algebra). With the unit quaternion (s, v) = (cos θ/2, sin θ/2 θ/|θ|) Rodrigues' formula
(eq-rodrigues) reads

    exp(θ) = I + 2 s v̂ + 2 v̂²,

free of cancellation and of switches, and log takes 4 q qᵀ, linear in R, by its column with the largest diagonal: no
digit is lost, neither near the identity nor near half turns. In d/dε exp(θ) = hat(dexp(θ) θ') exp(θ) (eq-dexp)

    dexp(θ) = I + (1 − cos θ)/θ² θ̂ + (θ − sin θ)/θ³ θ̂²,      dexp(θ)⁻¹ = I − θ̂/2 + (1 − θ/2 cot θ/2)/θ² θ̂²,

with a series for the last coefficient below 1 rad. All functions broadcast over leading axes. Rotations and frames may
depart from orthogonality by 1e-9 and are used as given: the departure passes into the result at its own size.
"""

from __future__ import annotations

from math import factorial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .arrays import EPS, TOLERANCE, Array, as_number, dot, norm, ratio, refuse, stack, unit_vectors
from .attitudes import quaternion_column
from .values import public

public(__name__)

# |B_2|, |B_4|, ..., |B_22|
_BERNOULLI = np.array([1, 1, 1, 1, 5, 691, 7, 3617, 43867, 174611, 854513])
_BERNOULLI = _BERNOULLI / np.array([6, 30, 42, 30, 66, 2730, 6, 510, 798, 330, 138])
_DEXP_SERIES = np.array([(-1) ** k / factorial(2 * k + 3) for k in range(9)])
_INVERSE_SERIES = np.array([b / factorial(2 * k + 2) for k, b in enumerate(_BERNOULLI)])


def hat(w: ArrayLike) -> Array:
    """Return the skew matrix of an axial vector: hat(w) a = w × a (eq-algebra).

    Parameters
    ----------
    w : (..., 3) array

    Returns
    -------
    (..., 3, 3) array

    Raises
    ------
    ValueError
        The argument is not an array of finite numbers of this shape.

    Examples
    --------
    >>> from nontwist import rotations
    >>> rotations.hat([1, 2, 3]) @ [4, 5, 6]  # the cross product
    array([-3.,  6., -3.])
    """
    x, y, z = np.moveaxis(stack(w, "w", (3,)), -1, 0)
    o = np.zeros_like(x)
    return np.stack([o, -z, y, z, o, -x, -y, x, o], axis=-1).reshape(*x.shape, 3, 3)


def vee(W: ArrayLike) -> Array:
    """Return the axial vector of a skew matrix, the inverse of `hat` (eq-algebra).

    Parameters
    ----------
    W : (..., 3, 3) array

    Returns
    -------
    (..., 3) array

    Raises
    ------
    ValueError
        W is not skew, to 1e-9 of its largest entry (the message names the index).

    Examples
    --------
    >>> from nontwist import rotations
    >>> rotations.vee([[0, -3, 2], [3, 0, -1], [-2, 1, 0]])
    array([1., 2., 3.])
    """
    W = stack(W, "W", (3, 3))
    size = np.abs(W).max(axis=(-2, -1))
    refuse(np.abs(W + W.mT).max(axis=(-2, -1)) > TOLERANCE * size, "W", "is not skew-symmetric")
    return np.stack([W[..., 2, 1] - W[..., 1, 2], W[..., 0, 2] - W[..., 2, 0], W[..., 1, 0] - W[..., 0, 1]], -1) / 2


def is_rotation(R: ArrayLike, tolerance: float = TOLERANCE) -> NDArray[np.bool_]:
    """Return whether matrices are in SO(3) (eq-sothree): RᵀR = I to a tolerance, det R > 0.

    Parameters
    ----------
    R : (..., 3, 3) array
    tolerance : float
        Bound for the largest entry of RᵀR - I.

    Returns
    -------
    (...) array of bool

    Raises
    ------
    ValueError
        The argument is not an array of finite numbers of this shape.

    Examples
    --------
    >>> import numpy as np
    >>> from nontwist import rotations
    >>> rotations.is_rotation([np.eye(3), -np.eye(3), 2 * np.eye(3)])
    array([ True, False, False])
    """
    R = stack(R, "R", (3, 3))
    tolerance = as_number(tolerance, "tolerance")
    R = np.clip(R, -2.0, 2.0)  # keeps the products of what is far from a rotation finite
    defect = np.abs(R.mT @ R - np.eye(3)).max(axis=(-2, -1))
    return np.asarray((defect <= tolerance) & (np.linalg.det(R) > 0.0))


def exp(theta: ArrayLike) -> Array:
    """Return the rotation by |θ| about the vector θ (eq-rodrigues).

    Parameters
    ----------
    theta : (..., 3) array, rad
        Rotation vector of any length, including many turns.

    Returns
    -------
    (..., 3, 3) array

    Raises
    ------
    ValueError
        The argument is not an array of finite numbers of this shape.

    Examples
    --------
    A third of a turn about the diagonal permutes the components cyclically:

    >>> import numpy as np
    >>> from nontwist import rotations
    >>> R = rotations.exp(2 * np.pi / 3 * np.array([1, 1, 1]) / np.sqrt(3))
    >>> (R @ [1, 2, 3]).round(9)
    array([3., 1., 2.])
    """
    half = stack(theta, "theta", (3,)) / 2
    angle = norm(half)
    return _matrix(np.cos(angle), ratio(np.sin(angle), angle, 1.0)[..., None] * half)


def log(R: ArrayLike) -> Array:
    """Return the shortest rotation vector of a rotation: |θ| ≤ π rad, exp(log(R)) = R (eq-rodrigues).

    For a half turn, there are two such vectors; the one whose largest component (the first of equals) is positive is
    returned.

    Parameters
    ----------
    R : (..., 3, 3) array

    Returns
    -------
    (..., 3) array, rad

    Raises
    ------
    ValueError
        R is not a rotation (the message names the index).

    Examples
    --------
    >>> from nontwist import rotations
    >>> rotations.log([[0, 0, 1], [1, 0, 0], [0, 1, 0]]).round(6)  # 2π/3 along the diagonal
    array([1.2092, 1.2092, 1.2092])
    """
    s, v = _quaternion(_rotation(R, "R"))
    length = norm(v)
    return ratio(2 * np.arctan2(length, s), length, 1.0)[..., None] * v


def dexp(theta: ArrayLike) -> Array:
    """Return the matrix from the rate of θ to the spatial angular velocity: exp(θ)' = hat(dexp(θ) θ') exp(θ) (eq-dexp).

    Parameters
    ----------
    theta : (..., 3) array, rad

    Returns
    -------
    (..., 3, 3) array

    Raises
    ------
    ValueError
        The argument is not an array of finite numbers of this shape.

    Examples
    --------
    >>> import numpy as np
    >>> from nontwist import rotations
    >>> (rotations.dexp([0, 0, np.pi / 2]) @ [1, 0, 0]).round(6)  # w where θ' = (1, 0, 0)
    array([0.63662, 0.63662, 0.     ])
    """
    angle, half, axis = _polar(theta)
    first = np.sin(half) * ratio(np.sin(half), half, 1.0)
    second = np.where(angle < 1.0, _even_series(_DEXP_SERIES, angle), 1.0 - ratio(np.sin(angle), angle, 1.0))
    return np.eye(3) + first[..., None, None] * axis + second[..., None, None] * (axis @ axis)


def dexp_inverse(theta: ArrayLike) -> Array:
    """Return the inverse of `dexp` (eq-dexp), which maps the spatial angular velocity to the rate of θ.

    Parameters
    ----------
    theta : (..., 3) array, rad

    Returns
    -------
    (..., 3, 3) array

    Raises
    ------
    ValueError
        |θ| is a multiple of 2π other than 0, to 8 eps |θ|: dexp is singular there (the message names the index).

    Examples
    --------
    >>> import numpy as np
    >>> from nontwist import rotations
    >>> (rotations.dexp_inverse([0, 0, np.pi / 2]) @ [1, 0, 0]).round(6)  # θ' where w = (1, 0, 0)
    array([ 0.785398, -0.785398,  0.      ])
    """
    angle, half, axis = _polar(theta)
    refuse((angle > 1.0) & (np.abs(np.sin(half)) <= 8 * EPS * half), "theta", "is a whole turn, where dexp is singular")
    second = np.where(
        angle < 1.0, _even_series(_INVERSE_SERIES, angle), 1.0 - np.cos(half) * ratio(half, np.sin(half), 1.0)
    )
    return np.eye(3) - half[..., None, None] * axis + second[..., None, None] * (axis @ axis)


def cayley(w: ArrayLike) -> Array:
    """Return the Cayley rotation (I − ŵ/2)⁻¹(I + ŵ/2), by 2 atan(|w|/2) about w: R a − a = w × (R a + a)/2.

    Parameters
    ----------
    w : (..., 3) array

    Returns
    -------
    (..., 3, 3) array

    Raises
    ------
    ValueError
        The argument is not an array of finite numbers of this shape.

    Examples
    --------
    Length 2 gives a right angle; for small angles the map is nearly the exponential:

    >>> import numpy as np
    >>> from nontwist import rotation, rotations
    >>> rotation(rotations.cayley([[0, 0, 2], [0, 0, 0.01]])).magnitude().round(6)
    array([1.570796, 0.01    ])
    """
    half = stack(w, "w", (3,)) / 2
    secant = np.hypot(1.0, norm(half))
    return _matrix(1.0 / secant, half / secant[..., None])


def cayley_inverse(R: ArrayLike) -> Array:
    """Return the vector w with cayley(w) = R.

    Parameters
    ----------
    R : (..., 3, 3) array

    Returns
    -------
    (..., 3) array

    Raises
    ------
    ValueError
        R is not a rotation, or is a half turn to 8 eps rad (the message names the index).

    Examples
    --------
    >>> from nontwist import rotations
    >>> rotations.cayley_inverse([[0, 0, 1], [1, 0, 0], [0, 1, 0]]).round(9)  # of the length 2 tan(π/3)
    array([2., 2., 2.])
    """
    s, v = _quaternion(_rotation(R, "R"))
    refuse(s <= 4 * EPS * norm(v), "R", "is a half turn, which no Cayley vector reaches")
    return 2 * v / s[..., None]


def darboux_vector(d3: ArrayLike, d3_dot: ArrayLike, psi_dot: ArrayLike = 0.0) -> Array:
    """Return the Darboux vector d3 × ḋ3 + ψ̇ d3 of a triad with the twist rate `psi_dot` (eq-w_twist).

    Parameters
    ----------
    d3, d3_dot : (..., 3) arrays
        Director and its rate, 1/s.
    psi_dot : (...) array, rad/s

    Returns
    -------
    (..., 3) array, rad/s
        The vector w with ḋ_i = w × d_i for each of the three directors.

    Raises
    ------
    ValueError
        d3 is not a unit vector (the message names the index).

    Examples
    --------
    >>> from nontwist import rotations
    >>> rotations.darboux_vector(d3=[0, 0, 1], d3_dot=[1, 0, 0], psi_dot=3)
    array([0., 1., 3.])
    """
    d3, d3_dot = unit_vectors(d3, "d3"), stack(d3_dot, "d3_dot", (3,))
    return np.cross(d3, d3_dot) + stack(psi_dot, "psi_dot", ())[..., None] * d3


def twisted_triad(frame: ArrayLike, psi: ArrayLike) -> Array:
    """Return the triad exp(ψ d3) {d1, d2, d3}, as rows (subs-non-twisting-frame).

    d1ψ = cos ψ d1 + sin ψ d2 and d2ψ = −sin ψ d1 + cos ψ d2.

    Parameters
    ----------
    frame : (..., 3, 3) array
        Rows d1, d2, d3.
    psi : (...) array, rad
        Twist angle.

    Raises
    ------
    ValueError
        A frame is not orthonormal and right-handed (the message names the index).

    Examples
    --------
    >>> import numpy as np
    >>> from nontwist import rotations
    >>> rotations.twisted_triad(np.eye(3), np.pi / 3)[0].round(6)  # d1
    array([0.5     , 0.866025, 0.      ])
    """
    d1, d2, d3 = np.moveaxis(_rotation(frame, "frame"), -2, 0)
    psi = stack(psi, "psi", ())[..., None]
    c, s = np.cos(psi), np.sin(psi)
    return np.stack(np.broadcast_arrays(c * d1 + s * d2, c * d2 - s * d1, d3), axis=-2)


def twist_rate(frame: ArrayLike, frame_dot: ArrayLike) -> Array:
    """Return the twist rate ψ̇ = w·d3 = (ḋ1·d2 − ḋ2·d1)/2 of a moving frame (eq-non-twisting).

    Parameters
    ----------
    frame : (..., 3, 3) array
        Rows d_i.
    frame_dot : (..., 3, 3) array, 1/s
        Rows ḋ_i.

    Returns
    -------
    (...) array, rad/s

    Raises
    ------
    ValueError
        A frame is not orthonormal and right-handed (the message names the index).

    Examples
    --------
    >>> import numpy as np
    >>> from nontwist import rotations
    >>> frame, w = np.eye(3), [0.3, -0.2, 2]
    >>> float(rotations.twist_rate(frame, np.cross(w, frame)))
    2.0
    """
    q, v = _rotation(frame, "frame"), stack(frame_dot, "frame_dot", (3, 3))
    return np.asarray((dot(v[..., 0, :], q[..., 1, :]) - dot(v[..., 1, :], q[..., 0, :])) / 2)


def velocity_variation(frame: ArrayLike, variation_rate: ArrayLike) -> tuple[Array, Array]:
    """Return the variations of the material angular velocity (subs-k-variations, eq-variation-convected).

    A motion Λ(t) is varied to exp(ι δθ(t)) Λ(t) (eq-one-parameter). At ι = 0

        δW_⊥ = Λᵀ (I − d3 ⊗ d3) δθ',      δW_∥ = d3·δθ'.

    δθ itself does not enter: by eq-var-lambdaprime ``δ(ΛᵀΛ') = Λᵀ hat(δθ') Λ``, so δW = Λᵀ δθ', which is split along
    D3.

    Parameters
    ----------
    frame : (..., 3, 3) array
        Rows d_i.
    variation_rate : (..., 3) array, rad/s
        δθ' in space.

    Returns
    -------
    delta_W_perp : (..., 3) array, rad/s
        δW_⊥ in body components; the third is 0.
    delta_W_par : (...) array, rad/s
        δW_∥.

    Raises
    ------
    ValueError
        A frame is not orthonormal and right-handed (the message names the index).

    Examples
    --------
    >>> from nontwist import rotations
    >>> frame = [[0, 1, 0], [0, 0, 1], [1, 0, 0]]
    >>> perp, par = rotations.velocity_variation(frame, (1, 2, 3))
    >>> perp
    array([2., 3., 0.])
    >>> float(par)
    1.0
    """
    q, rate = _rotation(frame, "frame"), stack(variation_rate, "variation_rate", (3,))
    d3 = q[..., 2, :]
    along = dot(d3, rate)
    across = (q @ (rate - along[..., None] * d3)[..., None])[..., 0]
    across[..., 2] = 0.0
    return across, along


def frame_map(frame: ArrayLike, initial_frame: ArrayLike) -> Array:
    """Return the rotation χ = d1 ⊗ D1 + d2 ⊗ D2 + d3 ⊗ D3 between two frames (subs-non-twisting-frame): χ D_i = d_i.

    Parameters
    ----------
    frame : (..., 3, 3) array
        Rows d_i.
    initial_frame : (..., 3, 3) array
        Rows D_i.

    Returns
    -------
    (..., 3, 3) array

    Raises
    ------
    ValueError
        A frame is not orthonormal and right-handed (the message names the index).

    Examples
    --------
    >>> import numpy as np
    >>> from nontwist import rotations
    >>> frame = rotations.twisted_triad(np.eye(3), np.pi / 3)
    >>> (rotations.frame_map(frame, np.eye(3)) @ [1, 0, 0]).round(6)  # d1
    array([0.5     , 0.866025, 0.      ])
    """
    return np.asarray(_rotation(frame, "frame").mT @ _rotation(initial_frame, "initial_frame"))


def _rotation(R: ArrayLike, name: str) -> Array:
    R = stack(R, name, (3, 3))
    refuse(~is_rotation(R), name, "is not a rotation (orthonormal, right-handed)")
    return R


def _polar(theta: ArrayLike) -> tuple[Array, Array, Array]:
    """|θ|, |θ|/2 and the skew matrix of the unit axis (zero for θ = 0)."""
    theta = stack(theta, "theta", (3,))
    angle = norm(theta)
    return angle, angle / 2, hat(ratio(theta, angle[..., None], 0.0))


def _even_series(coefficients: Array, angle: Array) -> Array:
    """Sum of coefficients[k] angle^(2k + 2), for angles below 1."""
    x = np.minimum(angle, 1.0) ** 2
    return np.asarray(x * np.polynomial.polynomial.polyval(x, coefficients))


def _matrix(s: Array, v: Array) -> Array:
    """Rotation of the unit quaternion (s, v)."""
    V = hat(v)
    return np.eye(3) + 2 * s[..., None, None] * V + 2 * V @ V


def _quaternion(R: Array) -> tuple[Array, Array]:
    """Quaternion (s ≥ 0, v) of R, up to a positive factor."""
    q = quaternion_column(R)
    return q[..., 0], q[..., 1:]

"""The free gyrostat: a standard body that carries rotors of constant momentum, attitude included, at any times.

With c = Σ h a the momentum of the rotors in the body and D = J⁻¹, the total momentum P = J W + c is fixed in space, and
in the body P' = P × W, W = D (P - c). Both |P| and K = ½ W·J W are kept, so the tip of P moves on the curve of degree
four in which a sphere meets an ellipsoid about c: W is a rational function of elliptic functions (Volterra 1899;
Wittenburg 1977). Most solutions first bring the pair of quadrics to diagonal form, case by case, with a transformation
that grows beyond bounds at a separatrix. Here nothing is transformed, and there is one case.

**The quartic.** Let e3 be the direction of P at the start, L = |P|, b = D c, and z = (n1 + i n2)/(1 + n3) the
stereographic coordinate of n = P/L, with z = 0 at the start. Then (1 + z z*)² (K - K0)/L is a biquadratic form
F(z, z*) = A(z) z*² + B(z) z* + C(z), and n' = n × W is the Hamiltonian equation z' = (i/2) ∂F/∂z*. On the curve, F = 0,

    z'² = g(z) = -(B² - 4 A C)/4,     A = m* + γ* z + 2 b3 z²,   B = β* + f z + γ z²,   C = β z + m z²,
    m = L (D11 - D22)/2 - i L D12,    f = L (D11 + D22 - 2 D33) + 2 b3,    β = W1 - i W2,    γ = -β - 2 (b1 - i b2):

of time alone, with complex coefficients g = a0 + a1 z + ... + a4 z⁴, but real invariants, as F is hermitian,

    g2 = a0 a4 - a1 a3/4 + a2²/12,    g3 = a0 a2 a4/6 + a1 a2 a3/48 - a2³/216 - (a0 a3² + a1² a4)/16.

So z is an elliptic function of t on a lattice with a real period, and Weierstrass's solution of z'² = g(z) (Whittaker &
Watson, §20.6) has its poles, the complex times a1, a2 at which P would point to -e3, where

    ℘(a) = a2/12 ± z0' y/2,     ℘'(a) = -(± a1 y + z0' a3)/4,     z0' = i β*/2,   y = √a4:     a = ±R_F(℘(a) - e_i),

Carlson's integral, its sign from ℘'. The zeros are 0 and, by Abel's theorem, a1 + a2.

**Velocity and attitude at once.** A direction fixed in space, seen from the body, is a spinor χ = (χ1, χ2) with z =
χ2/χ1, χ' = (i/2) W·σ χ and |χ| = 1. From (1, 0) it goes to the first column of the unitary matrix of the turn of the
body, that is to its quaternion: what an integral of the third kind adds to P, the angle about P, is the phase of χ.
The zeros of χ1 are the poles of z; its poles, where z z* = -1, are those of χ2 and in conjugate pairs, so that they
give a positive factor and a rate. With v = π t/(2ω), v_k = π a_k/(2ω), Z = θ1'/θ1 and one positive factor for both,

    χ1 = e^(iκt) θ1(v1 - v) θ1(v2 - v)/(θ1(v1) θ1(v2)),
    χ2 = e^(iκt) (2ω z0'/π) θ1(v) θ1(v1 + v2 - v)/(θ1'(0) θ1(v1 + v2)),     κ = W3/2 + Im((π/2ω) (Z(v1) + Z(v2))),

the rate from χ1'/χ1 = i W3/2 at the start. Then n = (2 Re χ1* χ2, 2 Im χ1* χ2, |χ1|² - |χ2|²) and W(t) = W + L D
(n(t) - n). The formula holds for every pair of periods. Of the real and the imaginary one that with the larger Im τ is
taken: it is at least 1/2, six terms are enough, and the separatrix is Im τ = ∞, θ1 = sin. Times are brought to half a
period about 0. With each period the products of θ1 gain a positive factor, and a phase: 0 where ω is real, else
-2 Re(v1 + v2), or twice that where Re τ = 1/2, from θ1(v + π τ) = -e^(-iπτ - 2iv) θ1(v).

**Where it degenerates.** Permanent rotations, P × W = 0 or P = 0: W is constant. Near them, at separatrices (two e_i
equal, one period infinite), for symmetric bodies and rotors along principal axes the formulas hold as they are. What
cancels are rates and axes, the invariants, their roots e_i and ℘(a) - e_i: these are computed with 120 digits from J, c
and W as they are in double precision. Without rotors this is the free body of `free_bodies`.

**θ1 of complex arguments**, its size apart. With q = e^(iπτ) and an argument v that is brought to |Im v| <= π Im τ/2
by θ1(v + π τ) = -e^(-iπτ - 2iv) θ1(v) (DLMF 20.2.8), the series over sin((2n + 1) v) = sin v (1 + 2 Σ cos 2jv), with
the sum over j <= n, is

    θ1(v)/(2 q^(1/4)) = sin v (1 + T_0 + Σ_j T_j (e^(ij(πτ + 2v)) + e^(ij(πτ - 2v)))),
    T_j = Σ_(n >= max(j, 1)) (-1)^n q^(n(n + 1) - j),

where no power exceeds 1 and no difference is small but that of sin v at its zeros. The size |Im v| of sin v is kept as
a logarithm, so that nothing overflows, and τ may be i∞. For |q| <= e^(-π/2) the terms left out are below 1e-24.

Accuracy: 1e-14, and not below 1e-16 per radian that the body turns and 3e-15 per turn of P in the body; of the motion
from the numbers given, however much it amplifies their last digits. Measured against Taylor series with 50 digits:
6e-13 after 1000 rad; 2e-14 past the saddle where the start is 1e-9 from a permanent rotation, and an ulp of it counts
5e-8. Of W: also round-off of |P| over the least moment. Work: a millisecond for a body, and 1 µs for a state.

**Digits.** What may cancel is computed with 120 decimal digits, from J, c and W as they are in double precision: axes
and rates, the invariants of the quartic, their roots and the differences of these. All else is positive sums and
products, where double precision loses nothing.
"""

from __future__ import annotations

import cmath
import math
from decimal import Decimal, localcontext
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..geometry.arrays import Array, as_array, cross
from ..geometry.attitudes import attitudes
from ..models.system import checked_inertia
from .free_bodies import TOO_FAR, Motion, as_times, checked_attitude, checked_velocity, free_standard
from .free_constants import FARTHEST

DIGITS = 120
ZERO = Decimal(0)
_STOP, _NONE, _STEADY, _LEAST = Decimal(10) ** (6 - DIGITS), Decimal(10) ** -DIGITS, Decimal(10) ** -45, 1e-100
Vector = Any  # array of decimals
_exact: Any = np.frompyfunc(lambda x: Decimal(float(x)), 1, 1)


class Lattice(NamedTuple):
    """The periods of the motion and the poles of z."""

    half: float  # half of the real period; infinite where the momentum does not return
    base: complex  # the half-period that theta functions are taken with, real or imaginary
    tau: complex
    poles: tuple[complex, complex]


class Gyrostat(NamedTuple):
    """A body with its rotors at the start."""

    inverse: Array  # (3, 3) D
    length: float  # L
    frame: Array  # (3, 3) rows e1, e2, e3
    pace: float  # 1/s, no part of W or of the motion of P in the body is faster by far
    unit: float  # of time, for what follows, 1/s: a power of two
    W: Array  # (3,) along e1, e2, e3
    lattice: Lattice | None  # None: W is constant


def complex_number(x: Decimal, y: Decimal = ZERO) -> Any:
    """Return the complex number x + iy of many digits, as the matrix that multiplies by it: ``@`` is the product."""
    return np.array([[x, -y], [y, x]])


def _root(z: Any) -> Any:
    """Return the square root, of real part >= 0."""
    (x, _), (y, _) = z
    size = (x * x + y * y).sqrt()
    if not size:
        return complex_number(ZERO)
    a = ((size + abs(x)) / 2).sqrt()
    b = y / (2 * a)
    return complex_number(a, b) if x >= 0 else complex_number(abs(b), a.copy_sign(y))


def _rounded(z: Any) -> complex:
    """Return a number in double precision; its zeros are positive, on the upper side of cuts."""
    return complex(float(z[0, 0]) + 0.0, float(z[1, 0]) + 0.0)


def gyrostat(J: Array, c: Array, W: Array) -> Gyrostat:
    """Return the constants of the motion from W on."""
    with localcontext() as context:
        context.prec = DIGITS
        inertia, rotor, velocity = _exact(J), _exact(c), _exact(W)
        adjugate = cross(inertia[[1, 2, 0]], inertia[[2, 0, 1]])
        D = adjugate / (inertia[0] @ adjugate[0])
        P = inertia @ velocity + rotor
        L = (P @ P).sqrt()
        frame = _frame(P / L) if L else _exact(np.eye(3))
        A = L * frame @ (D - np.trace(D) / 3 * _exact(np.eye(3))) @ frame.T  # a sphere turns nothing
        b, local = frame @ D @ rotor, frame @ velocity
        pace = ((A * A).sum() + b @ b + local @ local).sqrt()
        found, unit = None, 1.0
        if L and local[0] ** 2 + local[1] ** 2 > (_STEADY * pace) ** 2:
            unit = math.ldexp(1.0, math.frexp(float(pace))[1])
            rates = np.array([(A[0, 0] - A[1, 1]) / 2, A[0, 1], A[0, 0] + A[1, 1] - 2 * A[2, 2]])
            found = _lattice(*(part / Decimal(unit) for part in (rates, b, local)))
        inverse, axes, along = (part.astype(np.float64) for part in (D, frame, local))
    return Gyrostat(inverse, float(L), axes, float(pace), unit, along / unit, found)


def _frame(n: Vector) -> Vector:
    """Return a rotation whose third row is `n`, with zeros where `n` is an axis."""
    first: Any = cross(n, _exact(np.eye(3))[abs(n).argmin()])
    first = first / (first @ first).sqrt()
    return np.array([first, cross(n, first), n])


def _lattice(rates: Vector, b: Vector, W: Vector) -> Lattice:
    """Return the periods and poles from the `rates` Re m, -Im m and f - 2 b3, and from b and W."""
    m, beta = complex_number(rates[0], -rates[1]), complex_number(W[0], -W[1])
    gamma = -beta - 2 * complex_number(b[0], -b[1])
    quartic = _quartic(m, beta, gamma, rates[2] + 2 * b[2], b[2])
    first, second, third = _roots(*_invariants(quartic))
    is_real = not second[1, 0]
    slope, y, a2 = complex_number(-W[1], W[0]) / 2, _root(quartic[4]), quartic[2] / 12
    poles = []
    for sign in (1, -1):
        p = a2 + sign * slope @ y / 2
        change = (sign * quartic[1] @ y + slope @ quartic[3]) / -4
        poles.append(_pole([_rounded(p - e) for e in (first, second, third)], _rounded(change)))
    if is_real:
        e1, e2, e3 = sorted((first[0, 0], second[0, 0], third[0, 0]), reverse=True)
        span, upper, lower = e1 - e3, e1 - e2, e2 - e3
    else:
        real_root, imaginary_part = first[0, 0], second[1, 0]
        span = ((3 * real_root / 2) ** 2 + imaginary_part**2).sqrt()
        upper, lower = (span / 2 + sign * 3 * real_root / 4 for sign in (1, -1))
    real, imaginary = _half_period(float(span), float(upper)), _half_period(float(span), float(lower))
    ratio = max(real, imaginary) / min(real, imaginary)
    base = complex(real) if real <= imaginary else complex(0, imaginary)
    return Lattice(real, base, complex(0, ratio) if is_real else complex(0.5, ratio / 2), (poles[0], poles[1]))


def _quartic(m: Any, beta: Any, gamma: Any, f: Decimal, b3: Decimal) -> Any:
    """Return the coefficients of -(B² - 4AC)/4, B = β* + f z + γ z², A = m* + γ* z + 2 b3 z², C = β z + m z²."""
    A, B, C = (
        (m.T, gamma.T, complex_number(2 * b3)),
        (beta.T, complex_number(f), gamma),
        (complex_number(ZERO), beta, m),
    )
    return [ac - bb / 4 for ac, bb in zip(_polynomial_product(A, C), _polynomial_product(B, B), strict=True)]


def _polynomial_product(p: Any, q: Any) -> Any:
    """Return the coefficients of the product of two polynomials of degree two."""
    return [sum(p[i] @ q[k - i] for i in range(3) if 0 <= k - i < 3) for k in range(5)]


def _invariants(a: Any) -> tuple[Decimal, Decimal]:
    """Return g2 and g3, which are real."""
    outer, inner, square = a[0] @ a[4], a[1] @ a[3], a[2] @ a[2]
    g2 = outer - inner / 4 + square / 12
    g3 = a[2] @ (outer / 6 + inner / 48 - square / 216) - (a[0] @ a[3] @ a[3] + a[1] @ a[1] @ a[4]) / 16
    return g2[0, 0], g3[0, 0]


def _roots(g2: Decimal, g3: Decimal) -> tuple[Any, Any, Any]:
    """Return the roots of 4 x³ - g2 x - g3; the first is real, the others are real or conjugate.

    The root with the sign of g3 that is farthest from 0 is never double. Newton's iteration falls to it from above.
    """
    if abs(g2) < _NONE and abs(g3) < _NONE:
        g2 = _NONE  # three equal roots: the motion is rational in time, as far as anyone will wait
    size = abs(g3)
    x = Decimal(math.sqrt(max(float(g2), 0.0)) / 2 + math.cbrt(float(size) / 4)) * (1 + Decimal(10) ** -12)
    for _ in range(400):
        step = (4 * x * x * x - g2 * x - size) / (12 * x * x - g2)
        x -= step
        if abs(step) <= abs(x) * _STOP:
            break
    x = x.copy_sign(g3)
    rest = g2 - 3 * x * x
    half = abs(rest).sqrt() / 2
    half_difference = complex_number(half) if rest >= 0 else complex_number(ZERO, half)
    middle = complex_number(-x / 2)
    return complex_number(x), middle + half_difference, middle - half_difference


def _half_period(span: float, part: float) -> float:
    """Return K(k)/√span, where k'² = part/span."""
    from scipy.special import ellipkm1

    return float(ellipkm1(max(part, 0.0) / span)) / math.sqrt(span)


def _pole(differences: list[complex], slope: complex) -> complex:
    """Return a with ℘(a) - e_i = `differences` and ℘'(a) = `slope`: Carlson's R_F, after a duplication off its cut.

    Three negative numbers stay on the cut, as a is imaginary: the value above it is -i R_F of their sizes.
    """
    from scipy.special import elliprf

    most = max(abs(x) for x in differences)
    x, y, z = (e if abs(e) > _LEAST * most else complex(_LEAST * most) for e in differences)
    a, b, c = map(cmath.sqrt, (x, y, z))
    sign, shift = (-1.0 if abs(slope - 2 * a * b * c) < abs(slope + 2 * a * b * c) else 1.0), a * b + b * c + c * a
    moved = [(u + shift) / 4 for u in (x, y, z)]
    if all(not u.imag and u.real < 0 for u in moved):
        return -1j * sign * float(elliprf(*(-u.real for u in moved)))
    return complex(sign * elliprf(*moved))


_TERMS, _FLAT = 6, 200.0  # from this Im τ on, θ1 is a sine


def free_gyrostat(
    inertia: ArrayLike,
    rotor_momentum: ArrayLike,
    material_angular_velocity: ArrayLike,
    times: ArrayLike,
    rotation: object = None,
    *,
    physical: bool = True,
) -> Motion:
    """Return the free motion of a standard body with rotors of constant momentum.

    Parameters
    ----------
    inertia : (3, 3) array or 3 principal values, kg m²
        Convected inertia J about the fixed point, of the body with its rotors locked.
    rotor_momentum : (3,) array, kg m² s⁻¹
        Momentum of the rotors relative to the body, in body components: the sum of all h a.
    material_angular_velocity : (3,) array, rad/s
        W at t = 0, in the body; may be zero.
    times : (k,) array, s
        In any order, negative ones included.
    rotation : (3, 3) array or scipy Rotation, optional
        Λ at t = 0, body to space; the identity by default.
    physical : bool
        As in `nontwist.standard`.

    Returns
    -------
    attitude : (k, 3, 3) array
        Λ, columns are the directors.
    material_angular_velocity : (k, 3) array, rad/s

    Raises
    ------
    ValueError
        As `free_standard`.

    Notes
    -----
    Theta functions, on every branch. The docstring of the module has derivation, sources and accuracy.

    Examples
    --------
    A wheel along the middle axis makes the rotation about it stable:

    >>> import numpy as np
    >>> from nontwist import exact
    >>> J, c = np.array([3, 4, 5]), (0, 2.5, 0)
    >>> attitude, W = exact.free_gyrostat(J, c, (0.1, 2, 0.1), [0, 1, 1000])
    >>> np.einsum("kij,kj->ki", attitude, J * W + c).round(9)  # the total momentum, fixed in space
    array([[ 0.3, 10.5,  0.5],
           [ 0.3, 10.5,  0.5],
           [ 0.3, 10.5,  0.5]])
    >>> at = 6, 12, 18
    >>> exact.free_standard(J, (0.1, 2, 0.1), at)[1][:, 1].round(2)
    array([ 1.97, -1.33, -2.  ])
    >>> exact.free_gyrostat(J, c, (0.1, 2, 0.1), at)[1][:, 1].round(2)
    array([1.99, 1.99, 2.  ])
    """
    J, W = checked_inertia(inertia, physical), checked_velocity(material_angular_velocity)
    c = as_array(rotor_momentum, "rotor_momentum", (3,))
    if not c.any():
        return free_standard(J, W, times, rotation, physical=physical)
    t, R = as_times(times), checked_attitude(rotation)
    p, velocity = gyrostat_motion(J, c, W, t)
    Lam: Array = R @ attitudes(p)
    return Lam, velocity


def gyrostat_motion(J: Array, c: Array, W: Array, times: Array) -> tuple[Array, Array]:
    """Return the turns from the start, continuous quaternions (k, 4), scalar last, and W (k, 3), of sound arguments.

    Raises
    ------
    ValueError
        The body or its momentum turns by more than 1e15 rad.
    """
    body = gyrostat(J, c, W)
    if not body.pace * abs(times).max(initial=0.0) <= FARTHEST:
        raise ValueError(TOO_FAR)
    if body.lattice is None:
        return _states_of_steady_rotation(W, times)
    first, second = _spinor(body.lattice, body.W, times * body.unit)
    product = np.conj(first) * second
    turned = body.length * np.stack([2 * product.real, 2 * product.imag, -2 * abs(second) ** 2], axis=1)
    axis = np.stack([second.imag, -second.real, first.imag], axis=1)
    p = np.concatenate([axis @ body.frame, first.real[:, None]], axis=1)
    velocity: Array = W + turned @ body.frame @ body.inverse
    return p, velocity


def _states_of_steady_rotation(W: Array, times: Array) -> tuple[Array, Array]:
    rate = math.hypot(*W)
    axis = W / rate if rate > 0 else W
    half = 0.5 * rate * times
    return np.concatenate([np.outer(np.sin(half), axis), np.cos(half)[:, None]], axis=1), np.tile(W, (len(times), 1))


def _spinor(found: Lattice, W: Array, times: Array) -> tuple[Array, Array]:
    """Return χ1 and χ2 (k,) at `times` from the start (1, 0)."""
    theta, rate, period = Theta(found.tau), math.pi / 2 / found.base, 2 * found.half
    turns = np.round(times / period) if math.isfinite(period) else np.zeros(len(times))
    v = rate * (times - turns * period if turns.any() else times)
    v1, v2 = rate * found.poles[0], rate * found.poles[1]
    (x1, n1, Z1), (x2, n2, Z2), (x3, n3, _) = theta.at(v1), theta.at(v2), theta.at(v1 + v2)
    (y1, m1, _), (y2, m2, _), (y3, m3, _), (y0, m0, _) = (theta.at(x) for x in (v1 - v, v2 - v, v1 + v2 - v, v))
    sizes = m1 + m2 - n1 - n2, m0 + m3 - n3
    most, slope = np.maximum(*sizes), complex(-0.5 * W[1], 0.5 * W[0]) / rate / theta.slope
    first, second = y1 * y2 / (x1 * x2) * np.exp(sizes[0] - most), slope * y0 * y3 / x3 * np.exp(sizes[1] - most)
    phase = (0.5 * W[2] + float((rate * (Z1 + Z2)).imag)) * times
    if found.base.imag:
        phase -= (4 if found.tau.real else 2) * turns * (v1 + v2).real
    over = np.exp(1j * phase) / np.sqrt(abs(first) ** 2 + abs(second) ** 2)
    return over * first, over * second


class Theta:
    """θ1(v|τ)/(2 q^(1/4)), for Re τ of 0 or 1/2 and Im τ >= 1/2."""

    def __init__(self, tau: complex) -> None:
        self.tau, self.is_flat = tau, tau.imag > _FLAT
        self.exponent = 0j if self.is_flat else 1j * math.pi * tau
        q = 0j if self.is_flat else cmath.exp(self.exponent)
        powers = [[(-1) ** n * q ** (n * (n + 1) - j) for n in range(max(j, 1), _TERMS + 1)] for j in range(_TERMS + 1)]
        self.weights = [sum(terms, 0j) for terms in powers]
        self.slope = complex(1 + self.weights[0] + 2 * sum(w * q**j for j, w in enumerate(self.weights) if j))

    def at(self, v: Any) -> tuple[Any, Array, Any]:
        """Return the value over e^size, the size, and the logarithmic derivative, at complex `v`, an array or one."""
        v = np.asarray(v, complex)
        k = np.zeros(v.shape) if self.is_flat else np.round(v.imag / (math.pi * self.tau.imag))
        if not self.is_flat:
            v = v - k * (math.pi * self.tau)
        size = abs(v.imag)
        c, s = 0.5 * (1 + np.exp(-2 * size)), np.copysign(-0.5 * np.expm1(-2 * size), v.imag)
        sine, cosine = np.sin(v.real) * c + 1j * np.cos(v.real) * s, np.cos(v.real) * c - 1j * np.sin(v.real) * s
        series, slope = np.full(v.shape, 1 + self.weights[0]), np.zeros(v.shape, complex)
        if not self.is_flat:
            up, down = np.exp(self.exponent + 2j * v), np.exp(self.exponent - 2j * v)
            a, b = up, down
            for j in range(1, _TERMS + 1):
                series += self.weights[j] * (a + b)
                slope += 2j * j * self.weights[j] * (a - b)
                a, b = a * up, b * down
            shift = -self.exponent * k * k - 2j * k * v + 1j * math.pi * k
            sine, cosine, size = sine * np.exp(1j * shift.imag), cosine * np.exp(1j * shift.imag), size + shift.real
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
            return sine * series, size, cosine / sine + slope / series - 2j * k

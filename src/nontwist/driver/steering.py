"""The shortest motion without twist from one attitude to another.

Without twist, w·d3 = 0, the length of a motion is that of the path of d3 on the sphere. Any attitude can be reached:
turns about d3 come from the area that the path encloses. Extremals of the length are, with a unit vector p ⊥ e3 of the
body, a number c and the length T (U. Boscain, F. Rossi, SIAM J. Control Optim. 47 (2008) 1851),

    Λ(t) = Λ_0 exp(t (p + c e3)) exp(-c t e3),        W(t) = p turned by c t about e3,        |W| = 1,

so d3 moves on a circle, of angular radius η = arccot c about p + c e3. With 2θ = T/sin η, the angle that it goes on its
circle, the unit quaternion of Λ_0⁻¹ Λ(T) has

    q0 + i q3 = (cos θ + i cos η sin θ) exp(-i θ cos η),        (q1, q2) = sin η sin θ · p turned by θ cos η.

Hence with s = |(q1, q2)|, k = |q0 + i q3|, ζ = arg(q0 + i q3) and φ = arg(cos θ + i cos η sin θ)

    cos θ = k cos φ,   sin²θ = s² + k² sin²φ,   sin η = s/sin θ,   cos η = k sin φ/sin θ,   φ - θ cos η = |ζ|,

and c has the sign of ζ. The left side rises from 0 at φ = 0, a great circle, to π at φ = π: one root, bracketed. It is
``θ sin²η/(1 + cos η) - asin(s² cos φ/(sin θ + k sin φ))`` without a difference of nearly equal numbers. The length 2θ
sin η rises with φ, so of ±q the one with |ζ| ≤ π/2 is nearer. For s = 0, a turn α = 2ζ about d3, θ = π and cos η = 1 -
|α|/(2π): once around a circle, of length √(|α| (4π - |α|)).

Ties. Of turns of π, q0 = 0, both signs of q are as near: that with q3 > 0 is taken, or q1 > 0, or q2 > 0. A turn about
d3 starts into the direction p = e1.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import asin, atan2, cos, hypot, pi, sin, sqrt
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..geometry.arrays import Array, Rotation, as_floats
from ..geometry.values import hinted
from .starts import one_attitude

XTOL = 4 * float(np.finfo(np.float64).eps)
MOST_AXES = 31  # of fractions: NumPy's vector product takes 32 with that of the vectors


@dataclass(frozen=True, eq=False)
class Steering:
    """A shortest motion without twist, returned by `nontwist.steer`.

    Attributes
    ----------
    start : Rotation
    length : float, rad
        Length of the path of the axis d3.
    direction : (3,) array
        p, the angular velocity at the start, in the body, for a motion whose axis covers 1 rad of its path per unit of
        time.
    curvature : float
        c, the rate at which the angular velocity turns about d3 in the body, per unit of path length; 1/tan of the
        radius of the circle.
    radius : float, rad
        Angular radius of the circle on which the axis moves; π/2 for a great circle.

    Examples
    --------
    A quarter of a turn about d3 for a body that must not spin about d3:

    >>> from nontwist import steer
    >>> from scipy.spatial.transform import Rotation
    >>> way = steer(Rotation.identity(), Rotation.from_euler("z", 90, degrees=True))
    >>> round(way.length, 6), round(way.radius, 6)
    (4.155936, 0.722734)
    >>> way.rotation([0, 1]).as_euler("xyz", degrees=True)[:, 2].round(9)
    array([ 0., 90.])
    """

    start: Rotation
    length: float
    direction: Array
    curvature: float
    radius: float

    def rotation(self, fraction: ArrayLike) -> Rotation:
        """Return attitudes along the motion.

        Parameters
        ----------
        fraction : (...) array
            0 at the start, 1 at the target.

        Returns
        -------
        Rotation

        Raises
        ------
        ValueError
            A fraction is not from 0 to 1; more than 31 axes.
        """
        from scipy.spatial.transform import Rotation

        t = _fraction(fraction)
        angle = self.length / sin(self.radius) if self.length else 0.0
        about = sin(self.radius) * self.direction + cos(self.radius) * np.array([0.0, 0.0, 1.0])
        turn = t[..., None] * (angle * about)
        back = t[..., None] * np.array([0.0, 0.0, -angle * cos(self.radius)])
        return self.start * Rotation.from_rotvec(turn) * Rotation.from_rotvec(back)

    def material_angular_velocity(self, fraction: ArrayLike) -> Array:
        """Return W along the motion, if it takes one second.

        Parameters
        ----------
        fraction : (...) array
            0 at the start, 1 at the target.

        Returns
        -------
        (..., 3) array, rad/s

        Raises
        ------
        ValueError
            A fraction is not from 0 to 1; more than 31 axes.
        """
        t = _fraction(fraction)
        angle = t * self.length * self.curvature
        p, across = self.direction, np.array([-self.direction[1], self.direction[0], 0.0])
        return self.length * (np.cos(angle)[..., None] * p + np.sin(angle)[..., None] * across)


@hinted
def steer(start: Any, target: Any, *, scalar_first: bool | None = None) -> Steering:
    """Return the shortest motion without twist from one attitude to another.

    The axis d3 moves on a circle. Several motions are equally short for turns by π and for turns about d3; one of them
    is returned (`nontwist.driver.steering`).

    Parameters
    ----------
    start, target : Rotation, (3, 3) Λ, (4,) quaternion, DataArray, ...
        Attitudes, body to space; for a motion, its last attitude. See `nontwist.rotation` for all forms.
    scalar_first : bool, optional
        Order of quaternions given as plain arrays.

    Returns
    -------
    Steering

    Raises
    ------
    ValueError
        An argument is not an attitude.

    Examples
    --------
    Turning a body by 1° about its axis without spin about that axis requires a path of 27°:

    >>> import numpy as np
    >>> from nontwist import rotations, steer
    >>> way = steer(np.eye(3), rotations.exp([0, 0, np.radians(1)]))
    >>> round(np.degrees(way.length).item(), 1)
    26.8
    """
    begin, end = (one_attitude(x, scalar_first, name) for name, x in (("start", start), ("target", target)))
    return steered(begin, end)


def _fraction(value: ArrayLike) -> Array:
    t = as_floats(value, "fraction")
    if t.size and not (t.min() >= 0 and t.max() <= 1):
        raise ValueError(f"fraction must be from 0 to 1, got numbers from {t.min():g} to {t.max():g}")
    if t.ndim > MOST_AXES:
        raise ValueError(f"fraction has {t.ndim} axes, more than {MOST_AXES}")
    return t


def steered(start: Rotation, target: Rotation) -> Steering:
    """Return what `steer` does, of rotations."""
    q = (start.inv() * target).as_quat()
    lead = next(x for x in (q[3], q[2], q[0], q[1]) if x != 0)
    x, y, z, w = (q if lead > 0 else -q).tolist()
    s, zeta = hypot(x, y), atan2(z, w)
    if s == 0.0:
        theta, radius = (pi, 2 * asin(sqrt(abs(zeta) / (2 * pi)))) if zeta else (0.0, pi / 2)
        p = np.array([1.0, 0.0, 0.0])
    else:
        theta, radius = _solved(min(s, 1.0), hypot(z, w), abs(zeta))
        turned = -theta * cos(radius) * (1.0 if zeta >= 0 else -1.0)
        p = np.array([x * cos(turned) - y * sin(turned), x * sin(turned) + y * cos(turned), 0.0]) / s
    sign = 1.0 if zeta >= 0 else -1.0
    if sign < 0:
        radius = pi - radius
    return Steering(start, 2 * theta * sin(radius), p, cos(radius) / sin(radius) if radius else 0.0, radius)


def _solved(s: float, k: float, zeta: float) -> tuple[float, float]:
    """Return θ and η; φ is searched as it is, or where it is above π/2 as π - φ, whose digits count there."""
    from scipy.optimize import brentq

    def shape(x: float, far: bool) -> tuple[float, float, float, float]:
        sine = hypot(s, k * sin(x))
        return -cos(x) if far else cos(x), k * sin(x), sine, atan2(sine, -k * cos(x) if far else k * cos(x))

    def gap(x: float, far: bool) -> float:
        cosine, rise, sine, theta = shape(x, far)
        eta = s / sine
        return (
            theta * eta * eta / (1 + rise / sine) - asin(max(-1.0, min(1.0, s * cosine * (s / (sine + rise))))) - zeta
        )

    far = gap(pi / 2, False) < 0
    ends = (0.0, pi / 2)
    values = [gap(x, far) for x in ends]
    if values[0] * values[1] >= 0:  # rounding has taken away the change of sign
        x = ends[0] if abs(values[0]) < abs(values[1]) else ends[1]
    else:
        solve: Any = brentq
        x = float(solve(gap, *ends, args=(far,), xtol=1e-300, rtol=XTOL, maxiter=2000))
    _, rise, _, theta = shape(x, far)
    return theta, atan2(s, rise)

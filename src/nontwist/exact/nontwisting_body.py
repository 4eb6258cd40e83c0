"""The non-twisting body in closed form: under moments along its moving directors, and by the paper's scheme.

**Moments** (eq-nonholonomic). In the body Π_⊥' = M_⊥(t), so the momentum is a quadrature, ``Π_⊥(t) = Π_⊥(0) + ∫ M_⊥``;
the attitude is Λ' = Λ Ŵ with W = J_⊥⁻¹ Π_⊥. Where the axis â of W is fixed in the body, W = s(t) â, that is closed as
well: Λ = Λ0 exp(θ â), θ = ∫ s. So it is wherever J_⊥⁻¹ M_⊥ and the initial W have one direction (case 2 of the paper),
and after the end of any load.

The quadrature: M is taken at 16 Gauss points of each subinterval between breakpoints and output times; a subinterval is
halved until the last terms of its Legendre series are below round-off. Integrals up to a point inside a subinterval are
those of the series. Tables and triangles are exact at once; a kink that is not a breakpoint costs time, not accuracy. A
load that needs more than a million halvings is refused, a sine before anything is sampled.

**The director scheme** of the paper, of the free body (eq-discrete-nonholonomic). The step ``Δd_i = h w × d_{i,m}``,
``d_m`` the mean of both ends, is the Cayley rotation of h w: a rotation about w by

    θ_h = 2 atan(|w| h/2).

It keeps w × d_i as the velocity at both ends, for w × d_n + w × d_{n+1} = 2 w × d_m; hence W, Π1, Π2 and K are constant
to the last step, for every h, and the discrete body turns about a fixed axis by θ_h a step. At the time t the scheme of
step h/k has turned by φ_k = (t k/h) 2 atan(|w| h/2k), and two rotations about one axis lie ``2√2 sin(|φ - φ'|/2)``
apart, so the second quotient (eq-stwo) is sin(|φ1 - φ2|/2)/sin(|φ2 - φ4|/2) = 4 + O(h²). The differences of the angles
follow from 2 atan(x/2) - atan(x) = atan(x³/(4 + 3x²)), which does not cancel.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import ArrayLike

from ..geometry.arrays import Array, as_array, as_number, as_positive, norm, ratio
from ..geometry.values import as_whole
from ..loads import Load, Term, as_load
from ..models.bodies import D3
from .free_bodies import Motion, as_times, checked_attitude, planar, rotations_about

NODES, HALVINGS, TAIL, FIXED = 16, 60, 1e-16, 1e-12
MOST = 1_000_000  # subintervals that come from halving
A_PERIOD = 5  # subintervals of a period of a sine, at most


class Subintervals(NamedTuple):
    """Intervals [a, b] that follow one another, the times of their nodes, and the moment at these."""

    a: Array  # (p,)
    b: Array  # (p,)
    times: Array  # (p, NODES)
    moment: Array  # (p, NODES, 3)


class AxialRotation(NamedTuple):
    """Rotation about one axis of the body at the ends (p+1,) and the nodes (p, NODES) of subintervals."""

    axis: Array  # (3,)
    rate: Array
    angle: Array
    rate_inside: Array
    angle_inside: Array


@cache
def gauss() -> tuple[Array, Array, Array, Array]:
    """Nodes and weights on [-1, 1], the matrix that integrates from -1 to the nodes, that of the Legendre series."""
    x, w = legendre.leggauss(NODES)
    series = (2 * np.arange(NODES) + 1)[:, None] / 2 * legendre.legvander(x, NODES - 1).T * w
    P = legendre.legvander(x, NODES)
    k = np.arange(1, NODES)
    integrals = np.concatenate([(x + 1)[:, None], (P[:, k + 1] - P[:, k - 1]) / (2 * k + 1)], axis=1)
    return x, w, integrals @ series, series


def edges_of(load: Load, limits: Array) -> Array:
    """Return `limits` and the breakpoints of `load` between them, sorted."""
    inner = [t for t in load.breakpoints if limits[0] < t < limits[-1]]
    return np.unique(np.concatenate([limits, inner]))


def unrefined(load: Load, a: Array, b: Array) -> Subintervals:
    """Return the subintervals [a, b] as they are, with the moment of the terms of kind "body"."""
    times = (a + b)[:, None] / 2 + (b - a)[:, None] / 2 * gauss()[0]
    return Subintervals(a, b, times, load.sample(times.ravel(), "body").reshape(*times.shape, 3))


def expected_subintervals(load: Load, start: float, end: float) -> float:
    """Return the approximate number of subintervals after halving; 0 for a load of unknown time scale."""
    smooth = [term for term in load.terms if term.kind == "body" and not term.breakpoints]
    return A_PERIOD / 20 * (end - start) / min((term.resolution for term in smooth), default=np.inf)


def too_many(load: Load, limits: Array) -> str | None:
    """Return the message for more than `MOST` expected subintervals between `limits`, None for fewer."""
    start, end = float(limits[0]), float(limits[-1])
    if (count := expected_subintervals(load, start, end)) <= MOST + len(limits):
        return None
    return (
        f"the closed-form solution needs about {count:.2g} subintervals of the load, at most {MOST:.0e} are allowed; "
        f"a frequency of {MOST / A_PERIOD / (end - start):.2g} Hz would do, or the integrator split"
    )


def subintervals_of(load: Load, limits: Array) -> Subintervals:
    """Moment of the terms of kind "body" between `limits`, in subintervals on which its Legendre series is complete.

    Raises
    ------
    ValueError
        More than `MOST` subintervals come from halving.
    """
    if reason := too_many(load, limits):
        raise ValueError(reason)
    series = gauss()[3]
    edges = edges_of(load, limits)
    a, b = edges[:-1], edges[1:]
    done: list[Subintervals] = []
    scale, halved = 0.0, 0
    for level in range(HALVINGS):
        a, b, times, moment = unrefined(load, a, b)
        coefficients = abs(np.einsum("kn,pnc->pkc", series, moment)).max(axis=2)
        scale = max(scale, float(coefficients.max(initial=0.0)))
        tail = coefficients[:, -2:].max(axis=1)
        rough = (tail > 16 * TAIL * coefficients.max(axis=1)) & (tail * (b - a) > TAIL * scale * (edges[-1] - edges[0]))
        rough &= b - a > 4 * np.spacing(abs(a) + abs(b))
        if level == HALVINGS - 1:
            rough[:] = False
        done.append(Subintervals(a[~rough], b[~rough], times[~rough], moment[~rough]))
        if not rough.any():
            break
        if (halved := halved + int(rough.sum())) > MOST:
            raise ValueError(
                f"the closed-form solution needs more than {MOST:.0e} subintervals of the load: it is not smooth near "
                f"t = {a[rough][0]:.12g} s; give its breakpoints, or use the integrator split"
            )
        middle = (a[rough] + b[rough]) / 2
        a, b = np.concatenate([a[rough], middle]), np.concatenate([middle, b[rough]])
    a, b, times, moment = (np.concatenate(arrays) for arrays in zip(*done, strict=True))
    order = np.argsort(a)
    return Subintervals(a[order], b[order], times[order], moment[order])


def cumulative(start: Array, parts: Array) -> Array:
    """Values at the ends of subintervals, the first `start`, from the increment of each subinterval."""
    return np.concatenate([start[None], start + np.cumsum(parts, axis=0)])


def momenta(Pi: Array, subintervals: Subintervals) -> tuple[Array, Array]:
    """Return Π_⊥ at the ends (p+1, 3) and nodes (p, NODES, 3) of `subintervals`, from `Pi` (3,) at the first end."""
    _, w, integral, _ = gauss()
    half, M = (subintervals.b - subintervals.a)[:, None] / 2, subintervals.moment * [1, 1, 0]
    ends = cumulative(Pi, half * np.einsum("n,pnc->pc", w, M))
    return ends, ends[:-1, None] + half[:, None] * np.einsum("mn,pnc->pmc", integral, M)


def axial_rotation(J: Array, Pi: Array, subintervals: Subintervals) -> AxialRotation | None:
    """Rotation from the momentum `Pi` on; None where the axis does not stay fixed in the body."""
    _, w, integral, _ = gauss()
    inverse = np.zeros((3, 3))
    inverse[:2, :2] = np.linalg.inv(J[:2, :2])
    W, inside = (P @ inverse for P in momenta(Pi, subintervals))
    every = np.concatenate([W, inside.reshape(-1, 3)])
    fastest = every[np.argmax(np.einsum("ki,ki->k", every, every))]
    size = float(np.linalg.norm(fastest))
    axis = fastest / size if size else D3
    if abs(every @ np.cross(D3, axis)).max() > FIXED * size:
        return None
    half, s, s_in = (subintervals.b - subintervals.a) / 2, W @ axis, inside @ axis
    angle = cumulative(np.zeros(()), half * (s_in @ w))
    return AxialRotation(axis, s, angle, s_in, angle[:-1, None] + half[:, None] * (s_in @ integral.T))


def loaded_momentum(
    inertia: ArrayLike,
    material_angular_velocity: ArrayLike,
    load: Load | Term,
    times: ArrayLike,
    *,
    t_start: float = 0.0,
    physical: bool = True,
) -> Array:
    """Return the material momentum Π_⊥ of the non-twisting body under moments in the moving frame (eq-nonholonomic).

    Parameters
    ----------
    inertia : (3, 3) array or 3 principal values, kg m²
        Convected inertia; the third axis is principal.
    material_angular_velocity : (3,) array, rad/s
        W at `t_start`, without a component along the third axis.
    load : Load
        Terms along the moving directors only: `body_moment`, `pulse`, `sine`.
    times : (k,) array, s
        Not before `t_start`, in any order.
    t_start : float, s
    physical : bool
        As in `nontwist.standard`.

    Returns
    -------
    (k, 3) array, kg m² s⁻¹
        The third component is 0. Accuracy: round-off of the largest momentum and impulse.

    Raises
    ------
    ValueError
        As `free_nontwisting`; or a time is before the start, or the load is of another kind.

    Examples
    --------
    >>> from nontwist import exact, pulse
    >>> triangle = pulse((4, 0, 0), start=0, end=1)
    >>> exact.loaded_momentum([3, 4, 5], (0, 0, 0), triangle, [0.5, 1, 2])[:, 0].round(9)
    array([1., 2., 2.])
    """
    J, W = planar(inertia, material_angular_velocity, physical)
    subintervals, place = _subintervals(load, times, t_start)
    return momenta(J @ W, subintervals)[0][place(subintervals)]


def loaded_nontwisting(
    inertia: ArrayLike,
    material_angular_velocity: ArrayLike,
    load: Load | Term,
    times: ArrayLike,
    rotation: Any = None,
    *,
    t_start: float = 0.0,
    physical: bool = True,
) -> Motion:
    """Return the motion of the non-twisting body under moments that turn it about one axis fixed in the body.

    Parameters
    ----------
    inertia, material_angular_velocity, load, times, t_start, physical
        As in `loaded_momentum`.
    rotation : (3, 3) array or scipy Rotation, optional
        Λ at `t_start`, body to space; the identity by default.

    Returns
    -------
    attitude, material_angular_velocity
        As in `free_standard`. Accuracy: round-off of the angle.

    Raises
    ------
    ValueError
        As `loaded_momentum`; or the axis of rotation changes in the body: the attitude then has no closed form.

    Examples
    --------
    From rest, 1 rad/s² for one second, then a steady rotation:

    >>> from nontwist import exact, pulse, rotation
    >>> push = pulse((4, 0, 0), start=0, end=1, shape="rectangle")
    >>> attitude, W = exact.loaded_nontwisting([4, 4, 5], (0, 0, 0), push, [0, 1, 2])
    >>> rotation(attitude).magnitude().round(9)
    array([0. , 0.5, 1.5])
    """
    J, W = planar(inertia, material_angular_velocity, physical)
    R = checked_attitude(rotation)
    subintervals, place = _subintervals(load, times, t_start)
    motion = axial_rotation(J, J @ W, subintervals)
    if motion is None:
        raise ValueError(
            "the axis of rotation moves in the body: only the momentum has a closed form (loaded_momentum)"
        )
    at = place(subintervals)
    return rotations_about(R, motion.axis, motion.angle[at]), np.outer(motion.rate[at], motion.axis)


def _subintervals(load: Load | Term, times: ArrayLike, t_start: float) -> tuple[Subintervals, Any]:
    load, t, t0 = as_load(load), as_times(times), as_number(t_start, "t_start")
    if t.min(initial=t0) < t0:
        raise ValueError(f"times contains {t.min():g} s, before the start at {t0:g} s")
    if any(term.kind != "body" for term in load.terms):
        raise ValueError("load has terms that are not given along the moving directors: no closed form")
    subintervals = subintervals_of(load, np.unique(np.append(t, t0)))
    return subintervals, lambda p: np.searchsorted(np.append(p.a, p.b[-1:] if len(p.b) else t0), t)


MOST_STATES = 10_000_000  # states, 1 GB


def discrete_angle(angular_velocity: ArrayLike, step: float) -> float:
    """Return the angle θ_h = 2 atan(|w| h/2), rad, by which the free discrete body turns in one step.

    Parameters
    ----------
    angular_velocity : (3,) array, rad/s
        In the body or in space; without twist.
    step : float, s
        h, positive; any size: θ_h stays below π.

    Raises
    ------
    ValueError
        An argument has the wrong shape or is not finite, or the step is not positive.

    Examples
    --------
    >>> from nontwist import exact
    >>> round(exact.discrete_angle((0, 2, 0), 0.5), 6)  # 2 atan(1/2), where the body itself turns by 1 rad
    0.927295
    """
    rate = float(np.linalg.norm(as_array(angular_velocity, "angular_velocity", (3,))))
    return float(2 * np.arctan(rate * _step(step) / 2))


def discrete_free(
    inertia: ArrayLike,
    material_angular_velocity: ArrayLike,
    step: float,
    steps: int,
    rotation: Any = None,
    *,
    physical: bool = True,
) -> Motion:
    """Return all states of the scheme "energy-momentum", order 2, on the free non-twisting body, in closed form.

    Parameters
    ----------
    inertia : (3, 3) array or 3 principal values, kg m²
        Convected inertia; the third axis is principal.
    material_angular_velocity : (3,) array, rad/s
        W, without a component along the third axis.
    step : float, s
        h.
    steps : int
        N, at least 0.
    rotation : (3, 3) array or scipy Rotation, optional
        Λ at t = 0; the identity by default.
    physical : bool
        As in `nontwist.standard`.

    Returns
    -------
    attitude : (N+1, 3, 3) array
        Λ at t = n h: turned by n θ_h about W.
    material_angular_velocity : (N+1, 3) array, rad/s
        Constant.

    Raises
    ------
    ValueError
        As `free_nontwisting`; or `step` or `steps` is invalid.

    Notes
    -----
    Exact for the equations of the scheme; derived in the docstring of the module. Accuracy: round-off, and the ulp of n
    θ_h.

    Examples
    --------
    >>> from nontwist import exact, nontwisting, rotation, simulate
    >>> attitude, W = exact.discrete_free([3, 4, 5], (0, 2, 0), step=0.5, steps=3)
    >>> rotation(attitude).magnitude().round(6)
    array([0.      , 0.927295, 1.85459 , 2.781886])

    The same by the scheme itself, step by step:

    >>> how = {"t_end": 1.5, "step": 0.5, "integrator": "energy-momentum"}
    >>> run = simulate(nontwisting([3, 4, 5]), material_angular_velocity=(0, 2, 0), **how)
    >>> rotation(run).magnitude().round(6)
    array([0.      , 0.927295, 1.85459 , 2.781886])
    """
    (_, W), R = planar(inertia, material_angular_velocity, physical), checked_attitude(rotation)
    count = as_whole(steps, "steps", 0, MOST_STATES)
    rate = float(np.linalg.norm(W))
    axis = W / rate if rate > 0 else D3
    n = np.arange(count + 1, dtype=np.float64)
    return rotations_about(R, axis, n * discrete_angle(W, step)), np.broadcast_to(W, (len(n), 3)).copy()


def discrete_second_quotient(angular_velocity: ArrayLike, step: float, times: ArrayLike) -> Array:
    """Return the second quotient Q_II of the director scheme on the free non-twisting body (eq-stwo).

    Parameters
    ----------
    angular_velocity : (3,) array, rad/s
        In the body or in space; not 0.
    step : float, s
        h, the largest of the three steps h, h/2 and h/4.
    times : (k,) array, s
        Multiples of h; at 0 the limit is returned.

    Returns
    -------
    (k,) array
        ``sin(|φ1 - φ2|/2)/sin(|φ2 - φ4|/2)``. Accuracy: round-off of the arguments of the sines.

    Raises
    ------
    ValueError
        An argument has the wrong shape or is not finite, the step is not positive, or the body is at rest.

    Examples
    --------
    >>> from nontwist import exact
    >>> [exact.discrete_second_quotient((0, 2, 0), h, [1]).round(3).item() for h in (0.1, 0.05, 0.025)]
    [3.978, 3.994, 3.999]
    """
    h, t = _step(step), as_times(times)
    w = as_array(angular_velocity, "angular_velocity", (3,))
    if not w.any():
        raise ValueError("angular_velocity is zero: a body at rest has no second quotient")
    x = float(norm(w)) * h / 2
    if x < 1e-100:  # x³ underflows
        return np.full(len(t), 4.0)
    coarse, fine = _lag(x), 2 * _lag(x / 2)
    a, b = np.sin(np.outer([coarse / h, fine / h], t))
    return ratio(a, b, coarse / fine)


def _lag(x: float) -> float:
    """Return 2 atan(x/2) - atan(x)."""
    r = 2 / x
    return math.atan(x / (r * r + 3))


def _step(step: float) -> float:
    return float(as_positive(step, "step", (), "s"))

"""`least_effort`: the moments of least ∫|M|² dt from rest to rest between two attitudes of a non-twisting body.

The motion. With M in the body, across d3, the velocity is the integral of J⁻¹M, and the attitude that of the velocity.
Time in units of the span T and inertia in units of tr J leave nothing of both in the equations, so it is solved in
these units; then M scales with tr J/T², and the effort with (tr J)²/T³.

The problem. M is linear between n nodes, the run that of the integrator. In coordinates y of the table in which ``∫|M|²
dt = |y|²`` (Q = LLᵀ, the matrix of the integrals of products of hat functions, y = Lᵀ M)

    minimise ½ |y|²  where  c(y) = 0,        c = (log(Λ_goalᵀ Λ_end), W_end),

five equations, whose derivatives A are those of the discrete run (`linearised`): exact to round-off. At a minimum ``y =
Aᵀλ``. So what is left, ``|y - Aᵀλ|/|y|`` with the best λ, certifies the table: it is the gradient of the effort along
the moments that reach the goal, relative to the gradient.

The solution. SciPy's method of trust regions (`trust-constr`) for y and λ. Its matrix is I less the second derivatives
of λ·c; products with these are differences of Aᵀλ. A direction along which it is not positive is followed downhill. The
first guess goes along the path of `steer` with the speed ``6 t (1 - t)``: the least effort for a great circle of a
round body.

What is found is a minimum next to the shortest path; whether one far away is lower is not decided. It goes a longer
way: to follow the shortest path the axis must turn into a circle at once, which takes moments.

The same minimum without tables, for the tests: with the momentum p of the attitude, constant in space, and M' = J⁻¹ p
across d3, p' = p × W (Pontryagin). So ``W_i'' = J_i⁻² p_i``, five numbers at the start for five at the end.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from ..geometry import rotations
from ..geometry.arrays import Array, Rotation, as_positive
from ..geometry.values import as_whole
from ..integrators import Status
from ..integrators.ivp import segmented
from ..integrators.linearised_runs import Linearised, scheme_of
from ..integrators.tangents import forward
from ..loads import Load, body_moment
from ..models.bodies import D3, nontwisting
from ..models.stack import is_principal, stacked
from ..models.system import DirectorSystem, as_system
from . import completion
from .parameters import Parameters
from .planning import planned
from .starts import AT_REST, one_attitude
from .steering import Steering, steered

STEPS = 80  # at least
FEWEST, MOST = 4, 401  # nodes
PARALLEL = 1e-12
ITERATIONS = 300
CERTIFIED, NEARLY = 1e-10, 1e-6  # projected gradient; where round-off allows no less
NARROWEST = 1e-6  # region of trust, of y
REACHED, FAR = 1e-12, 1e3  # rad
DIFFERENCE = 1e-6  # of y


@dataclass(frozen=True, eq=False)
class LeastEffort:
    """The moments of least effort between two attitudes, returned by `nontwist.least_effort`.

    Attributes
    ----------
    start : Rotation
    times : (n,) array, s
        From 0 to the end.
    moment : (n, 3) array, N m
        Moments in the body at these times, linear in between; the third is 0.
    effort : float, N² m² s
        ∫|M|² dt.
    length : float, rad
        Length of the path of the axis d3; never less than that of `nontwist.steer`.
    projected_gradient : float
        Projection of the gradient of the effort on the moments that still reach the target, relative to the gradient; a
        measure of convergence.
    gap : float
        Distance of the final state from the target and from rest: rad, and rad per span.

    Examples
    --------
    >>> from nontwist import least_effort, nontwisting, simulate
    >>> from scipy.spatial.transform import Rotation
    >>> body, target = nontwisting([3, 4, 5]), Rotation.from_euler("z", 90, degrees=True)
    >>> found = least_effort(body, Rotation.identity(), target, t_end=10, nodes=11)
    >>> run = simulate(body, t_end=10, rotation=found.start, load=found.load)
    >>> last = Rotation.from_quat(run.quaternion.values[-1])
    >>> bool((last.inv() * target).magnitude() < 1e-7)
    True
    """

    start: Rotation
    times: Array
    moment: Array
    effort: float
    length: float
    projected_gradient: float
    gap: float

    @property
    def load(self) -> Load:
        """The moments as a load."""
        return body_moment(self.times, self.moment)


def least_effort(
    system: DirectorSystem,
    start: Any,
    target: Any,
    *,
    t_end: float,
    nodes: int = 41,
    scalar_first: bool | None = None,
) -> LeastEffort:
    """Return the moments of least ∫|M|² dt that move a non-twisting body from rest to rest between two attitudes.

    They are piecewise linear between `nodes` equidistant times. With more nodes the effort approaches the least of all
    moments, with an error that falls like the fourth power of their distance. The minimum is local, found from the
    shortest path, that of `steer`; other minima are not searched for.

    Parameters
    ----------
    system : DirectorSystem
        A body made by `nontwisting`, without weight and without a prescribed spin.
    start, target : Rotation, (3, 3) Λ, (4,) quaternion, DataArray, ...
        Attitudes, body to space; for a motion, its last attitude. See `nontwist.rotation` for all forms.
    t_end : float, s
        Duration; the motion begins at 0.
    nodes : int, 4 to 401
    scalar_first : bool, optional
        Order of quaternions given as plain arrays.

    Returns
    -------
    LeastEffort

    Raises
    ------
    ValueError
        An argument is invalid: `system` is another kind of body, or an attitude is not one.
    RuntimeError
        The solver does not converge: for turns by less than 10⁻³ rad, or with very few nodes.

    Examples
    --------
    A turn by 90° about the axis with the least effort; the path of the axis is longer than the shortest one:

    >>> from nontwist import least_effort, nontwisting, steer
    >>> from scipy.spatial.transform import Rotation
    >>> start, target = Rotation.identity(), Rotation.from_euler("z", 90, degrees=True)
    >>> found = least_effort(nontwisting([3, 4, 5]), start, target, t_end=10, nodes=11)
    >>> round(found.effort, 2), round(found.length, 3), round(steer(start, target).length, 3)
    (7.51, 4.406, 4.156)
    """
    system = as_system(system)
    require_nontwisting(system)
    T, n = float(as_positive(t_end, "t_end", (), "s")), as_whole(nodes, "nodes", FEWEST, MOST)
    begin, end = (one_attitude(x, scalar_first, name) for name, x in (("start", start), ("target", target)))
    way, trace = steered(begin, end), float(np.trace(system.inertia))
    transfer = Transfer(system.inertia / trace, begin.inv() * end, n)
    y, gradient, gap = (
        least_effort_table(transfer, transfer.along(way)) if way.length > 0 else (np.zeros(2 * n), 0.0, 0.0)
    )
    table, unit = transfer.table(y), trace / T / T
    effort = float(y @ y) * unit * unit * T
    if not (math.isfinite(effort) and (effort > 0 or way.length == 0)):
        raise ValueError(
            f"the moments for t_end = {T:g} s are too large or too small for a number; choose units of time, length "
            "and mass in which the numbers are nearer to 1"
        )
    length = path_length(transfer.inertia, transfer.times, table)
    return LeastEffort(begin, T * transfer.times, unit * table, effort, length, gradient, gap)


def require_nontwisting(system: DirectorSystem) -> None:
    """Raise a ValueError unless a body is non-twisting, and without weight and prescribed spin."""
    takes = "least_effort takes bodies of nontwisting(inertia), without weight and spin"
    if (
        system.axis is None
        or np.linalg.norm(np.cross(system.axis, D3)) > PARALLEL
        or not is_principal(stacked(system))[0]
    ):
        raise ValueError(f"{takes}; got one of {system.name!r}")
    if system.dead_force.any():
        raise ValueError(f"{takes}; this one has dead forces")
    if system.spin is not None:
        raise ValueError(f"{takes}; this one has a prescribed spin")


def path_length(inertia: Array, times: Array, table: Array) -> float:
    """Return the length of the path of the axis, ∫|W| dt from rest, under moments that are linear between times."""
    x, w = np.polynomial.legendre.leggauss(8)
    part, h, rates = (1 + x) / 2, np.diff(times)[:, None], np.zeros_like(table)
    rates[:, :2] = np.linalg.solve(inertia[:2, :2], table[:, :2].T).T
    before = np.concatenate([np.zeros((1, 3)), np.cumsum(h * (rates[1:] + rates[:-1]) / 2, axis=0)])[:-1]
    inside = part - part**2 / 2, part**2 / 2
    W = before[:, None] + h[:, :, None] * sum(
        f[:, None] * rate[:, None] for f, rate in zip(inside, (rates[:-1], rates[1:]), strict=True)
    )
    return float((h * np.sqrt((W * W).sum(axis=2)) * w / 2).sum())


class Ends(NamedTuple):
    """Where a table leads to: c and its derivatives by y."""

    gap: Array  # (5,)
    slopes: Array  # (5, k)


class Transfer:
    """From rest to rest in one unit of time, of a body of trace 1: what tables of moments lead to."""

    def __init__(self, inertia: Array, goal: Rotation, nodes: int) -> None:
        self.goal, self.inertia, self.times = goal, inertia, np.linspace(0, 1, nodes)
        body, h = nontwisting(inertia, physical=False), 1 / (nodes - 1)
        hats = h / 6 * (4 * np.eye(nodes) + np.eye(nodes, k=1) + np.eye(nodes, k=-1))
        hats[0, 0] = hats[-1, -1] = h / 3
        self._root = np.linalg.cholesky(hats)
        self._inverse = np.linalg.inv(self._root)
        steps = -(-STEPS // (nodes - 1)) * (nodes - 1)
        plan = planned(body, integrator="gauss", order=8, t_end=1.0)
        self._scheme = plan.scheme
        self._problem = plan.problem(AT_REST, segmented((0.0, 1.0), (steps,)))
        self._kept = np.zeros(steps, dtype=np.int64)
        self._kept[-1] = 1

    def table(self, y: Array) -> Array:
        """Return moments at the nodes, (n, 3)."""
        across: Array = self._inverse.T @ y.reshape(-1, 2)
        return np.concatenate([across, np.zeros((len(across), 1))], axis=1)

    def along(self, way: Steering) -> Array:
        """Return y of the moments along a path, from rest to rest."""
        t, c, p = self.times[:, None], way.length * way.curvature, way.direction
        angle, ahead = c * (3 - 2 * t) * t * t, np.array([-p[1], p[0], 0.0])
        along, left = np.cos(angle) * p + np.sin(angle) * ahead, np.cos(angle) * ahead - np.sin(angle) * p
        speed = 6 * t * (1 - t)
        rate = way.length * ((6 - 12 * t) * along + c * speed**2 * left)
        return (self._root.T @ (rate @ self.inertia)[:, :2]).ravel()

    def ends(self, y: Array) -> Ends:
        """Return where the moments lead to: far away where a step turns too far."""
        problem = replace(self._problem, load=body_moment(self.times, self.table(y)))
        outcome = completion.checked_march(self._scheme, problem)
        if outcome.failures[0, 0] != Status.OK:
            return Ends(np.full(5, FAR), np.zeros((5, y.size)))
        from scipy.spatial.transform import Rotation

        states = outcome.states.part(0)
        parameters = Parameters(problem, "values", scheme_of(self._scheme, problem.load))
        steps = Linearised(problem, self._scheme, parameters.inputs, parameters.changes)
        first = np.zeros((steps.rows, parameters.count))
        X = forward(steps, states, first, parameters.entries, self._kept)[-1]
        off = (self.goal.inv() * Rotation.from_quat(states.quaternion[-1])).as_rotvec()
        by_table = np.concatenate([rotations.dexp_inverse(-off) @ X[:3], X[3:5]]).reshape(5, -1, 3)[:, :, :2]
        slopes = np.einsum("lk,mkc->mlc", self._inverse, by_table).reshape(5, -1)
        return Ends(np.concatenate([off, states.velocity[-1, :2]]), slopes)


def least_effort_table(transfer: Transfer, guess: Array) -> tuple[Array, float, float]:
    """Return the table of least effort near a guess, its projected gradient, and its gap.

    Raises
    ------
    RuntimeError
        None is found.
    """
    from scipy.optimize import NonlinearConstraint, minimize

    size = float(np.linalg.norm(guess))

    @lru_cache(maxsize=4)
    def ends(table: bytes) -> Ends:
        return transfer.ends(size * np.frombuffer(table))

    reached = NonlinearConstraint(
        lambda x: ends(x.tobytes()).gap,
        0.0,
        0.0,
        jac=lambda x: size * ends(x.tobytes()).slopes,
        hess="2-point",
        finite_diff_rel_step=DIFFERENCE,
    )
    found = minimize(
        lambda x: x @ x / 2,
        guess / size,
        jac=lambda x: x,
        hess=lambda x: np.eye(len(x)),
        constraints=reached,
        method="trust-constr",
        options={"gtol": CERTIFIED, "xtol": NARROWEST, "maxiter": ITERATIONS},
    )
    y, (gap, slopes) = size * found.x, ends(found.x.tobytes())
    left = float(np.linalg.norm(y - slopes.T @ np.linalg.lstsq(slopes.T, y, rcond=None)[0]) / np.linalg.norm(y))
    if not (left <= NEARLY and abs(gap).max() <= REACHED):
        raise RuntimeError(
            f"no least effort is found: the projected gradient is still {left:.1e} of the gradient; use more nodes, "
            "or a target that is further away"
        )
    return y, left, float(abs(gap).max())

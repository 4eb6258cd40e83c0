"""split: what is exact without load is taken exactly, and the load enters by quadrature or kicks.

Non-twisting body (any principal axis n). With body components Π_⊥ the split form (eq-nonholonomic-red, with moments)
is

    Π_⊥' = M_⊥,        Λ' = Λ Ŵ,        W = J_⊥⁻¹ Π_⊥,

so the momentum is a quadrature of the moment in the moving frame, and the attitude a product of exponentials.

- Moments given along the moving frame: M(t) at Gauss nodes, Π_⊥ at the nodes by the Gauss Runge-Kutta matrix, and
  Λ_{n+1} = Λ_n exp(Ω̂) with the Magnus expansion of order 2, 4, 6 (A. Iserles, S. P. Nørsett, Phil. Trans. R. Soc. A 357
  (1999) 983; S. Blanes, F. Casas, J. Ros, BIT 40 (2000) 434), for order 4
  Ω = h (W_1 + W_2)/2 + (√3/12) h² W_1 × W_2. The sign of the bracket is that of Λ' = Λ Ŵ. Order 8 composes order 2.
- Moments fixed in space, gravity, loads of the state: M at Λ_m = Λ_n exp(h Ŵ_m/2) with W_m = J_⊥⁻¹ (Π_n + Π_{n+1})/2,
  implicit in W_m and iterated to round-off; symmetric, of order 2; composed to orders 4, 6, 8.

Without load W is constant and the step exact, at any size. W·n = 0 at every node by construction: no twist. Without
moment K and Π_⊥ stand still; with one, ½ (W_n + W_{n+1})·ΔΠ is the change of K, which is the work.

Standard body. Half a step of exact free motion (`nontwist.exact`), the kick J ΔW = h M(t_m, Λ, ½ (W + W + ΔW)) at a
fixed attitude, half a step of exact free motion: symmetric, of order 2, exact without load; composed to 4, 6, 8. Load
nodes lie inside the step. There is no limit to the turn of a step.

The mean moment of a load along the moving frame is reported with the attitudes that the turn of the step gives at its
nodes when it is taken as steady: of order 3.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from ..geometry.arrays import Array
from ..geometry.compiled import interpreted
from ..loads.compiled import callback
from .base import Failure, Integrator, March, Problem
from .composition import fractions
from .marching import SLOW_BLOCK, basis_of, in_blocks, python_moment, quaternion

PRINCIPAL, BLOCK, I3 = 1e-9, 2**17, np.eye(3)
GAUSS = {1: (0.5,), 2: (0.5 - 3**0.5 / 6, 0.5 + 3**0.5 / 6), 3: (0.5 - 15**0.5 / 10, 0.5, 0.5 + 15**0.5 / 10)}


@dataclass(frozen=True)
class Split(Integrator):
    """Exact free motion and quadrature or kicks of the load, orders 2, 4, 6, 8: standard and non-twisting bodies.

    Raises
    ------
    ValueError
        From `march`, where the constrained axis is not principal.
    """

    name: ClassVar[str] = "split"
    orders: ClassVar[tuple[int, ...]] = (2, 4, 6, 8)
    is_compiled: ClassVar[bool] = True
    order: int = 4

    def march(self, problem: Problem) -> March:
        """Integrate `problem`."""
        return _standard(problem, self.order) if problem.system.axis is None else _held(problem, self.order)


def _held(problem: Problem, order: int) -> March:
    from . import split_kernel
    from .midpoint_kernel import Grid, Output

    system, load, axis = problem.system, problem.load, problem.system.axis
    assert axis is not None
    basis = basis_of(axis)
    J = basis.T @ system.convected_inertia @ basis
    if abs(J[:2, 2]).max() > PRINCIPAL * abs(J).max():
        raise ValueError(
            f"split needs a constrained axis that is principal, but J n differs from its part along n by "
            f"{np.linalg.norm(J[:2, 2]):.3g} kg m²; take integrator='lie-midpoint'"
        )
    state = np.zeros(10)
    state[:4] = quaternion((basis.T @ problem.directors).T)
    V = (basis.T @ problem.velocities) @ (basis.T @ problem.directors).T
    W = np.array([V[1, 2] - V[2, 1], V[2, 0] - V[0, 2]]) / 2
    state[4:6] = J[:2, :2] @ W
    implicit = system.dead_force.any() or any(term.kind != "body" for term in load.terms)
    gauss = 1 if implicit or order == 8 else order // 2
    gamma = fractions(order) if gauss == 1 else np.ones(1)
    inverse, tilted = _inverse(J), bool((basis != I3).any())
    dead, damping = basis.T @ system.dead_force, basis.T @ load.damping @ basis
    out = Output(*_arrays(problem, 1))
    out.velocities[0] = basis @ np.array([[0, 0, -W[1]], [0, 0, W[0]], [W[1], -W[0], 0]]) @ basis.T @ problem.directors
    run, function, size, reasons = _runner(problem, split_kernel, "march")

    def block(times: Array, moving: Array, space: Array, first: int, done: int) -> Any:
        body = (inverse, bool(load.terms), moving @ basis, tilted, basis)
        more = (dead, damping, space, basis) if implicit else None
        grid = tuple(Grid(problem.step, gamma, times, problem.stored))
        return (*run(state, function, more, body, grid, tuple(out), first, done, gauss), reasons)

    middles = _middles(gamma, gauss)
    done, failure = in_blocks(problem, middles, size, block)
    return _stored(out, done, failure)


def _standard(problem: Problem, order: int) -> March:
    from . import split_kernel
    from .midpoint_kernel import Grid, Output

    system, load, q = problem.system, problem.load, problem.directors
    J, gamma = system.convected_inertia, fractions(order)
    W = q @ np.cross(q, problem.velocities).sum(0) / 2
    state = [np.ascontiguousarray(q.T), W]
    out = Output(*_arrays(problem, 0))
    out.velocities[0] = np.cross(W @ q, q)
    run, function, size, reasons = _runner(problem, split_kernel, "march_free")
    constant = (J, np.linalg.inv(J), np.array(system.dead_force), load.damping)

    def block(times: Array, moving: Array, space: Array, first: int, done: int) -> Any:
        grid = tuple(Grid(problem.step, gamma, times, problem.stored))
        *result, R, W = run(*state, function, (*constant, moving, space), grid, tuple(out), first, done)
        state[:] = R, W
        return (*result, reasons)

    done, failure = in_blocks(problem, _middles(gamma, 1), size, block)
    return _stored(out, done, failure)


def _inverse(J: Array) -> Array:
    """Return the inverse of the inertia in the plane of motion, (2, 2)."""
    (a, b, _), (_, c, _), _ = J.tolist()
    inverse: Array = np.array([[c, -b], [-b, a]]) / (a * c - b * b)
    return inverse


def _stored(out: Any, done: int, failure: Failure | None) -> March:
    directors, velocities, multipliers, moment, work, iterations = out
    states = directors[: done + 1], velocities[: done + 1]
    return March(*states, multipliers[:done], moment[:done], work[:done], iterations[:done], failure)


def _runner(problem: Problem, kernel: Any, name: str) -> tuple[Any, Any, int, list[str]]:
    """Return the march, what it calls for the load, the nodes of a block, and where reasons of failures go."""
    called, reasons = problem.load.called, [""]
    if not called.terms:
        return getattr(kernel, name), None, BLOCK, reasons
    if called.is_compiled:
        return getattr(kernel, name), callback(tuple((t.compiled, t.scale) for t in called.terms)), BLOCK, reasons
    return getattr(interpreted(kernel), name), python_moment(called, reasons), SLOW_BLOCK, reasons


def _middles(gamma: Array, gauss: int) -> Array:
    """Where the nodes of the load lie, as fractions of the step."""
    start = np.cumsum(gamma) - gamma
    middles: Array = (start[:, None] + gamma[:, None] * np.array(GAUSS[gauss])).ravel()
    return middles


def _arrays(problem: Problem, columns: int) -> tuple[Array, ...]:
    n = len(problem.stored) - 1
    directors, velocities = np.empty((n + 1, 3, 3)), np.empty((n + 1, 3, 3))
    directors[0] = problem.directors
    iterations: Any = np.zeros(n, dtype=np.int64)
    return directors, velocities, np.zeros((n, columns)), np.zeros((n, 3)), np.zeros(n), iterations

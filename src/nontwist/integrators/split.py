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
fixed attitude, half a step of exact free motion: symmetric, of order 2, exact without load; composed to 4, 6, 8, where
the last half of one substep and the first of the next are one free motion. Each is an increment of full relative
accuracy in the principal frame (`nontwist.exact.free_step`), and all sums are compensated: K, π, W and Λ do not drift,
however small the steps and however long the load; steps with |λ h| > 1/2 may lose 2e-18 of K and π each. Load nodes
lie inside the step. There is no limit to the turn of a step but 1e15 rad, of which round-off leaves no digit: an
error.

Once the last moment is known to have ceased (pulses and tables end; gravity and functions do not) all that is left is
one exact motion, evaluated at each stored time from where it begins: no step is taken, no round-off adds up.

**Mean moment in space.** It is the impulse of the load over the length of the interval. A kick of the standard body,
and an implicit step, apply the moment at one attitude, so that on the standard body Δπ = h · moment to round-off;
both are symmetric in time, the composed steps have the mean in their order, and so has Λ_n exp(Ω̂/2) M(t_m) of order
8. Orders 4 and 6 of moments along the moving frame take the mean Σ b_i Λ(t_i) M(t_i) over their s Gauss nodes: a
quadrature of order 2s of the integral of Λ M, wherever Λ(t_i) is good enough. M is interpolated through the nodes by
a polynomial of degree s - 1, Π_⊥ by its integral, and Λ(t_i) = Λ_n exp(Ω̂_i) with the Magnus expansion of the part
[0, c_i h] of the step. The interpolation leaves M a multiple of the node polynomial P_s, Π_⊥ of its integral, Λ(t_i)
of its second integral δ(c_i) h^(s+2). For s = 2 that is h⁴. For s = 3 it is h⁵; but P_3 is odd about the middle of
the step, orthogonal to 1 - c, and so is δ odd, and Σ b_i δ(c_i) M(t_i) of h⁶. The impulse of an interval has its
order then, 4 and 6: what π gains is h · moment and what the reaction along the axis adds.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, lru_cache
from math import ceil
from typing import Any, ClassVar

import numpy as np

from ..engine.functions import Called
from ..geometry.arrays import Array
from ..loads import Load
from ..models.system import DirectorSystem
from .base import Failure, Integrator, March, Problem, Status
from .composition import fractions
from .costs import Cost, steps_cost
from .marching import ZEROS, Output, begun, in_blocks, kept, states_of, turned_body

PRINCIPAL, CHUNK, ONE = 1e-9, 2**15, np.ones(1)
BLOCK, SLOW_BLOCK = 2**17, 2**8  # nodes that are sampled and marched at a time; with a load in Python
HELD_NS = 400.0  # of a substep of a non-twisting body
GAUSS = {1: (0.5,), 2: (0.5 - 3**0.5 / 6, 0.5 + 3**0.5 / 6), 3: (0.5 - 15**0.5 / 10, 0.5, 0.5 + 15**0.5 / 10)}


@dataclass(frozen=True)
class Split(Integrator):
    """Exact free motion and quadrature or kicks of the load, orders 2, 4, 6, 8: standard and non-twisting bodies.

    Parameters
    ----------
    order : {4, 2, 6, 8}

    Raises
    ------
    ValueError
        An order that the scheme has not; from `march`, where the constrained axis is not principal.

    Examples
    --------
    Without load a step is exact, whatever its length:

    >>> from nontwist import Split, nontwisting, rotation, simulate
    >>> body = nontwisting([3, 4, 5])
    >>> run = simulate(body, t_end=1, step=0.5, material_angular_velocity=(0, 3, 0), integrator=Split())
    >>> rotation(run).magnitude().round(9)
    array([0. , 1.5, 3. ])
    """

    name: ClassVar[str] = "split"
    orders: ClassVar[tuple[int, ...]] = (2, 4, 6, 8)
    is_compiled: ClassVar[bool] = True
    substep_ns: ClassVar[float] = 550.0
    sources: ClassVar[Mapping[str, str]] = {
        "order": "eq-nonholonomic-red; Blanes, Casas & Ros 2000; Kahan & Li 1997",
        "invariant": "eq-nonholonomic-red",
    }
    counts: ClassVar[Mapping[int, tuple[int, ...]]] = {**Integrator.counts, 6: (14, 18, 24), 8: (12, 14, 16)}
    order: int = 4

    def refusal(self, problem: Problem) -> str | None:
        """Return why the constrained axis will not do, None where it does."""
        return _not_principal(problem.system)

    def cost(self, problem: Problem, states: int) -> Cost:
        """Return what `march` will take: steps while moments may act."""
        ns = self.substep_ns if problem.system.axis is None else HELD_NS
        return steps_cost(problem, _pushed_steps(problem), len(fractions(self.order)), ns)

    def march_one(self, problem: Problem) -> March:
        """Integrate `problem`."""
        if reason := self.refusal(problem):
            raise ValueError(reason)
        return _standard(problem, self.order) if problem.system.axis is None else _held(problem, self.order)


def _held(problem: Problem, order: int) -> March:
    from . import split_kernel

    load, turned = problem.load, turned_body(problem.system)
    basis, plane = turned.basis, _in_plane(problem.system)
    state, whole = np.zeros(14), begun(problem.directors, problem.velocities, basis)[0]
    state[:4], state[4:6] = whole[:4], plane @ whole[4:6]
    implicit = turned.is_heavy or any(term.kind != "body" for term in load.terms)
    gauss = 1 if implicit or order == 8 else order // 2
    gamma = fractions(order) if gauss == 1 else ONE
    out = _output(problem, 1)
    whole[6] = 0.0
    out.velocities[0] = states_of(whole, ZEROS, basis)[1]
    run: Any = split_kernel.march
    called, last, function, size = _called(load)
    more = (turned.dead_force, basis.T @ load.damping @ basis) if implicit else None

    def block(times: Array, moving: Array, space: Array, first: int, done: int) -> Any:
        moving = moving @ basis if turned.is_tilted else moving
        body = (plane, bool(load.terms), moving, turned.is_tilted, basis)
        grid = (problem.step, gamma, times, problem.stored)
        result = run(state, function, more and (*more, space, basis), body, grid, tuple(out), first, done, gauss)
        called.require_no_interrupt()
        return (*result, called.reason(last) if result[0] == Status.LOAD else "")

    def now() -> tuple[Array, Array]:
        whole[:4], whole[4:6] = state[:4], np.linalg.solve(plane, state[4:6] + state[6:8])
        return states_of(whole, ZEROS, basis)

    return _marched(problem, out, _middles(order, gauss), size, block, [state], now)


def _standard(problem: Problem, order: int) -> March:
    from . import split_kernel

    load, (basis, moments) = problem.load, _principal(problem.system)
    state = np.zeros(14)
    state[:7] = begun(problem.directors, problem.velocities, basis)[0][:7]
    out = _output(problem, 0)
    out.velocities[0] = states_of(state, ZEROS, basis)[1]
    run: Any = split_kernel.march_free
    called, last, function, size = _called(load)
    constant = (moments, basis.T @ problem.system.dead_force, basis.T @ load.damping @ basis)

    def block(times: Array, moving: Array, space: Array, first: int, done: int) -> Any:
        grid = (problem.step, fractions(order), times, problem.stored)
        body = (*constant, moving @ basis, space, basis)
        result = run(state, function, body, grid, tuple(out), first, done)
        called.require_no_interrupt()
        return (*result, called.reason(last) if result[0] == Status.LOAD else "")

    def now() -> tuple[Array, Array]:
        return states_of(state, ZEROS, basis)

    return _marched(problem, out, _middles(order, 1), size, block, [state], now)


def _marched(
    problem: Problem,
    out: Output,
    middles: Array,
    size: int,
    block: Callable[[Array, Array, Array, int, int], Any],
    state: list[Array],
    now: Callable[[], tuple[Array, Array]],
) -> March:
    """March while moments may act, then coast; `now` tells the directors and velocities of `state`."""
    pushed = _pushed_steps(problem)
    done, failure = in_blocks(problem, pushed, middles, size, block, state, out)
    if failure is None and pushed < problem.steps:
        done, failure = _coast(problem, out, pushed, done, *now())
    return kept(problem, out, done, failure, now)


def _pushed_steps(problem: Problem) -> int:
    """Return the number of steps before the last moment has ceased: from there the rest is one exact motion."""
    if problem.system.dead_force.any():
        return problem.steps
    last = (problem.load.end - problem.t_start) / problem.step
    return problem.steps if last > problem.steps - 1 else ceil(max(0.0, last))


def _coast(problem: Problem, out: Output, first: int, done: int, q: Array, v: Array) -> tuple[int, Failure | None]:
    """Fill `out` from the free motion that begins with the step `first` in the state (q, v).

    Returns the stored intervals and the failure.
    """
    from ..exact.free_bodies import TOO_FAR
    from ..exact.free_constants import BAD_TIME, OK
    from ..exact.free_kernels import free_run

    system, stored, failure, mu = problem.system, problem.stored, None, 0.0
    start, last = np.zeros((10, 3)), len(problem.stored) - 1
    start[:3], start[3:6], start[6:9] = system.euler_inertia, q, v
    if system.axis is not None:
        start[9] = system.axis
    reached = done
    try:
        while reached < last:
            now = slice(reached + 1, reached + 1 + CHUNK)
            lengths = problem.step * (stored[now] - first).astype(np.float64)
            status, directors, velocities, mu = free_run(start, system.axis is not None, 0.0, lengths)
            if status != OK:
                reason = TOO_FAR if status == BAD_TIME else ""
                failure = Failure(Status.TURN if reason else Status.BROKEN, first, np.nan, np.nan, reason)
                break
            out.directors[now], out.velocities[now] = directors, velocities
            reached = min(reached + CHUNK, last)
            if problem.progress:
                problem.progress(stored[reached] / problem.steps)
    except KeyboardInterrupt as stop:
        failure = Failure(Status.INTERRUPTED, max(first, int(stored[reached])), np.nan, np.nan, str(stop))
    if system.axis is not None and reached > done:
        out.multipliers[done] += mu * (stored[done + 1] - first) / (stored[done + 1] - stored[done])
        out.multipliers[done + 1 : reached] = mu
    return reached, failure


@lru_cache(maxsize=16)
def _in_plane(system: DirectorSystem) -> Array:
    """Return the inertia in the plane of motion, (2, 2)."""
    return turned_body(system).inertia[:2, :2].copy()


def _not_principal(system: DirectorSystem) -> str | None:
    """Return that the constrained axis is not principal, None where it is, or where there is none."""
    if system.axis is None:
        return None
    J = turned_body(system).inertia
    if abs(J[:2, 2]).max() <= PRINCIPAL * abs(J).max():
        return None
    return (
        f"split needs a constrained axis that is principal, but J n differs from its part along n by "
        f"{np.linalg.norm(J[:2, 2]):.3g} kg m²; take integrator='lie-midpoint'"
    )


@lru_cache(maxsize=16)
def _principal(system: DirectorSystem) -> tuple[Array, Array]:
    """Return the principal axes, right-handed columns in body components, and the moments, ascending."""
    from ..exact.free_constants import principal_axes

    V, moments = np.empty((3, 3)), np.empty(3)
    principal_axes(np.array(system.convected_inertia), V, moments)
    V[1] = np.cross(V[2], V[0])
    return V.T.copy(), moments


def _called(load: Load) -> tuple[Called, Array, tuple[int, int] | None, int]:
    """Return what is called for a load, what it was called with last, their addresses, and the nodes of a block."""
    called, last = Called(load), np.zeros(16)
    addresses = (called.address, last.ctypes.data) if called.address else None
    return called, last, addresses, BLOCK if load.is_compiled else SLOW_BLOCK


@cache
def _middles(order: int, gauss: int) -> Array:
    """Where the nodes of the load lie, as fractions of the step."""
    gamma = fractions(order) if gauss == 1 else ONE
    start = np.cumsum(gamma) - gamma
    middles: Array = (start[:, None] + gamma[:, None] * np.array(GAUSS[gauss])).ravel()
    return middles


def _output(problem: Problem, columns: int) -> Output:
    n = len(problem.stored) - 1
    directors, velocities = np.empty((n + 1, 3, 3)), np.empty((n + 1, 3, 3))
    directors[0] = problem.directors
    sums = np.zeros((n, columns)), np.zeros((n, 3)), np.zeros(n), np.zeros(n, dtype=np.int64)
    return Output(directors, velocities, *sums)

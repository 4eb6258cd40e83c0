r"""Motions with quadratic rates and their derivatives, by Taylor series: what a fit asks for at every step.

The bodies that are fitted have rates that are quadratic in their state x: ``M x' = L x + B(x, x)``, with B symmetric in
its two arguments. A free body has x = W, M = J and ``B(W, W) = J W × W``; under gravity the vertical as seen from the
body is part of x, with ``γ' = γ × W``. So the coefficients of the power series ``x(t) = Σ x_n tⁿ`` follow one from the
other,

    S_n = Σ_{i≤n} x_i x_{n-i}ᵀ,     (n + 1) M x_{n+1} = L x_n + B : S_n ,

and so do those of the derivatives. Let ``D = ∂x/∂(x(0), p)`` for parameters p of M, L and B. Its columns obey the
linear equation ``M D' = A D + G`` with ``A = L + 2 B(x, ·)`` and, for a parameter, ``G = -M_p x' + L_p x + B_p(x, x)``,
G = 0 for the start:

    (n + 1) M D_{n+1} = Σ_{i≤n} A_i D_{n-i} + G_n ,     G_n = -(n + 1) M_p x_{n+1} + L_p x_n + B_p : S_n .

What is given as a function of time, such as the speed of a rotor, is a part of the state as well: where it is linear
between knots, its rate is constant but for kicks at the knots. A kick, and the start, may depend on parameters of their
own, q more columns of D, for which G = 0.

These are the derivatives of the exact motion. A step is as long as the series of order `ORDER` allows at the tolerance
`EXACT`: with the last two coefficients, ``h = min_j (EXACT |x_0| / |x_j|)^{1/j}`` (Jorba and Zou, Experimental
Mathematics 14, 2005, 99-117). Within it the same series is the motion at every sample, so samples cost no steps. Many
motions of one body go side by side, a lane each.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..geometry.arrays import Array

ORDER, EXACT = 20, 1e-11
MOST_STEPS = 100_000


class RunawayError(ArithmeticError):
    """A motion has left the numbers: the parameters are far off."""


@dataclass(frozen=True)
class QuadraticMotion:
    """``M x' = L x + B(x, x)`` and its derivatives by p parameters.

    Attributes
    ----------
    mass, linear : (d, d) array
    quadratic : (d, d, d) array, symmetric in the last two axes
    mass_by, linear_by : (p, d, d) array
    quadratic_by : (p, d, d, d) array
    """

    mass: Array
    linear: Array
    quadratic: Array
    mass_by: Array
    linear_by: Array
    quadratic_by: Array

    def rate(self, x: Array) -> Array:
        """Return x' of states, (n, d)."""
        forces = x @ self.linear.T + np.einsum("ijk,nj,nk->ni", self.quadratic, x, x)
        return np.linalg.solve(self.mass, forces.T).T


@dataclass(frozen=True)
class Kicks:
    """Jumps of the state of a lane, and how they and its start depend on q parameters of their own.

    Attributes
    ----------
    times : (k,) array, s
        From the start of the lane, ascending, positive.
    jumps : (k, d) array
    jumps_by : (k, d, q) array
    start_by : (d, q) array
    """

    times: Array
    jumps: Array
    jumps_by: Array
    start_by: Array


def responses(
    motion: QuadraticMotion, starts: Array, times: list[Array], kicks: Sequence[Kicks] | None = None
) -> tuple[list[Array], list[Array]]:
    """Return the states of several motions at their times, and the derivatives by start and parameters.

    Parameters
    ----------
    motion : QuadraticMotion
    starts : (lanes, d) array
        At the time 0 of each lane.
    times : list of (n,) array, s
        Of each lane; before 0 as far as the series of the start reaches.
    kicks : sequence of Kicks, optional
        Of each lane.

    Returns
    -------
    values : list of (n, d) array
    derivatives : list of (n, d, d + p + q) array
        By the start first, then by the parameters, then by those of the kicks.

    Raises
    ------
    RunawayError
        Numbers are not finite any more, or steps become too short.
    """
    lanes, d = starts.shape
    p = len(motion.mass_by)
    columns = d + p + (kicks[0].start_by.shape[1] if kicks else 0)
    counts = [len(one) for one in times]
    at, lane = np.concatenate(times), np.repeat(np.arange(lanes), counts)
    values, derivatives = np.empty((len(at), d)), np.empty((len(at), d, columns))
    end = np.array([one.max(initial=0.0) for one in times])
    now, x = np.zeros(lanes), np.array(starts, dtype=float)
    D = np.zeros((lanes, d, columns))
    D[:, :, :d] = np.eye(d)
    for k, one in enumerate(kicks or ()):
        D[k, :, d + p :] = one.start_by
    due = [list(one.times) for one in kicks] if kicks else [[] for _ in range(lanes)]
    waiting, recurrence = np.ones(len(at), dtype=bool), _recurrence(motion)
    for _ in range(MOST_STEPS):
        with np.errstate(all="ignore"):
            xs, Ds = _series(motion, recurrence, x, D)
            until = np.array([min(one[0], last) if one else last for one, last in zip(due, end, strict=True)])
            step = np.minimum(_reach(xs), until - now)
        if not (np.isfinite(step).all() and np.isfinite(Ds).all()):
            raise RunawayError("the motion is not finite")
        last = now + step >= end * (1 - 1e-15)
        here = np.flatnonzero(waiting & (last[lane] | (at < (now + step)[lane])))
        of, s = lane[here], at[here] - now[lane[here]]
        values[here], derivatives[here] = _at(xs, s, of), _at(Ds, s, of)
        waiting[here] = False
        if last.all():
            break
        everyone = np.arange(lanes)
        x, D, now = _at(xs, step, everyone), _at(Ds, step, everyone), np.where(last, end, now + step)
        for k, one in enumerate(kicks or ()):
            if due[k] and now[k] >= due[k][0] * (1 - 1e-15):
                n = len(one.times) - len(due[k])
                now[k] = due[k].pop(0)
                x[k] += one.jumps[n]
                D[k, :, d + p :] += one.jumps_by[n]
    else:
        raise RunawayError("the motion needs too many steps")
    borders = np.cumsum(counts)[:-1]
    return np.split(values, borders), np.split(derivatives, borders)


def _recurrence(motion: QuadraticMotion) -> Array:
    """Return the matrix that takes x_n and S_n to (n + 1) x_{n+1}, M⁻¹ G_n of the parameters, and M⁻¹ 2 B(x_n, ·)."""
    p, d = motion.mass_by.shape[:2]
    inverse = np.linalg.inv(motion.mass)
    rate = np.vstack([(inverse @ motion.linear).T, (inverse @ motion.quadratic.reshape(d, d * d)).T])
    by_rate, by_state = (
        np.einsum("ji,pic->cjp", inverse, one).reshape(d, d * p) for one in (motion.mass_by, motion.linear_by)
    )
    by_square = np.einsum("ji,pick->ckjp", inverse, motion.quadratic_by).reshape(d * d, d * p)
    along = np.zeros((d + d * d, d * d))
    along[:d] = 2 * np.einsum("ji,ikc->cjk", inverse, motion.quadratic).reshape(d, d * d)
    return np.hstack([rate, np.vstack([by_state, by_square]) - rate @ by_rate, along])


def _series(motion: QuadraticMotion, recurrence: Array, x: Array, D: Array) -> tuple[Array, Array]:
    """Return the coefficients of the motions, (ORDER + 1, lanes, d), and of their derivatives."""
    lanes, d, columns = D.shape
    p, N = len(motion.mass_by), ORDER
    xs, Ds = np.empty((N + 1, lanes, d)), np.empty((N + 1, lanes, d, columns))
    ahead = np.empty((lanes, d, N + 1))  # x_0, x_1, ...
    back = np.empty((lanes, N + 1, d))  # ..., x_1, x_0
    A = np.empty((lanes, d, (N + 1) * d))
    D_back = np.empty((lanes, (N + 1) * d, columns))
    terms = np.empty((lanes, d + d * d))
    xs[0], Ds[0] = x, D
    for n in range(N):
        ahead[:, :, n] = back[:, N - n] = terms[:, :d] = xs[n]
        terms[:, d:] = (ahead[:, :, : n + 1] @ back[:, N - n :]).reshape(lanes, d * d)
        found = terms @ recurrence
        np.divide(found[:, :d], n + 1, out=xs[n + 1])
        A[:, :, n * d : (n + 1) * d] = found[:, d + d * p :].reshape(lanes, d, d)
        if n == 0:
            A[:, :, :d] += recurrence[:d, :d].T
        D_back[:, (N - n) * d : (N - n + 1) * d] = Ds[n]
        change = A[:, :, : (n + 1) * d] @ D_back[:, (N - n) * d :]
        change[:, :, d : d + p] += found[:, d : d + d * p].reshape(lanes, d, p)
        np.divide(change, n + 1, out=Ds[n + 1])
    return xs, Ds


def _reach(xs: Array) -> Array:
    """Return how far the series of each lane is exact."""
    size = abs(xs).max(axis=2)
    reach = np.full(xs.shape[1], np.inf)
    for j in (len(xs) - 2, len(xs) - 1):
        np.minimum(reach, (EXACT * size[0] / np.maximum(size[j], 1e-300)) ** (1 / j), out=reach)
    return reach


def _at(coefficients: Array, s: Array, lane: NDArray[np.intp]) -> Array:
    """Return the series of some lanes at times s."""
    own = coefficients[:, lane]
    powers = s ** np.arange(len(coefficients))[:, None]
    return np.asarray(np.einsum("nk,nk...->k...", powers, own))

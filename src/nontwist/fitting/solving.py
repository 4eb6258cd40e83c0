r"""Least squares of what `shooting` makes of a recording, in numbers that are free: the best body from a start.

The information about J is that of the linear least-squares problem at the solution, in J itself along the basis of the
model, all else eliminated: ``I = F_JJ - F_Jn F_nn⁻¹ F_nJ``. Its inverse is the covariance where every direction is
told.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from ..geometry.arrays import Array
from .bodies import Model
from .chart import THINNEST, Chart, Weighed, of_a_body, of_trace_one
from .motions import Motion, RunawayError, responses
from .quality import correlation
from .shooting import COMMON, Residuals, Rows, Shooting, Unknowns, reduced, residuals, stacked

FINE, CALLS = 1e-8, 40  # of cost and unknowns, relative; trials
HELD = 1e6  # weight of what is held
WHITE, MOST = 5.0, 0.9999  # standard errors of a correlation; correlation
FAR = 1e6  # residual of a motion that is none


def counted(problem: Shooting, found: Residuals) -> tuple[Array, Array]:
    """Return residuals and derivatives, as few as there are columns, whose squares add up to the loss.

    For soft_l1 residuals of the data are ``sign(r) √(2 √(1 + r²) - 2)``; gaps and priors stay as they are.
    """
    data = [*found.rates, *found.attitudes]
    if problem.loss == "soft_l1":
        roots = [np.sqrt(1 + row.r**2) for row in data]
        data = [
            Rows(row.r * np.sqrt(2 / (1 + s)), (np.sqrt((1 + s) / 2) / s)[:, None] * row.A, row.columns)
            for row, s in zip(data, roots, strict=True)
        ]
    return stacked([reduced(row) for row in (*data, *found.beside)], problem.columns)


def without(A: Array, others: Array) -> Array:
    """Return columns without what others, at any scale, could take up."""
    scale = np.maximum(np.linalg.norm(others, axis=0), 1e-300)
    rest = np.linalg.qr(others / scale)[0]
    return np.asarray(A - rest @ (rest.T @ A))


def _root(A: Array) -> Array:
    values, vectors = np.linalg.eigh(A)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)) @ vectors.T)


def smeared(x: Array, phi: float) -> Array:
    """Return ``Σ_j φ^|i - j| x_j`` along the first axis."""
    from scipy.signal import lfilter

    ahead, behind = (lfilter([1.0], [1.0, -phi], y, axis=0) for y in (x, x[::-1]))
    return np.asarray(ahead + behind[::-1] - x)


@dataclass(frozen=True)
class Solution:
    """A least-squares solution: unknowns, cost, residuals over the noise and their derivatives."""

    problem: Shooting
    unknowns: Unknowns
    cost: float
    residuals: Residuals

    @cached_property
    def left_over(self) -> Array:
        """What the model leaves of the angular velocities, rad/s, (n, 3)."""
        return (
            np.concatenate([np.zeros(0), *(row.r for row in self.residuals.rates)]).reshape(-1, 3) * self.problem.noise
        )

    @cached_property
    def turned_by(self) -> Array:
        """What the model leaves of the attitudes, rad, (n, 3)."""
        left = np.concatenate([np.zeros(0), *(row.r for row in self.residuals.attitudes)])
        return left.reshape(-1, 3) * self.problem.tilt

    @cached_property
    def states(self) -> list[Array]:
        """The states of each lane at its times."""
        begin, kicks = self.problem.states(self.unknowns)
        motion = Motion(self.problem.model, self.unknowns.inertia, self.unknowns.more)
        return responses(motion, begin, self.problem.times, kicks)[0]

    @property
    def misses(self) -> Array:
        """What it leaves of the angular velocities, or of the attitudes where there is no gyroscope, (n, 3)."""
        return self.left_over if self.problem.has_gyroscope else self.turned_by

    @cached_property
    def weighted(self) -> tuple[Array, Array]:
        """Residuals and derivatives, by J along the basis of the model first, weighted as the loss does."""
        r, A = counted(self.problem, self.residuals)
        return r, np.concatenate([A[:, :6] @ self.problem.model.basis, A[:, 6:]], axis=1)

    @cached_property
    def apart(self) -> tuple[Array, Array]:
        """Residuals and derivatives by J, weighted, without what all else could take up."""
        (r, A), k = self.weighted, self.problem.model.basis.shape[1]
        both = without(np.concatenate([r[:, None], A[:, :k]], axis=1), A[:, k:])
        return both[:, 0], both[:, 1:]

    @cached_property
    def information(self) -> Array:
        """The information about J along the basis of the model, (5, 5) or (6, 6)."""
        own = self.apart[1]
        return np.asarray(own.T @ own)

    @cached_property
    def trusted(self) -> Array:
        """The same where noise is as correlated as the residuals are, in no direction more than of white noise."""
        white = self.information
        if self.memory == 0:
            return white
        root = np.linalg.pinv(_root(white), rcond=1e-12, hermitian=True)
        values, vectors = np.linalg.eigh(root @ self._scatter @ root)
        of_both = vectors / np.maximum(values, 1.0) @ vectors.T
        return np.asarray(_root(white) @ of_both @ _root(white))

    @cached_property
    def memory(self) -> float:
        """The correlation φ of neighbouring residuals of the gyroscope, 0 where they are white.

        That of residuals is less than that of noise, as the fit takes up what is slow, by about
        ``(1 + 3 φ + unknowns)/n``, n samples of an axis (Kendall 1954, of a mean that is fitted).
        """
        left = self.left_over
        if len(left) < 2 or abs(phi := correlation(left)) < WHITE / np.sqrt(left.size):
            return 0.0
        taken = (1 + 3 * phi + (self.problem.unknown + self.problem.common) / 3) / len(left)
        return float(np.clip(phi + taken, -MOST, MOST))

    @cached_property
    def _scatter(self) -> Array:
        """The covariance of the derivatives of the cost by J, where noise goes on as φ^|i - j|, all else eliminated."""
        _, A = self.weighted
        basis = self.problem.model.basis
        k, found = basis.shape[1], self.information
        others = np.linalg.lstsq(A[:, k:], A[:, :k], rcond=1e-12)[0]
        for row in self.residuals.rates:
            whole = np.zeros((len(row.r), self.problem.columns))
            whole[:, row.columns] = row.A
            own = (whole[:, :6] @ basis - whole[:, 6:] @ others).reshape(-1, 3, k)
            found = found + np.einsum("nai,naj->ij", own, smeared(own, self.memory) - own)
        times = float(np.trace(np.linalg.pinv(self.information, rcond=1e-12, hermitian=True) @ found)) / k
        n, p = len(self.problem), self.problem.unknown  # the fit takes up more of the variance than of white noise
        return np.asarray(found * (n - p) / max(n - times * p, n / 10))

    @property
    def effective_samples(self) -> float:
        """As how many samples of white noise the data count for a number of the inertia."""
        return len(self.problem) / self.inflation

    @cached_property
    def inflation(self) -> float:
        """How many times larger variances are than under white noise."""
        if self.memory == 0:
            return 1.0
        inverse = np.linalg.pinv(self.information, rcond=1e-12, hermitian=True)
        return max(float(np.trace(inverse @ self._scatter)) / len(inverse), 1.0)

    @cached_property
    def beside(self) -> Array:
        """Covariance of what the model has beside J, all else eliminated."""
        k = self.problem.model.basis.shape[1]
        return self._covariance(slice(k, k + self.problem.model.more))

    @cached_property
    def of_errors(self) -> Array:
        """Covariance of the errors of the gyroscope that are fitted, all else eliminated."""
        k = self.problem.model.basis.shape[1] + self.problem.model.more
        return self._covariance(slice(k + COMMON, k + self.problem.common))

    def _covariance(self, columns: slice) -> Array:
        _, A = self.weighted
        own = without(A[:, columns], np.delete(A, columns, axis=1))
        size = np.maximum(np.linalg.norm(own, axis=0), 1e-300)
        white = np.linalg.pinv((own / size).T @ (own / size), rcond=1e-14, hermitian=True) / np.outer(size, size)
        return np.asarray(self.inflation * white)

    def surprise(self, information: Array) -> float:
        """Return the residuals over what is expected r.m.s., where J came from elsewhere with this information.

        With C its inverse, r has the covariance ``1 + A C Aᵀ``, and Woodbury's formula needs no C.
        """
        r, own = self.apart
        by = own.T @ r
        taken_up = float(by @ np.linalg.pinv(information + self.information, rcond=1e-12, hermitian=True) @ by)
        own_unknowns = self.problem.unknown - self.problem.model.basis.shape[1]
        return float(np.sqrt(max(float(r @ r) - taken_up, 0.0) / (len(self.problem) - own_unknowns)))

    @cached_property
    def newton(self) -> Array:
        """The step of J along the basis that Gauss and Newton would take from here if there were no wall."""
        r, A = self.weighted
        return np.asarray(-np.linalg.lstsq(A, r, rcond=1e-10)[0][: self.problem.model.basis.shape[1]])

    @property
    def spread(self) -> float:
        """The standard deviation of the noise by the residuals, rad/s; as assumed without a gyroscope."""
        return self._deviation(self.left_over) if self.left_over.size else self.problem.noise

    @property
    def tilt(self) -> float:
        """The same of the attitudes, rad; 0 without."""
        return self._deviation(self.turned_by) if self.turned_by.size else 0.0

    def _deviation(self, left: Array) -> float:
        """Return the standard deviation of what is left of one kind of data, which has its share of the unknowns."""
        if self.problem.loss != "linear":
            return float(np.median(abs(left)) / 0.6745)
        free = left.size * (1 - self.problem.unknown / len(self.problem))
        return float(np.sqrt((left**2).sum() / max(free, 1)))

    def of_trace_one(self) -> Solution:
        """Return the same solution in a unit in which tr J = 1."""
        factor = float(np.trace(self.unknowns.inertia))
        if not self.problem.model.is_absolute:
            return self
        model, more = self.problem.model.in_unit(self.unknowns.more, factor)
        unknowns = replace(self.unknowns, inertia=self.unknowns.inertia / factor, more=more)
        scale = np.ones(self.problem.columns)
        scale[:6] = scale[6 + model.more - model.damping : 6 + model.more] = factor
        scaled = Residuals(*([row._replace(A=row.A * scale[row.columns]) for row in rows] for rows in self.residuals))
        return Solution(replace(self.problem, model=model), unknowns, self.cost, scaled)


def solve(
    problem: Shooting,
    start: Unknowns,
    held: tuple[Any, float] | None = None,
    accuracy: float = FINE,
    calls: int = CALLS,
    fixed_inertia: bool = False,
) -> Solution:
    """Return the least-squares solution from a start.

    Parameters
    ----------
    problem : Shooting
    start : Unknowns
    held : function and value, optional
        A function of J that returns a number and its derivative by the six entries: it is held at the value.
    accuracy : float
        Relative, of the cost and of the unknowns.
    calls : int
        Trials at most.
    fixed_inertia : bool
        All but the inertia is fitted.

    Raises
    ------
    RunawayError
        The start itself is no motion.
    """
    from scipy.optimize import least_squares

    model, count, common = problem.model, problem.model.more, problem.common
    own = 0 if fixed_inertia else model.coordinates
    chart = _chart(model, start)
    # Where directions begin: numbers of any length, which count over their length, as a length that is held by its
    # weight alone makes the valley narrow and the way long.
    lengths = [slice(own + one.start, own + one.stop) for one in model.directions_beside]
    for k in range(len(problem.lanes)):
        begin = own + count + problem.common + model.size * k
        lengths += [slice(begin + part.start, begin + part.stop) for part in model.directions]
    last: dict[str, Any] = {}

    def unpacked(x: Array) -> tuple[Unknowns, Array]:
        """Return the unknowns, and the derivatives of J and `more` by the first numbers of x."""
        x = x.copy()
        for part in lengths:
            x[part] /= np.linalg.norm(x[part])
        more, rest = x[own : own + count], x[own + count :]
        J, slope = (start.inertia, np.zeros((6, count))) if fixed_inertia else chart(x[:own], more)
        slope = np.concatenate([slope, np.eye(count, own + count, own)])
        errors, rest = rest[:common], rest[common:]
        starts, speeds = rest[: start.starts.size].reshape(-1, model.size), rest[start.starts.size :]
        return Unknowns(J, errors[:3], float(errors[3]), starts, more, speeds, errors[COMMON:]), slope

    def at(x: Array) -> dict[str, Any]:
        if not last or not np.array_equal(last["x"], x):
            unknowns, slope = unpacked(x)
            try:
                found = residuals(problem, unknowns)
            except RunawayError:
                if not last:
                    raise
                return {"r": np.full_like(last["r"], FAR), "B": last["B"]}
            r, A = counted(problem, found)
            B = np.concatenate([A[:, : 6 + count] @ slope, A[:, 6 + count :]], axis=1)
            for part in lengths:
                size = np.linalg.norm(x[part])
                n = x[part] / size
                B[:, part] = (B[:, part] - np.outer(B[:, part] @ n, n)) / size
            if held is not None:
                value, by_entries = held[0](unknowns.inertia)
                r = np.append(r, (value - held[1]) * HELD)
                row = np.zeros((1, B.shape[1]))
                row[0, : own + count] = HELD * by_entries @ slope[:6]
                B = np.concatenate([B, row])
            last.update(x=x.copy(), r=r, B=B)
        return last

    of_gyroscope = start.bias, [start.scale], start.errors
    x = np.concatenate([np.zeros(own), start.more, *of_gyroscope, start.starts.ravel(), start.speeds])
    # MINPACK's method takes no more of residuals than their products with each other and with derivatives at a point,
    # so these may be the rows of a triangle, another one at each point. It needs no BLAS, whose threads take ten times
    # as long on a busy machine.
    how = {"method": "lm", "x_scale": "jac", "max_nfev": calls, "ftol": accuracy, "xtol": accuracy}
    found = least_squares(lambda x: at(x)["r"], x, jac=lambda x: at(x)["B"], **how)
    unknowns, _ = unpacked(found.x)
    return Solution(problem, unknowns, float(found.cost), residuals(problem, unknowns))


def _chart(model: Model, start: Unknowns) -> Callable[[Array, Array], tuple[Array, Array]]:
    """Return J as a function of its own coordinates and of what is fitted beside it, with derivatives by both."""
    if not model.is_absolute:
        of_one = Chart.about(start.inertia)

        def ratios(z: Array, more: Array) -> tuple[Array, Array]:
            J, slope = of_one.inertia(z)
            return J, np.concatenate([slope, np.zeros((6, len(more)))], axis=1)

        return ratios
    weighed = Weighed.about(start.inertia, model.weight, model.direction(start.more))

    def absolute(z: Array, more: Array) -> tuple[Array, Array]:
        J, slope = weighed.inertia(z, model.direction(more))
        full = np.zeros((6, 6 + len(more)))
        full[:, :6] = slope[:, :6]
        if model.points:
            full[:, 6:9] = slope[:, 6:]
        return J, full

    return absolute


def nearest_body(model: Model, J: Array, more: Array, thinnest: float = THINNEST) -> Array:
    """Return the closest inertia that a body can have; where something acts, off the wall by a part of tr J."""
    return of_a_body(J, model.centred(more), thinnest) if model.is_absolute else of_trace_one(J)

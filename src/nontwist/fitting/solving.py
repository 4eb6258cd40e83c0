r"""Least squares of what `shooting` makes of a recording, in numbers that are free: the best body from a start.

The information about J is that of the linear least-squares problem at the solution, in J itself along the basis of the
model, all else eliminated: ``I = F_JJ - F_Jn F_nn⁻¹ F_nJ``. Its inverse is the covariance where every direction is
told.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..geometry.arrays import Array
from ..machine import cached_property
from .predictions import RunawayError
from .shooting import Residuals, Rows, Shooting, Unknowns, lengths, residuals, stacked
from .slow_noise import SlowNoise, noise_of_residuals

FINE = 1e-8  # of cost and unknowns, relative
CALLS, PATIENT = 40, 3000  # trials of a stage, and of what is returned: valleys may be long
HELD = 1e6  # weight of what is held
SINGULAR = 1e-12  # of the information: none
TINY = 1e-6  # of the speed: residuals of a recording without noise
LOST = 1e-10  # of the largest singular value: none
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
    return stacked([row.reduced for row in (*data, *found.beside)], problem.columns)


def without(A: Array, others: Array) -> Array:
    """Return columns without what others, at any scale, could take up."""
    scale = np.maximum(np.linalg.norm(others, axis=0), 1e-300)
    rest = np.linalg.qr(others / scale)[0]
    return np.asarray(A - rest @ (rest.T @ A))


def inverse(A: Array, rcond: float = 1e-12) -> Array:
    """Return the pseudo-inverse of a positive semidefinite matrix of which the scales of rows differ."""
    size = np.sqrt(np.maximum(A.diagonal(), 1e-300))
    return np.asarray(np.linalg.pinv(A / np.outer(size, size), rcond=rcond, hermitian=True) / np.outer(size, size))


@dataclass(frozen=True)
class Solution:
    """A least-squares solution: unknowns, cost, residuals over the noise and their derivatives.

    It `is_settled` unless its trials were used up.
    """

    problem: Shooting
    unknowns: Unknowns
    cost: float
    residuals: Residuals
    is_settled: bool = True

    @cached_property
    def left_over(self) -> Array:
        """What the model leaves of the angular velocities, rad/s, (n, 3)."""
        return _left(self.residuals.rates) * self.problem.noise

    @cached_property
    def turned_by(self) -> Array:
        """What the model leaves of the attitudes, rad, (n, 3)."""
        return _left(self.residuals.attitudes) * self.problem.tilt

    @property
    def misses(self) -> Array:
        """What it leaves of the angular velocities, or of the attitudes where there is no gyroscope, (n, 3)."""
        return self.left_over if self.problem.has_gyroscope else self.turned_by

    @property
    def unlike(self) -> float:
        """The largest error of the gyroscope, over its standard deviation before anything is known."""
        gyroscope, free = self.problem.gyroscope, self.problem.gyroscope.free
        off = (self.unknowns.gyroscope - gyroscope.mean[free]) / gyroscope.deviation[free]
        return float(abs(off).max(initial=0.0))

    @cached_property
    def weighted(self) -> tuple[Array, Array]:
        """Residuals and derivatives, by J along the basis of the model first, weighted as the loss does."""
        r, A = counted(self.problem, self.residuals)
        return r, np.concatenate([A[:, :6] @ self.problem.model.basis, A[:, 6:]], axis=1)

    @property
    def own(self) -> int:
        """How many numbers of J there are, along the basis of the model."""
        return int(self.problem.model.basis.shape[1])

    @cached_property
    def apart(self) -> tuple[Array, Array]:
        """Residuals and derivatives by J, weighted, without what all else could take up."""
        r, A = self.weighted
        both = without(np.concatenate([r[:, None], A[:, : self.own]], axis=1), A[:, self.own :])
        return both[:, 0], both[:, 1:]

    @cached_property
    def information(self) -> Array:
        """The information about J along the basis of the model, (5, 5) or (6, 6)."""
        own = self.apart[1]
        return np.asarray(own.T @ own)

    @cached_property
    def trusted(self) -> Array:
        """The same where noise is as slow as the residuals show, in no direction more than of white noise."""
        from scipy.linalg import eigh

        white = self.information
        if self.slow_noise is None:
            return white
        scatter = white @ self.of_inertia(self.slow_noise.covariance) @ white
        values, vectors = eigh(scatter, white + SINGULAR * np.trace(white) * np.eye(len(white)))
        both = white @ vectors
        return np.asarray(both / np.maximum(values, 1.0) @ both.T)

    @cached_property
    def unit(self) -> Array:
        """Unknowns, J along the basis first, by those in which white noise has the covariance 1."""
        A = self.weighted[1]
        scale = np.maximum(np.linalg.norm(A, axis=0), 1e-300)
        _, sizes, V = np.linalg.svd(A / scale, full_matrices=False)
        told = sizes > LOST * sizes[0]
        return np.asarray(V[told].T / sizes[told] / scale[:, None])

    @property
    def of_columns(self) -> Array:
        """The same of all unknowns, with the six entries of J."""
        return np.concatenate([self.problem.model.basis @ self.unit[: self.own], self.unit[self.own :]])

    @cached_property
    def slow_noise(self) -> SlowNoise | None:
        """The noise of rates and of attitudes where neighbours are correlated; None where it is white."""
        problem, by = self.problem, self.of_columns
        soft = problem.loss == "soft_l1"  # whose derivative is what is correlated then
        kinds, white = list[list[Array]](), [*self.residuals.beside]
        for rows, left, size in (
            (self.residuals.rates, self.left_over, np.linalg.norm(problem.data)),
            (self.residuals.attitudes, self.turned_by, np.sqrt(len(self.turned_by))),
        ):
            if not np.linalg.norm(left) > TINY * size:
                white += rows
                continue
            kinds.append(
                [
                    np.column_stack([A @ by[columns], r / np.sqrt(1 + r**2) if soft else r]).reshape(
                        -1, 3, by.shape[1] + 1
                    )
                    for r, A, columns in rows
                ]
            )
        return noise_of_residuals(kinds, stacked(white, problem.columns)[1] @ by) if kinds else None

    def of_inertia(self, covariance: Array) -> Array:
        """Return the covariance of J along the basis."""
        return np.asarray(self.unit[: self.own] @ covariance @ self.unit[: self.own].T)

    def _times(self, covariance: Array) -> float:
        """Return how many times as large as under white noise variances of J are, on average."""
        return float(np.trace(self.information @ self.of_inertia(covariance))) / self.own

    @cached_property
    def inflation(self) -> float:
        """How many times larger variances are than under white noise."""
        return 1.0 if self.slow_noise is None else max(self._times(self.slow_noise.covariance), 1.0)

    @cached_property
    def effective_samples(self) -> float:
        """As how many numbers of white noise tell the variance of the inertia."""
        if self.slow_noise is None:
            return float(len(self.problem))
        counts, phi, shared, covariance, parts = self.slow_noise
        q = np.array([self._times(part) for part in parts]) / self._times(covariance)
        z = q * np.sqrt((1 + phi**2) / (1 - phi**2) / counts)
        slow = z @ z + shared**2 * (z.sum() ** 2 - z @ z)
        return float(1 / (slow + (1 - q.sum()) ** 2 / len(self.problem)))

    @property
    def samples_each(self) -> float:
        """The same for each number of the inertia, where every other unknown takes up one."""
        return (self.effective_samples - self.fitted + self.own) / self.own

    @property
    def freedom(self) -> float:
        """Degrees of freedom of the variances."""
        free = self.effective_samples - self.fitted
        return max(free if self.slow_noise is None else free / 4, 1.0)

    @property
    def fitted(self) -> int:
        """How many numbers are fitted."""
        return self.problem.unknown + self.problem.common

    @cached_property
    def beside(self) -> Array:
        """Covariance of what the model has beside J, all else eliminated."""
        return self._covariance(self.own, self.problem.model.more)

    @cached_property
    def of_errors(self) -> Array:
        """Covariance of what of θ, e and τ is fitted, all else eliminated: the scale too, which e could take up."""
        common = len(self.problem.gyroscope.free) - len(self.problem.gyroscope.errors)
        return self._covariance(self.own + self.problem.model.more + common, self.problem.common - common)

    def _covariance(self, first: int, count: int) -> Array:
        _, A = self.weighted
        columns = slice(first, first + count)
        own = without(A[:, columns], np.delete(A, columns, axis=1))
        return np.asarray(self.inflation * inverse(own.T @ own, 1e-14))

    def surprise(self, information: Array) -> float:
        """Return the residuals over what is expected r.m.s., where J came from elsewhere with this information.

        With C its inverse, r has the covariance ``1 + A C Aᵀ``, and Woodbury's formula needs no C.
        """
        r, own = self.apart
        by = own.T @ r
        taken_up = float(by @ np.linalg.pinv(information + self.information, rcond=1e-12, hermitian=True) @ by)
        free = len(self.problem) - (self.problem.unknown - self.own)
        return float(np.sqrt(max(float(r @ r) - taken_up, 0.0) / free))

    @cached_property
    def newton(self) -> Array:
        """The step of J along the basis that Gauss and Newton would take from here if there were no wall."""
        r, A = self.weighted
        return np.asarray(-np.linalg.lstsq(A, r, rcond=1e-10)[0][: self.own])

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
        model, more = self.problem.model.in_unit(self.unknowns.more, factor)
        problem, at = replace(self.problem, model=model), replace(self.unknowns, more=more)
        at = replace(at, inertia=self.unknowns.inertia / factor)
        own = replace(self, problem=problem, unknowns=at, residuals=residuals(problem, at))
        return own if model.is_absolute else self


def _left(rows: list[Rows]) -> Array:
    return np.concatenate([np.zeros(0), *(row.r for row in rows)]).reshape(-1, 3)


def solve(
    problem: Shooting,
    start: Unknowns,
    held: tuple[Callable[[Array], tuple[float, Array]], float] | None = None,
    accuracy: float = FINE,
    calls: int = CALLS,
    fixed_inertia: bool = False,
    enough: float = -np.inf,
) -> Solution:
    """Return the least-squares solution from a start.

    Numbers of it are the unknowns, with the entries of L in the place of those of J. Directions are numbers of any
    length, which count over their length, as a length that is held by its weight alone makes the valley narrow and the
    way long; so is L where J has trace 1.

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
    enough : float
        A cost: no trials follow one of less.

    Raises
    ------
    RunawayError
        The start itself is no motion.
    """
    from scipy.optimize import least_squares

    model, more = problem.model, slice(6, problem.ends[1])
    directions = lengths(problem) + [slice(0, 6)] * (not model.is_absolute)

    def unknowns(x: Array) -> tuple[Unknowns, Array]:
        """Return the unknowns, and the derivatives of J by the first of these numbers."""
        x = x.copy()
        for one in directions:
            x[one] /= np.linalg.norm(x[one])
        J, slope = model.inertia(x[:6], x[more])
        at = problem.unknowns(x)
        if fixed_inertia:
            return replace(at, inertia=start.inertia), np.zeros_like(slope)
        return replace(at, inertia=J), slope

    last: tuple[Array, ...] = ()

    def at(x: Array) -> tuple[Array, ...]:
        """Return residuals and derivatives."""
        nonlocal last
        if last and np.array_equal(last[0], x):
            return last[1:]
        now, slope = unknowns(x)
        try:
            r, A = counted(problem, residuals(problem, now))
        except RunawayError:
            if not last:
                raise
            return np.full_like(last[1], FAR), last[2]
        if held is not None:
            value, by = held[0](now.inertia)
            r, A = np.append(r, (value - held[1]) * HELD), np.append(A, np.zeros((1, A.shape[1])), axis=0)
            A[-1, :6] = HELD * by
        by_J = A[:, :6] @ slope
        A = np.concatenate([by_J[:, :6], A[:, more] + by_J[:, 6:], A[:, more.stop :]], axis=1)
        lengthwise = np.zeros((len(directions), len(x)))  # rows that let no step change a length
        for row, one in zip(lengthwise, directions, strict=True):
            size = np.linalg.norm(x[one])
            n = x[one] / size
            A[:, one] = (A[:, one] - np.outer(A[:, one] @ n, n)) / size
            row[one] = np.linalg.norm(A[:, one]) * n
        last = x.copy(), np.append(r, np.zeros(len(directions))), np.append(A, lengthwise, axis=0)
        if r @ r < 2 * enough:
            raise StopIteration
        return last[1:]

    x = np.concatenate([model.cholesky(start.inertia, start.more), start.flat[6:]])
    # MINPACK's method takes no more of residuals than their products with each other and with derivatives at a point,
    # so these may be the rows of a triangle, another one at each point. It needs no BLAS, whose threads take ten times
    # as long on a busy machine.
    how = {"method": "lm", "x_scale": "jac", "max_nfev": calls, "ftol": accuracy, "xtol": accuracy}
    try:
        found = least_squares(lambda x: at(x)[0], x, jac=lambda x: at(x)[1], **how)
        x, cost, is_settled = found.x, found.cost, found.status > 0
    except StopIteration:
        x, cost, is_settled = last[0], last[1] @ last[1] / 2, False
    best, _ = unknowns(x)
    return Solution(problem, best, float(cost), residuals(problem, best), is_settled)

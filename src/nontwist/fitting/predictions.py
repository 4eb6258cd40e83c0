r"""Motions of the bodies that are fitted, and their derivatives, by power series: what a fit asks for at every step.

About a fixed point the angular velocity W of a body, with the direction γ of gravity in body components, obeys

    J W' = J W × W + m g c × γ - C W + h Ω a × W - h Ω' a ,     γ' = γ × W ,

with the centre of mass c, a damping C along the axes, and a rotor that turns about the axis a of the body at the speed
Ω, momentum h Ω; J is that with the rotor held. A body that may not turn about its axis n has ``n·W = 0``, and the
moment μ n that this takes: with ``u = J⁻¹ (...)`` and ``c = J⁻¹n / (n·J⁻¹n)`` it turns with ``W' = u - c (n·u)``. An
attitude q = (v, w), body to space, has ``v' = ½ (w W + v × W)``, ``w' = -½ v·W``.

The speed is linear between knots: it is part of the state, as its rate is, which jumps there.

This text is run on power series of dual numbers (`kernels.series`): their coefficients follow one from the other, and
with them the derivatives of the exact motion by the state at the beginning, by J and by what is fitted beside it. A
step is as long as the series of order `ORDER` allows at the tolerance `EXACT`: with the last two coefficients,
``h = min_j (EXACT |x_0| / |x_j|)^{1/j}`` (Jorba and Zou, Experimental Mathematics 14, 2005, 99-117). Within it the
same series is the motion at every sample, so samples cost no steps.

Derivatives by the speed at knots are put together from those over the pieces between knots: over a piece the state
depends on that at its beginning, x_k, with the rate of the speed in it, and on p, and ``dx = Φ dx_k + Ψ dp``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache, reduce
from typing import Any, NamedTuple

import numpy as np

from ..geometry.arrays import Array
from ..kernels.control import Variables, loop, when, whilst
from ..kernels.dual import Dual
from ..kernels.elements import larger, logical_not, power, smaller
from ..kernels.kernel import Kernel
from ..kernels.machine_code import tracer
from ..kernels.memory import Doubles, View, doubles, view_of
from ..kernels.series import Recurrence, Stored
from ..kernels.vectors import Matrix, Symmetric, Vector, cross, inverse_of
from .unknowns import Model, entries

ORDER, EXACT = 20, 1e-11
LANES, TINY = 4, 1e-300
MOST_STEPS = 1000, 5  # of a lane; and for each sample: a body that is recorded needs about one for a radian


class RunawayError(ArithmeticError):
    """A motion has left the numbers: the parameters are far off."""


class Kind(NamedTuple):
    """Which terms the equations of a body have, which of its vectors vary, and in how many directions, full lanes."""

    has_pivot: bool
    oriented: bool
    has_wheel: bool
    is_damped: bool
    is_constrained: bool
    varied: tuple[bool, ...]
    directions: int

    @property
    def size(self) -> int:
        """How many numbers a state has."""
        return 3 + 3 * self.has_pivot + 4 * self.oriented + 2 * self.has_wheel


def law(kind: Kind, J: Matrix, vectors: Iterable[Vector], axis: Vector) -> Callable[[Sequence[Any]], list[Any]]:
    """Return the rates of a state, W, γ, the attitude and Ω, as a function of it; the last, Ω', is constant.

    The vectors are m g c, C and h a.
    """
    inverse, (arm, drag, wheel) = inverse_of(*J), vectors
    along = inverse @ axis
    along = along / (axis @ along) if kind.is_constrained else axis

    def rates(x: Sequence[Any]) -> list[Any]:
        W = Vector(*x[:3])
        torque = cross(J @ W, W)
        if kind.has_pivot:
            down = Vector(*x[3:6])
            torque = torque + cross(arm, down)
        if kind.is_damped:
            torque = torque - drag * W
        if kind.has_wheel:
            torque = torque + cross(wheel, W) * x[-2] - wheel * x[-1]
        u = inverse @ torque
        if kind.is_constrained:
            u = u - along * (axis @ u)
        found = [*u]
        if kind.has_pivot:
            found += cross(down, W)
        if kind.oriented:
            *v, w = x[len(found) : len(found) + 4]
            found += [*((W * w + cross(v, W)) * 0.5), (Vector(*v) @ W) * -0.5]
        return [*found, x[-1]] if kind.has_wheel else found

    return rates


@dataclass(frozen=True)
class Motion:
    """A model with its numbers: J over the unit, and `more`.

    With the sense -1 its motions run backwards in time: ``-W(-t)`` is a motion of the same body where C and the
    momentum of a rotor change their sign.
    """

    model: Model
    J: Array
    more: Array
    sense: float = 1.0

    @cached_property
    def kind(self) -> Kind:
        """Which terms there are."""
        model = self.model
        has = model.pivot is not None, model.oriented, model.wheel is not None, model.is_damped
        varied = "centre" in model.places, model.damping > 0, bool({"axis", "factor"} & model.places.keys())
        states = model.size + 2 * (model.wheel is not None)
        directions = -(-(states + 6 + model.more) // LANES) * LANES
        return Kind(*has, model.constraint is not None, varied, directions)

    @cached_property
    def vectors(self) -> tuple[Array, Array]:
        """The vectors m g c, C and h a over the unit, (3, 3) in rows, and their derivatives by `more`, (3, 3, k)."""
        model, more = self.model, self.more
        values, by = np.zeros((3, 3)), np.zeros((3, 3, len(more)))
        if model.pivot is not None:
            arm = model.pivot.moment / model.unit
            values[0] = arm * model.direction(more)
        values[1] = self.sense * model.damping_of(more)
        if model.wheel is not None:
            momentum = self.sense * model.wheel.inertia / model.unit
            values[2] = momentum * model.factor(more) * model.axis(more)
        for name, place in model.places.items():
            if name == "centre":
                by[0, :, place] = arm * np.eye(3)
            elif name == "axis":
                by[2, :, place] = momentum * model.factor(more) * np.eye(3)
            elif name == "factor":
                by[2, :, place] = momentum * model.axis(more)[:, None]
            else:
                by[1, :, place] = self.sense * (np.eye(3) if model.damping == 3 else np.ones((3, 1)))
        return values, by

    @cached_property
    def run(self) -> View:
        """What the kernel is called with, but for a start and times."""
        run, (vectors, vectors_by) = view_of(Run), self.vectors
        d, p = self.kind.size, 6 + len(self.more)
        by = np.eye(d + 15, self.kind.directions)
        by[d + 6 :] = 0.0
        by[d + 6 :, d + 6 : d + p] = vectors_by.reshape(9, -1)
        run.J, run.vectors = Symmetric(*entries(self.J)), Matrix(*vectors)
        run.axis, run.by = Vector(*self.constraint), by
        return run

    @property
    def constraint(self) -> Array:
        """The axis n; 0 without one."""
        return np.zeros(3) if self.model.constraint is None else self.model.constraint

    def rate(self, x: Array) -> Array:
        """Return W' of states, (n, 3)."""
        rates = law(self.kind, Matrix(*self.J), Matrix(*self.vectors[0]), Vector(*self.constraint))
        return np.stack(rates(list(x.T))[:3], axis=1)


class Line(NamedTuple):
    """The speed of a rotor in a lane, linear between knots; how it depends on q numbers.

    Attributes
    ----------
    times : (k,) array, s
        The knots from the start of the lane, ascending, positive.
    rates, rates_by : (k + 1,) and (k + 1, q) arrays
        The rate of each piece.
    start, start_by : float and (q,) array
        The speed where it starts.
    """

    times: Array
    rates: Array
    rates_by: Array
    start: float
    start_by: Array


class Run(NamedTuple):
    """What the kernel is called with."""

    J: Symmetric
    vectors: Matrix  # m g c, C and h a in rows
    axis: Vector
    start: Doubles  # (d,)
    by: Doubles  # (d + 15, directions) derivatives of the state, of J and of the vectors, by all that varies
    times: Doubles  # (n,) ascending
    samples: int
    most_steps: int
    out: Doubles  # (n, d, 1 + directions) at samples
    failed: int


@lru_cache
def motion_kernel(kind: Kind) -> Kernel:
    """Return the kernel that follows a motion, for all bodies of a kind."""

    def kernel(address: Any) -> None:
        follow(kind, View(Run, doubles(address)))

    return Kernel(kernel, "i8")


def follow(kind: Kind, run: View) -> None:
    """Follow a motion over its pieces, steps, and samples."""
    d, directions = kind.size, kind.directions
    lanes = 1 if tracer() is None else LANES
    recurrence = Recurrence(ORDER, directions // lanes, lanes)

    def seeded(x: Any, row: int) -> Dual:
        """Return a number with its derivatives."""
        return Dual(x, [run.by.load(row * directions + g * lanes, lanes) for g in range(directions // lanes)])

    plain = Dual(0.0, [0.0] * (directions // lanes)).lifted
    J = Symmetric(*(seeded(x, d + k) for k, x in enumerate(run.J)))
    vectors = [
        Vector(*(seeded(x, d + 6 + 3 * k + i) if kind.varied[k] else plain(x) for i, x in enumerate(vector)))
        for k, vector in enumerate(run.vectors)
    ]
    unknowns = [recurrence.unknown() for _ in range(d)]
    changes = law(kind, J.matrix, vectors, Vector(*map(plain, run.axis)))(unknowns)
    changing, size = unknowns[: len(changes)], d * recurrence.size
    if kind.has_wheel:
        for n in loop(1, ORDER + 1):
            unknowns[-1].set_coefficient(n, plain(0.0))

    for k, one in enumerate(unknowns):
        one.set_coefficient(0, seeded(run.start[k], k))
    v = Variables(now=0.0, sample=0, steps=0, goes=True)
    for _ in whilst(lambda: v.goes):
        recurrence.solve(changing, changes)
        reach = reach_of(unknowns)
        v.steps = v.steps + 1
        v.goes = (reach == reach) & (v.steps < run.most_steps)
        for _ in when(logical_not(v.goes)):
            run.failed = 1
        for _ in whilst(lambda: v.goes & (v.sample < run.samples)):
            t = run.times[v.sample]
            v.goes = t < v.now + reach
            for _ in when(v.goes):
                for k, one in enumerate(unknowns):
                    Stored(recurrence, run.out.shifted(v.sample * size)).set_coefficient(k, one.at(t - v.now))
                v.sample = v.sample + 1
        v.goes = (run.failed == 0) & (v.sample < run.samples)
        for _ in when(v.goes):
            x = [one.at(reach) for one in unknowns]
            v.now = v.now + reach
            for one, y in zip(unknowns, x, strict=True):
                one.set_coefficient(0, y)


def reach_of(series: Sequence[Stored]) -> Any:
    """Return how far the series are exact."""

    def size(n: int) -> Any:
        return reduce(larger, (abs(x[n].value) for x in series))

    return smaller(*(power(EXACT * size(0) / larger(size(n), TINY), 1.0 / n) for n in (ORDER - 1, ORDER)))


def response(motion: Motion, start: Array, times: Array, speed: Line | None = None) -> tuple[Array, Array]:
    """Return the states of a motion at times, and the derivatives by its start and its parameters.

    Parameters
    ----------
    motion : Motion
    start : (m,) array
        At the time 0, without the speed of a rotor.
    times : (n,) array, s
        Before 0 as far as the series of the start reaches.
    speed : Line, optional
        That of a rotor.

    Returns
    -------
    values : (n, d) array
        With the speed of a rotor and its rate last.
    derivatives : (n, d, m + p + q) array
        By the start first, then by J and `more`, then by what the speed depends on.

    Raises
    ------
    RunawayError
        Numbers are not finite any more, or steps become too short.
    """
    order = np.argsort(times, kind="stable")
    sorted_values, sorted_slopes = _sorted_response(motion, start, times[order], speed)
    values, slopes = np.empty_like(sorted_values), np.empty(sorted_slopes.shape)
    values[order], slopes[order] = sorted_values, sorted_slopes
    return values, slopes


def _sorted_response(motion: Motion, start: Array, times: Array, speed: Line | None) -> tuple[Array, Array]:
    """Return the same for ascending times."""
    if speed is None:
        return _piece(motion, start, times)
    knots, d, m, p = speed.times, motion.kind.size, len(start), 6 + len(motion.more)
    values, found = np.empty((len(times), d)), np.empty((len(times), d, m + p + len(speed.start_by)))
    state, by = np.array([*start, speed.start, 0.0]), np.eye(d, found.shape[2])
    by[m:, m:], by[m, m + p :] = 0.0, speed.start_by
    ends = [0, *np.searchsorted(times, knots), len(times)]
    for k, (rate, rate_by) in enumerate(zip(speed.rates, speed.rates_by, strict=True)):
        state[-1], by[-1], by[-1, m + p :] = rate, 0.0, rate_by
        there, begin = slice(ends[k], ends[k + 1]), knots[k - 1] if k else 0.0
        x, D = _piece(motion, state, np.concatenate([times[there], knots[k : k + 1]]) - begin)
        whole = D[:, :, :d] @ by
        whole[:, :, m : m + p] += D[:, :, d:]
        count = there.stop - there.start
        values[there], found[there] = x[:count], whole[:count]
        if k < len(knots):
            state, by = x[-1].copy(), whole[-1]
    return values, found


def _piece(motion: Motion, start: Array, times: Array) -> tuple[Array, Array]:
    """Return states while a rate of the speed lasts, and derivatives by the whole state at its start, J and `more`.

    Times ascend.
    """
    kind, run = motion.kind, motion.run
    out = np.empty((len(times), kind.size, 1 + kind.directions))
    run.start, run.times, run.out = start, times, out
    run.samples, run.most_steps = len(times), MOST_STEPS[0] + MOST_STEPS[1] * len(times)
    motion_kernel(kind)(run.address)
    if run.failed or not np.isfinite(out).all():
        raise RunawayError("the motion is not finite, or needs too many steps")
    return out[:, :, 0], out[:, :, 1 : 1 + kind.size + 6 + len(motion.more)]

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
depends on that at its beginning, x_k, and on p, and ``dx = Φ dx_k + Ψ dp``; the kick at its end adds ``dΩ'``.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache, reduce
from typing import Any, NamedTuple

import numpy as np

from ..geometry.arrays import Array
from ..kernels.control import Variables, loop, when, whilst
from ..kernels.dual import Dual
from ..kernels.elements import larger, logical_not, power, smaller
from ..kernels.kernel import Kernel
from ..kernels.memory import Doubles, View, doubles, view_of
from ..kernels.series import Recurrence, Stored
from ..kernels.tracing import tracer
from ..kernels.vectors import Matrix, Symmetric, Vector, cross, inverse_of
from .bodies import Model, entries

ORDER, EXACT = 20, 1e-11
LANES, TINY, HUGE = 4, 1e-300, 1e300
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


class Parameters(NamedTuple):
    """Numbers of the equations: J, m g c, C, h a, n, and W' for a torque."""

    J: Matrix
    arm: Vector
    drag: Vector
    wheel: Vector
    axis: Vector
    inverse: Matrix
    along: Vector  # c

    @classmethod
    def of(cls, J: Matrix, vectors: Iterable[Vector], axis: Vector, is_constrained: bool) -> Parameters:
        """Return them by the ones that are given."""
        inverse = inverse_of(*J)
        along = inverse @ axis
        arm, drag, wheel = vectors
        return cls(J, arm, drag, wheel, axis, inverse, along / (axis @ along) if is_constrained else axis)


def rates(kind: Kind, p: Parameters, x: Sequence[Any]) -> list[Any]:
    """Return the rates of a state, W, γ, the attitude and Ω; the last, Ω', is constant between kicks."""
    W = Vector(*x[:3])
    torque = cross(p.J @ W, W)
    if kind.has_pivot:
        down = Vector(*x[3:6])
        torque = torque + cross(p.arm, down)
    if kind.is_damped:
        torque = torque - p.drag * W
    if kind.has_wheel:
        torque = torque + cross(p.wheel, W) * x[-2] - p.wheel * x[-1]
    u = p.inverse @ torque
    if kind.is_constrained:
        u = u - p.along * (p.axis @ u)
    found = [*u]
    if kind.has_pivot:
        found += cross(down, W)
    if kind.oriented:
        *v, w = x[len(found) : len(found) + 4]
        found += [*((W * w + cross(v, W)) * 0.5), (Vector(*v) @ W) * -0.5]
    return [*found, x[-1]] if kind.has_wheel else found


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

    @property
    def constraint(self) -> Array:
        """The axis n; 0 without one."""
        return np.zeros(3) if self.model.constraint is None else self.model.constraint

    def rate(self, x: Array) -> Array:
        """Return W' of states, (n, 3)."""
        vectors = Matrix(*self.vectors[0])
        p = Parameters.of(Matrix(*self.J), vectors, Vector(*self.constraint), self.kind.is_constrained)
        return np.stack(rates(self.kind, p, list(x.T))[:3], axis=1)


@dataclass(frozen=True)
class Kicks:
    """The speed of a rotor and its rate at the start of a lane, and jumps of the rate; how they depend on q numbers.

    Attributes
    ----------
    times : (k,) array, s
        From the start of the lane, ascending, positive.
    jumps : (k,) array
    jumps_by : (k, q) array
    start : (2,) array
    start_by : (2, q) array
    """

    times: Array
    jumps: Array
    jumps_by: Array
    start: Array
    start_by: Array


NO_KICKS = Kicks(np.zeros(0), np.zeros(0), np.zeros((0, 0)), np.zeros(0), np.zeros((0, 0)))


class Run(NamedTuple):
    """What the kernel is called with."""

    J: Symmetric
    vectors: Matrix  # m g c, C and h a in rows
    axis: Vector
    start: Doubles  # (d,)
    by: Doubles  # (d + 15, directions) derivatives of the state, of J and of the vectors, by all that varies
    knots: Doubles  # (k + 1,) times of the kicks, and the end
    jumps: Doubles  # (k,)
    kicks: int
    times: Doubles  # (n,) ascending
    samples: int
    most_steps: int
    out: Doubles  # (n, d, 1 + directions) at samples
    ends: Doubles  # (k, d, 1 + directions) at kicks
    failed: int


@lru_cache
def kernel_of(kind: Kind) -> Kernel:
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
    p = Parameters.of(J.matrix, vectors, Vector(*map(plain, run.axis)), kind.is_constrained)
    unknowns = [recurrence.unknown() for _ in range(d)]
    changes = rates(kind, p, unknowns)
    changing, size = unknowns[: len(changes)], d * recurrence.size
    if kind.has_wheel:
        for n in loop(1, ORDER + 1):
            unknowns[-1].put(n, plain(0.0))

    def put(memory: Any, row: Any, numbers: list[Dual]) -> None:
        """Write a state with its derivatives."""
        for k, x in enumerate(numbers):
            Stored(recurrence, memory.shifted(row * size)).put(k, x)

    def begin(numbers: list[Any]) -> None:
        """Begin a piece: derivatives are by the state here."""
        for k, (one, x) in enumerate(zip(unknowns, numbers, strict=True)):
            one.put(0, seeded(x, k))

    begin([run.start[k] for k in range(d)])
    v = Variables(now=0.0, piece=0, sample=0, steps=0, goes=True)
    for _ in whilst(lambda: v.goes):
        recurrence.solve(changing, changes)
        until = run.knots[v.piece]
        reach = smaller(reach_of(unknowns), until - v.now)
        is_last = v.now + reach >= until * (1.0 - 1e-15)
        ahead = Variables(border=v.now + reach)
        for _ in when(is_last):
            ahead.border = until
            for _ in when(v.piece >= run.kicks):
                ahead.border = HUGE
        v.steps = v.steps + 1
        v.goes = (reach == reach) & (v.steps < run.most_steps)
        for _ in when(logical_not(v.goes)):
            run.failed = 1
        for _ in whilst(lambda: v.goes & (v.sample < run.samples)):
            t = run.times[v.sample]
            v.goes = t < ahead.border
            for _ in when(v.goes):
                put(run.out, v.sample, [one.at(t - v.now) for one in unknowns])
                v.sample = v.sample + 1
        v.goes = (run.failed == 0) & (logical_not(is_last) | (v.piece < run.kicks))
        for _ in when(v.goes):
            x = [one.at(reach) for one in unknowns]
            v.now = v.now + reach
            for one, y in zip(unknowns, x, strict=True):
                one.put(0, y)
            for _ in when(is_last):
                put(run.ends, v.piece, x)
                begin([y.value for y in x[:-1]] + [x[-1].value + run.jumps[v.piece]])
                v.now, v.piece = until, v.piece + 1


def reach_of(series: Sequence[Stored]) -> Any:
    """Return how far the series are exact."""

    def size(n: int) -> Any:
        return reduce(larger, (abs(x[n].value) for x in series))

    return smaller(*(power(EXACT * size(0) / larger(size(n), TINY), 1.0 / n) for n in (ORDER - 1, ORDER)))


def response(motion: Motion, start: Array, times: Array, kicks: Kicks = NO_KICKS) -> tuple[Array, Array]:
    """Return the states of a motion at times, and the derivatives by its start and its parameters.

    Parameters
    ----------
    motion : Motion
    start : (m,) array
        At the time 0, without the speed of a rotor, which `kicks` have.
    times : (n,) array, s
        Before 0 as far as the series of the start reaches.
    kicks : Kicks, optional

    Returns
    -------
    values : (n, d) array
        With the speed of a rotor and its rate last.
    derivatives : (n, d, m + p + q) array
        By the start first, then by J and `more`, then by what the kicks depend on.

    Raises
    ------
    RunawayError
        Numbers are not finite any more, or steps become too short.
    """
    kind, (vectors, vectors_by) = motion.kind, motion.vectors
    d, m, p, at = kind.size, len(start), 6 + len(motion.more), kicks.times
    order = np.argsort(times, kind="stable")
    sorted_times, run = np.ascontiguousarray(times[order]), view_of(Run)
    run.J, run.vectors, run.axis = Symmetric(*entries(motion.J)), Matrix(*vectors), Vector(*motion.constraint)
    by = np.eye(d + 15, kind.directions)
    by[d + 6 :] = 0.0
    by[d + 6 :, d + 6 : d + p] = vectors_by.reshape(9, -1)
    out, ends = (np.empty((n, d, 1 + kind.directions)) for n in (len(times), len(at)))
    run.start, run.by, run.times = np.concatenate([start, kicks.start]), by, sorted_times
    run.knots, run.kicks = np.append(at, times.max(initial=0.0)), len(at)
    run.jumps, run.samples = kicks.jumps, len(times)
    run.most_steps = MOST_STEPS[0] + MOST_STEPS[1] * len(times)
    run.out, run.ends = out, ends
    kernel_of(kind)(run.address)
    if run.failed or not (np.isfinite(out).all() and np.isfinite(ends).all()):
        raise RunawayError("the motion is not finite, or needs too many steps")
    values, slopes = np.empty((len(times), d)), np.empty((len(times), d, d + p))
    values[order], slopes[order] = out[:, :, 0], out[:, :, 1 : 1 + d + p]
    if m == d:
        return values, slopes
    piece, found = np.searchsorted(at, times, "right"), np.empty((len(times), d, m + p + kicks.start_by.shape[1]))
    own = np.eye(d, found.shape[2])  # of the state at the beginning of a piece
    own[m:, m:], own[m:, m + p :] = 0.0, kicks.start_by
    for k in range(len(at) + 1):
        there = piece == k
        found[there] = slopes[there][:, :, :d] @ own
        found[there, :, m : m + p] += slopes[there, :, d:]
        if k < len(at):
            own = ends[k, :, 1 : 1 + d] @ own
            own[:, m : m + p] += ends[k, :, 1 + d : 1 + d + p]
            own[-1, m + p :] += kicks.jumps_by[k]
    return values, found

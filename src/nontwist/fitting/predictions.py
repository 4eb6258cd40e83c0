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
depends on that at its beginning, x_k, with the rate of the speed in it, and on p, and ``dx = Φ dx_k + Ψ dp``. One
call of the kernel follows all pieces of all tracks: derivatives begin anew with each, states with each track.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache, reduce
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from ..geometry.arrays import Array
from ..kernels.control import Variables, loop, when, whilst
from ..kernels.dual import Dual
from ..kernels.elements import larger, logical_not, power, smaller
from ..kernels.kernel import Kernel
from ..kernels.machine_code import tracer
from ..kernels.memory import Doubles, View, Wholes, doubles, view_of
from ..kernels.series import Recurrence, Stored
from ..kernels.vectors import Matrix, Symmetric, Vector, cross, inverse_of
from ..machine import cached_property
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


class Track(NamedTuple):
    """Where and when a motion is followed.

    Attributes
    ----------
    start : (m,) array
        The state at the time 0, without the speed of a rotor.
    times : (n,) array, s
        Before 0 as far as the series of the start reaches.
    speed : Line, optional
        That of a rotor.
    """

    start: Array
    times: Array
    speed: Line | None = None


class Run(NamedTuple):
    """What the kernel is called with."""

    J: Symmetric
    vectors: Matrix  # m g c, C and h a in rows
    axis: Vector
    by: Doubles  # (d + 15, directions) derivatives of the state, of J and of the vectors, by all that varies
    pieces: int
    starts: Doubles  # (pieces, d)
    goes_on: Wholes  # (pieces,) 1: from where the piece before has ended, with another rate of the speed
    ends: Wholes  # (pieces,) where the times of each end
    times: Doubles  # (n,) ascending in a track
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

    v = Variables(now=0.0, sample=0, last=0, steps=0, goes=True)
    for piece in loop(run.pieces, whilst=lambda: run.failed == 0):
        start, v.last, v.now, v.goes = run.starts.shifted(piece * d), run.ends[piece], 0.0, True
        for _ in when(run.goes_on[piece] == 1):
            v.now = run.times[v.sample - 1]
            for k in range(d - 1):
                start[k] = run.out[(v.sample - 1) * size + k * recurrence.size]
        for k, one in enumerate(unknowns):
            one.set_coefficient(0, seeded(start[k], k))
        for _ in whilst(lambda: v.goes):
            recurrence.solve(changing, changes)
            reach = reach_of(unknowns)
            v.steps = v.steps + 1
            v.goes = (reach == reach) & (v.steps < run.most_steps)
            for _ in when(logical_not(v.goes)):
                run.failed = 1
            for _ in whilst(lambda: v.goes & (v.sample < v.last)):
                t = run.times[v.sample]
                v.goes = t < v.now + reach
                for _ in when(v.goes):
                    for k, one in enumerate(unknowns):
                        recurrence.write(run.out.shifted(v.sample * size), k, one.at(t - v.now))
                    v.sample = v.sample + 1
            v.goes = (run.failed == 0) & (v.sample < v.last)
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


def responses(motion: Motion, tracks: Sequence[Track]) -> list[tuple[Array, Array]]:
    """Return the states of a motion along tracks, and the derivatives by their starts and by parameters.

    Returns
    -------
    list of pairs
        Of each track values, (n, d), with the speed of a rotor and its rate last, and derivatives, (n, d, m + p + q),
        by the start first, then by J and `more`, then by what the speed depends on.

    Raises
    ------
    RunawayError
        Numbers are not finite any more, or steps become too short.
    """
    kind, run, times, starts, places, ends = motion.kind, motion.run, [], [], [], []
    d, first = kind.size, 0
    for one in tracks:
        knots = np.zeros(0) if one.speed is None else one.speed.times
        every, start = np.concatenate([knots, one.times]), np.zeros((1 + len(knots), d))
        order, place = np.argsort(every, kind="stable"), np.empty(len(every), int)
        place[order] = np.arange(first, first + len(every))
        start[0, : len(one.start)] = one.start
        if one.speed is not None:
            start[0, -2], start[:, -1] = one.speed.start, one.speed.rates
        times.append(every[order])
        starts.append(start)
        places.append(place[len(knots) :])
        ends.append(np.concatenate([[first], place[: len(knots)] + 1, [first + len(every)]]))
        first += len(every)
    out = np.empty((first, d, 1 + kind.directions))
    run.starts, run.times, run.out = np.concatenate(starts), np.concatenate(times), out
    run.ends = np.concatenate([end[1:] for end in ends])
    run.goes_on = np.concatenate([np.arange(len(start)) > 0 for start in starts]).astype(int)
    run.pieces, run.most_steps = sum(map(len, starts)), MOST_STEPS[0] * len(tracks) + MOST_STEPS[1] * first
    motion_kernel(kind)(run.address)
    if run.failed or not np.isfinite(out).all():
        raise RunawayError("the motion is not finite, or needs too many steps")
    values, by = out[:, :, 0], out[:, :, 1 : 7 + d + len(motion.more)]
    return [
        (values[place], by[place] if one.speed is None else through(by, end, one.speed, len(one.start))[place - end[0]])
        for one, place, end in zip(tracks, places, ends, strict=True)
    ]


def through(by: Array, ends: Array, line: Line, m: int) -> Array:
    """Return derivatives along a track, m by its start, by those over its pieces, which end at these of all times."""
    d, p = by.shape[1], by.shape[2] - by.shape[1]
    found = np.empty((ends[-1] - ends[0], d, m + p + len(line.start_by)))
    begin = np.eye(d + p, found.shape[2])  # derivatives of the state where a piece begins, of J and `more`
    begin[m:], begin[m, m + p :], begin[d:, m : m + p] = 0.0, line.start_by, np.eye(p)
    for (first, last), rate_by in zip(pairwise(ends), line.rates_by, strict=True):
        begin[d - 1] = 0.0
        begin[d - 1, m + p :] = rate_by
        piece = found[first - ends[0] : last - ends[0]]
        np.matmul(by[first:last], begin, out=piece)
        begin[:d] = piece[-1]
    return found

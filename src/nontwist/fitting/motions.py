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

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache, reduce
from typing import Any, NamedTuple

import numpy as np

from ..geometry.arrays import Array
from ..geometry.tensors import ENTRIES
from ..kernels.control import Variables, loop, when, whilst
from ..kernels.dual import Dual
from ..kernels.elements import larger, logical_not, power, smaller
from ..kernels.kernel import Kernel
from ..kernels.memory import Doubles, View, doubles, view_of
from ..kernels.series import Recurrence, Stored
from ..kernels.tracing import tracer
from ..kernels.vectors import Matrix, Symmetric, Vector, cross, inverse_of
from .bodies import Kind, Model

ORDER, EXACT = 20, 1e-11
LANES, TINY, HUGE = 4, 1e-300, 1e300
MOST_STEPS = 1000, 5  # of a lane; and for each sample: a body that is recorded needs about one for a radian


class RunawayError(ArithmeticError):
    """A motion has left the numbers: the parameters are far off."""


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
    def of(cls, J: Matrix, arm: Vector, drag: Vector, wheel: Vector, axis: Vector, is_constrained: bool) -> Parameters:
        """Return them by the ones that are given."""
        inverse = inverse_of(*J)
        along = inverse @ axis
        return cls(J, arm, drag, wheel, axis, inverse, along / (axis @ along) if is_constrained else axis)


class State(NamedTuple):
    """What changes: W, γ, the attitude, the speed of a rotor and its rate; None where there is none."""

    W: Vector
    down: Vector | None = None
    q: tuple[Any, ...] | None = None
    speed: tuple[Any, Any] | None = None

    @classmethod
    def of(cls, kind: Kind, numbers: Sequence[Any]) -> State:
        """Return a state by its numbers."""
        n = iter(numbers)
        W = Vector(next(n), next(n), next(n))
        down = Vector(next(n), next(n), next(n)) if kind.has_pivot else None
        q = tuple(next(n) for _ in range(4)) if kind.oriented else None
        return cls(W, down, q, (next(n), next(n)) if kind.has_wheel else None)


def rates(kind: Kind, p: Parameters, x: State) -> list[Any]:
    """Return the rates of the numbers of a state but the last, which is constant between kicks."""
    W = x.W
    torque = cross(p.J @ W, W)
    if x.down is not None:
        torque = torque + cross(p.arm, x.down)
    if kind.is_damped:
        torque = torque - p.drag * W
    if x.speed is not None:
        torque = torque + cross(p.wheel, W) * x.speed[0] - p.wheel * x.speed[1]
    u = p.inverse @ torque
    if kind.is_constrained:
        u = u - p.along * (p.axis @ u)
    found = [*u]
    if x.down is not None:
        found += cross(x.down, W)
    if x.q is not None:
        v, w = Vector(*x.q[:3]), x.q[3]
        found += [*((W * w + cross(v, W)) * 0.5), (v @ W) * -0.5]
    return found if x.speed is None else [*found, x.speed[1]]


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

    def rate(self, x: Array) -> Array:
        """Return W' of states, (n, 3)."""
        kind = self.model.kind
        return np.stack(
            rates(kind, Parameters.of(*self.vectors, kind.is_constrained), State.of(kind, list(x.T)))[:3], axis=1
        )

    @property
    def vectors(self) -> tuple[Matrix, Vector, Vector, Vector, Vector]:
        """J, m g c, C, h a and n."""
        model, more = self.model, self.more
        arm = 0.0 if model.pivot is None else model.pivot.moment / model.unit
        wheel, axis = np.zeros(3), np.zeros(3) if model.constraint is None else model.constraint
        if model.wheel is not None:
            wheel = self.sense * model.factor(more) * model.wheel.inertia / model.unit * model.axis(more)
        drag = self.sense * model.damping_of(more)
        vectors = (Vector(*x) for x in (arm * model.direction(more), drag, wheel, axis))
        return Matrix(*self.J), *vectors  # type: ignore[return-value]


@dataclass(frozen=True)
class Kicks:
    """The speed of a rotor and its rate at the start of a lane, and jumps of the rate; how they depend on q numbers.

    Attributes
    ----------
    times : (k,) array, s
        From the start of the lane, ascending, positive.
    jumps : (k,) array
    jumps_by : (k, q) array
    start_by : (2, q) array
    """

    times: Array
    jumps: Array
    jumps_by: Array
    start_by: Array


class Run(NamedTuple):
    """What the kernel is called with."""

    J: Symmetric
    arm: Vector
    drag: Vector
    wheel: Vector
    axis: Vector
    arm_by: float  # derivative of the arm by the direction of the centre
    wheel_by: Vector  # of the momentum of the rotor by its factor
    axis_by: float  # and by its axis
    start: Doubles  # (d,)
    knots: Doubles  # (k + 1,) times of the kicks, and the end
    jumps: Doubles  # (k,)
    kicks: int
    times: Doubles  # (n,) ascending
    samples: int
    most_steps: int
    unit: Doubles  # the unit matrix of as many rows as there are directions
    out: Doubles  # (n, d, 1 + directions) at samples
    ends: Doubles  # (k, d, 1 + directions) at kicks
    failed: int


def sizes(kind: Kind) -> tuple[int, int]:
    """Return how many numbers a state has, and how many directions there are, full lanes."""
    d = kind.size + kind.hidden
    return d, -(-(d + 6 + kind.more) // LANES) * LANES


@lru_cache
def kernel_of(kind: Kind) -> Kernel:
    """Return the kernel that follows a motion, for all bodies of a kind."""

    def kernel(address: Any) -> None:
        follow(kind, View(Run, doubles(address)))

    return Kernel(kernel, "i8")


def follow(kind: Kind, run: View) -> None:
    """Follow a motion over its pieces, steps, and samples."""
    d, directions = sizes(kind)
    lanes = 1 if tracer() is None else LANES
    recurrence = Recurrence(ORDER, directions // lanes, lanes)

    def seeded(x: Any, k: Any) -> Dual:
        """Return a number with the derivative 1 in a direction."""
        return Dual(x, [run.unit.load(k * directions + g * lanes, lanes) for g in range(directions // lanes)])

    plain = Dual(0.0, [0.0] * (directions // lanes)).lifted
    place = d + 6
    J = Symmetric(*(seeded(x, d + k) for k, x in enumerate(run.J)))
    arm, drag, wheel, axis = (Vector(*map(plain, getattr(run, name))) for name in ("arm", "drag", "wheel", "axis"))
    if kind.points:
        arm = Vector(*(x + run.arm_by * seeded(0.0, place + k) for k, x in enumerate(arm)))
        place += 3
    if kind.has_axis:
        wheel = Vector(*(x + run.axis_by * seeded(0.0, place + k) for k, x in enumerate(wheel)))
        place += 3
    if kind.has_factor:
        wheel = Vector(*(x + b * seeded(0.0, place) for x, b in zip(wheel, run.wheel_by, strict=True)))
        place += 1
    if kind.damping:
        drag = Vector(*(x + seeded(0.0, place + k * (kind.damping == 3)) for k, x in enumerate(drag)))
    p = Parameters.of(J.matrix, arm, drag, wheel, axis, kind.is_constrained)
    unknowns = [recurrence.unknown() for _ in range(d)]
    changes = rates(kind, p, State.of(kind, unknowns))
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


def responses(
    motion: Motion, starts: Array, times: list[Array], kicks: Sequence[Kicks] | None = None
) -> tuple[list[Array], list[Array]]:
    """Return the states of several motions at their times, and the derivatives by start and parameters.

    Parameters
    ----------
    motion : Motion
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
        By the start first, then by the parameters, then by what the kicks depend on.

    Raises
    ------
    RunawayError
        Numbers are not finite any more, or steps become too short.
    """
    found = [
        _response(motion, start, t, None if kicks is None else kicks[k])
        for k, (start, t) in enumerate(zip(starts, times, strict=True))
    ]
    return [values for values, _ in found], [derivatives for _, derivatives in found]


def _response(motion: Motion, start: Array, times: Array, kicks: Kicks | None) -> tuple[Array, Array]:
    model = motion.model
    (d, directions), p = sizes(model.kind), 6 + model.more
    order, at = np.argsort(times, kind="stable"), np.zeros(0) if kicks is None else kicks.times
    sorted_times, run = np.ascontiguousarray(times[order]), view_of(Run)
    J, run.arm, run.drag, run.wheel, run.axis = motion.vectors
    run.J = Symmetric(*(J[i][j] for i, j in ENTRIES))
    if model.pivot is not None:
        run.arm_by = model.pivot.moment / model.unit
    if model.wheel is not None:
        momentum = motion.sense * model.wheel.inertia / model.unit
        run.wheel_by, run.axis_by = Vector(*(momentum * model.axis(motion.more))), momentum * model.factor(motion.more)
    out, ends = (np.empty((n, d, 1 + directions)) for n in (len(times), len(at)))
    run.start, run.times, run.samples = np.ascontiguousarray(start, dtype=float), sorted_times, len(times)
    run.knots, run.kicks = np.append(at, times.max(initial=0.0)), len(at)
    run.jumps = np.zeros(0) if kicks is None else kicks.jumps
    run.most_steps = MOST_STEPS[0] + MOST_STEPS[1] * len(times)
    run.unit, run.out, run.ends = np.eye(directions), out, ends
    kernel_of(model.kind)(run.address)
    if run.failed or not (np.isfinite(out).all() and np.isfinite(ends).all()):
        raise RunawayError("the motion is not finite, or needs too many steps")
    values, slopes = np.empty((len(times), d)), np.empty((len(times), d, d + p))
    values[order], slopes[order] = out[:, :, 0], out[:, :, 1 : 1 + d + p]
    slopes[:, :, d + p - model.damping :] *= motion.sense
    if kicks is None:
        return values, slopes
    piece, found = np.searchsorted(at, times, "right"), np.empty((len(times), d, d + p + kicks.start_by.shape[1]))
    by = np.zeros(found.shape[1:])  # the state at the beginning of a piece
    by[:, :d], by[d - 2 :, d + p :] = np.eye(d), kicks.start_by
    for k in range(len(at) + 1):
        own = piece == k
        found[own] = slopes[own][:, :, :d] @ by
        found[own, :, d : d + p] += slopes[own, :, d:]
        if k < len(at):
            by = ends[k, :, 1 : 1 + d] @ by
            by[:, d : d + p] += ends[k, :, 1 + d : 1 + d + p]
            by[-1, d + p :] += kicks.jumps_by[k]
    return values, found

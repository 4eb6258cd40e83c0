"""The march over the time grid: one text for all schemes, for one body and for bodies in lanes.

A kernel is made for the scheme and the `Parts` at hand, when it is first called (`march_kernel`). It takes the address
of a `Block`. Members are marched a few at a time, as many as there are lanes: their numbers are copied into its
workspace, go through all steps, and are copied back. A member that fails is noted and its numbers are NaN from there
on; its neighbours go on. What a step gives to means and sums over the interval, and to what is observed, is summed in
the workspace.

A scheme is a `Text`. Its step gets

- `nodes`, which has what acts at the nodes of the step (`sampling`), with ``nodes.parts``: what there is, known
  when the text is traced, so that an `if` on it leaves things out; ``nodes.body``; ``nodes.h``, the step; and
  ``nodes.memory``, scratch of the scheme itself behind the workspace;
- the `State` at the beginning of the step, all bodies of the lanes side by side; ``state.auxiliary`` has as many
  numbers as the text says;
- the mask of bodies that are alive: the iteration of a step must not wait for others, nor depend on them.

It returns a `Step`: the state at the end, with s and p as compensated sums (`turned_by`, `compensated`), why bodies
cannot go on, and, if ``parts.needs_means``, what the step gives: mean multipliers, mean moment, work, twist; None is
what is not given. The march does the rest: notes failures, sums, observes, writes nodes.

Quaternions are turned by finite turns, for as long as one likes, without a drift of their length or direction.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from math import sqrt as root
from typing import Any, NamedTuple

from numpy.polynomial.legendre import leggauss

from ..kernels.control import Variables, loop, when, whilst
from ..kernels.elements import any_of, fma, larger, select, sin, smaller, sqrt, without
from ..kernels.kernel import Kernel
from ..kernels.memory import View, doubles, size_of
from ..kernels.vectors import Quaternion, Vector, compensated, cross, taxicab
from .newton import Solution
from .records import NODAL, Block, Parts, State, Work
from .sampling import Nodes, mean_moment_of_dead
from .workspace import (
    NAN,
    NOW,
    OK,
    add_to_integrals,
    advance_internal,
    begin_observing,
    extend,
    gather,
    internal,
    note_failure,
    observe,
    scatter,
    write,
)

COSINE = -1 / 2, 1 / 24, -1 / 720, 1 / 40320, -1 / 3628800  # (cos h - 1)/h² and sin h/2h by the powers of h²
SINE = 1 / 2, -1 / 12, 1 / 240, -1 / 10080, 1 / 725760
SERIES = 0.01  # the largest h² for which they are enough


def exponential(turn: Vector) -> tuple[Any, Vector]:
    """Return (c - 1, v) of the quaternion (c, v) that turns one body by the rotation vector."""
    h2 = 0.25 * (turn @ turn)
    cosm1, sine = 0.0 * h2 + COSINE[-1], 0.0 * h2 + SINE[-1]
    for c, s in zip(COSINE[-2::-1], SINE[-2::-1], strict=True):
        cosm1, sine = fma(h2, cosm1, c), fma(h2, sine, s)
    found = Variables(cosm1=h2 * cosm1, sine=sine)
    for _ in when(h2 >= SERIES):
        half = sqrt(h2)
        quarter = sin(0.5 * half)
        found.cosm1, found.sine = -2.0 * quarter * quarter, 0.5 * sin(half) / half
    return found.cosm1, found.sine * turn


def turned_by_vector(p: Quaternion, turn: Vector) -> Quaternion:
    """Return the quaternion p turned by a rotation vector."""
    cosm1, v = exponential(turn)
    return p @ Quaternion(1.0 + cosm1, *v)


def turned_and_normalised(p: Quaternion, c: Quaternion, cosm1: Any, v: Vector) -> tuple[Quaternion, Quaternion, Any]:
    """Return p (1 + cosm1, v), of unit length to first order in its deviation, its compensation, and that deviation.

    The sum of p and its increment is Knuth's. What p was rounded by is turned as well: else the rounding errors of
    motions that nearly repeat add up.
    """

    def grown(p: Quaternion) -> Quaternion:
        q = p.vector
        return Quaternion(cosm1 * p[0] - q @ v, *(fma(cosm1, q, p[0] * v) + cross(q, v)))

    def updated(x: Any, c: Any, d: Any, e: Any) -> tuple[Any, Any]:
        t = x + d
        b = t - x
        small = ((x - (t - b)) + (d - b)) + (c + (e + 0.5 * gap * t))
        total = t + small
        return total, small - (total - t)

    gap = 1.0 - (p[0] * p[0] + p.vector @ p.vector)
    pairs = [updated(*each) for each in zip(p, c, grown(p), grown(c), strict=True)]
    return Quaternion(*(a for a, _ in pairs)), Quaternion(*(b for _, b in pairs)), abs(gap)


def magnus(h: Any, W: list[Vector]) -> Any:
    """Return the rotation vector Ω of Λ(h) = Λ(0) exp(Ω̂), Λ' = Λ Ŵ, from W at one, two or three Gauss nodes.

    Magnus expansions of order 2, 4, 6 (A. Iserles, S. P. Nørsett, Phil. Trans. R. Soc. A 357 (1999) 983; S. Blanes, F.
    Casas, J. Ros, BIT 40 (2000) 434). They are those of Y' = A Y with the bracket [x, y] = -x × y.
    """
    if len(W) == 1:
        return h * W[0]
    if len(W) == 2:
        return (root(3.0) / 12.0 * h * h) * cross(W[0], W[1]) + (0.5 * h) * (W[0] + W[1])
    a1, a2 = h * W[1], (root(15.0) / 3.0 * h) * (W[2] - W[0])
    a3 = (10.0 / 3.0 * h) * (W[2] - 2.0 * W[1] + W[0])
    c1 = -cross(a1, a2)
    c2 = cross(a1, 2.0 * a3 + c1) / 60.0
    return a1 + a3 / 12.0 - cross(c1 - a3 - 20.0 * a1, a2 + c2) / 240.0


TOTALS = "twist", "work", "velocity_integral", "velocity_moment"  # what is no mean
PI = 3.141592653589793
FARTHEST = 1e15  # rad a step, of which round-off leaves nothing
UNIT = 1e-9  # how far a quaternion may be from unit length
GAUSS_4 = [(0.5 + 0.5 * float(x), 0.5 * float(w)) for x, w in zip(*leggauss(4), strict=True)]  # nodes and weights


class Step(NamedTuple):
    """What a step gives."""

    state: State  # at the end
    stalled: Any  # mask of bodies whose equations are not solved
    far: Any  # mask of bodies that turn too far
    gap: Any  # how far the quaternion at the beginning was from unit length
    used: Any  # iterations
    residual: Any
    turn: Any  # rad, where a body fails
    twist: Any = None  # about the axis
    mu: Any = None  # means over the step: of the multipliers
    lam: Any = None
    moment: Any = None  # of the moment of the load, of that of dead forces, in space
    dead: Any = None
    work: Any = None
    velocity_integral: Any = None  # integrals of W, and of W times the time
    velocity_moment: Any = None


# Of a state: what gives, of a time, the state after it, and the mask of bodies that turn too far.
Flow = Callable[[Nodes, State], Callable[[Any], tuple[State, Any]]]


class Text(NamedTuple):
    """What a scheme gives to the march."""

    step: Callable[[Nodes, State, Any], Step]
    auxiliary: int = 0  # numbers of `State.auxiliary` that it carries
    # The first guess of a known step: `State.auxiliary`, of h, s, s⁺.
    first_guess: Callable[[Any, Vector, Vector], Any] | None = None
    integrates: bool = False  # whether it integrates what is observed over its own nodes, else the trapezoidal rule
    exchange: Callable[[Parts, View, Any, Any, Any, bool], None] | None = None  # brings what it carries beside `State`
    is_midpoint: bool = False  # whether it calls functions of the state in the middle of its turn cay(hΩ) alone
    flow: Flow | None = None  # moves a body on which nothing acts over any time, exactly; None: by steps


def turned_by(p: Quaternion, c: Quaternion, a: Vector, f: Any, cosm1: Any) -> tuple[Quaternion, Quaternion, Any]:
    """Return the quaternion ``p (1 + cosm1, f a)``, what it is rounded by, and how far p was from unit length.

    It has unit length where ``1 + cosm1`` is f/√(f² (1 + |a|²)), to first order in what p was away from it.
    """
    v = p.vector
    gap = 1.0 - fma(p[0], p[0], v @ v)
    more, d = cosm1 + 0.5 * gap, f * fma(p[0], a, cross(v, a))
    change = Quaternion(fma(more, p[0], -f * (v @ a)), *(fma(more, x, y) for x, y in zip(v, d, strict=True)))
    ahead, left = compensated(p, c, change)
    return ahead, left, abs(gap)


def turned_by_half(p: Quaternion, c: Quaternion, a: Vector) -> tuple[Quaternion, Quaternion, Any]:
    """Return `turned_by` for the rotation cay(2a), which has the quaternion (1, a)/|(1, a)|."""
    f = sqrt(1.0 / (1.0 + a @ a))
    return turned_by(p, c, a, f, f - 1.0)


def midpoint_step(state: State, a: Vector, change: Vector, auxiliary: Any, found: Solution) -> Step:
    """Return the step that turns by cay(2a) and changes s, by the solution of its equations; to half a turn."""
    p, c, gap = turned_by_half(state.p, state.c, a)
    s, compensation = compensated(state.s, state.compensation, change)
    far, turn = 4.0 * (a @ a) > PI * PI, 2.0 * sqrt(a @ a)
    after = State(p, s, compensation, c, auxiliary)
    return Step(after, found.stalled, far, gap, found.used, found.residual, turn)


def midpoint_means(nodes: Nodes, dead: Any, found: Step, a: Vector, moment: Any, **multipliers: Any) -> Step:
    """Return such a step with its means, given the moment of the load, in b at the beginning, and dead forces there."""
    parts = nodes.parts
    if moment is not None:
        found = found._replace(moment=nodes.R @ moment, work=2.0 * (a @ moment))
    if parts.dead and parts.is_constrained:
        found = found._replace(dead=nodes.R @ mean_moment_of_dead(dead, 1.0 / (1.0 + a @ a), a))
    if parts.integrates_velocity:
        found = found._replace(velocity_integral=2.0 * a, velocity_moment=(2.0 * nodes.time()) * a)
    return found._replace(twist=2.0 * (nodes.body.axis @ a), **multipliers)


@cache
def march_kernel(text: Text, parts: Parts) -> Kernel:
    """Return the kernel that marches bodies; it is compiled when it is called."""
    return Kernel(marching_text(text, parts), "i8", parts.lanes)


def marching_text(text: Text, parts: Parts) -> Callable[[Any], None]:
    """Return the text of the march of the members `begin` to `end` of the block's order over the nodes of its grid."""

    def kernel(address: Any) -> None:
        b = View(Block, doubles(address))
        memory = doubles(b.workspace)
        x, end = View(Work, memory, parts.lanes), b.end
        for first in loop(b.begin, end, parts.lanes):
            last = smaller(first + parts.lanes, end)
            own = memory.shifted(size_of(Work) * parts.lanes + parts.memory_size)
            gather(parts, b, x, first, last)
            if text.exchange is not None:
                text.exchange(parts, b, own, first, last, False)
            march_lanes(text, parts, b, x, own, first, last)
            scatter(parts, b, x, first, last)
            if text.exchange is not None:
                text.exchange(parts, b, own, first, last, True)

    return kernel


def march_lanes(text: Text, parts: Parts, b: View, x: View, memory: Any, first: Any, last: Any) -> None:
    """March the bodies in the workspace."""
    nodes = Nodes(parts, b, x, memory)
    state, stored, lengths, begin, h = x.state.read(), b.stored, b.lengths, b.first, b.step[0]
    state = state._replace(auxiliary=state.auxiliary[: text.auxiliary])
    v = Variables(state=state, done=b.done, alive=x.failure.status == OK)

    def show(now: State) -> None:
        x.state.write(now._replace(auxiliary=(*now.auxiliary, *x.state.auxiliary[text.auxiliary :])))
        x.velocity = parts.velocity(nodes.body, now.s)

    def see(now: State) -> None:
        show(now)
        observe(x, parts.is_director_scheme)

    def store(now: State) -> None:
        v.done = v.done + 1
        if parts.is_director_scheme:
            show(now)
        else:
            x.state.p, x.velocity = now.p, parts.velocity(nodes.body, now.s)
        write(parts, b, x, v.done, first, last)

    if text.flow is None:
        turn = abs(h) * taxicab(parts.velocity(nodes.body, v.state.s))
        far = v.alive & (turn > FARTHEST)
        for _ in when(any_of(far)):
            note_failure(parts, x, far, turn < 0.0, far, begin, NAN, turn)
            v.alive = without(v.alive, far)
    if parts.observes:
        see(v.state)
        for _ in when(begin == 0):
            begin_observing(x)
    end, unloaded_from = begin + b.steps, b.unloaded_from
    last_of_steps = smaller(end, unloaded_from) if parts.skips_unloaded else end
    for number in loop(begin, last_of_steps, whilst=lambda: any_of(v.alive)) if parts.acts else ():
        nodes.begin((number - begin) * parts.nodes, v.state.p)
        found = text.step(nodes, v.state, v.alive)
        fine = without(v.alive & (found.gap <= UNIT), found.stalled | found.far)
        bad = without(v.alive, fine)
        for _ in when(any_of(bad)):
            W = parts.velocity(nodes.body, v.state.s)
            how_far = select(found.stalled, h * sqrt(W @ W), found.turn)
            note_failure(parts, x, bad, found.stalled, found.far, number, found.residual, how_far)
            v.alive = without(v.alive, bad)
        for _ in when(any_of(v.alive)):
            if parts.needs_means:
                take_in(text, parts, x, h, h / lengths[v.done], found)
            v.state = found.state
            advance_internal(parts, internal(b))
            if parts.observes:
                see(v.state)
                if not text.integrates:
                    add_to_integrals(x, 0.5 * h)
                extend(x, h)
            for _ in when(number + 1 == stored[v.done + 1]):
                store(v.state)
    if parts.skips_unloaded:
        for _ in when(any_of(v.alive) & (end > unloaded_from)):
            coast(text, nodes, v, see, store)
    show(v.state)
    for _ in when(b.writes_end != 0):
        write(parts, b, x, v.done + 1, first, last)


def coast(text: Text, nodes: Nodes, v: Variables, see: Callable[[State], None], store: Callable[[State], None]) -> None:
    """Move a body on which nothing acts from the step `unloaded_from` on: each state follows from the one there.

    What is observed is integrated by four Gauss nodes a step.
    """
    assert text.flow is not None
    b, x = nodes.block, nodes.x
    parts, h, begin, stored, lengths = nodes.parts, nodes.h, b.unloaded_from, b.stored, b.lengths
    end, loaded_from, state_after = b.first + b.steps, b.loaded_from, text.flow(nodes, v.state)
    mu = cross(v.state.s, parts.velocity(nodes.body, v.state.s))[2] if parts.is_constrained else 0.0 * h
    v.at = larger(b.first, begin)
    far = state_after(h * (loaded_from - begin))[1]
    for _ in when(far):
        note_failure(parts, x, far, h != h, far, v.at, NAN, NAN)
        v.alive = without(v.alive, far)
    for _ in whilst(lambda: any_of(v.alive) & (v.at < end)):
        until = smaller(stored[v.done + 1], end)
        if parts.needs_means:
            x.sums.mu = x.sums.mu + h * (until - v.at) / lengths[v.done] * mu
        if parts.observes:
            for number in loop(v.at - begin, until - begin):
                for node, weight in GAUSS_4:
                    see(state_after(h * (number + node))[0])
                    add_to_integrals(x, h * weight)
                see(state_after(h * (number + 1))[0])
                x.set_number(NOW + NODAL, -mu)
                extend(x, h)
        for _ in when(until == stored[v.done + 1]):
            store(state_after(h * (until - begin))[0])
        v.at = until
    for _ in when(any_of(v.alive) & ((end == loaded_from) | (b.writes_end != 0))):
        v.state = state_after(h * (end - begin))[0]


def take_in(text: Text, parts: Parts, x: View, h: Any, part: Any, found: Step) -> None:
    """Take what a step gives, a part of the interval, into means and sums, and into what is observed."""
    for name in ("mu", "lam", "moment", "dead", *TOTALS):
        if (value := getattr(found, name)) is not None and (parts.reports or name != "lam"):
            own = getattr(x.sums, name)
            setattr(x.sums, name, own + (value if name in TOTALS else part * value))
    if parts.reports:
        x.sums.iterations = larger(found.used, x.sums.iterations)
    if parts.observes:
        x.set_number(NOW + NODAL, x.number(NOW + NODAL) - found.mu)
        if not text.integrates:
            add_to_integrals(x, 0.5 * h)
        if found.work is not None:
            x.observed.work = x.observed.work + found.work

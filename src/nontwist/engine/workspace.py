"""Around the steps of a march: its workspace, the arrays of results, the list of calls of its kernel.

**The workspace.** Place k of it holds the number k of each member, side by side: `View(Work, ..., lanes)`.

What is observed at whole steps: least and greatest value of the quantities K, V, K + V - A (A: work of the load), π, Π,
ψ', e·π (e vertical) and, as means over a step, of the reaction moment -μ; their integrals over time are those of the
trapezoidal rule over each step or, with `gauss` and `split`, sums over their stages and substeps, of the order of the
scheme. All in the units of the body.

**Outputs.** A march is a list of calls, made beforehand (`integrators.stack_march`), which is carried out here: steps
of equal length, in order; and where there are outputs that need not be nodes, substeps to them.

A run goes from node to node of its grid, whatever output is asked for. A state at t between the nodes t_n and t_{n+1}
is that of one more step of the scheme, from the state at t_n over t - t_n, which is then left aside. So it depends on
t and the run alone, not on the other outputs; it has the order of the scheme, as its own error is that of one step;
whatever the scheme keeps at any length of a step is kept there too; and it crosses no kink of the load that is a node.

Means over an interval between outputs follow from integrals over time, which are exact as well: with T the integral
from the last output o to the node t_n, S that over the step, E(o) that over the substep to the output o,

    from o to o' in the same step: E(o') - E(o);    from o to the node t_{n+1}: S - E(o);    onwards: T + E(o').

So T becomes -E(o) once o is written, and T + S at the next node. An impulse or a work of the load that balances over
each step balances between any two outputs.

A list with outputs is carried out for a few members at a time. Those within a step come before it.

A prepared march is one call, of what a caller waits for beside the steps. It gives back the sum of the squares of all
results, which tells whether numbers are finite and small enough, infinite where the run has failed; and the largest
|W|² of the stored states.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

from ..kernels.control import Variables, loop, when
from ..kernels.elements import larger, mapped, real, select, smaller, without
from ..kernels.kernel import Kernel, kernel, part
from ..kernels.memory import View, call, doubles, fields, put, size_of, vector_at
from ..kernels.vectors import Matrix, Quaternion, Symmetric, Vector, attitude, compensated, first_moment
from .records import NODAL, QUANTITIES, Block, Body, MemberFailure, Observed, Parts, State, Sums, Work, offsets_of

NAN, ROUND_OFF = float("nan"), 2.0**-48
OK, TURN, STALLED, BROKEN, LOAD = 0.0, 1.0, 2.0, 3.0, 4.0  # status
VELOCITIES = "velocity_integral", "velocity_moment"  # of the sums
NOW, AUXILIARY = fields(Work)["now"].offset, fields(State)["auxiliary"].offset


def member_fields(parts: Parts, b: View) -> list[tuple[str, Any, Any, Any]]:
    """Return what members carry: a field of the workspace, its record, their array, numbers from row to row."""
    found = [("state", State, b.states, b.state_size), ("failure", MemberFailure, b.failures, size_of(MemberFailure))]
    if parts.reports:
        found.append(("sums", Sums, b.sums, size_of(Sums)))
    if parts.observes:
        found.append(("observed", Observed, b.observed, size_of(Observed)))
    return found


def internal(b: View) -> Any:
    """Return z of the one member that is marched, what it was rounded by, its change in a step."""
    return doubles(b.workspace).shifted(size_of(Work))


def internal_of(b: View, i: Any) -> Any:
    """Return z of a member and what it was rounded by, behind all that it carries else."""
    return b.states.shifted((i + 1) * b.state_size - 2 * b.internal)


def copy(source: Any, target: Any, count: Any) -> None:
    """Copy so many numbers."""
    for k in loop(count):
        target[k] = source[k]


def advance_internal(parts: Parts, z: Any) -> None:
    """Add the change in a step to z."""
    k = parts.memory
    for c in loop(k) if k else ():
        z[c], z[k + c] = compensated(z[c], z[k + c], z[2 * k + c])


@part
def gather(parts: Parts, b: View, x: View, first: Any, last: Any) -> None:
    """Fill the workspace with members; lanes beyond `last` repeat the one before it."""
    for l in loop(parts.lanes):
        i, lane = b.order[smaller(first + l, last - 1)], x.lane(l)
        for name, record, array, stride in [("body", Body, b.bodies, b.body_stride), *member_fields(parts, b)]:
            getattr(lane, name).copy_from(View(record, array.shifted(i * stride)))
        lane.scale = b.scales[i * b.scale_stride]
        if parts.memory:
            copy(internal_of(b, i), internal(b), 2 * parts.memory)
        if parts.observes:
            lane.set_number(NOW + NODAL, 0.0)


@part
def scatter(parts: Parts, b: View, x: View, first: Any, last: Any) -> None:
    """Put back what the members carry on."""
    for l in loop(last - first):
        i, lane = b.order[first + l], x.lane(l)
        for name, record, array, stride in member_fields(parts, b):
            View(record, array.shifted(i * stride)).copy_from(getattr(lane, name))
        if parts.memory:
            copy(internal(b), internal_of(b, i), 2 * parts.memory)


@part
def write(parts: Parts, b: View, x: View, k: Any, first: Any, last: Any) -> None:
    """Write the states of the node k, and the means over the interval before it, in body components.

    Of the two quaternions of an attitude it is the one nearer to the state stored before. NaN where a run has failed.
    """
    for l in loop(last - first) if parts.lanes > 1 else (0,):
        i, lane, rate = b.order[first + l], x.lane(l), b.step[1]
        row, body = i * b.output_count + k, lane.body
        B, unit = body.basis, body.unit
        f = select(lane.failure.status == OK, 1.0, NAN)
        s, *v = lane.state.p @ body.frame.inverse
        q = b.quaternions.shifted(row * 4)
        p, before = (*v, s), q.shifted(-4)
        nearer = before[0] * p[0] + before[1] * p[1] + before[2] * p[2] + before[3] * p[3]
        sign = select(nearer >= 0.0, f, -f)
        put(q, tuple(sign * y for y in p))
        put(b.velocities.shifted(row * 3), (f * rate) * (B @ lane.velocity))
        if parts.memory:
            z, own = b.internals.shifted(row * parts.memory), internal(b)
            for c in loop(parts.memory):
                z[c] = f * own[c]
        if parts.is_director_scheme:
            N = Symmetric(*lane.state.auxiliary[:6])
            put(b.normals.shifted(row * 6), (f * rate) * turned_into(B, N))
        if parts.reports:
            means, sums = View(Sums, b.intervals.shifted((row - i - 1) * size_of(Sums))), lane.sums
            for name in reported(parts):
                y = getattr(sums, name)
                mean = turned_into(B, y) if name == "lam" else B @ y if name in VELOCITIES else y
                setattr(means, name, mean if name in (*VELOCITIES, "twist", "iterations") else unit * mean)
                setattr(sums, name, mapped(lambda _: 0.0, y))


def reported(parts: Parts) -> list[str]:
    """Return the sums that are made of steps; the others stay 0."""
    dead = parts.dead or parts.generalised
    is_made = {"lam": parts.is_director_scheme, "mu": parts.is_constrained, "dead": dead}
    is_made |= dict.fromkeys(VELOCITIES, parts.integrates_velocity)
    return [name for name in Sums._fields if is_made.get(name, True)]


def turned_into(B: Any, A: Symmetric) -> Symmetric:
    """Return B A Bᵀ."""
    return (B @ A.matrix @ B.T).symmetric


@part
def note_failure(
    parts: Parts, x: View, bad: Any, stalled: Any, far: Any, number: Any, residual: Any, turn: Any
) -> None:
    """Note why bodies cannot go on."""
    status = select(stalled, STALLED, select(far, TURN, BROKEN))
    if parts.calls:
        m = x.found.total
        status = select(without(stalled, abs(m[0]) + abs(m[1]) + abs(m[2]) < 1e300), LOAD, status)
    before = x.failure.read()
    x.failure.write(select(bad, MemberFailure(status, real(number), residual, turn), before))


def entered(body: Any, q: Any, w: Any) -> tuple[Quaternion, Vector]:
    """Return a quaternion, scalar last, and W that lie in memory, in the frame b."""
    return Quaternion(q[3], q[0], q[1], q[2]) @ body.frame, vector_at(w) @ body.basis


@kernel("i8")
def enter(address: Any) -> None:
    """Set the states of all members from the first of those stored, in the frames and units of the bodies.

    Round-off of N, and of W along a constrained axis without spin, is taken away; all of the latter unless N is
    carried. With N goes W, else the momentum.
    """
    b = View(Block, doubles(address))
    unit, has_normal, is_constrained = 1.0 / b.step[1], b.director != 0, b.is_constrained != 0
    for i in loop(b.members):
        body, row = View(Body, b.bodies.shifted(i * b.body_stride)), b.states.shifted(i * b.state_size)
        q, w = b.quaternions.shifted(4 * i * b.output_count), b.velocities.shifted(3 * i * b.output_count)
        state, B = View(State, row), body.basis
        for k in loop(b.state_size):
            row[k] = 0.0
        z, own = b.internals.shifted(i * b.output_count * b.internal), internal_of(b, i)
        for k in loop(b.internal):
            own[k] = z[k]
        state.p, W = entered(body, q, w)
        W = unit * W
        largest = larger(abs(W[0]), larger(abs(W[1]), abs(W[2])))
        is_noise = is_constrained & (body.k[2] == 0.0) & ((b.director == 0) | (abs(W[2]) <= ROUND_OFF * largest))
        W = Vector(W[0], W[1], select(is_noise, 0.0, W[2]))
        v = Variables(s=W)
        for _ in when(b.director == 0):
            v.s = body.read().momentum_of(W)
        state.s = v.s
        for _ in when(has_normal & (b.normals.address != 0)):
            normal = b.normals.shifted(6 * i * b.output_count)
            N = turned_into(B.T, Symmetric(*(normal[k] for k in range(6))))
            put(row, tuple(select(abs(unit * x) > ROUND_OFF * largest, unit * x, 0.0) for x in N), AUXILIARY)


OF_OBSERVED = fields(Work)["observed"].offset
LEAST, MOST, INTEGRAL = (OF_OBSERVED + fields(Observed)[name].offset for name in ("least", "most", "integral"))


@part
def observe(x: View, has_normal: bool) -> None:
    """Set the quantities at the node whose state the workspace holds."""
    observe_at(x, has_normal, attitude(x.state.p))


def observe_at(x: View, has_normal: bool, R: Matrix) -> None:
    """Set the quantities at the attitude R and the velocity in the workspace.

    With ``V_i = W × e_i + N_i`` it is K = ½ Σ E_ij V_i·V_j and Π = Σ e_i × Σ_j E_ij V_j.
    """
    body, W = x.body, x.velocity
    (e0, e1, e2), (b0, b1) = body.E, body.off
    Pi = Vector((e1 + e2) * W[0] + b0 * W[2], (e2 + e0) * W[1] + b1 * W[2], b0 * W[0] + b1 * W[1] + (e0 + e1) * W[2])
    K = 0.5 * (W @ Pi)
    if has_normal:
        N = Symmetric(*x.state.auxiliary[:6]).matrix
        EN = body.read().euler_inertia @ N
        z = first_moment(EN)
        K = K + 0.5 * (EN[0] @ N[0] + EN[1] @ N[1] + EN[2] @ N[2]) + W @ z
        Pi = Pi + z
    f, q, pi = body.dead, R.T, R @ Pi
    V = -(f[0] @ q[0] + f[1] @ q[1] + f[2] @ q[2])
    ends = body.axis @ W, body.vertical @ pi, x.now[NODAL]
    x.now = (K, V, K + V - x.observed.work, *pi, *(body.basis @ Pi), *ends)


@part
def add_to_integrals(x: View, h: Any) -> None:
    """Add h times the quantities at the node to their integrals."""
    for i in loop(NODAL):
        x.set_number(i + INTEGRAL, x.number(i + INTEGRAL) + h * x.number(i + NOW))


@part
def extend(x: View, h: Any) -> None:
    """Take the quantities of a whole step into the least and the greatest, and the reaction into its integral."""
    for i in loop(QUANTITIES):
        now = x.number(i + NOW)
        x.set_number(i + LEAST, smaller(now, x.number(i + LEAST)))
        x.set_number(i + MOST, larger(now, x.number(i + MOST)))
    x.set_number(INTEGRAL + NODAL, x.number(INTEGRAL + NODAL) + h * x.number(NOW + NODAL))
    x.set_number(NOW + NODAL, 0.0 * h)


@part
def begin_observing(x: View) -> None:
    """Begin all least, greatest and integrals at the first node."""
    now, nan, infinite = x.now[:NODAL], float("nan"), float("inf")
    x.observed.first, x.observed.least, x.observed.most = (*now, nan), (*now, infinite), (*now, -infinite)
    x.observed.integral = (0.0,) * QUANTITIES


ITERATIONS, WORKED = fields(Sums)["iterations"].offset, fields(Sums)["work"].offset


class Call(NamedTuple):
    """A call of a kernel within a list: what differs in the block, and what it is for."""

    first: int
    steps: int
    done: int
    unloaded_from: int
    loaded_from: int
    step: int
    times: int
    moving: int
    space: int
    forces: int
    rotor: int
    spin: int
    output_row: int  # where the state is written, behind which the march is put back to where it was; 0: it marches
    begins: int  # 1: a segment begins with it


CALL = offsets_of(Call)
IN_BLOCK = Call._fields[: Call._fields.index("output_row")]


def begin_call(b: View, number: Any, first: Any, last: Any) -> View:
    """Return a call of the list, with the block made ready for it, and for the members `first` to `last` of its order.

    Where a segment begins nothing is known of the step before: what first guesses are made of is cleared.
    """
    row = View(Call, b.rows.shifted(size_of(Call) * number))
    for name in IN_BLOCK:
        setattr(b, name, getattr(row, name))
    for _ in when(row.begins != 0):
        for l in loop(first, last):
            state = b.states.shifted(b.order[l] * b.state_size)
            for k in loop(b.guesses, b.state_size - 2 * b.internal):
                state[k] = 0.0
    return row


@kernel("i8")
def carry_out(address: Any) -> None:
    """Carry out the list of calls of a block for the members `begin` to `end` of its order."""
    b = View(Block, doubles(address))
    for number in loop(b.calls):
        begin_call(b, number, b.begin, b.end)
        call(b.kernel, address)


@lru_cache
def carry_out_outputs(parts: Parts) -> Kernel:
    """Return the kernel that carries out a list with outputs."""

    def some_at_a_time(address: Any) -> None:
        b = View(Block, doubles(address))
        begin, end = b.begin, b.end
        for first in loop(begin, end, parts.lanes):
            b.begin, b.end = first, smaller(first + parts.lanes, end)
            for_some(parts, b, lambda is_output: call(select(is_output, b.side, b.kernel), address))
        b.begin, b.end = begin, end

    return Kernel(some_at_a_time, "i8")


def for_some(parts: Parts, b: View, march: Callable[[Any], None]) -> None:
    """Carry out the list for some members, as many as are marched at once: to an output, or onwards."""
    x = View(Work, doubles(b.workspace), parts.lanes)
    first, last, size, v = b.begin, b.end, b.state_size, Variables(are_alive=True)
    for number in loop(b.calls, whilst=lambda: v.are_alive):
        row, rate = begin_call(b, number, first, last), b.rates[number]
        is_output = row.output_row != 0
        for l in loop(last - first):
            copy(b.states.shifted(b.order[first + l] * size), b.scratch.shifted(l * size), size)
        march(is_output)
        for _ in when(is_output):
            for l in loop(last - first):
                copy(b.scratch.shifted(l * size), b.states.shifted(b.order[first + l] * size), size)
        v.are_alive = False
        for l in loop(last - first):
            if parts.reports:
                take_sums(b, x.lane(l), b.order[first + l], is_output, rate)
            v.are_alive = v.are_alive | (b.failures[size_of(MemberFailure) * b.order[first + l]] == OK)
        for _ in when(is_output):
            write(parts, b, x, row.output_row, first, last)


def take_sums(b: View, lane: View, i: Any, is_output: Any, rate: Any) -> None:
    """Take the sums of a call out of those of a member; at an output, put those of its interval to the workspace."""
    sums, T = (array.shifted(i * size_of(Sums)) for array in (b.sums, b.totals))
    for k in loop(size_of(Sums)):
        S, is_count = sums[k], k == ITERATIONS
        total, sums[k] = select(is_count, larger(T[k], S), T[k] + S), 0.0
        T[k] = select(is_output, select(is_count, 0.0 * rate, -S), total)
        for _ in when(is_output):
            lane.sums.set_number(k, total * select(k >= WORKED, 1.0, rate))


class PreparedCall(NamedTuple):
    """What a prepared march is called with, and what comes back."""

    block: int  # address; its quaternions are the first of all results
    numbers: int  # how many results
    enter: int  # address of what enters a start, and of what carries out the list of the block
    run: int
    p: Quaternion  # the start
    W: Vector
    factor: float  # of the load
    squares: float
    fastest: float


PREPARED = offsets_of(PreparedCall)


@kernel("i8")
def run_prepared(address: Any) -> None:
    """March from the start that is given."""
    own = View(PreparedCall, doubles(address))
    b = View(Block, doubles(own.block))
    results, velocities, numbers = b.quaternions, b.velocities, own.numbers
    for k in loop(numbers):
        results[k] = 0.0
    put(results, own.p)
    put(velocities, own.W)
    call(own.enter, own.block)
    call(own.run, own.block)
    v = Variables(squares=0.0 * results[0], fastest=0.0 * results[0])
    for k in loop(numbers):
        v.squares = v.squares + results[k] * results[k]
    for k in loop(b.output_count):
        w = vector_at(velocities, 3 * k)
        v.fastest = larger(w @ w, v.fastest)
    own.squares = select(b.failures[0] == 0.0, v.squares, float("inf"))
    own.fastest = v.fastest

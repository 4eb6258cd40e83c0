"""The steps of a march as a list of calls of its kernel, and states between nodes: substeps from the last node.

A march is a list of calls, made beforehand (`integrators.listing`), which is carried out here: steps of equal length,
in order; and where there are outputs that need not be nodes, substeps to them.

A run goes from node to node of its grid, whatever output is asked for. A state at t between the nodes t_n and t_{n+1}
is that of one more step of the scheme, from the state at t_n over t - t_n, which is then left aside. So it depends on
t and the run alone, not on the other outputs; it has the order of the scheme, as its own error is that of one step;
whatever the scheme keeps at any length of a step is kept there too; and it crosses no kink of the load that is a node.

Means over an interval between outputs follow from integrals over time, which are exact as well: with T the integral
from the last output o to the node t_n, S that over the step, E(o) that over the substep to the output o,

    from o to o' in the same step: E(o') - E(o);    from o to the node t_{n+1}: S - E(o);    onwards: T + E(o').

So T becomes -E(o) once o is written, and T + S at the next node. An impulse or a work of the load that balances over
each step balances between any two outputs.

A list with outputs is carried out for a few members at a time.

The substeps of a Gauss step are guessed from its own stages, which are known by then: let q be the polynomial through
their derivatives, and those of the step before, if there is one on the same grid. The stages of a substep of the length
θ h have the increments ``θ h b_k q(θ c_k)``. As the kernel extrapolates what it is given by one step, it is given

    L_j = θ h b_j Σ_k l_k(c_j - 1) q(θ c_k),

which it takes there. `within` holds c and b, the numbers l_k(c_j - 1) column by column, each padded to eight, and the
matrices that make the coefficients of q, lowest first, of s increments and of 2s.

A prepared march is one call, of what a caller waits for beside the steps. The start lies behind the head, and so does
what comes back: the sum of the squares of all results, which tells whether numbers are finite and small enough,
infinite where the run has failed; and the largest |W|² of the stored states.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

from ..kernels.control import Variables, loop, when
from ..kernels.elements import larger, select, smaller
from ..kernels.kernel import Kernel, kernel, part
from ..kernels.memory import Doubles, View, call, doubles, fields, put, size_of, vector_at
from ..kernels.vectors import Quaternion, Vector
from .records import Block, Failure, Parts, State, Sums, Work, places
from .workspace import OK, copy, write

MARCH, EXCURSION, OUTPUT, NODE = range(4)
COMPONENTS, EIGHT = 6, 8  # of the increments that a member carries; stages that there is room for
ITERATIONS, WORKED = fields(Sums)["iterations"].place, fields(Sums)["work"].place


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
    op: int
    place: int  # where its state is written
    begins: int  # 1: a stretch begins with it


class Calls(NamedTuple):
    """A list of calls."""

    kernel: int  # addresses of what marches and of what marches to an output, unobserved
    side: int
    calls: int  # how many
    rows: int  # (count,) of `Call`
    reals: Doubles  # (count, 2): 1 over the length of the interval that ends there, the part of the step
    scratch: Doubles  # of `Member`
    stride: int  # numbers of it
    stages: int  # of a Gauss step
    within: Doubles  # the polynomials through them
    guesses: int  # where the numbers that first guesses are made of begin


CALL, CALLS = places(Call), places(Calls)
IN_BLOCK = Call._fields[: Call._fields.index("op")]


def joined(a: Any, b: Any, k: Any) -> Any:
    """Return the sum of two integrals; of iterations the larger number."""
    return select(k == ITERATIONS, larger(a, b), a + b)


class Member(NamedTuple):
    """What a member carries, its sums since the last output, and scratch."""

    state: Any
    total: Any
    base: Any  # its state at the beginning of an excursion, at its end; sums of it, and of another call
    after: Any
    excursion: Any
    own: Any
    fits: Any  # polynomials

    def back_from_excursion(self, size: Any) -> None:
        """Put the member back to the end of the excursion, and add what it gave to the sums."""
        copy(self.after, self.state, size)
        for k in loop(size_of(Sums)):
            self.total[k] = joined(self.total[k], self.excursion[k], k)


def member_of(b: View, head: View, l: Any) -> Member:
    """Return number l of those that are marched at a time."""
    i, size, sums, scratch = b.order[b.begin + l], b.state_size, size_of(Sums), head.scratch.shifted(l * head.stride)
    ends = scratch.shifted(2 * size)
    rest = ends, ends.shifted(sums), ends.shifted(2 * sums)
    return Member(b.states.shifted(i * size), b.totals.shifted(i * sums), scratch, scratch.shifted(size), *rest)


@part
def fitted(before: Any, after: Any, within: Any, s: Any, is_known: Any, into: Any) -> None:
    """Put the coefficients of the polynomials through the derivatives of a step to `into`, from its increments `after`.

    Where those of the step before are known, they are fitted as well.
    """
    v = Variables(count=s, matrix=2 * EIGHT + EIGHT * s)
    for _ in when(is_known):
        v.count, v.matrix = 2 * s, v.matrix + s * s
    count, matrix = v.count, within.shifted(v.matrix)
    for c in loop(COMPONENTS):
        for k in loop(count):
            x = Variables(sum=0.0 * after[0])
            for j in loop(s):
                x.sum = x.sum + matrix[(j + count - s) * count + k] * after[c * s + j]
                for _ in when(is_known):
                    x.sum = x.sum + matrix[j * count + k] * before[c * s + j]
            into[c * count + k] = x.sum


@part
def guessed(increments: Any, within: Any, s: Any, theta: Any, is_known: Any, polynomials: Any) -> None:
    """Set the increments of the last step so that those of a substep follow; behind the polynomials there is room."""
    v = Variables(count=s)
    for _ in when(is_known):
        v.count = 2 * s
    count, scratch = v.count, 2 * COMPONENTS * s
    for c in loop(COMPONENTS):
        for i in loop(s):
            x = Variables(value=0.0 * theta)
            for k in loop(count):
                x.value = x.value * (theta * within[i]) + polynomials[c * count + (count - 1 - k)]
            polynomials[scratch + i] = x.value
        for i in loop(s):
            x = Variables(value=0.0 * theta)
            for k in loop(s):
                x.value = x.value + within[(2 + k) * EIGHT + i] * polynomials[scratch + k]
            increments[c * s + i] = (theta * within[EIGHT + i]) * x.value


def taken(b: View, head: View, number: Any) -> View:
    """Return a call of the list, with the block made ready for it."""
    row = View(Call, doubles(head.rows + 8 * size_of(Call) * number))
    for name in IN_BLOCK:
        setattr(b, name, getattr(row, name))
    return row


def forget(b: View, head: View, first: Any, last: Any) -> None:
    """Clear what first guesses of members are made of: where a stretch begins nothing is known of the step before."""
    for l in loop(first, last):
        state = b.states.shifted(b.order[l] * b.state_size)
        for k in loop(head.guesses, b.state_size - 2 * b.internal):
            state[k] = 0.0


@kernel("i8")
def carry_out(address: Any) -> None:
    """Carry out the list of calls of a block for the members `begin` to `end` of its order."""
    b = View(Block, doubles(address))
    head = View(Calls, b.calls)
    for number in loop(head.calls):
        row = taken(b, head, number)
        for _ in when(row.begins != 0):
            forget(b, head, b.begin, b.end)
        call(head.kernel, address)


def carry_out_outputs(parts: Parts) -> Kernel:
    """Return the kernel that carries out a list with outputs."""
    names = "lanes", "is_director_scheme", "is_constrained", "dead", "generalised", "reports", "turns", "memory"
    return _with_outputs(Parts(**{name: getattr(parts, name) for name in names}))


@lru_cache
def _with_outputs(parts: Parts) -> Kernel:
    def some_at_a_time(address: Any) -> None:
        b = View(Block, doubles(address))
        head = View(Calls, b.calls)
        begin, end = b.begin, b.end
        for first in loop(begin, end, parts.lanes):
            b.begin, b.end = first, smaller(first + parts.lanes, end)
            for_some(parts, address, b, head)
        b.begin, b.end = begin, end

    return Kernel(some_at_a_time, "i8")


def for_some(parts: Parts, address: Any, b: View, head: View) -> None:
    """Carry out the list for some members, as many as the kernel takes at once."""
    x, observed, s, within = View(Work, doubles(b.workspace), parts.lanes), b.observed, head.stages, head.within
    first, last, size, after_state = b.begin, b.end, b.state_size, size_of(State)
    v = Variables(is_inside=False, is_known=False, are_alive=True)

    def back_from_excursion() -> None:
        v.is_inside = False
        for l in loop(last - first):
            member_of(b, head, l).back_from_excursion(size)

    for number in loop(head.calls, whilst=lambda: v.are_alive):
        row, reals = taken(b, head, number), head.reals.shifted(2 * number)
        op = row.op
        b.observed = observed
        for _ in when(v.is_inside & (op != OUTPUT)):
            back_from_excursion()
        for _ in when(op >= OUTPUT):
            b.observed = 0
        for _ in when((op != OUTPUT) & (row.begins != 0)):
            forget(b, head, first, last)
        for l in loop(last - first):
            own = member_of(b, head, l)
            for _ in when(op == EXCURSION):
                copy(own.state, own.base, size)
            for _ in when(op == OUTPUT):
                copy(own.base, own.state, size)
                for _ in when(s > 0):
                    guessed(own.state.shifted(after_state), within, s, reals[1], v.is_known, own.fits)
        call(select(op >= OUTPUT, head.side, head.kernel), address)
        for _ in when(op == EXCURSION):
            v.is_inside, v.is_known = True, (row.first > 0) & (row.begins == 0)
        v.are_alive = False
        for l in loop(last - first):
            own = member_of(b, head, l)
            for _ in when(op == EXCURSION):
                copy(own.state, own.after, size)
                for _ in when(s > 0):
                    before, after = own.base.shifted(after_state), own.state.shifted(after_state)
                    fitted(before, after, within, s, v.is_known, own.fits)
            if parts.reports:
                take_sums(b, x.lane(l), own, first + l, op, reals[0])
            v.are_alive = v.are_alive | (b.failures[size_of(Failure) * b.order[first + l]] == OK)
        for _ in when(op >= OUTPUT):
            write(parts, b, x, row.place, first, last)
    for _ in when(v.is_inside):
        back_from_excursion()
    b.observed = observed


def take_sums(b: View, lane: View, own: Member, place: Any, op: Any, per_time: Any) -> None:
    """Take the sums of a call out of those of the member; at an output, put those of its interval to the workspace."""
    sums, T = b.sums.shifted(b.order[place] * size_of(Sums)), own.total
    for k in loop(size_of(Sums)):
        own.own[k] = sums[k]
        sums[k] = 0.0
        for _ in when(op == EXCURSION):
            own.excursion[k] = own.own[k]
        for _ in when(op == MARCH):
            T[k] = joined(T[k], own.own[k], k)
        for _ in when(op >= OUTPUT):
            lane.sums.set_number(k, joined(T[k], own.own[k], k) * select(k >= WORKED, 1.0, per_time))
            T[k] = select(k == ITERATIONS, 0.0 * per_time, -own.own[k])


class Head(NamedTuple):
    """What a prepared march is called with."""

    block: int  # address; its quaternions are the first of all results
    numbers: int  # how many results
    enter: int  # address of what enters a start, and of what carries out the list of the block
    run: int


class Prepared(NamedTuple):
    """The start, behind the head, and what comes back."""

    p: Quaternion
    W: Vector
    factor: float  # of the load
    squares: float
    fastest: float


HEAD, PREPARED = places(Head), places(Prepared)


@kernel("i8")
def run_prepared(address: Any) -> None:
    """March from the start behind the head at the address."""
    memory = doubles(address)
    head, own = View(Head, memory), View(Prepared, memory.shifted(HEAD.size))
    b = View(Block, doubles(head.block))
    results, velocities = b.quaternions, b.velocities
    for k in loop(head.numbers):
        results[k] = 0.0
    put(results, own.p)
    put(velocities, own.W)
    call(head.enter, head.block)
    call(head.run, head.block)
    v = Variables(squares=0.0 * results[0], fastest=0.0 * results[0])
    for k in loop(head.numbers):
        v.squares = v.squares + results[k] * results[k]
    for k in loop(b.kept):
        w = vector_at(velocities, 3 * k)
        v.fastest = larger(w @ w, v.fastest)
    own.squares = select(b.failures[0] == 0.0, v.squares, float("inf"))
    own.fastest = v.fastest

"""The steps of a march as a list of calls of its kernel, and states between nodes: substeps from the last node.

A march is a list of calls, made beforehand (`integrators.stack_march`), which is carried out here: steps of equal
length, in order; and where there are outputs that need not be nodes, substeps to them.

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

A prepared march is one call, of what a caller waits for beside the steps. The start lies behind the head, and so does
what comes back: the sum of the squares of all results, which tells whether numbers are finite and small enough,
infinite where the run has failed; and the largest |W|² of the stored states.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

from ..kernels.control import Variables, loop, when
from ..kernels.elements import larger, select, smaller
from ..kernels.kernel import Kernel, kernel
from ..kernels.memory import Doubles, View, call, doubles, fields, put, size_of, vector_at
from ..kernels.vectors import Quaternion, Vector
from .records import Block, Failure, Parts, Sums, Work, offsets_of
from .workspace import OK, copy, write

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
    begins: int  # 1: a stretch begins with it


class Calls(NamedTuple):
    """A list of calls."""

    kernel: int  # addresses of what marches and of what marches to an output, unobserved
    side: int
    calls: int  # how many
    rows: int  # (count,) of `Call`
    rates: Doubles  # (count,) 1 over the length of the interval that ends there
    scratch: Doubles  # for the states of members at the beginning of a step
    guesses: int  # where the numbers that first guesses are made of begin


CALL, CALLS = offsets_of(Call), offsets_of(Calls)
IN_BLOCK = Call._fields[: Call._fields.index("output_row")]


def joined(a: Any, b: Any, k: Any) -> Any:
    """Return the sum of two integrals; of iterations the larger number."""
    return select(k == ITERATIONS, larger(a, b), a + b)


def begin_call(b: View, head: View, number: Any) -> View:
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
        row = begin_call(b, head, number)
        for _ in when(row.begins != 0):
            forget(b, head, b.begin, b.end)
        call(head.kernel, address)


def carry_out_outputs(parts: Parts) -> Kernel:
    """Return the kernel that carries out a list with outputs."""
    names = (
        "lanes",
        "is_director_scheme",
        "is_constrained",
        "dead",
        "generalised",
        "reports",
        "integrates_velocity",
        "memory",
    )
    return _output_march(Parts(**{name: getattr(parts, name) for name in names}))


@lru_cache
def _output_march(parts: Parts) -> Kernel:
    def some_at_a_time(address: Any) -> None:
        b = View(Block, doubles(address))
        head = View(Calls, b.calls)
        begin, end = b.begin, b.end
        for first in loop(begin, end, parts.lanes):
            b.begin, b.end = first, smaller(first + parts.lanes, end)
            for_some(parts, b, head, lambda is_output: call(select(is_output, head.side, head.kernel), address))
        b.begin, b.end = begin, end

    return Kernel(some_at_a_time, "i8")


def for_some(parts: Parts, b: View, head: View, march: Callable[[Any], None]) -> None:
    """Carry out the list for some members, as many as are marched at once: to an output, or onwards."""
    x = View(Work, doubles(b.workspace), parts.lanes)
    first, last, size, v = b.begin, b.end, b.state_size, Variables(are_alive=True)
    for number in loop(head.calls, whilst=lambda: v.are_alive):
        row, rate = begin_call(b, head, number), head.rates[number]
        is_output = row.output_row != 0
        for _ in when(row.begins != 0):
            forget(b, head, first, last)
        for l in loop(last - first):
            copy(b.states.shifted(b.order[first + l] * size), head.scratch.shifted(l * size), size)
        march(is_output)
        for _ in when(is_output):
            for l in loop(last - first):
                copy(head.scratch.shifted(l * size), b.states.shifted(b.order[first + l] * size), size)
        v.are_alive = False
        for l in loop(last - first):
            if parts.reports:
                take_sums(b, x.lane(l), b.order[first + l], is_output, rate)
            v.are_alive = v.are_alive | (b.failures[size_of(Failure) * b.order[first + l]] == OK)
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


HEAD, PREPARED = offsets_of(Head), offsets_of(Prepared)


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
    for k in loop(b.output_count):
        w = vector_at(velocities, 3 * k)
        v.fastest = larger(w @ w, v.fastest)
    own.squares = select(b.failures[0] == 0.0, v.squares, float("inf"))
    own.fastest = v.fastest

"""States between the nodes of a march: substeps of the same scheme from the last node.

A run goes from node to node of its grid, whatever output is asked for. A state at t between the nodes t_n and t_{n+1}
is that of one more step of the scheme, from the state at t_n over t - t_n, which is then left aside. So it depends on
t and the run alone, not on the other outputs; it has the order of the scheme, as its own error is that of one step;
whatever the scheme keeps at any length of a step is kept there too; and it crosses no kink of the load that is a node.

Means over an interval between outputs follow from integrals over time, which are exact as well: with T the integral
from the last output o to the node t_n, S that over the step, E(o) that over the substep to the output o,

    from o to o' in the same step: E(o') - E(o);    from o to the node t_{n+1}: S - E(o);    onwards: T + E(o').

So T becomes -E(o) once o is written, and T + S at the next node. An impulse or a work of the load that balances over
each step balances between any two outputs.

A march with outputs is a list of calls of its kernel, in order, made beforehand (`integrators.output_calls`), which is
carried out here for a few members at a time.

The substeps of a Gauss step are guessed from its own stages, which are known by then: let q be the polynomial through
their derivatives, and those of the step before, if there is one on the same grid. The stages of a substep of the length
θ h have the increments ``θ h b_k q(θ c_k)``. As the kernel extrapolates what it is given by one step, it is given

    L_j = θ h b_j Σ_k l_k(c_j - 1) q(θ c_k),

which it takes there. `within` holds c and b, the numbers l_k(c_j - 1) column by column, each padded to eight, and the
matrices that make the coefficients of q, lowest first, of s increments and of 2s.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

from ..kernels.control import Variables, loop, when
from ..kernels.elements import larger, select, smaller
from ..kernels.kernel import Kernel
from ..kernels.memory import Doubles, View, call, doubles, fields, size_of
from ..kernels.parts import part
from .records import Block, Failure, Parts, State, Sums, Work, places
from .workspace import OK, write

GO, LEG, OUTPUT, NODE = range(4)
COMPONENTS, EIGHT = 6, 8  # of the increments that a member carries; stages that there is room for
ITERATIONS, WORKED = fields(Sums)["iterations"].place, fields(Sums)["work"].place


class Call(NamedTuple):
    """A call of a kernel within a list: what it is for, and what differs in the block."""

    op: int
    first: int
    steps: int
    step: int
    times: int
    moving: int
    space: int
    rotor: int
    spin: int
    forces: int
    place: int  # where its state is written
    begins: int  # 1: a stretch begins with it
    coasts: int  # 1: it is a free motion, from the beginning of the leg


class Calls(NamedTuple):
    """A list of calls."""

    kernel: int  # addresses of what marches and of what marches to an output, unobserved
    side: int
    width: int  # bodies that they take at a time
    calls: int  # how many
    rows: int  # (count,) of `Call`
    reals: Doubles  # (count, 2): 1 over the length of the interval that ends there, the part of the step
    totals: Doubles  # sums since the last output
    room: Doubles
    stages: int  # of a Gauss step
    within: Doubles  # the polynomials through them
    guesses: int  # where the numbers that first guesses are made of begin


CALL, CALLS = places(Call), places(Calls)


def copy(source: Any, target: Any, count: Any) -> None:
    """Copy so many numbers."""
    for k in loop(count):
        target[k] = source[k]


def joined(a: Any, b: Any, k: Any) -> Any:
    """Return the sum of two integrals; of iterations the larger number."""
    return select(k == ITERATIONS, larger(a, b), a + b)


class March(NamedTuple):
    """The members that are marched at a time, and memory."""

    order: Any
    first: Any
    members: Any
    states: Any
    size: Any
    totals: Any
    base: Any  # states at the beginning of a leg, at its end; sums of the leg, and of another call
    after: Any
    leg: Any
    own: Any
    fits: Any  # polynomials

    def state(self, l: Any) -> Any:
        """Return the state of a member."""
        return self.states.shifted(self.order[self.first + l] * self.size)

    def total(self, l: Any) -> Any:
        """Return the sums of a member since its last output."""
        return self.totals.shifted(self.order[self.first + l] * size_of(Sums))

    def back_from_leg(self) -> None:
        """Put the members back to the end of the leg, and add what it gave to their sums."""
        for l in loop(self.members):
            copy(self.after.shifted(l * self.size), self.state(l), self.size)
            self.add(l, self.leg)

    def add(self, l: Any, sums: Any) -> None:
        """Add sums of a call to those since the last output."""
        T = self.total(l)
        for k in loop(size_of(Sums)):
            T[k] = joined(T[k], sums[l * size_of(Sums) + k], k)


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
    count, room = v.count, 2 * COMPONENTS * s
    for c in loop(COMPONENTS):
        for i in loop(s):
            x = Variables(value=0.0 * theta)
            for k in loop(count):
                x.value = x.value * (theta * within[i]) + polynomials[c * count + (count - 1 - k)]
            polynomials[room + i] = x.value
        for i in loop(s):
            x = Variables(value=0.0 * theta)
            for k in loop(s):
                x.value = x.value + within[(2 + k) * EIGHT + i] * polynomials[room + k]
            increments[c * s + i] = (theta * within[EIGHT + i]) * x.value


@lru_cache
def carry_out(parts: Parts) -> Kernel:
    """Return the kernel that carries out the list of calls of a block for the members `begin` to `end` of its order."""
    names = "lanes", "is_director_scheme", "is_held", "dead", "generalised", "reports"
    return _carry_out(Parts(**{name: getattr(parts, name) for name in names}))


@lru_cache
def _carry_out(parts: Parts) -> Kernel:
    def kernel(address: Any) -> None:
        b = View(Block, doubles(address))
        head = View(Calls, b.calls)
        begin, end = b.begin, b.end
        for first in loop(begin, end, parts.lanes):
            b.begin, b.end = first, smaller(first + parts.lanes, end)
            for_some(parts, address, b, head, first, b.end)
        b.begin, b.end = begin, end

    return Kernel(kernel, "i8")


def for_some(parts: Parts, address: Any, b: View, head: View, first: Any, last: Any) -> None:
    """Carry out the list for some members, as many as the kernel takes at once."""
    x, observed, s, within = View(Work, doubles(b.workspace), parts.lanes), b.observed, head.stages, head.within
    size, base, n, sums = b.state_size, head.room, parts.lanes, size_of(Sums)
    after = base.shifted(n * size)
    leg = after.shifted(n * size)
    own, fits = leg.shifted(n * sums), leg.shifted(2 * n * sums)
    m = March(b.order, first, last - first, b.states, size, head.totals, base, after, leg, own, fits)
    fit, v = 2 * COMPONENTS * s + EIGHT, Variables(is_inside=False, is_known=False, are_alive=True)
    for number in loop(head.calls, whilst=lambda: v.are_alive):
        row, reals = View(Call, doubles(head.rows + 8 * size_of(Call) * number)), head.reals.shifted(2 * number)
        op = row.op
        for _ in when(v.is_inside & (op != OUTPUT)):
            v.is_inside = False
            m.back_from_leg()
        for name in ("first", "steps", "step", "times", "moving", "space", "rotor", "spin", "forces"):
            setattr(b, name, getattr(row, name))
        b.resumed, b.observed = row.first + row.steps, observed
        b.ceased = select(row.coasts != 0, row.first, row.first + row.steps)
        for _ in when(op >= OUTPUT):
            b.observed = 0
        for _ in when(op == OUTPUT):
            for l in loop(m.members):
                copy(base.shifted(l * size), m.state(l), size)
                for _ in when(s > 0):
                    polynomials = fits.shifted(l * fit)
                    guessed(m.state(l).shifted(size_of(State)), within, s, reals[1], v.is_known, polynomials)
        for _ in when((op != OUTPUT) & (row.begins != 0)):  # a stretch: nothing is known of the step before
            for l in loop(m.members):
                for k in loop(head.guesses, size):
                    m.state(l)[k] = 0.0
        for _ in when(op == LEG):
            for l in loop(m.members):
                copy(m.state(l), base.shifted(l * size), size)
        call(select(op >= OUTPUT, head.side, head.kernel), address)
        for _ in when(op == LEG):
            v.is_inside, v.is_known = True, (row.first > 0) & (row.begins == 0)
            for l in loop(m.members):
                copy(m.state(l), after.shifted(l * size), size)
                for _ in when(s > 0):
                    before, increments = base.shifted(l * size + size_of(State)), m.state(l).shifted(size_of(State))
                    fitted(before, increments, within, s, v.is_known, fits.shifted(l * fit))
        if parts.reports:
            for l in loop(m.members):
                take_sums(b, x.lane(l), m, l, op, reals[0])
        for _ in when(op >= OUTPUT):
            write(parts, b, x, row.place, first, last)
        v.are_alive = False
        for l in loop(m.members):
            v.are_alive = v.are_alive | (b.failures[size_of(Failure) * m.order[first + l]] == OK)
    for _ in when(v.is_inside):
        m.back_from_leg()
    b.observed = observed


def take_sums(b: View, lane: View, m: March, l: Any, op: Any, per_time: Any) -> None:
    """Take the sums of a call out of those of the member; at an output, put those of its interval to the workspace."""
    given, T = b.sums.shifted(m.order[m.first + l] * size_of(Sums)), m.total(l)
    of_leg, of_call = m.leg.shifted(l * size_of(Sums)), m.own.shifted(l * size_of(Sums))
    for k in loop(size_of(Sums)):
        of_call[k] = given[k]
        given[k] = 0.0
        for _ in when(op == LEG):
            of_leg[k] = of_call[k]
        for _ in when(op == GO):
            T[k] = joined(T[k], of_call[k], k)
        for _ in when(op >= OUTPUT):
            lane.sums.set_number(k, joined(T[k], of_call[k], k) * select(k >= WORKED, 1.0, per_time))
            T[k] = select(k == ITERATIONS, 0.0 * per_time, -of_call[k])

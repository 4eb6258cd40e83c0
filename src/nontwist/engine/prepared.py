"""A prepared march in one call: what a caller waits for beside the steps.

The start lies behind the head, and so does what comes back: the sum of the squares of all results, which tells whether
numbers are finite and small enough, infinite where the run has failed; and the largest |W|² of the stored states.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from ..kernels.control import Variables, loop
from ..kernels.elements import larger, select
from ..kernels.kernel import kernel
from ..kernels.memory import View, call, doubles, put, vector_at
from ..kernels.vectors import Quaternion, Vector
from .records import Block, places


class Head(NamedTuple):
    """What a prepared march is called with."""

    block: int  # address; its quaternions are the first of all results
    numbers: int  # how many results
    enter: int  # address of what enters a start, and of what carries out the list of the block
    run: int


class Given(NamedTuple):
    """The start, behind the head, and what comes back."""

    p: Quaternion
    W: Vector
    factor: float  # of the load
    squares: float
    fastest: float


HEAD, GIVEN = places(Head), places(Given)
INFINITE = float("inf")


@kernel("i8")
def run_prepared(address: Any) -> None:
    """March from the start behind the head at the address."""
    memory = doubles(address)
    head, given = View(Head, memory), View(Given, memory.shifted(HEAD.size))
    b = View(Block, doubles(head.block))
    results, velocities = b.quaternions, b.velocities
    for k in loop(head.numbers):
        results[k] = 0.0
    put(results, given.p)
    put(velocities, given.W)
    call(head.enter, head.block)
    call(head.run, head.block)
    v = Variables(squares=0.0 * results[0], fastest=0.0 * results[0])
    for k in loop(head.numbers):
        v.squares = v.squares + results[k] * results[k]
    for k in loop(b.kept):
        w = vector_at(velocities, 3 * k)
        v.fastest = larger(w @ w, v.fastest)
    given.squares = select(b.failures[0] == 0.0, v.squares, INFINITE)
    given.fastest = v.fastest

"""A prepared march in one call: what a caller waits for beside the steps.

The start lies behind the head, and so does what comes back: the sum of the squares of all results, which tells whether
numbers are finite and small enough, infinite where the run has failed or a quaternion is not of unit length; and the
largest |W|² of the stored states.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from ..kernels.control import Variables, loop
from ..kernels.elements import larger, select
from ..kernels.kernel import kernel
from ..kernels.memory import Doubles, View, call, doubles, vector_at
from ..kernels.vectors import Quaternion, Vector
from .records import places


class Head(NamedTuple):
    """What a prepared march is called with: addresses, counts, and places of numbers among the results."""

    results: Doubles
    numbers: int  # how many results
    states: int  # how many quaternions there are, from the first number on
    factor: Doubles  # of the load
    blocks: int  # one for each stretch
    stride: int  # bytes between blocks
    pieces: int  # how many blocks
    enter: int  # address of what enters a start, and of what runs a block
    run: int
    velocities: int
    failure: int
    guesses: int  # which are cleared where a stretch begins
    guesses_end: int


class Given(NamedTuple):
    """The start, behind the head, and what comes back."""

    p: Quaternion
    W: Vector
    factor: float
    squares: float
    fastest: float


HEAD, GIVEN = places(Head), places(Given)
LENGTH = 1e-3  # how far |q|² may be from 1
INFINITE = float("inf")


@kernel("i8")
def run_prepared(address: Any) -> None:
    """March from the start behind the head at the address."""
    memory = doubles(address)
    head, given, x = View(Head, memory), View(Given, memory.shifted(HEAD.size)), View(Head, memory).results
    count, velocities, p, W = head.numbers, head.velocities, given.p, given.W
    for k in loop(count):
        x[k] = 0.0
    for k in range(4):
        x[k] = p[k]
    for k in range(3):
        x[velocities + k] = W[k]
    head.factor[0] = given.factor
    call(head.enter, head.blocks)
    for piece in loop(head.pieces):
        for k in loop(head.guesses, select(piece > 0, head.guesses_end, head.guesses)):
            x[k] = 0.0
        call(head.run, head.blocks + piece * head.stride)
    v = Variables(squares=0.0 * x[0], fastest=0.0 * x[0], is_fine=x[head.failure] == 0.0)
    for k in loop(count):
        v.squares = v.squares + x[k] * x[k]
    for k in loop(head.states):
        w, q = vector_at(x, velocities + 3 * k), x.shifted(4 * k)
        v.fastest = larger(w @ w, v.fastest)
        square = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]
        v.is_fine = v.is_fine & (abs(square - 1.0) < LENGTH)
    given.squares = select(v.is_fine, v.squares, INFINITE)
    given.fastest = v.fastest

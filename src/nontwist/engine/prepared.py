"""A prepared march in one call: what a caller waits for beside the steps.

The start lies behind the head, and so does what comes back: the sum of the squares of all results, which tells whether
numbers are finite and small enough, infinite where the run has failed or a quaternion is not of unit length; and the
largest |W|² of the stored states.
"""

from ..geometry.compiled import kernel
from ..geometry.elements import call_kernel, doubles, eight, integers, load, splat, store
from .layout import layout

# Addresses of the results, of the factor of the load, of the blocks, one for each stretch, of `enter` and of what runs
# a block; places of numbers among the results.
HEAD = layout(
    "Head",
    results=1,
    count=1,
    states=1,  # how many quaternions there are, from the first number on
    factor=1,
    blocks=1,
    stride=1,  # bytes between blocks
    pieces=1,  # how many blocks
    enter=1,
    run=1,
    velocities=1,
    failure=1,
    guesses=1,  # which are cleared where a stretch begins
    guesses_end=1,
)
GIVEN = layout("Given", p=4, W=3, factor=1, squares=1, fastest=1, room=8)
LENGTH = 1e-3  # how far |q|² may be from 1
INFINITE = float("inf")


@kernel
def run_prepared(address):
    """March from the start behind the head at the address."""
    head, given = integers(address), doubles(address + 8 * HEAD.size)
    x, factor = doubles(head[HEAD.results]), doubles(head[HEAD.factor])
    count, block, velocities = head[HEAD.count], head[HEAD.blocks], head[HEAD.velocities]
    for k in range(count):
        x[k] = 0.0
    for k in range(4):
        x[k] = given[k]
    for k in range(3):
        x[velocities + k] = given[GIVEN.W + k]
    factor[0] = given[GIVEN.factor]
    call_kernel(head[HEAD.enter], block)
    for piece in range(head[HEAD.pieces]):
        for k in range(head[HEAD.guesses] if piece > 0 else 0, head[HEAD.guesses_end] if piece > 0 else 0):
            x[k] = 0.0
        call_kernel(head[HEAD.run], block + piece * head[HEAD.stride])
    wide, squares, rest = splat(0.0, eight()), 0.0, count - count % 8
    for k in range(0, rest, 8):
        some = load(x, k, eight())
        wide = wide + some * some
    store(given, GIVEN.room, wide)
    for k in range(8):
        squares += given[GIVEN.room + k]
    for k in range(rest, count):
        squares += x[k] * x[k]
    fine = x[head[HEAD.failure]] == 0.0
    fastest = 0.0
    for k in range(velocities, velocities + 3 * head[HEAD.states], 3):
        fastest = max(fastest, x[k] * x[k] + x[k + 1] * x[k + 1] + x[k + 2] * x[k + 2])
    for k in range(0, 4 * head[HEAD.states], 4):
        fine = (
            fine and abs(x[k] * x[k] + x[k + 1] * x[k + 1] + x[k + 2] * x[k + 2] + x[k + 3] * x[k + 3] - 1.0) < LENGTH
        )
    given[GIVEN.squares] = squares if fine else INFINITE
    given[GIVEN.fastest] = fastest

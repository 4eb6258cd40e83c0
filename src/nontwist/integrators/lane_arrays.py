"""16 bodies in one flat array: where its numbers lie, and how they are read and written.

Why it is quick. All numbers of 16 bodies lie in one flat array `x`, each in a row of 16, at places that are constants
of the compiler, and loops over the lanes have no branch but selections. So LLVM sees that no two rows overlap and works
on 4 (AVX2) or 8 (AVX-512) lanes with one instruction. Three things had to be avoided: indices with a sign (`get`), a
number of turns that the compiler knows (`lanes`), and storing a number where it has just been read (`widen` in
`lane_watch`). Without `fastmath` nothing is reordered or fused: a lane holds the same bits, whatever its neighbours and
its number, and so does a member for any number of threads and any size of a block.
"""

import numpy as np

from ..geometry.compiled import inlined, kernel
from .midpoint_kernel import times

LANES = 16
STEADY, MOVED, PUSHED, HEAVY = 0, 1, 2, 3  # y = 0; J31 = J32 = 0 and no load but M; no dead forces; anything
QUANTITIES = 12  # K, V, K + V - A, π (3), Π (3), ψ', e·π at nodes; -μ over steps
NODAL = QUANTITIES - 1


def places(*sizes: int) -> list[np.int64]:
    """Return where rows of 16 begin when so many follow one another, and where they end.

    As NumPy integers: of Python's, Numba would compile every function once for each value.
    """
    return [np.int64(LANES * sum(sizes[:k])) for k in range(len(sizes) + 1)]


# A member's state, in b: quaternion (scalar first), W, its compensation, and for lie-midpoint the rate y/h of the last
# step, for the director scheme N (11, 22, 33, 23, 13, 12). Its body: c, (J31, J32), k, (J1, J2, J3), b as columns in
# body components and as a quaternion, dead forces, damping, n and e.
STATE, DIRECTOR_STATE, BODY = 13, 16, 48
P, W, CARRY, RATE, C, OFF, K, J, BASIS, FRAME, DEAD, DAMPING, AXIS, VERTICAL, SCALE, GONE, *_REST = places(
    4, 3, 3, 6, 3, 2, 3, 3, 9, 4, 9, 9, 3, 3, 1, 1, 3, 3, 9, 3, 1, 1, 1, *(6 * (QUANTITIES,)), 1, 1
)
MOVING, SPACE, FORCES, Y, INCREMENT, OPEN, BAD, NOW, FIRST, LEAST, MOST, INTEGRAL, SPARE, PULL, WORK, ROWS = _REST
NORMAL = RATE
# What is written down of the quantities: at first, least, greatest, integral; the work.
SUMS = 4 * QUANTITIES + 1


@inlined
def lanes(x):
    """Return 16, as what the compiler cannot know: else it unrolls a loop over the lanes instead of vectorising it."""
    return LANES * (x.shape[0] // ROWS)


@inlined
def get(x, place, l):
    """Return a number; its index is unsigned, or Numba would look for negative ones, and no loop become vectors."""
    return x[np.uintp(place + l)]


@inlined
def put(x, place, l, a):
    """Write a number."""
    x[np.uintp(place + l)] = a


@inlined
def vector(x, place, l):
    """Read three rows."""
    return (get(x, place, l), get(x, place + LANES, l), get(x, place + 2 * LANES, l))


@inlined
def put_vector(x, place, l, a):
    """Write three rows."""
    put(x, place, l, a[0])
    put(x, place + LANES, l, a[1])
    put(x, place + 2 * LANES, l, a[2])


@inlined
def quaternion_at(x, place, l):
    """Read four rows, scalar first."""
    return (get(x, place, l), get(x, place + LANES, l), get(x, place + 2 * LANES, l), get(x, place + 3 * LANES, l))


@inlined
def matrix_at(x, place, l):
    """Read nine rows as the rows of a matrix."""
    return (vector(x, place, l), vector(x, place + 3 * LANES, l), vector(x, place + 6 * LANES, l))


@inlined
def body_at(x, l):
    """Return c, (J31, J32) and k."""
    return vector(x, C, l), (get(x, OFF, l), get(x, OFF + LANES, l)), vector(x, K, l)


@inlined
def more_at(x, l):
    """Return damping and moment in space."""
    return matrix_at(x, DAMPING, l), vector(x, SPACE, l)


@kernel
def any_of(x, place):
    """Whether a lane that still runs has a mark there."""
    found = False
    for l in range(lanes(x)):
        found = found or (get(x, place, l) != 0.0 and get(x, GONE, l) == 0.0)
    return found


@inlined
def normal_at(x, l):
    """Return N as rows."""
    n00, n11, n22 = vector(x, NORMAL, l)
    n12, n02, n01 = vector(x, NORMAL + 3 * LANES, l)
    return ((n00, n01, n02), (n01, n11, n12), (n02, n12, n22))


@inlined
def euler_at(x, l):
    """Return E as rows, and its trace."""
    (j0, j1, j2), e02, e12 = vector(x, J, l), -get(x, OFF, l), -get(x, OFF + LANES, l)
    t = 0.5 * (j0 + j1 + j2)
    return ((t - j0, 0.0, e02), (0.0, t - j1, e12), (e02, e12, t - j2)), t


@inlined
def product_of(E, N):
    """Return the rows of E N for a symmetric N."""
    return (times(N, E[0]), times(N, E[1]), times(N, E[2]))

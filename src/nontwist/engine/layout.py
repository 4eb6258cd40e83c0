"""Where the numbers of a march lie: one table for each array, from which Python packs and kernels read.

A table names what a row holds, in order, with its size; `layout` turns it into the places. The numbers of the block are
addresses, counts and flags: all that a kernel takes is the address of the block, so no call checks or converts
anything.
"""

from __future__ import annotations

from collections import namedtuple
from itertools import accumulate
from math import prod
from typing import Any

import numpy as np

from ..geometry.arrays import Array

QUANTITIES = 12  # K, V, K + V - A, π (3), Π (3), ψ', e·π at nodes; -μ over steps
NODAL = QUANTITIES - 1


def layout(name: str, **sizes: int) -> Any:
    """Return the places, one attribute each, at which so many numbers begin one after the other, and their `size`."""
    make: Any = namedtuple
    return make(name, [*sizes, "size"])(0, *accumulate(sizes.values()))


# A body in its frame b and in its units: 1/J_i, 0 in a held direction; J31, J32; 1 or, where the third direction is
# held, 0; E_ii; the frame as columns in body components and as a quaternion; dead forces, rows; damping, rows; the axis
# n (E3 where there is none) and the vertical e; dissipation of the orders 1 and 2; factor of a prescribed
# spin; what its moments are multiplied by at the end.
BODY = layout(
    "Body",
    k=3,
    off=2,
    free=1,
    E=3,
    basis=9,
    frame=4,
    dead=9,
    damping=9,
    axis=3,
    vertical=3,
    dissipation=2,
    spin=1,
    unit=1,
)
# What a march carries, in b: quaternion; momentum or W, its compensation; that of the quaternion; the first guess of
# the next rate and the last two rates, or N (11, 22, 33, 23, 13, 12) and zeros, or iterations to take unseen.
STATE = layout("State", p=4, s=3, carry=3, c=4, extra=9)
FAILURE = layout("Failure", status=1, step=1, residual=1, turn=1)
# Sums over the open interval: λ (11, 22, 33, 23, 13, 12) in b, μ, the moment in space, that of dead forces on held
# bodies, the work, the twist, iterations.
SUMS = layout("Sums", lam=6, mu=1, moment=3, dead=3, work=1, twist=1, iterations=1)
# What is observed: the quantities at first, least, greatest, integral; the work of the load since the start.
OBSERVATION = layout("Observation", first=QUANTITIES, least=QUANTITIES, most=QUANTITIES, integral=QUANTITIES, work=1)
# What generalised forces act on, and what they are (`generalised`): directors, w, the moment of a C function, the time,
# the half turn of the step in the body; the action, addresses of `TERM`s and of the forces of the node; moments of the
# load and of potentials; σ (11, 22, 33, 23, 13, 12); room. It begins with what a moment of the state is called with.
ACTING = layout(
    "Acting",
    directors=9,
    w=3,
    called=3,
    t=1,
    half=3,
    action=1,
    terms=1,
    node=1,
    load=3,
    held=3,
    rest=6,
    room=48,
)
# A potential, behind two numbers: the address of a function of director forces, 0: none; how many potentials there are.
# Its kind, factor, vectors in space; l or ρ, Q; |ρ|² + |a|², k, L; the address of V and its gradient.
TERM = layout(
    "Term",
    kind=1,
    scale=1,
    count=1,
    vectors=12,
    linear=3,
    quadratic=9,
    square=1,
    stiffness=1,
    rest=1,
    function=1,
)
# The workspace, for each lane: a member's numbers, and what a call of a moment and a closed solution need.
WORK = layout(
    "Work",
    body=BODY.size,
    state=STATE.size,
    sums=SUMS.size,
    observed=OBSERVATION.size,
    now=QUANTITIES,
    velocity=3,
    scale=1,
    failure=FAILURE.size,
    call=15,
    buffer=ACTING.size,
    constants=35,
    spare=6,  # so that what lies behind it begins with a line of the cache (`aligned`)
)
BLOCK = layout(
    "Block",
    members=1,
    director=1,  # 1: they carry W and N, else the momentum
    held=1,  # 1: they have a constrained axis
    order=1,  # numbers of the members
    begin=1,  # first and last of them
    end=1,
    bodies=1,
    body_stride=1,  # 0: one body for all
    scales=1,  # of the loads, in units of the body
    scale_stride=1,
    states=1,
    state_size=1,  # numbers of a member: STATE.size, and what a scheme carries beside them
    failures=1,
    sums=1,
    observed=1,  # 0: nothing is observed
    quaternions=1,  # (m, k, 4) scalar last
    velocities=1,  # (m, k, 3)
    normals=1,  # (m, k, 6), 0: none
    intervals=1,  # (m, k - 1, SUMS.size), 0: none
    count=1,  # k
    stored=1,  # steps whose ends are kept
    done=1,  # how many are
    first=1,  # number of the first step
    steps=1,
    ceased=1,  # the step from which on no moment but that of dead forces acts; none of this call: its last
    resumed=1,  # the step from which on one acts again, or the march ends
    leaves=1,  # 1: write the state at the end as that of the node `done` + 1, though it is not one
    stages=1,
    fractions=1,
    gauss=1,  # nodes of a stage
    table=1,  # coefficients of the scheme, 0: none
    times=1,  # of the nodes, 0 unless a moment of the state is called
    moving=1,  # (nodes, 3), 0: none
    space=1,  # (nodes, 3), 0: none
    rotor=1,  # (nodes, 6) momentum of the rotors and its rate, 0: none
    spin=1,  # (nodes,) change of the prescribed spin in the step, 0: none
    function=1,  # address of a moment of the state, 0: none
    forces=1,  # (nodes, 18) on the directors: in space, along them; 0: none
    generalised=1,  # address of what makes moments of director forces and potentials; 0: there are none
    terms=1,  # address of two numbers and the potentials (`TERM`)
    action=1,  # what it makes (`generalised`)
    exact=1,  # 1: moments act exactly in a director scheme
    orbit=1,  # address of the rate and the axis of a frame that `gauss` sees the body from; 0: it stands still
    step=1,  # address of two doubles: the step and the time unit
    lengths=1,  # (k - 1,) of the stored intervals
    workspace=1,
    calls=1,  # address of a list of calls (`CALLS`), 0: none
)
# A call of a kernel within a list of calls (`outputs`): what it is for, and what differs in the block; where its state
# is written; whether a stretch begins with it; whether it is a free motion, from the beginning of the leg.
CALL = layout(
    "Call",
    op=1,
    first=1,
    steps=1,
    step=1,
    times=1,
    moving=1,
    space=1,
    rotor=1,
    spin=1,
    forces=1,
    place=1,
    begins=1,
    coasts=1,
)
# A list of calls: address of the kernel and bodies that it takes at a time; how many calls, their rows (`CALL`) and,
# two to each, 1 over the length of the interval that ends there and the part of the step; sums since the last output;
# room; stages of a Gauss step and the polynomials through them; where the numbers that first guesses are made of begin.
CALLS = layout("Calls", kernel=1, width=1, count=1, rows=1, reals=1, totals=1, room=1, stages=1, within=1, guesses=1)


def slab(**shapes: tuple[int, ...]) -> tuple[dict[str, Array], dict[str, int]]:
    """Return arrays of zeros that lie in one piece of memory, and their addresses; 0 for one without entries."""
    sizes = [prod(shape) for shape in shapes.values()]
    ends = [0, *accumulate(sizes)]
    memory = np.zeros(ends[-1])
    base, arrays, addresses = memory.ctypes.data, {}, {}
    for (name, shape), first, last in zip(shapes.items(), ends[:-1], ends[1:], strict=True):
        arrays[name] = memory[first:last].reshape(shape)
        addresses[name] = base + 8 * first if last > first else 0
    return arrays, addresses

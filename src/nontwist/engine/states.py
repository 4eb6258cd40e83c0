"""Between what a caller sees of states and what a march carries."""

from ..geometry.compiled import kernel
from ..geometry.elements import doubles, integers, shifted
from ..geometry.tuples import (
    EPS,
    product,
    scaled,
    transposed,
    transposed_times,
)
from .layout import BLOCK, BODY, STATE

ROUND_OFF = 16.0 * EPS


@kernel
def enter(address):
    """Set the states of all members from the first of those stored, in the frames and units of the bodies.

    Round-off of N, and of W along a constrained axis without spin, is taken away; all of the latter unless N is
    carried. With N goes W, else the momentum.
    """
    b = integers(address)
    fixed, normal = b[BLOCK.held] != 0, b[BLOCK.director] != 0
    reals, bodies, states = doubles(b[BLOCK.step]), doubles(b[BLOCK.bodies]), doubles(b[BLOCK.states])
    quaternions, velocities = doubles(b[BLOCK.quaternions]), doubles(b[BLOCK.velocities])
    unit, count = 1.0 / reals[1], b[BLOCK.count]
    for i in range(b[BLOCK.members]):
        body, state = shifted(bodies, i * b[BLOCK.body_stride]), shifted(states, i * b[BLOCK.state_size])
        q, v = shifted(quaternions, 4 * i * count), shifted(velocities, 3 * i * count)
        for k in range(b[BLOCK.state_size]):
            state[k] = 0.0
        frame = (body[BODY.frame], body[BODY.frame + 1], body[BODY.frame + 2], body[BODY.frame + 3])
        state[0], state[1], state[2], state[3] = product((q[3], q[0], q[1], q[2]), frame)
        c = shifted(body, BODY.basis)
        B = ((c[0], c[1], c[2]), (c[3], c[4], c[5]), (c[6], c[7], c[8]))
        W = scaled(unit, transposed_times(B, (v[0], v[1], v[2])))
        largest = max(abs(W[0]), abs(W[1]), abs(W[2]))
        spins = body[BODY.k + 2] != 0.0
        if fixed and not spins and (not normal or abs(W[2]) <= ROUND_OFF * largest):
            W = (W[0], W[1], 0.0)
        if not normal:
            e0, e1, e2 = body[BODY.E], body[BODY.E + 1], body[BODY.E + 2]
            W = ((e1 + e2) * W[0], (e2 + e0) * W[1], (e0 + e1) * W[2])
        state[STATE.s], state[STATE.s + 1], state[STATE.s + 2] = W
        if normal and b[BLOCK.normals] != 0:
            a = shifted(doubles(b[BLOCK.normals]), 6 * i * count)
            N = ((a[0], a[5], a[4]), (a[5], a[1], a[3]), (a[4], a[3], a[2]))
            N = transposed((transposed_times(B, N[0]), transposed_times(B, N[1]), transposed_times(B, N[2])))
            N = (transposed_times(B, N[0]), transposed_times(B, N[1]), transposed_times(B, N[2]))
            entries = (N[0][0], N[1][1], N[2][2], N[1][2], N[0][2], N[0][1])
            for k in range(6):
                entry = unit * entries[k]
                state[STATE.extra + k] = entry if abs(entry) > ROUND_OFF * largest else 0.0

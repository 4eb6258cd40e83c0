"""The workspace: place k of it holds the number k of each body, side by side; how numbers get in and out of it."""

from ..geometry.compiled import inlined, shared
from ..geometry.elements import doubles, integers, lanes, load, shifted, store
from ..geometry.tuples import NAN, product, scaled, times, transposed, turned_into
from .records import BLOCK, BODY, FAILURE, NODAL, STATE, SUMS, WORK
from .records import OBSERVED as OBSERVATION


@inlined
def vector(x, place, one):
    n = lanes(one)
    return (load(x, place * n, one), load(x, (place + 1) * n, one), load(x, (place + 2) * n, one))


@inlined
def put_vector(x, place, v):
    n = lanes(v[0])
    store(x, place * n, v[0])
    store(x, (place + 1) * n, v[1])
    store(x, (place + 2) * n, v[2])


@inlined
def matrix(x, place, one):
    return (vector(x, place, one), vector(x, place + 3, one), vector(x, place + 6, one))


@inlined
def show(x, p, W, extra):
    """Put attitude, velocity and N, where `extra` holds it, where `write` and what is observed take them from."""
    store(x, WORK.state * lanes(p[0]), p[0])
    put_vector(x, WORK.state + 1, (p[1], p[2], p[3]))
    put_vector(x, WORK.velocity, W)
    if extra is not None:
        put_vector(x, WORK.state + STATE.extra, (extra[0], extra[1], extra[2]))
        put_vector(x, WORK.state + STATE.extra + 3, (extra[3], extra[4], extra[5]))


@inlined
def keep(x, p, c, s, carry, extra, W):
    """Write the states to the workspace; `extra` is None where a scheme carries none."""
    show(x, p, W, extra)
    store(x, (WORK.state + STATE.c) * lanes(c[0]), c[0])
    put_vector(x, WORK.state + STATE.c + 1, (c[1], c[2], c[3]))
    put_vector(x, WORK.state + STATE.s, s)
    put_vector(x, WORK.state + STATE.carry, carry)
    if extra is not None:
        put_vector(x, WORK.state + STATE.extra + 6, (extra[6], extra[7], extra[8]))


@shared
def gather(b, x, n, first, last):
    """Fill the workspace with members; lanes beyond `last` repeat the one before it."""
    order, bodies, states = integers(b[BLOCK.order]), doubles(b[BLOCK.bodies]), doubles(b[BLOCK.states])
    scales, failures = doubles(b[BLOCK.scales]), doubles(b[BLOCK.failures])
    for l in range(n):
        i = order[min(first + l, last - 1)]
        for k in range(BODY.size):
            x[(WORK.body + k) * n + l] = bodies[i * b[BLOCK.body_stride] + k]
        for k in range(STATE.size):
            x[(WORK.state + k) * n + l] = states[i * b[BLOCK.state_size] + k]
        for k in range(FAILURE.size):
            x[(WORK.failure + k) * n + l] = failures[i * FAILURE.size + k]
        x[WORK.scale * n + l] = scales[i * b[BLOCK.scale_stride]]
        if b[BLOCK.intervals] != 0:
            sums = doubles(b[BLOCK.sums])
            for k in range(SUMS.size):
                x[(WORK.sums + k) * n + l] = sums[i * SUMS.size + k]
        if b[BLOCK.observed] != 0:
            observed = doubles(b[BLOCK.observed])
            for k in range(OBSERVATION.size):
                x[(WORK.observed + k) * n + l] = observed[i * OBSERVATION.size + k]
            x[(WORK.now + NODAL) * n + l] = 0.0


@shared
def scatter(b, x, n, first, last):
    """Put back what the members carry on."""
    order, states, failures = integers(b[BLOCK.order]), doubles(b[BLOCK.states]), doubles(b[BLOCK.failures])
    for l in range(last - first):
        i = order[first + l]
        for k in range(STATE.size):
            states[i * b[BLOCK.state_size] + k] = x[(WORK.state + k) * n + l]
        for k in range(FAILURE.size):
            failures[i * FAILURE.size + k] = x[(WORK.failure + k) * n + l]
        if b[BLOCK.intervals] != 0:
            sums = doubles(b[BLOCK.sums])
            for k in range(SUMS.size):
                sums[i * SUMS.size + k] = x[(WORK.sums + k) * n + l]
        if b[BLOCK.observed] != 0:
            observed = doubles(b[BLOCK.observed])
            for k in range(OBSERVATION.size):
                observed[i * OBSERVATION.size + k] = x[(WORK.observed + k) * n + l]


@inlined
def at(x, place, n, l):
    """Return the vector of one body."""
    return (x[place * n + l], x[(place + 1) * n + l], x[(place + 2) * n + l])


@shared
def write(b, x, n, k, first, last):
    """Write the states of the node k, and the means over the interval before it, in body components.

    Of the two quaternions of an attitude it is the one nearer to the state stored before. NaN where a run has failed.
    """
    order, count, rate = integers(b[BLOCK.order]), b[BLOCK.count], doubles(b[BLOCK.step])[1]
    quaternions, velocities, normals = doubles(b[BLOCK.quaternions]), doubles(b[BLOCK.velocities]), b[BLOCK.normals]
    for l in range(last - first):
        row, unit = order[first + l] * count + k, x[(WORK.body + BODY.unit) * n + l]
        q, gone = shifted(quaternions, 4 * row), x[WORK.failure * n + l] != 0.0
        f = NAN if gone else 1.0
        B = transposed(frame_at(x, n, l))
        s, v = x[WORK.state * n + l], at(x, WORK.state + 1, n, l)
        c, u = x[(WORK.body + BODY.frame) * n + l], at(x, WORK.body + BODY.frame + 1, n, l)
        p = product((s, v[0], v[1], v[2]), (c, -u[0], -u[1], -u[2]))
        before = shifted(quaternions, 4 * row - 4)
        nearer = before[0] * p[1] + before[1] * p[2] + before[2] * p[3] + before[3] * p[0]
        sign = f if nearer >= 0.0 else -f
        q[0], q[1], q[2], q[3] = sign * p[1], sign * p[2], sign * p[3], sign * p[0]
        W = times(transposed(B), at(x, WORK.velocity, n, l))
        put(shifted(velocities, 3 * row), scaled(f * rate, W))
        if normals != 0:
            N = symmetric(x, WORK.state + STATE.extra, n, l)
            put_symmetric(shifted(doubles(normals), 6 * row), B, N, f * rate)
        if b[BLOCK.intervals] != 0:
            interval = shifted(doubles(b[BLOCK.intervals]), (row - order[first + l] - 1) * SUMS.size)
            if normals != 0:
                put_symmetric(shifted(interval, SUMS.lam), B, symmetric(x, WORK.sums + SUMS.lam, n, l), unit)
            for j in range(SUMS.mu, SUMS.twist):
                interval[j] = unit * x[(WORK.sums + j) * n + l]
            interval[SUMS.twist] = x[(WORK.sums + SUMS.twist) * n + l]
            interval[SUMS.iterations] = x[(WORK.sums + SUMS.iterations) * n + l]
            for j in range(0 if normals != 0 else SUMS.mu, SUMS.size):
                x[(WORK.sums + j) * n + l] = 0.0


@inlined
def put(pointer, v):
    pointer[0], pointer[1], pointer[2] = v


@inlined
def frame_at(x, n, l):
    """Return the frame of one body, as columns in body components."""
    place = WORK.body + BODY.basis
    return (at(x, place, n, l), at(x, place + 3, n, l), at(x, place + 6, n, l))


@inlined
def symmetric(x, place, n, l):
    """Return the symmetric matrix of the entries 11, 22, 33, 23, 13, 12 of one body."""
    (a, b, c), (d, e, f) = at(x, place, n, l), at(x, place + 3, n, l)
    return ((a, f, e), (f, b, d), (e, d, c))


@inlined
def put_symmetric(pointer, B, A, f):
    """Write the entries of f times a symmetric matrix in body components, B the frame as rows."""
    A = turned_into(transposed(B), A)
    A = turned_into(transposed(B), transposed(A))
    put(pointer, (f * A[0][0], f * A[1][1], f * A[2][2]))
    put(shifted(pointer, 3), (f * A[1][2], f * A[0][2], f * A[0][1]))

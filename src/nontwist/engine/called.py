"""Moments that depend on the state: of C functions, of director forces and of potentials (`generalised`).

A C function is ``void (t, directors, angular_velocity, moment)``.

A call is a tuple (is_called, (t, forces), room, ...): the time and the address of the forces of the node; ``room = (x,
buffer, basis, rate, factor, acting)``: room for 15 elements and for a body, the frame, what angular velocities and
moments are multiplied by on the way to the function's units and back; ``acting = (function, generalised, terms, action,
address)``: what is called, 0 where there is none, and the address of the room for a body.
"""

from math import sqrt

from ..geometry.compiled import inlined
from ..geometry.elements import any_of, call_kernel, call_moment, integers, lanes, load, select, shifted, store
from ..geometry.tuples import (
    EPS,
    add,
    add_unit,
    axpy,
    chosen,
    cross,
    dot,
    minus,
    scaled,
    size,
    times,
    transposed,
    transposed_times,
    turned_into,
)
from .layout import ACTING

DIFFERENCE, SEEN = sqrt(EPS), 1e-13  # of the velocity; rad, the least turn of a difference


@inlined
def mean(s, a, x):
    """Return M x, M = (I - â)⁻¹ = s (I + â + a aᵀ)."""
    return scaled(s, axpy(dot(a, x), a, add(x, cross(a, x))))


@inlined
def mean_transposed(s, a, x):
    """Return Mᵀ x."""
    return scaled(s, axpy(dot(a, x), a, axpy(-1.0, cross(a, x), x)))


@inlined
def state_called(call, R, q, w, half):
    """Call what depends on the state for the directors of q and the velocity w in space, for each body.

    R is the attitude between b and space, q that of the directors in their frame, `half` the half turn of the step. The
    room then holds for each body: all moments, those of the load, those of potentials; σ.
    """
    (t, forces), (x, buffer, basis, rate, _, acting) = call[1], call[2]
    function, generalised, terms, action, address = acting
    d0, d1, d2 = times(basis, q[0]), times(basis, q[1]), times(basis, q[2])
    v, n = scaled(rate, times(R, w)), lanes(rate * w[0])
    for k in range(3):
        store(x, 3 * k * n, d0[k])
        store(x, (3 * k + 1) * n, d1[k])
        store(x, (3 * k + 2) * n, d2[k])
        store(x, (9 + k) * n, v[k])
    if generalised != 0:
        v = times(basis, half)
        for k in range(3):
            store(x, (12 + k) * n, v[k])
    buffer[ACTING.t] = t
    for l in range(n):
        for k in range(12):
            buffer[k] = x[k * n + l]
        if function != 0:
            call_moment(function, t, buffer, shifted(buffer, ACTING.w), shifted(buffer, ACTING.called))
        else:
            buffer[ACTING.called] = buffer[ACTING.called + 1] = buffer[ACTING.called + 2] = 0.0
        if generalised != 0:
            for k in range(3):
                buffer[ACTING.half + k] = x[(12 + k) * n + l]
            given = integers(address)
            given[ACTING.action], given[ACTING.terms], given[ACTING.node] = action, terms, forces
            call_kernel(generalised, address)
            for k in range(3):
                held, loaded = buffer[ACTING.held + k], buffer[ACTING.called + k] + buffer[ACTING.load + k]
                x[k * n + l], x[(3 + k) * n + l], x[(6 + k) * n + l] = loaded + held, loaded, held
            for k in range(6):
                x[(9 + k) * n + l] = buffer[ACTING.rest + k]
        else:
            for k in range(3):
                x[k * n + l] = buffer[ACTING.called + k]


@inlined
def found(call, place, like):
    """Return the vector of the last call that the room holds from a place on, in units of the body."""
    x, factor, n = call[2][0], call[2][4], lanes(like)
    return scaled(factor, (load(x, place * n, like), load(x, (place + 1) * n, like), load(x, (place + 2) * n, like)))


@inlined
def moment_of(call, R, q, w, half):
    """Return the moment in b of all that is called; arguments as of `state_called`."""
    state_called(call, R, q, w, half)
    return transposed_times(R, found(call, 0, w[0]))


@inlined
def parts_of(call, R, q, w, half):
    """Return the moments in b of the load, and of potentials."""
    state_called(call, R, q, w, half)
    zero = 0.0 * w[0]
    load_, held = transposed_times(R, found(call, 0, w[0])), (zero, zero, zero)
    if call[2][5][1] != 0:
        load_, held = transposed_times(R, found(call, 3, w[0])), transposed_times(R, found(call, 6, w[0]))
    return load_, held


@inlined
def step_called(call, a, w):
    """Call what depends on the state for the averaged directors of a step, and w; ``call[3]`` is Λ_n."""
    R, s = call[3], 1.0 / (1.0 + dot(a, a))
    rows = (mean_transposed(s, a, R[0]), mean_transposed(s, a, R[1]), mean_transposed(s, a, R[2]))
    state_called(call, R, rows, w, a)  # the rows of Λ_m = R M are Mᵀ R_i


@inlined
def moment_of_state(call, a, w):
    """Return the moment in b, of all that is called, for the averaged directors and w."""
    step_called(call, a, w)
    return transposed_times(call[3], found(call, 0, w[0]))


@inlined
def load_of_state(call, total):
    """Return the part of the moment `total` of the last call that is of the load, and not of potentials."""
    if call[2][5][1] != 0:
        return transposed_times(call[3], found(call, 3, total[0]))
    return total


@inlined
def rest_of_state(call, like):
    """Return σ of the last call in b: 11, 22, 33, 23, 13, 12."""
    zero = 0.0 * like
    if call[2][5][1] == 0:
        return zero, zero, zero, zero, zero, zero
    B = transposed(call[2][2])
    (a, b, c), (d, e, f) = found(call, 9, like), found(call, 12, like)
    A = turned_into(B, ((a, f, e), (f, b, d), (e, d, c)))
    A = turned_into(B, transposed(A))
    return A[0][0], A[1][1], A[2][2], A[1][2], A[0][2], A[0][1]


@inlined
def derivatives(call, f, shrinking, Om, state):
    """Return the derivatives of the moment of the state by the components of Ω, as differences.

    The function gets a = f Ω and ``w = Ω``, or with `shrinking` ``w = s Ω``. Where the body is so slow that the
    difference of a is lost in the round-off of the attitude, a and w have differences of their own, a that of the turn
    `SEEN`.
    """
    e = DIFFERENCE * size(Om)
    e = select(e > 0.0, e, e + DIFFERENCE)
    slow, here, speed = abs(f) * e < SEEN, scaled(f, Om), Om
    if shrinking:
        speed = scaled(1.0 / (1.0 + dot(here, here)), Om)
    S = (state, state, state)
    for j in range(3):
        w = add_unit(j, e, Om)
        a = chosen(slow, here, scaled(f, w))
        if shrinking:
            w = scaled(1.0 / (1.0 + dot(a, a)), w)
        column = scaled(1.0 / e, minus(moment_of_state(call, a, w), state))
        if any_of(slow):
            turned = minus(moment_of_state(call, add_unit(j, SEEN, here), speed), state)
            column = chosen(slow, axpy(f / SEEN, turned, column), column)
        S = (S[1], S[2], column)
    return S

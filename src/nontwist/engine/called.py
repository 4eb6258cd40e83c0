"""Moments that are functions of the state: C functions ``void (t, directors, angular_velocity, moment)``."""

from math import sqrt

from ..geometry.compiled import inlined
from ..geometry.elements import call_moment, doubles, lanes, load, select, shifted, store
from ..geometry.tuples import EPS, add, add_unit, axpy, cross, dot, minus, scaled, size, times, transposed_times

DIFFERENCE = sqrt(EPS)


@inlined
def mean(s, a, x):
    """Return M x, M = (I - â)⁻¹ = s (I + â + a aᵀ)."""
    return scaled(s, axpy(dot(a, x), a, add(x, cross(a, x))))


@inlined
def mean_transposed(s, a, x):
    """Return Mᵀ x."""
    return scaled(s, axpy(dot(a, x), a, axpy(-1.0, cross(a, x), x)))


@inlined
def moment_of_state(call, a, w):
    """Return the moment in b, which the function gives for the averaged directors (rows) and w, both in space.

    ``call = (function, t, x, buffer, R, basis, rate, factor)``: its address and time, room for 12 elements and 16
    doubles, Λ_n, the frame, and what angular velocities and moments are multiplied by on the way to the function's
    units and back.
    """
    function, t, x, buffer, R, basis, rate, factor = call
    s = 1.0 / (1.0 + dot(a, a))
    d0 = times(basis, mean_transposed(s, a, R[0]))  # the rows of Λ_m = R M are Mᵀ R_i
    d1 = times(basis, mean_transposed(s, a, R[1]))
    d2 = times(basis, mean_transposed(s, a, R[2]))
    v, n = scaled(rate, times(R, w)), lanes(s)
    for k in range(3):
        store(x, 3 * k * n, d0[k])
        store(x, (3 * k + 1) * n, d1[k])
        store(x, (3 * k + 2) * n, d2[k])
        store(x, (9 + k) * n, v[k])
    buffer[15] = t
    for l in range(n):
        for k in range(12):
            buffer[k] = x[k * n + l]
        call_moment(function, t, buffer, shifted(buffer, 9), shifted(buffer, 12))
        for k in range(3):
            x[k * n + l] = buffer[12 + k]
    return transposed_times(R, scaled(factor, (load(x, 0, s), load(x, n, s), load(x, 2 * n, s))))


@inlined
def moment_at(call, t, q, w):
    """Return the moment in space for directors, nine numbers, and w; ``call = (address, 16 doubles)`` for one body."""
    function, place = call
    buffer = doubles(place)
    for k in range(9):
        buffer[k] = q[k]
    buffer[9], buffer[10], buffer[11] = w
    buffer[15] = t
    call_moment(function, t, buffer, shifted(buffer, 9), shifted(buffer, 12))
    return (buffer[12], buffer[13], buffer[14])


@inlined
def derivatives(call, f, shrinking, Om, state):
    """Return the derivatives of the moment of the state by the components of Ω, as differences.

    The function gets a = f Ω and ``w = Ω``, or with `shrinking` ``w = s Ω``. Where nothing moves yet the difference is
    of a velocity of 1 rad in a unit of time.
    """
    e = DIFFERENCE * size(Om)
    e = select(e > 0.0, e, e + DIFFERENCE)
    S = (state, state, state)
    for j in range(3):
        w = add_unit(j, e, Om)
        a = scaled(f, w)
        if shrinking:
            w = scaled(1.0 / (1.0 + dot(a, a)), w)
        S = (S[1], S[2], scaled(1.0 / e, minus(moment_of_state(call, a, w), state)))
    return S

"""Moments that are functions of the state: C functions ``void (t, directors, angular_velocity, moment)``."""

from math import sqrt

from ..geometry.compiled import inlined
from ..geometry.elements import call_moment, lanes, load, select, shifted, store
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
def moment_of(call, R, q, w):
    """Return the moment in b, which the function gives for the directors of q and the velocity w in space.

    R is the attitude between b and space, q that of the directors in their frame. ``call = (function, t, room, ...)``:
    its address and time; ``room = (x, buffer, basis, rate, factor)``: room for 12 elements and 16 doubles, the frame,
    and what angular velocities and moments are multiplied by on the way to the function's units and back.
    """
    function, t, (x, buffer, basis, rate, factor) = call[0], call[1], call[2]
    d0, d1, d2 = times(basis, q[0]), times(basis, q[1]), times(basis, q[2])
    v, n = scaled(rate, times(R, w)), lanes(rate * w[0])
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
    return transposed_times(R, scaled(factor, (load(x, 0, w[0]), load(x, n, w[0]), load(x, 2 * n, w[0]))))


@inlined
def moment_of_state(call, a, w):
    """Return the moment in b, which the function gives for the averaged directors and w.

    ``call[3]`` is Λ_n; ``call[4]`` says whether the moment of the step is asked for, after its solution.
    """
    R, s = call[3], 1.0 / (1.0 + dot(a, a))
    rows = (mean_transposed(s, a, R[0]), mean_transposed(s, a, R[1]), mean_transposed(s, a, R[2]))
    return moment_of(call, R, rows, w)  # the rows of Λ_m = R M are Mᵀ R_i


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

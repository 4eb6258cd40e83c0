"""Free and Suslov motions to 30 digits and more, in two ways that share nothing with the package.

`elliptic_top` evaluates the textbook formulas (Landau & Lifshitz §37, Euler angles with Legendre's third integral) in
mpmath; `taylor_top` sums the Taylor series of the differential equations in 50-digit integers.
"""

from fractions import Fraction
from operator import mul

import mpmath as mp
import numpy as np

mp.mp.dps = 40
BITS = 170


def elliptic_top(moments, W, t):
    """Λ (3, 3) of a body with principal axes E1, E2, E3, three different `moments`, off the principal axes."""
    with mp.workdps(40):
        order = np.argsort(moments)
        basis = mp.matrix(3)
        for row, column in enumerate(order):
            basis[row, int(column)] = 1
        I = [mp.mpf(float(moments[i])) for i in order]
        M = [I[i] * mp.mpf(float(W[order[i]])) for i in range(3)]
        m = mp.sqrt(sum(x * x for x in M))
        twice = sum(x * x / i for x, i in zip(M, I, strict=True))
        if m * m < twice * I[1]:  # about the smallest moment: exchange 1 and 3
            I, M, basis = I[::-1], M[::-1], mp.matrix(basis.tolist()[::-1])
        if mp.det(basis) < 0:
            M[1], basis[1, :] = -M[1], -basis[1, :]
        if M[2] < 0:
            M[1], M[2] = -M[1], -M[2]
            basis[1, :], basis[2, :] = -basis[1, :], -basis[2, :]
        a = mp.sqrt(I[0] * (twice * I[2] - m * m) / (I[2] - I[0]))
        b = mp.sqrt(I[1] * (twice * I[2] - m * m) / (I[2] - I[1]))
        c = mp.sqrt(I[2] * (m * m - twice * I[0]) / (I[2] - I[0]))
        k2 = (I[1] - I[0]) * (twice * I[2] - m * m) / ((I[2] - I[1]) * (m * m - twice * I[0]))
        rate = mp.sqrt((I[2] - I[1]) * (m * m - twice * I[0]) / (I[0] * I[1] * I[2])) * mp.sign(I[2] - I[0])
        n = -I[2] * (I[1] - I[0]) / (I[0] * (I[2] - I[1]))
        K = mp.ellipk(k2)

        def state(u):
            j = mp.nint(u / (2 * K))
            v = u - 2 * K * j
            sn, cn, dn = (mp.ellipfun(name, v, m=k2) for name in ("sn", "cn", "dn"))
            phi = j * mp.pi + mp.atan2(sn, cn)
            sign = -1 if int(j) % 2 else 1
            x, y, z = a * cn * sign / m, b * sn * sign / m, c * dn / m
            s = mp.sqrt(x * x + y * y)
            return mp.matrix([[x * z / s, y * z / s, -s], [-y / s, x / s, 0], [x, y, z]]), mp.ellippi(n, phi, k2)

        u0 = mp.ellipf(mp.atan2(M[1] / b, M[0] / a), k2)
        t = mp.mpf(float(t))
        (P0, first), (P1, last) = state(u0), state(u0 + rate * t)
        psi = m * t / I[2] + m * (1 / I[0] - 1 / I[2]) / rate * (last - first)
        turn = mp.matrix([[mp.cos(psi), -mp.sin(psi), 0], [mp.sin(psi), mp.cos(psi), 0], [0, 0, 1]])
        R = basis.T * P0.T * turn * P1 * basis
        return np.array([[float(R[i, j]) for j in range(3)] for i in range(3)])


def _fixed(x):
    x = Fraction(x)
    return (x.numerator << BITS) // x.denominator


def _inverse(J):
    c = [
        [
            J[(i + 1) % 3][(j + 1) % 3] * J[(i + 2) % 3][(j + 2) % 3]
            - J[(i + 1) % 3][(j + 2) % 3] * J[(i + 2) % 3][(j + 1) % 3]
            for j in range(3)
        ]
        for i in range(3)
    ]
    return [[c[j][i] / sum(J[0][k] * c[0][k] for k in range(3)) for j in range(3)] for i in range(3)]


def _convolution(a, b):
    return sum(map(mul, a, reversed(b)))


def taylor_top(inertia, W, t, axis3=False, order=44, turn=0.35, rotor=(0, 0, 0)):
    """(Λ, W) at `t` of a free body; with `axis3` of the Suslov body n = E3, J12 = 0, whose momentum obeys the same law.

    The quaternion and, for the standard body, the momentum M in M' = M × W, W = J⁻¹ (M - rotor); for the
    Suslov body W itself in J11 W1' = -W2 M3, J22 W2' = W1 M3, M3 = J13 W1 + J23 W2.
    """
    J = np.diag(inertia) if np.ndim(inertia) == 1 else np.asarray(inertia, float)
    exact = [[Fraction(float(x)) for x in row] for row in J]
    back = [[_fixed(x) for x in row] for row in _inverse(exact)]
    x = [Fraction(float(w)) for w in W]
    if not axis3:
        x = [sum(exact[i][j] * x[j] for j in range(3)) + Fraction(float(rotor[i])) for i in range(3)]
    apart = [_fixed(Fraction(float(v))) for v in rotor]
    fastest = np.sqrt(np.asarray(W) @ J @ np.asarray(W) / np.linalg.eigvalsh(J)[0])
    fastest += np.linalg.norm(rotor) / np.linalg.eigvalsh(J)[0]
    steps = max(1, int(np.ceil(abs(t) * fastest / turn)))
    h = _fixed(Fraction(float(t)) / steps)
    cross, over = [_fixed(exact[i][2]) for i in range(2)], [_fixed(1 / exact[i][i]) for i in range(2)]
    state, q = [_fixed(v) for v in x], [1 << BITS, 0, 0, 0]
    for _ in range(steps):
        X, V, Q = [[v] for v in state], [[], [], []], [[v] for v in q]
        M3 = []
        for k in range(order):
            for i in range(3):
                M = X if k else [[x[0] - v] for x, v in zip(X, apart, strict=True)]
                w = X[i][k] if axis3 else sum(back[i][j] * M[j][k] for j in range(3)) >> BITS
                V[i].append((h * w) >> BITS)
            if axis3:
                M3.append((cross[0] * X[0][k] + cross[1] * X[1][k]) >> BITS)
                pair = -_convolution(V[1], M3), _convolution(V[0], M3)
                new = [((p >> BITS) * o >> BITS) // (k + 1) for p, o in zip(pair, over, strict=True)] + [0]
            else:
                new = [
                    ((_convolution(X[i - 2], V[i - 1]) - _convolution(X[i - 1], V[i - 2])) >> BITS) // (k + 1)
                    for i in range(3)
                ]
            s, a, b, c = Q
            u, v, w = V
            turned = (
                -_convolution(a, u) - _convolution(b, v) - _convolution(c, w),
                _convolution(s, u) + _convolution(b, w) - _convolution(c, v),
                _convolution(s, v) + _convolution(c, u) - _convolution(a, w),
                _convolution(s, w) + _convolution(a, v) - _convolution(b, u),
            )
            for row, value in zip(X, new, strict=True):
                row.append(value)
            for row, value in zip(Q, turned, strict=True):
                row.append((value >> (BITS + 1)) // (k + 1))
        state, q = [sum(row) for row in X], [sum(row) for row in Q]
    s, a, b, c = (Fraction(v, 1 << BITS) for v in q)
    assert abs(s * s + a * a + b * b + c * c - 1) < Fraction(1, 10**32)
    M = [x - v for x, v in zip(state, apart, strict=True)]
    rates = state if axis3 else [sum(back[i][j] * M[j] for j in range(3)) >> BITS for i in range(3)]
    return _matrix((s, a, b, c)), np.array([float(Fraction(v, 1 << BITS)) for v in rates])


def steady(W, t):
    """exp(t Ŵ) in mpmath."""
    with mp.workdps(40):
        return _matrix(_turn([mp.mpf(w) for w in W], mp.mpf(t)))


def _turn(w, t):
    rate = mp.sqrt(sum(x * x for x in w))
    f = mp.sin(rate * t / 2) / rate if rate else t / 2
    return [mp.cos(rate * t / 2), *(f * x for x in w)]


def _matrix(q):
    s, a, b, c = q
    R = [
        [1 - 2 * (b * b + c * c), 2 * (a * b - s * c), 2 * (a * c + s * b)],
        [2 * (a * b + s * c), 1 - 2 * (a * a + c * c), 2 * (b * c - s * a)],
        [2 * (a * c - s * b), 2 * (b * c + s * a), 1 - 2 * (a * a + b * b)],
    ]
    return np.array([[float(v) for v in row] for row in R])

"""Motions in ways that share nothing with the package: free and Suslov ones to 30 digits and more, others by SciPy.

`elliptic_top` evaluates the textbook formulas (Landau & Lifshitz §37, Euler angles with Legendre's third integral) in
mpmath; `taylor_top` sums the Taylor series of the differential equations in 50-digit integers.
"""

from fractions import Fraction

import mpmath as mp
import numpy as np
from scipy.integrate import solve_ivp

from conftest import cross

mp.mp.dps = 40
BITS, EYE = 170, np.eye(3)
FULL = np.array([[3, 0.2, 0.1], [0.2, 4, -0.3], [0.1, -0.3, 5]])


def distance(a, b):
    return np.linalg.norm(a - b) / np.sqrt(2)


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


def _fixed(numbers):
    """Integers in units of 2^-BITS."""
    return np.array([int(mp.ldexp(mp.mpf(x), BITS)) for x in np.ravel(numbers)], object).reshape(np.shape(numbers))


def taylor_top(inertia, W, t, axis3=False, order=44, turn=0.35, rotor=(0, 0, 0)):
    """(Λ, W) at `t` of a free body; with `axis3` of the Suslov body n = E3, J12 = 0, whose momentum obeys the same law.

    The quaternion and, for the standard body, the momentum M in M' = M × W, W = J⁻¹ (M - rotor); for the
    Suslov body W itself in J11 W1' = -W2 M3, J22 W2' = W1 M3, M3 = J13 W1 + J23 W2.
    """
    J = np.diag(inertia) if np.ndim(inertia) == 1 else np.asarray(inertia, float)
    least = np.linalg.eigvalsh(J)[0]
    fastest = np.sqrt(np.asarray(W) @ J @ np.asarray(W) / least) + np.linalg.norm(rotor) / least
    steps = max(1, int(np.ceil(abs(t) * fastest / turn)))
    with mp.workprec(3 * BITS):
        exact, w, apart = mp.matrix(J.tolist()), mp.matrix([float(x) for x in W]), _fixed([float(x) for x in rotor])
        back, h = _fixed((exact**-1).tolist()), _fixed([mp.mpf(float(t)) / steps])
        state = _fixed(list(w)) if axis3 else _fixed(list(exact * w)) + apart
        across, over = _fixed(J[:2, 2]), _fixed([-1 / exact[0, 0], 1 / exact[1, 1]])
    q = _fixed([1, 0, 0, 0])
    for _ in range(steps):
        X, V, Q, M3 = (np.zeros((order + 1, n), object) for n in (3, 3, 4, 1))
        X[0], Q[0] = state, q
        for k in range(order):
            V[k] = h * (X[k] if axis3 else back @ (X[k] - apart * (k == 0)) >> BITS) >> BITS
            u, s, v = V[k::-1], Q[: k + 1, :1], Q[: k + 1, 1:]
            if axis3:
                M3[k] = across @ X[k, :2] >> BITS
                X[k + 1, :2] = ((u[:, 1::-1] * M3[: k + 1]).sum(0) >> BITS) * over // (k + 1) >> BITS
            else:
                X[k + 1] = (cross(X[: k + 1], u).sum(0) >> BITS) // (k + 1)
            turned = np.append(-(v * u).sum(), (s * u + cross(v, u)).sum(0))
            Q[k + 1] = (turned >> (BITS + 1)) // (k + 1)
        state, q = X.sum(0), Q.sum(0)
    rates = state if axis3 else back @ (state - apart) >> BITS
    q, rates = ([Fraction(x, 1 << BITS) for x in numbers] for numbers in (q, rates))
    assert abs(sum(x * x for x in q) - 1) < Fraction(1, 10**32)
    return _matrix(q), np.array([float(x) for x in rates])


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


def by_scipy(J, W, forces, t_end, q=EYE, axis=None, **how):
    """Directors, W, and the work of forces on the directors: Euler's equations and d_i' = w × d_i, by DOP853 at 1e-13.

    Where an axis is held, W along it is taken out by the moment that the plane leaves.
    """
    plane = np.eye(3) if axis is None else np.linalg.svd(axis[None])[2][1:]

    def rates(t, y):
        q, W = y[:9].reshape(3, 3), y[9:12]
        w = W @ q
        f, velocities = forces(t, q, w), cross(w, q)
        M = cross(J @ W, W) + q @ cross(q, f).sum(0)
        return [*velocities.ravel(), *plane.T @ np.linalg.solve(plane @ J @ plane.T, plane @ M), (f * velocities).sum()]

    start = [*np.ravel(q), *W, 0.0]
    end = solve_ivp(rates, (0, t_end), start, method="DOP853", rtol=1e-13, atol=1e-14, **how).y[:, -1]
    return end[:9].reshape(3, 3), end[9:12], end[12]

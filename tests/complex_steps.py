"""The steps of three schemes as plain text for complex numbers: what tangents are compared with.

A function that is evaluated at x + iε, ε = 1e-30, has its derivative in the imaginary part, to the last digits. So all
is polynomials, quotients and square roots, and iterations go on until real and imaginary parts stand still.
"""

from dataclasses import dataclass, field

import numpy as np

from nontwist.integrators.gauss_coefficients import matrix, weights

TINY = 1e-30
I3 = np.eye(3)
NEXT, LAST = np.array([1, 2, 0]), np.array([2, 0, 1])
MOST = 400


def cross(a, b):
    """The vector product along the last axis, an eighth of the time of `numpy.cross`."""
    return a.take(NEXT, -1) * b.take(LAST, -1) - a.take(LAST, -1) * b.take(NEXT, -1)


def hat(a):
    return np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])


def vee(A):
    return np.array([A[2, 1] - A[1, 2], A[0, 2] - A[2, 0], A[1, 0] - A[0, 1]]) / 2


def root(x):
    return np.sqrt(x)


def cay(w):
    """The rotation (I - ŵ/2)⁻¹ (I + ŵ/2)."""
    return np.linalg.solve(I3 - hat(w) / 2, I3 + hat(w) / 2)


def turned(angle, axis):
    """The rotation about an axis of unit length."""
    return I3 + np.sin(angle) * hat(axis) + (1 - np.cos(angle)) * hat(axis) @ hat(axis)


@dataclass
class Potential:
    """V of one space vector seen from the body, with the gradient between two of its values."""

    vector: object  # or a function of the time
    discrete: object  # of γ at the beginning and at the end

    def at(self, t):
        return self.vector(t) if callable(self.vector) else self.vector

    @classmethod
    def quadratic(cls, a, linear, Q):
        return cls(a, lambda first, last: linear + Q @ (first + last) / 2)

    @classmethod
    def spring(cls, k, rho, a, L):
        def length(g):
            return root(rho @ rho + a @ a - 2 * rho @ g)

        return cls(a, lambda first, last: -k * (1 - 2 * L / (length(first) + length(last))) * rho)

    @classmethod
    def function(cls, a, V, slope):
        def discrete(first, last):
            middle, change = (first + last) / 2, last - first
            if not (change @ change).real > 0:
                return slope(middle)
            q = (V(last) - V(first) - slope(middle) @ change) / (change @ change)
            return slope(middle) + q * change

        return cls(a, discrete)


@dataclass
class Body:
    """A body and what acts on it: functions of the time that return components."""

    J: np.ndarray
    axis: np.ndarray | None = None
    dead: np.ndarray = field(default_factory=lambda: np.zeros((3, 3)))
    damping: np.ndarray = field(default_factory=lambda: np.zeros((3, 3)))
    moving: object = None
    space: object = None
    rotor: object = None
    exact: bool = False
    called: object = None  # the moment in space of time, directors, angular velocity
    forces: object = None  # on the directors, of the same
    potentials: tuple = ()  # `Potential`
    dissipation: tuple = (0.0, 0.0)  # of the orders 1 and 2
    orbit: tuple | None = None  # mean motion and normal, where `gauss` turns the rows with W - n o

    def at(self, name, t):
        function = getattr(self, name)
        return np.zeros(3) if function is None else np.asarray(function(t))

    def moment(self, t, d, w):
        """The moment in space of what depends on the state, but for potentials."""
        m = np.zeros(3) if self.called is None else self.called(t, d, w)
        return m if self.forces is None else m + cross(d, self.forces(t, d, w)).sum(axis=0)

    def rates(self, torque):
        """K of ``J K = τ - μ n, n·K = 0``."""
        if self.axis is None:
            return np.linalg.solve(self.J, torque)
        A = np.zeros((4, 4), dtype=complex)
        A[:3, :3], A[:3, 3], A[3, :3] = self.J, self.axis, self.axis
        return np.linalg.solve(A, np.append(torque, 0))[:3]


def settled(step, x):
    """Iterate x until its real and imaginary parts stand still, to some units of round-off."""
    for _ in range(MOST):
        new = step(x)
        change = max(abs((new - x).real).max(), abs((new - x).imag).max() / TINY)
        x = new
        if change <= 4e-15 * max(1, abs(x.real).max(), abs(x.imag).max() / TINY):
            return step(x)
    raise AssertionError(f"the iteration does not stand still: {change}")


def gauss_step(body, R, W, t, h, order, form):
    """One step of `gauss`: R, W at its end. `form`: how the body turns, by a word or a direction in space."""
    a, b = matrix(order) * weights(order), weights(order)
    s = len(b)
    c = (a.sum(axis=1)).real
    seen = R.T @ np.array([body.at("space", t + x * h) for x in c]).T
    moving = np.array([body.at("moving", t + x * h) for x in c])
    before, after = body.at("rotor", t), body.at("rotor", t + h)
    n, normal = (0.0, np.zeros(3)) if body.orbit is None else body.orbit

    def torque(j, Wj, C):
        g = cross(body.J @ Wj, Wj) + moving[j] - body.damping @ Wj
        g = g + cross(before + c[j] * (after - before), Wj) - (after - before) / h
        seen_from = turned(n * c[j] * h, normal)  # a dead force stands still, the radius turns with the rows
        g = g + cross(I3.astype(complex), body.dead @ seen_from @ R @ C).sum(axis=0)
        attitude = R @ C
        for one in body.potentials:
            gamma = attitude.T @ one.at(t if n else t + c[j] * h)
            g = g + cross(gamma, one.discrete(gamma, gamma))
        m = body.moment(t + c[j] * h, attitude.T, attitude @ Wj)
        return g + np.linalg.solve(C, seen[:, j] + R.T @ m)

    def once(x):
        K, D = x[: 3 * s].reshape(s, 3), x[3 * s :].reshape(s, 3, 3)
        stages = W + h * a @ K
        C = I3 + h * np.einsum("ij,jkl->ikl", a, D)
        K = np.array([body.rates(torque(j, stages[j], C[j])) for j in range(s)])
        D = np.array([cross(C[j], stages[j] - n * (normal @ R @ C[j])) for j in range(s)])
        return np.concatenate([K.ravel(), D.ravel()])

    x = settled(once, np.zeros(12 * s, dtype=complex))
    K, D = x[: 3 * s].reshape(s, 3), x[3 * s :].reshape(s, 3, 3)
    stages, C = W + h * a @ K, I3 + h * np.einsum("ij,jkl->ikl", a, D)
    end, turn = W + h * b @ K, I3 + h * np.einsum("j,jkl->kl", b, D)
    kind = form if isinstance(form, str) else "direction"
    if kind == "rows":
        return turned(n * h, normal) @ R @ turn, end
    if kind == "steady":
        w = h * W
        angle = root(w @ w)
        n = hat(w / angle)
        return R @ (I3 + np.sin(angle) * n + (1 - np.cos(angle)) * n @ n), end
    if kind == "momentum":
        P = body.J @ W
        f = 1 / root(P @ P)
        g0, g1, g = f * P, f * body.J @ end, f * stages @ body.J
    else:
        g0 = form @ R
        g1, g = g0 @ turn, np.einsum("k,jkl->jl", g0, C)
    w = h * b @ stages
    r = w / root(w @ w)
    r = r if ((g0 + g1) @ w).real >= 0 else -r
    psi = h * sum(b[i] * stages[i] @ (g[i] + r) / (1 + g[i] @ r) for i in range(s))

    def smallest(g):
        u = hat(cross(g, r))
        return I3 + u + u @ u / (1 + g @ r)

    about = I3 + np.sin(psi) * hat(r) + (1 - np.cos(psi)) * hat(r) @ hat(r)
    return R @ smallest(g0).T @ about @ smallest(g1), end


def midpoint_step(body, R, W, t, h):
    """One step of `lie_midpoint`, as its docstring has it."""
    tm, seen = t + h / 2, R.T @ body.at("space", t + h / 2)
    rotor, rate = (
        (body.at("rotor", t) + body.at("rotor", t + h)) / 2,
        (body.at("rotor", t + h) - body.at("rotor", t)) / h,
    )
    F = body.dead @ R

    first, second = body.dissipation

    def turning(y):
        Wm = W + y
        speed = root(Wm @ Wm) if second else 0.0
        return Wm + h / np.trace(body.J) * (first + second * h * speed) * cross(body.J @ Wm + rotor, Wm)

    def once(y):
        Om = turning(y)
        a = h / 2 * Om
        M = np.linalg.inv(I3 - hat(a))
        moment = seen + sum(cross(M[:, i], F[i]) for i in range(3))
        mean, end = R @ M, R @ cay(h * Om)
        for one in body.potentials:
            v = one.at(tm)
            moment = moment + R.T @ cross(v, mean @ one.discrete(R.T @ v, end.T @ v))
        moment = moment + R.T @ body.moment(tm, mean.T, mean @ Om)
        g = cross(body.J @ (W + y), Om) + body.at("moving", tm) - body.damping @ Om + cross(rotor, Om) - rate
        return h / 2 * body.rates(g + (I3 - hat(a)) @ moment)

    y = settled(once, np.zeros(3, dtype=complex))
    return R @ cay(h * turning(y)), W + 2 * y


def director_step(body, q, v, t, h):
    """One step of `energy_momentum`, eq-discrete-nonholonomic itself: 16 unknowns, by Newton's iteration."""
    from nontwist.models.constraints import constraint_matrices

    E = np.trace(body.J) / 2 * I3 - body.J
    A = constraint_matrices(None).astype(complex)
    if body.axis is not None:
        A = np.concatenate([A, -hat(body.axis)[None] / 2])
    tm, n = t + h / 2, len(A)
    Q = np.linalg.eigh(body.J.real)[1]
    first, second = body.dissipation
    w = cross(q, v).sum(axis=0) / 2
    turn = h * root(w @ w)
    chi = first + second * (turn if turn.real < 1 else 1.0)

    def moved(u):
        """What the directors move by for each unit of time: faster or slower than u along the principal axes."""
        if not any(body.dissipation):
            return u
        before, after = (root((x * x).sum(axis=1)) for x in (Q.T @ v, Q.T @ (2 * u - v)))
        return Q @ ((1 + chi * (after - before) / (after + before))[:, None] * (Q.T @ u))

    def residual(x):
        u, lam = v + x[:9].reshape(3, 3), x[9:]
        mean = u
        u = moved(u)
        qm = q + h / 2 * u
        spatial = body.at("space", tm) + body.at("moving", tm) @ qm
        w = cross(qm, u).sum(axis=0) / 2
        spatial = spatial - (body.damping @ (qm @ w)) @ qm
        if body.called is not None:
            spatial = spatial + body.called(tm, qm, w)
        wanted = np.zeros(3)
        if body.exact:
            wanted, spatial = spatial, np.zeros(3)
        if body.rotor is not None:  # -(Λ c)' = -(q_1ᵀ c_1 - q_0ᵀ c_0)/h
            q1 = q + h * u
            wanted = wanted - (body.at("rotor", t + h) @ q1 - body.at("rotor", t) @ q) / h
        D = qm.T @ qm
        y = np.linalg.solve(np.trace(D) * I3 - D, wanted)
        force = body.dead + cross(spatial, qm) / 2 + cross(y, qm)
        if body.forces is not None:
            force = force + body.forces(tm, qm, w)
        for one in body.potentials:
            r = one.at(tm)
            force = force - np.outer(one.discrete(q @ r, (q + h * u) @ r), r)
        first = 2 / h * E @ (mean - v) + np.tensordot(lam, A, 1) @ qm - force
        return np.concatenate([first.ravel(), ((A @ qm).reshape(n, 9) @ u.ravel())])

    J = np.zeros((9 + n, 9 + n), dtype=complex)
    for k, e in enumerate(1e-5 * np.eye(9 + n)):
        J[:, k] = (residual(e) - residual(-e)) / 2e-5
    inverse = np.linalg.inv(J)
    x = settled(lambda x: x - inverse @ residual(x), np.zeros(9 + n, dtype=complex))
    u = v + x[:9].reshape(3, 3)
    return q + h * moved(u), v + 2 * (u - v)


def march(body, R, W, h, steps, scheme, order=2, form="rows", t=0.0):
    """R and W after some steps of a scheme, from t on."""
    R, W = np.asarray(R, dtype=complex), np.asarray(W, dtype=complex)
    if scheme == "energy-momentum":
        q, v = R.T, cross(R @ W, R.T)
        for k in range(steps):
            q, v = director_step(body, q, v, t + k * h, h)
        return q.T, q @ (cross(q, v).sum(axis=0) / 2)
    for k in range(steps):
        if scheme == "gauss":
            R, W = gauss_step(body, R, W, t + k * h, h, order, form)
            R = R @ (3 * I3 - R.T @ R) / 2  # round-off of orthonormality would grow
        else:
            R, W = midpoint_step(body, R, W, t + k * h, h)
    return R, W


def derivative(make, *how, **options):
    """The change of the attitude, as a rotation vector in the body, and of W, by the x of ``make(x)``, six numbers."""
    body, R, W, h = make(TINY * 1j)
    R, W = march(body, R, W, h, *how, **options)
    return np.concatenate([vee(R.real.T @ R.imag), W.imag]) / TINY

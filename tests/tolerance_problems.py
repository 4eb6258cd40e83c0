"""Generated problems for runs to a tolerance, and solutions that are independent of every kernel.

The truth comes from Gragg, Bulirsch and Stoer's extrapolation of the modified midpoint rule, of order 14, with
`numpy.longdouble`, on W and Λ: J W' = J W × W + moments - μ n, Λ' = Λ Ŵ, from kink to kink.
"""

from typing import NamedTuple

import numpy as np

import nontwist as nt
from conftest import compiled_load, cross
from nontwist.geometry import rotations
from nontwist.inertia import convected_inertia

COLUMNS = 7
NOISE = 1e-15  # of a step in extended precision, at most
COUNTS = 2 * np.arange(1, COLUMNS + 1)


class Task(NamedTuple):
    """A problem with its tolerance."""

    body: object
    load: nt.Load
    start: dict
    t_end: float
    tolerance: float
    store: object


def spring(t, directors, w):
    x, y, z = directors[2]
    return y, -x + 0.1 * z, 0.3 * x


def turning_drag(t, directors, w):
    return -0.3 * w[0], -0.1 * w[1] + 0.2 * w[2], -0.2 * w[2] - 0.2 * w[1]


def generated(seed):
    """Return a task: a body of any kind, up to three loads whose kinks are declared, a start, and a tolerance."""
    rng = np.random.default_rng(seed)
    kind = rng.choice(["standard", "nontwisting", "suslov", "heavy_top", "heavy nontwisting"])
    euler = 10 ** rng.uniform(-1.5, 0, 3)
    R = rotations.exp(rng.uniform(-2, 2, 3) * ([0, 0, 1] if "nontwisting" in kind else 1))
    J = convected_inertia(R @ np.diag(euler) @ R.T)
    J = (J + J.T) / 2
    t_end, turn = 10 ** rng.uniform(-1, 2), 10 ** rng.uniform(-1, 1.8)
    size = float(np.trace(J) * turn / t_end**2)
    pull = 10 ** rng.uniform(-1, 0.5) * size * rng.uniform(-1, 1, 3)
    if kind == "standard":
        body = nt.standard(J)
    elif kind == "nontwisting":
        body = nt.nontwisting(J)
    elif kind == "suslov":
        body = nt.suslov(J, rng.normal(size=3))
    elif kind == "heavy_top":
        body = nt.heavy_top(J, 1.0, pull / 9.81) if moments_fit(J, pull / 9.81) else nt.standard(J)
    else:
        at = np.array([0, 0, 0.5 * np.sqrt(euler.min())])
        body = nt.with_gravity(nt.nontwisting(J), 1.0, at)
    load = nt.Load()
    for _ in range(rng.integers(0, 4)):
        load += term(rng, t_end, size)
    start = {
        "rotation": rotations.exp(rng.uniform(-2, 2, 3)),
        "material_angular_velocity": rng.normal(size=3) * turn / t_end * rng.choice([0.0, 1.0, 1.0, 1.0]),
        "project": True,
    }
    return Task(body, load, start, t_end, 10 ** rng.uniform(-11, -3), rng.choice(["end", 1]))


def moments_fit(J, at):
    """Whether a body of 1 kg with its centre there can have this inertia."""
    euler = np.trace(J) / 2 * np.eye(3) - J
    return np.linalg.eigvalsh(euler - np.outer(at, at))[0] > 0.1 * np.linalg.eigvalsh(euler)[0]


def term(rng, t_end, size):
    m, frame = 10 ** rng.uniform(-1, 1) * size * rng.uniform(-1, 1, 3), rng.choice(["body", "space"])
    along = nt.body_moment if frame == "body" else nt.space_moment
    kind = rng.choice(["table", "pulse", "sine", "damping", "state", "switched"])
    if kind == "table":
        times = np.sort(rng.uniform(0, 1.2 * t_end, rng.integers(3, 8)))
        return along(times, rng.uniform(-1, 1, (len(times), 1)) * m)
    if kind == "pulse":
        begin, shape = rng.uniform(-0.2, 1) * t_end, rng.choice(["triangle", "rectangle", "half-sine"])
        return nt.pulse(m, begin, begin + 10 ** rng.uniform(-2, 0) * t_end, shape=shape, frame=frame)
    if kind == "sine":
        return nt.sine(m, 10 ** rng.uniform(-1, 1.3) / t_end, phase=rng.uniform(0, 6), frame=frame)
    if kind == "damping":
        return nt.damping(size * t_end * 10 ** rng.uniform(-2, 0.5))
    if kind == "state":
        function = (spring, turning_drag)[rng.integers(2)]
        return (size * (t_end if function is turning_drag else 1)) * compiled_load(function)
    switch, rate = rng.uniform(0.1, 0.9) * t_end, 10 ** rng.uniform(-1, 1) / t_end
    return along(lambda t: m * (np.cos(rate * t) if t < switch else -0.5), breakpoints=[switch])


class Motion:
    """The equations of a task in extended precision."""

    def __init__(self, task):
        body, self.load = task.body, task.load
        self.J, self.dead, self.C = map(np.longdouble, (body.convected_inertia, body.dead_force, task.load.damping))
        cofactors = cross(self.J[[1, 2, 0]], self.J[[2, 0, 1]])
        self.inverse = cofactors / (self.J[0] @ cofactors[0])
        if body.axis is not None:  # W' = J⁻¹ (g - μ n), n·W' = 0
            v = self.inverse @ body.axis
            self.inverse = self.inverse - np.outer(v, v) / (body.axis @ v)

    def rates(self, times, y):
        """Return y' at (k,) times, y = W and Λ by rows, (k, 12)."""
        W, R, load = y[:, :3], y[:, 3:].reshape(-1, 3, 3), self.load
        at, rows = times.astype(float), R.swapaxes(1, 2)
        g = cross(W @ self.J, W) - W @ self.C.T + cross(np.eye(3), self.dead @ R).sum(1)
        if load.terms:
            space = np.longdouble(load.sample(at, "space"))
            if load.called.terms:
                w = (R @ W[:, :, None])[:, :, 0].astype(float)
                space += [load.called.state_moment(*one) for one in zip(at, rows.astype(float), w, strict=True)]
            g = g + load.sample(at, "body") + (rows @ space[:, :, None])[:, :, 0]
        turn = cross(R, W[:, None] + 0 * R)  # rows r_x of Λ: (Λ Ŵ)_x = r_x × W
        return np.concatenate([g @ self.inverse, turn.reshape(-1, 9)], axis=1)

    def step(self, t, H, y, last, speed):
        """Return y(t + H) and an estimate of the error, of W over `speed`; no load is taken later than at `last`."""
        h = H / np.longdouble(COUNTS)
        before = np.repeat(y[None], COLUMNS, axis=0)
        now = before + h[:, None] * self.rates(np.repeat(t, COLUMNS), before)
        ends = [None] * COLUMNS
        for m in range(1, COUNTS[-1] + 1):
            f = self.rates(np.minimum(t + m * h, last), now)
            for i in np.flatnonzero(m == COUNTS):
                ends[i] = (now[i] + before[i] + h[i] * f[i]) / 2
            before, now = now, before + 2 * h[:, None] * f
        table = ends
        for k in range(1, COLUMNS):
            size = (np.longdouble(COUNTS[k:]) / COUNTS[:-k]) ** 2 - 1
            previous, table = table, [b + (b - a) / s for a, b, s in zip(table[:-1], table[1:], size, strict=True)]
        scale = np.concatenate([np.full(3, max(speed, abs(table[-1][:3]).max()) + 1e-300), np.ones(9)])
        return table[-1], float((abs(table[-1] - previous[-1]) / scale).max())


def truth(task, times, speed=0.0):
    """Return Λ and W at increasing times, and the largest |W|; `speed`: about that, where it is known."""
    motion, body, accuracy = Motion(task), task.body, min(max(1e-6 * task.tolerance, 2e-17), 1e-12)
    W = np.array(task.start["material_angular_velocity"])
    if body.axis is not None:
        W = W - (body.axis @ W) * body.axis
    R = np.longdouble(nt.rotation(task.start["rotation"]).as_matrix())
    y, here, found, largest = np.concatenate([W, R.ravel()]), np.longdouble(0), [], 0.0
    borders = sorted({*(b for b in task.load.breakpoints if 0 < b < task.t_end), task.t_end, *times})
    for border in borders:
        H, rejected = task.t_end / 4, np.inf  # a short stretch is no reason for short steps in the next
        last, goal = np.longdouble(np.nextafter(border, -1)), np.longdouble(border)
        while here < goal:
            size = goal - here if goal - here < 1.2 * H else np.longdouble(H)
            try:  # a step that is far too long makes numbers huge
                with np.errstate(all="ignore"):
                    z, error = motion.step(here, size, y, last, max(speed, largest))
            except ValueError:  # of a load
                z, error = y, np.inf
            if not error <= accuracy and not (error < NOISE and error > 0.1 * rejected):  # else it is round-off
                H, rejected = 0.6 * float(size), error
                continue
            rejected = np.inf
            H = max(H, float(size) * (1.3 if error < 0.01 * accuracy else 1.0))
            y, here = z, goal if size == goal - here else here + size
            largest = max(largest, float(np.sqrt((y[:3] ** 2).sum())))
        if border in times:
            found.append(y)
    states = np.array(found)
    return states[:, 3:].reshape(-1, 3, 3), states[:, :3], largest


def error_of(run, task, most=8):
    """Return the error of a run: of the attitude (rad), and of W relative to its largest, at up to `most` states."""
    k = np.unique(np.linspace(1, len(run.time) - 1, most).astype(int))
    speed = float(np.linalg.norm(run.material_angular_velocity, axis=1).max())
    R, W, largest = truth(task, run.time[k].tolist(), speed=speed)
    chord = np.sqrt(((R - run.directors[k].swapaxes(1, 2)) ** 2).sum(axis=(1, 2))).astype(float) / np.sqrt(8)
    angle = 2 * np.arcsin(np.minimum(1, chord))
    size = max(largest, speed)
    gap = np.sqrt(((W - run.material_angular_velocity[k]) ** 2).sum(axis=1)).astype(float)
    return float(max(angle.max(), gap.max() / size if size > 0 else 0.0))

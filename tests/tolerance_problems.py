"""Generated problems for runs to a tolerance, and their error against SciPy's DOP853 on Euler's equations."""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import nontwist as nt
from conftest import compiled_load
from nontwist.geometry import rotations
from nontwist.inertia import convected_inertia
from nontwist.loads.load import moment_at
from nontwist.models.equations import hat


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


def truth(task, times):
    """Return Λ and W at these times by DOP853, from kink to kink, at a ten-thousandth of the tolerance at most.

    J W' = J W × W + moments - μ n and Λ' = Λ Ŵ keep W free of what Λ is off from a rotation. Of the split form that
    `continuous` takes, errors are up to a thousand times as large, and larger than the tolerance.
    """
    rtol, body, load = min(1e-9, max(1e-13, 1e-4 * task.tolerance)), task.body, task.load
    J, n = body.convected_inertia, body.axis
    inverse = np.linalg.inv(J)
    if n is not None:  # n·W' = 0
        v = inverse @ n
        inverse = inverse - np.outer(v, v) / (n @ v)
    W = np.array(task.start["material_angular_velocity"], dtype=float)
    y = np.concatenate([W if n is None else W - (n @ W) * n, np.ravel(task.start["rotation"])])
    borders = np.unique([0.0, *(b for b in load.breakpoints if 0 < b < task.t_end), *times])
    states = {0.0: y}
    for first, last in pairwise(borders):
        ends = np.nextafter(first, last), np.nextafter(last, first)

        def rates(t, y, ends=ends):
            R, turn = y[3:].reshape(3, 3), hat(y[:3])
            moment = moment_at(load, min(max(t, ends[0]), ends[1]), R.T, R @ y[:3])
            if body.dead_force.any():
                moment = moment + sum(d @ hat(f) for d, f in zip(R.T, body.dead_force, strict=True))
            return np.concatenate([inverse @ ((J @ y[:3]) @ turn + moment @ R), (R @ turn).ravel()])

        states[last] = solve_ivp(rates, (first, last), states[first], "DOP853", rtol=rtol, atol=rtol / 100).y[:, -1]
    found = np.array([states[t] for t in times])
    return Rotation.from_matrix(found[:, 3:].reshape(-1, 3, 3)), found[:, :3]


def error_of(run, task, most=8):
    """Return the error of a run: of the attitude (rad), and of W relative to its largest, at up to `most` states."""
    k = np.unique(np.linspace(1, len(run.time) - 1, most).astype(int))
    rotation, W = truth(task, run.time[k].tolist())
    turned = (run.rotation[k].inv() * rotation).magnitude()
    speed = np.linalg.norm(run.material_angular_velocity, axis=1).max()
    gap = np.linalg.norm(run.material_angular_velocity[k] - W, axis=1)
    return float(max(turned.max(), gap.max() / speed if speed > 0 else 0.0))

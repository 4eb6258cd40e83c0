"""Every kernel computes on plain floats what its machine code does, bit for bit."""

from collections import defaultdict
from importlib import import_module
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from nontwist.exact import free_bodies, free_constants, suslov_body
from nontwist.geometry import frame_kernels, linking, path_kernels
from nontwist.kernels.kernel import Kernel

ROOT = Path(__file__).parents[2] / "src"
rng = np.random.default_rng(5)


def unit(*shape):
    """Return random vectors of length 1."""
    x = rng.normal(size=shape)
    return x / np.linalg.norm(x, axis=-1, keepdims=True)


def path(m, n, step=0.2):
    """Return paths on the sphere that rest, leap and turn back."""
    x = np.cumsum(step * rng.normal(size=(m, n, 3)) * rng.choice([0.0, 1e-4, 1.0, 1.0], size=(m, n, 1)), axis=1)
    x += unit(3)
    return x / np.linalg.norm(x, axis=-1, keepdims=True)


def across(u):
    """Return unit vectors normal to the first vector of each path."""
    x = np.cross(u[:, 0], unit(len(u), 3))
    return x / np.linalg.norm(x, axis=-1, keepdims=True)


def paths():
    """Paths with an antipodal step in the last one, and with few samples."""
    bent = path(3, 14)
    bent[2, 7] = -bent[2, 6]
    return [path(2, 30), bent, path(2, 4), path(1, 2)]


def streams():
    """Quaternions of streams: turned slowly, by half turns, missing, not of length 1."""
    for wrong in (False, True):
        state, q = np.zeros((4, path_kernels.SIZE)), unit(4, 4)
        for i in range(9):
            q = q + 0.3 * rng.normal(size=(4, 4))
            q /= np.linalg.norm(q, axis=1, keepdims=True)
            q[1] = [q[1, 3], 0.0, 0.0, -q[1, 0]] / np.hypot(q[1, 3], q[1, 0]) if i % 3 else q[1]
            given, at, axes = q.copy(), np.array([0.1 * i]), np.eye(3)[[1, 2, 0]]
            given[3] = np.nan if i % 2 else given[3]
            given[2] *= 1.5 if wrong and i == 4 else 1.0
            for order in (2, 4):
                yield state, given, at, order, 1.0 - 2.0 * wrong, axes, 0.1, np.zeros((4, 4))


def links():
    """Polygons: two, and one with itself."""
    a, b = (np.cumsum(rng.normal(size=(3, n)), axis=1) for n in (9, 22))
    b = np.pad(b, ((0, 0), (0, linking.SCRATCH)), mode="edge")
    same = np.pad(a, ((0, 0), (0, linking.SCRATCH)), mode="edge")
    for y, is_same, closed in ((b, 0, 0), (same, 1, 0), (same, 1, 1)):
        numbers, work = np.arange(float(y.shape[1])), np.zeros((linking.WORK, y.shape[1]))
        yield a, y, numbers, is_same, closed, 0, 2, work, *np.zeros((2, 9))


def bodies():
    """Inertias, attitudes and velocities of free bodies: any, symmetric, at rest, near the middle axis, wrong."""
    for k in range(14):
        A, R = (np.linalg.qr(rng.normal(size=(3, 3)))[0] for _ in range(2))
        A, R = A * np.linalg.det(A), R * np.linalg.det(R)
        d = [(3.0, 4.0, 5.0), (2.0, 2.0, 3.0), (1.0, 2.0, 2.0), (2.0, 2.0, 2.0), (1.0, 2.0, 3.0)][k % 5]
        J = A @ np.diag(d) @ A.T
        J = 0.5 * (J + J.T)
        W = [rng.normal(size=3), A[:, 1] + 1e-6 * A[:, 0], A[:, 1], np.zeros(3), A[:, 2]][k % 5 if k < 10 else 0]
        if k > 10:
            (J, R)[k % 2][0, 0] = (np.nan, -3.0, 9.0)[k % 3]
        yield J, R, W


def exact_cases():
    """Kernels of free bodies, and arguments for them."""
    times, principal = np.array([0.0, 0.01, -0.02, 0.3, 2.0, -50.0]), np.diag([3.0, 4.0, 5.0])
    k, full = len(times), np.array([[3.0, 0.1, 0.2], [0.1, 4.0, 0.0], [0.2, 0.0, 5.0]])
    for J, R, W in bodies():
        yield free_bodies.momentum_cycle, (J, W)
        for t, is_constrained in product((times, times * 1e15), (0, 1)):
            yield free_bodies.free_top, (J, W, R, t, is_constrained, np.zeros((k, 3, 3)), np.zeros((k, 3)))
    for is_constrained, J, t in product((0, 1), (principal, full), (times, times * 1e15)):
        p, W = np.zeros((2, 1 + k, 4)), np.zeros((2, 1 + k, 3))
        p[:, 0], W[:, 0] = unit(2, 4), rng.normal(size=(2, 3)) * [1.0, 1.0, 0.0]
        yield free_bodies.free_members, (np.stack([J, J + np.eye(3)]), is_constrained, t, 1, 0, 2, p, W)
    for J, t in product((principal, full), ([0.0, 0.1, 3.0], [-0.5], [])):
        motion = suslov_body._motion(J, [0.0, 0.0, 1.0], [1.0, 2.0, 0.0])
        ends, steps = suslov_body._schedule(motion, np.array(t))
        yield suslov_body._set_attitudes, (R, *motion[:3], ends, steps, np.zeros((len(ends), 3, 3)))


def cases():
    """Kernels, and arguments for them."""
    yield from exact_cases()
    yield from ((path_kernels.count, given) for given in streams())
    yield from ((linking.row_integrals, given) for given in links())
    for u in paths():
        m, n = u.shape[:2]
        for order in (2, 4):
            yield path_kernels.error_angles, (u, order, np.empty((m, n)))
        for closed in (0, 1):
            node, nodes = np.zeros((m, n), dtype=np.int64), np.zeros(n, dtype=np.int64)
            yield frame_kernels.smooth_rolls, (u, closed, np.zeros((m, n)), node, nodes, np.zeros((3, n)))
        roll, node = 0.1 * rng.normal(size=(m, n)), rng.integers(0, 2, size=(m, n))
        roll[:, ::2] = 0.0
        yield frame_kernels.transport_samples, (u, across(u), roll, node, np.zeros((m, n, 3, 3)))
        yield frame_kernels.solid_angles, (u, np.zeros(m))
        points = np.cumsum(u + rng.normal(size=u.shape), axis=1)
        points[:, 1] = points[:, 0]
        yield frame_kernels.double_reflection, (points, u, across(u), np.zeros((m, n, 3, 3)))
        yield path_kernels.angles, (unit(n, 3), np.stack([unit(n, 3)] * 3, 1), np.zeros(n))


CASES = defaultdict(list)
for one, given in cases():
    CASES[one].append(given)
FREE = {free_bodies.free_top, free_bodies.free_members}
IN_LANES = {linking.row_integrals}  # whose sums have another order


def kernels():
    """Return every kernel of the package that takes numbers and arrays, and no address of a block, by its name."""
    for file in sorted((ROOT / "nontwist").rglob("*.py")):
        if "@kernel(" in file.read_text(encoding="utf-8"):
            module = import_module(".".join(file.relative_to(ROOT).with_suffix("").parts))
            for name, value in vars(module).items():
                is_own = isinstance(value, Kernel) and value.__module__ == module.__name__
                if is_own and not value.signature.is_address:
                    yield f"{file.stem}.{name}", value


KERNELS = dict(kernels())


@pytest.mark.parametrize("name", KERNELS)
def test_floats_equal_machine_code(name):
    kernel, results = KERNELS[name], []
    for arguments in CASES[kernel]:
        is_stream = kernel is path_kernels.count
        copies = [[a.copy() if isinstance(a, np.ndarray) else a for a in arguments] for _ in range(2)]
        one, two = kernel(*copies[0]), kernel.on_floats(*copies[1])
        assert one == two
        results.append(one)
        if kernel in FREE and np.ravel(one)[0] != free_constants.OK:
            continue  # as many times at once are left out as there are lanes
        if kernel in IN_LANES:
            np.testing.assert_allclose(copies[0][-2:], copies[1][-2:], rtol=1e-13, atol=1e-15)
            continue
        for a, b in zip(*copies, strict=True):
            np.testing.assert_array_equal(a, b)
        if is_stream:
            arguments[0][...] = copies[0][0]
    if kernel in (
        frame_kernels.transport_samples,
        frame_kernels.solid_angles,
        path_kernels.count,
        free_bodies.free_members,
    ):
        assert len(set(results)) > 1  # faults are among the cases

"""The discrete multiplier μ tends to the exact one, μ = n·J⁻¹(JW × W + M)/(n·J⁻¹n), with the square of the step."""

import numpy as np
import pytest

from conftest import PAPER_J
from nontwist import Continuous, integrate, nontwisting, rotations, space_moment, suslov
from nontwist.paper.cases import CASES

FULL_J, AXIS = np.array([[3, 0.2, 0.4], [0.2, 4, -0.3], [0.4, -0.3, 5]]), np.array([0.3, 0.2, 1])
W0, T_END, COUNTS = np.array([1.0, -2.0, 0.1]), 1.0, (100, 200, 400)
PROBLEMS = {
    "case 2": (nontwisting(PAPER_J), [0, 0, 0], CASES[2].load(), lambda t: CASES[2].load().sample(t, "body")),
    "case 3": (nontwisting(PAPER_J), [1.5, 4.5, 0], CASES[3].load(), lambda t: CASES[3].load().sample(t, "body")),
    "Suslov": (suslov(FULL_J, AXIS), W0, space_moment(lambda t: (np.sin(3 * t), 1, 0.3)), None),
}


def exact(name, times):
    """μ at `times`, on states of DOP853 at 1e-11."""
    body, W, load, M = PROBLEMS[name]
    fine = Continuous(rtol=1e-11, atol=1e-13)
    run = integrate(body, times=np.append(0, times), material_angular_velocity=W, load=load, integrator=fine)
    q, w = run.directors[1:], np.cross(run.directors[1:], run.director_velocities[1:]).sum(1) / 2
    W = (q @ w[..., None])[..., 0]
    m = np.stack([np.sin(3 * times), np.ones_like(times), np.full_like(times, 0.3)], axis=1)
    M = (q @ m[..., None])[..., 0] if M is None else M(times)
    J, n = body.convected_inertia, body.axis
    row = np.linalg.solve(J, n)
    return (np.cross(W @ J, W) + M) @ row / (n @ row)


@pytest.fixture(scope="module")
def truth():
    """Exact μ at the middles and ends of the steps of every run."""
    times = np.unique([T_END * k / (2 * n) for n in COUNTS for k in range(1, 2 * n)])
    return {name: (times, exact(name, times)) for name in PROBLEMS}


def slopes(name, scheme, truth, paired):
    body, W, load, _ = PROBLEMS[name]
    times, mu = truth[name]
    errors = []
    for n in COUNTS:
        how = {"t_end": T_END, "step": T_END / n, "material_angular_velocity": W, "load": load}
        found, at = integrate(body, integrator=scheme, order=2, **how).multipliers[:, -1], np.arange(n) + 0.5
        if paired:
            found, at = (found[1:] + found[:-1]) / 2, at[:-1] + 0.5
        errors.append(abs(found - mu[np.searchsorted(times, at * T_END / n - 1e-9)]).max())
    return np.log2(np.divide(errors[:-1], errors[1:]))


@pytest.mark.parametrize(
    ("name", "scheme", "order", "paired"),
    [
        ("case 2", "lie-midpoint", 2, False),
        ("case 2", "energy-momentum", 2, False),
        ("case 3", "lie-midpoint", 2, False),
        ("case 3", "energy-momentum", 2, False),
        ("Suslov", "lie-midpoint", 2, False),
        ("Suslov", "energy-momentum", 2, True),
        ("Suslov", "energy-momentum", 1, False),  # the alternating part
    ],
)
def test_order(name, scheme, order, paired, truth):
    """Order 2; in the director scheme the mean of two steps where neither W nor W' is 0 at the start."""
    assert slopes(name, scheme, truth, paired) == pytest.approx(order, abs=0.1)


def test_the_alternating_part_starts_with_the_normal_part_of_the_first_step():
    """N is 0 at even nodes and -h²/2 sym(Ŵ Ŵ') at odd ones, to leading order."""
    body, h = suslov(FULL_J, AXIS), 1e-3
    J, n = body.convected_inertia, body.axis
    gyroscopic, row = np.cross(J @ W0, W0), np.linalg.solve(J, n)
    rate = np.linalg.solve(J, gyroscopic - row @ gyroscopic / (n @ row) * n)
    S = rotations.hat(W0) @ rotations.hat(rate)
    run = integrate(body, t_end=4 * h, step=h, material_angular_velocity=W0, integrator="energy-momentum")
    g = run.director_velocities @ np.swapaxes(run.directors, 1, 2)
    N = (g + np.swapaxes(g, 1, 2)) / 2 / h**2
    leading = -(S + S.T) / 4
    assert abs(leading).max() > 0.1
    assert N[1] == pytest.approx(leading, abs=2e-3)
    assert N[3] == pytest.approx(leading, abs=5e-3)
    assert N[[0, 2]] == pytest.approx(np.zeros((2, 3, 3)), abs=2e-3)

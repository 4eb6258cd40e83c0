"""The paper's scheme and its multipliers against what the derivation in its module says."""

import numpy as np
import pytest

import nontwist as nt
from nontwist.validation.loaded_bodies import COUNTS, MOTIONS, T_END, exact_multiplier
from nontwist.validation.problems import FINE, KICK, SAMPLES

EM = {"integrator": "energy-momentum", "order": 2}


def test_constraint_in_the_mean(paper_body):
    """Under load the velocities leave the tangent space by a mode of alternating sign."""
    run = nt.simulate(paper_body, t_end=1, step=0.005, load=nt.pulse((-123.625, -53.75, 0)), **EM)
    q, v = run.directors.values, run.director_velocities.values
    qm, u = (q[1:] + q[:-1]) / 2, np.diff(q, axis=0) / 0.005
    g = np.sum(u[:, 0] * qm[:, 1] - u[:, 1] * qm[:, 0], axis=1) / 2
    assert abs(g).max() < 1e-11
    assert 1e-4 < abs(np.sum(v[:, 0] * q[:, 1], axis=1)).max() < 1.2e-3


def test_multipliers_of_single_steps():
    """The mean of two steps, of order 2, is a check."""
    body, W, load = MOTIONS["Suslov body"]
    how = {"material_angular_velocity": W, "load": load}
    times = np.unique([T_END * (2 * k + 1) / (2 * n) for n in COUNTS for k in range(n)])
    mu = exact_multiplier(nt.integrate(body, times=np.append(0, times), integrator=FINE, **how), load)[1:]
    errors = []
    for n in COUNTS:
        found = nt.integrate(body, t_end=T_END, step=T_END / n, integrator="energy-momentum", order=2, **how)
        middle = T_END / n * (np.arange(n) + 0.5)
        errors.append(abs(found.multipliers[:, -1] - mu[np.searchsorted(times, middle - 1e-9)]).max())
    assert np.log2(np.divide(errors[:-1], errors[1:])) == pytest.approx(1, abs=0.1)


def test_start_of_the_alternating_part():
    """N is 0 at even nodes and -h²/2 sym(Ŵ Ŵ') at odd ones, to leading order."""
    body, W0, h = SAMPLES["suslov"], np.array(KICK), 1e-3
    J, n = body.convected_inertia, body.axis
    gyroscopic, row = np.cross(J @ W0, W0), np.linalg.solve(J, n)
    rate = np.linalg.solve(J, gyroscopic - row @ gyroscopic / (n @ row) * n)
    S = nt.rotations.hat(W0) @ nt.rotations.hat(rate)
    run = nt.integrate(body, t_end=4 * h, step=h, material_angular_velocity=W0, integrator="energy-momentum")
    g = run.director_velocities @ np.swapaxes(run.directors, 1, 2)
    N = (g + np.swapaxes(g, 1, 2)) / 2 / h**2
    leading = -(S + S.T) / 4
    assert abs(leading).max() > 0.1
    assert N[1] == pytest.approx(leading, abs=2e-3)
    assert N[3] == pytest.approx(leading, abs=5e-3)
    assert N[[0, 2]] == pytest.approx(np.zeros((2, 3, 3)), abs=2e-3)

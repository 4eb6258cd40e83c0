"""The alternating part of the multipliers of the director scheme; orders of μ are checks of `nontwist.validation`."""

import numpy as np
import pytest

from nontwist import integrate, rotations
from nontwist.validation.loaded_bodies import COUNTS, MOTIONS, T_END, exact_multiplier
from nontwist.validation.problems import FINE, KICK, SAMPLES


def test_multipliers_of_single_steps_are_of_order_one():
    """The mean of two steps, of order 2, is a check."""
    body, W, load = MOTIONS["Suslov body"]
    how = {"material_angular_velocity": W, "load": load}
    times = np.unique([T_END * (2 * k + 1) / (2 * n) for n in COUNTS for k in range(n)])
    mu = exact_multiplier(integrate(body, times=np.append(0, times), integrator=FINE, **how), load)[1:]
    errors = []
    for n in COUNTS:
        found = integrate(body, t_end=T_END, step=T_END / n, integrator="energy-momentum", order=2, **how)
        middle = T_END / n * (np.arange(n) + 0.5)
        errors.append(abs(found.multipliers[:, -1] - mu[np.searchsorted(times, middle - 1e-9)]).max())
    assert np.log2(np.divide(errors[:-1], errors[1:])) == pytest.approx(1, abs=0.1)


def test_the_alternating_part_starts_with_the_normal_part_of_the_first_step():
    """N is 0 at even nodes and -h²/2 sym(Ŵ Ŵ') at odd ones, to leading order."""
    body, W0, h = SAMPLES["suslov"], np.array(KICK), 1e-3
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

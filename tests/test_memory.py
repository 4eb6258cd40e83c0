"""Loads with memory: order, exchange of momentum, continuation, ensembles, tolerance, refusals."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from nontwist import Gauss, integrate, memory_load, standard

J, FIELD, START = np.array([1.0, 2.0, 3.0]), np.array([0.3, 0.2, 1.0]), np.array([0.5, 1.2, -0.4])
AXIS, H0, LAG = np.array([0.6, 0.0, 0.8]), 0.4, 0.4


def rods(t, z, directors, W):
    """Two rods, magnetised along the first two directors by the field and its rate, with a lag and with saturation."""
    b = directors @ FIELD
    rate = np.cross(b, W)
    return np.array([(1.2 * b[0] - z[0]) / LAG + 0.3 * rate[0], np.tanh(3 * b[1] + z[0]) - 2 * z[1] * np.cos(t)])


def torque(t, z, directors, W):
    return np.cross(np.array([z[0], z[1], 0.0]), directors @ FIELD) - 0.1 * z[1] * W


RODS = memory_load(rods, torque, [0.1, -0.2], frame="body", compiled=True)


def reference(t_end):
    """Return directors, W and z of the rods by DOP853."""

    def rates(t, y):
        q, W, z = y[:9].reshape(3, 3), y[9:12], y[12:]
        turned = np.cross(W @ q, q)
        return np.concatenate([turned.ravel(), (torque(t, z, q, W) - np.cross(W, J * W)) / J, rods(t, z, q, W)])

    y0 = np.concatenate([np.eye(3).ravel(), START, [0.1, -0.2]])
    return solve_ivp(rates, (0, t_end), y0, method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]


@pytest.mark.parametrize("order", [2, 4, 6, 8])
def test_order(order):
    found, known = [], reference(4)
    for n in (32, 64):
        run = integrate(
            standard(J), t_end=4, step=4 / n, load=RODS, material_angular_velocity=START, integrator=Gauss(order)
        )
        end = np.concatenate([run.directors[-1].ravel(), run.material_angular_velocity[-1], run.states.internal[-1]])
        found.append(abs(end - known).max())
    assert np.log2(found[0] / found[1]) == pytest.approx(order, abs=0.25)


def friction(t, z, directors, W):
    return 0.3 * np.sin(1.7 * t) - 0.2 * (z / 0.05 - AXIS @ W)


def reaction(t, z, directors, W):
    return z[0] * np.cross(AXIS, W) - AXIS * friction(t, z, directors, W)[0]


@pytest.mark.parametrize("order", [2, 8])
def test_momentum_that_is_exchanged_is_kept(order):
    """The total momentum of body and wheel over 10^4 steps."""
    wheel = memory_load(friction, reaction, H0, frame="body", compiled=True)
    start = {"material_angular_velocity": START, "integrator": Gauss(order)}
    run = integrate(standard(J + 1), t_end=1e3, step=0.1, load=wheel, **start)
    total = run.rotation.apply((J + 1) * run.material_angular_velocity + run.states.internal * AXIS)
    assert abs(total - total[0]).max() < 2e-14
    assert np.ptp(run.states.internal) > 0.1

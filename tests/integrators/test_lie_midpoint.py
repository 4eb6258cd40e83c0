"""The rotation-based step against the balances that its module derives."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import nontwist as nt
from conftest import BODIES, LOADS, PAPER_J

LIE = {"integrator": "lie-midpoint", "order": 2, "step": 0.01, "t_end": 0.4, "project": True}


@pytest.mark.parametrize("load", [None, LOADS["sum"]() + LOADS["state"]()])
@pytest.mark.parametrize("name", BODIES)
def test_impulses_and_tangent_velocities(name, load):
    """Δπ = h m - h μ Λ_m n, with the moment of dead forces in m; v_i·d_j + v_j·d_i = 0 at every node."""
    body = BODIES[name]()
    run = nt.simulate(body, angular_velocity=[1, -2, 0.5], load=load, **LIE)
    q = run.directors.values
    qm = (q[1:] + q[:-1]) / 2
    impulse = run.moment.values + np.cross(qm, body.dead_force).sum(1)
    if body.axis is not None:
        impulse -= run.multipliers.values * (body.axis @ qm)
    change = np.diff(run.spatial_momentum.values, axis=0)
    assert change == pytest.approx(0.01 * impulse, abs=1e-12 * abs(run.spatial_momentum.values).max())
    g = run.director_velocities.values @ q.mT
    assert abs(g + g.mT).max() < 1e-13


def test_the_step_is_symmetric():
    """A step back from the end with the reversed velocity returns to the start."""
    body, load = BODIES["suslov"](), nt.space_moment(lambda t: (1, 2, 3))
    there = nt.integrate(body, angular_velocity=[1, -2, 0.5], load=load, **LIE)
    w = there.to_dataset().angular_velocity[-1].values
    back = nt.integrate(body, rotation=there.rotation[-1], angular_velocity=-w, load=load, **LIE)
    assert back.directors[-1] == pytest.approx(there.directors[0], abs=1e-12)


def test_continues_the_director_scheme():
    """Whose velocities are not tangent."""
    body, how = nt.nontwisting(PAPER_J), {"load": nt.sine([30, 10, 0], 2), "step": 0.01}
    first = nt.integrate(body, t_end=0.2, angular_velocity=[1, -2, 0], integrator="energy-momentum", **how)
    second = nt.integrate(body, t_end=0.4, start=first, integrator="lie-midpoint", **how)
    assert second.time[0] == 0.2
    assert abs(second.to_dataset().twist_rate).max() < 1e-13


@pytest.mark.parametrize("name", ["lie-midpoint", "energy-momentum", "gauss", "split"])
def test_tiny_turns_add_up(name):
    steps, turn = 10**5, 1e-17
    how = {"t_end": steps, "step": 1.0, "store": "end", "integrator": name, "order": 2}
    start = Rotation.from_rotvec([0, np.pi / 2, 0])  # no component of its quaternion that turns is near 0
    q = nt.integrate(
        nt.standard([1, 1, 1]), rotation=start, material_angular_velocity=[0, turn, 0], **how
    ).states.quaternion
    turned = Rotation.from_quat(q[0]).inv() * Rotation.from_quat(q[-1])
    assert abs(turned.as_rotvec() - [0, steps * turn, 0]).max() < 4e-16

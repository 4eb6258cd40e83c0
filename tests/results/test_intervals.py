"""What is counted over the intervals: the moment of the constraint in space, and the twist."""

import numpy as np
import pytest

import nontwist as nt
from conftest import NONTWISTING, STANDARD

J = [[3, 0.2, -0.1], [0.2, 4, 0.3], [-0.1, 0.3, 5]]
WEIGHT = 1.5, (0.3, 0.1, 0.4)
HEAVY = nt.with_gravity(NONTWISTING, *WEIGHT)
BODIES = {"heavy": HEAVY, "general axis": nt.with_gravity(nt.suslov(J, (1, 2, 2)), *WEIGHT)}
LOAD = nt.sine((0.5, 0.2, 0.7), frequency=0.3) + nt.damping(0.1)
SPIN = {"material_angular_velocity": (0.3, 1.2, 0)}


@pytest.fixture(scope="module")
def truth():
    """Mean moments of the constraint over eight intervals: −μ d3 of fine steps, without the balance of momentum."""
    found = {}
    for name, body in BODIES.items():
        n = body.axis
        fine = {"t_end": 2, "step": 2 / 16384, "integrator": "gauss", "order": 4, "project": True, "load": LOAD, **SPIN}
        run, states = nt.integrate(body, store=2, **fine), nt.integrate(body, **fine)
        moment = -run.multipliers[:, -1:] * (states.rotation[1::2].as_matrix() @ n)
        found[name] = moment.reshape(8, -1, 3).mean(axis=1)
    return found


CELLS = [
    ("heavy", "split", 4),
    ("general axis", "lie-midpoint", 2),
    ("general axis", "energy-momentum", 2),
    ("general axis", "gauss", 2),
    ("general axis", "gauss", 4),
    ("general axis", "gauss", 6),
]


@pytest.mark.parametrize(("name", "integrator", "order"), CELLS)
def test_order_of_the_constraint_moment(name, integrator, order, truth):
    errors, counts = [], (32, 64) if order == 2 else (8, 16)
    for n in counts:
        how = {"integrator": integrator, "order": order, "load": LOAD, "project": True}
        run = nt.simulate(BODIES[name], t_end=2, step=2 / n, store=n // 8, **how, **SPIN)
        errors.append(abs(run.spatial_reaction_moment.values - truth[name]).max())
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.1)


@pytest.mark.parametrize(("integrator", "order"), [("lie-midpoint", 2), ("energy-momentum", 2), ("gauss", 4)])
def test_constraint_moment_of_a_gyrostat(integrator, order):
    """The momentum of the body changes by the moments of rotors, which `moment` has, of gravity and constraint."""
    wheel, off = nt.rotor((1, 0, 0.5), (0, 1), (0.2, 0.8)), []
    for n in (128, 256):
        run = nt.simulate(HEAVY, t_end=1, step=1 / n, integrator=integrator, order=order, load=wheel, **SPIN)
        d3 = nt.simulate(HEAVY, times=run.midtime.values, step=1 / 512, load=wheel, **SPIN).directors[:, 2].values
        off.append(abs(run.spatial_reaction_moment.values - run.reaction_moment.values[:, None] * d3).max())
    assert np.log2(off[0] / off[1]) == pytest.approx(2, abs=0.1)


@pytest.mark.parametrize("order", [2, 16])
def test_twist_beyond_half_a_turn(order):
    """About its own axis a body turns steadily, and twists as far as it turns."""
    how = {"step": 1, "integrator": "gauss", "order": order, "angular_velocity": (0, 0, 0.8 * order / 2)}
    run = nt.simulate(STANDARD, t_end=6, **how)
    assert (run.mean_twist_rate * 1).values == pytest.approx(np.full(6, 0.8 * order / 2), rel=1e-14)


def test_twist_of_tumbling():
    body, start = nt.heavy_top([3, 4, 1], 1, (0, 0, 0.2)), {"t_end": 4, "material_angular_velocity": (0.4, 0.2, 2)}
    fine = nt.simulate(body, step=1 / 512, integrator="gauss", order=8, **start)
    coarse = nt.simulate(body, step=0.5, integrator="gauss", order=12, **start)
    other = nt.simulate(body, step=1 / 512, integrator="lie-midpoint", **start)
    expected = np.diff(nt.twist(fine).twist_angle.values[::256]) / 0.5
    assert coarse.mean_twist_rate.values == pytest.approx(expected, abs=1e-8)
    assert other.mean_twist_rate.values.reshape(8, -1).mean(axis=1) == pytest.approx(expected, abs=1e-5)


def test_twist_adds_up():
    body, start = nt.standard(J), {"material_angular_velocity": (0.4, 0.2, 2), "integrator": "gauss", "step": 0.1}
    plain = nt.integrate(body, t_end=2, **start)
    asked = nt.integrate(body, times=[0, 0.333, 1.7, 2], t_end=2, **start)
    events = nt.integrate(body, t_end=2, events=lambda t, state: state.material_angular_velocity[0] - 0.1, **start)
    assert asked.twist.sum() == pytest.approx(plain.twist.sum(), abs=1e-12)
    assert events.twist == pytest.approx(plain.twist, abs=1e-13)


def test_twist_of_held_bodies():
    for name in ("lie-midpoint", "energy-momentum", "gauss", "split"):
        run = nt.integrate(HEAVY, t_end=2, step=0.1, integrator=name, **SPIN)
        assert abs(run.twist).max() < 1e-15
    free = {"t_end": 1, "step": 0.5, "angular_velocity": (1, 2, 3)}
    assert "mean_twist_rate" not in nt.simulate(nt.standard(J), integrator="exact", **free)
    assert "mean_twist_rate" not in nt.simulate(nt.standard(J), integrator="split", **free)

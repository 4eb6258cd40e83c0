"""Which invariants a finished run has, and how far they drifted, told by the dataset alone."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import nontwist as nt
from conftest import BODIES
from nontwist.analysis.invariants import drifts, twist_defect
from nontwist.integrators import INTEGRATORS

PULSE = nt.pulse([1, 2, 3], 0.1, 0.5, frame="space")
TWO_FORCES = nt.DirectorSystem(np.diag([1.0, 1.2, 0.8]), dead_force=np.diag([1.0, 1.0, 0.0]))
ALONG_A_LINE = nt.potential([0.1, 0.2, 0.7], linear=[1, 0, 2]) + nt.potential([0.3, 0.6, 2.1], linear=[0, 1, 0])
CASES = {
    "standard": (BODIES["standard"], None, {"kinetic_energy", "spatial_momentum"}),
    "nontwisting": (BODIES["nontwisting"], None, {"kinetic_energy", "material_momentum"}),
    "suslov": (BODIES["suslov"], None, {"kinetic_energy"}),
    "held about x": (lambda: nt.suslov([3, 4, 5], [1, 0, 0]), None, {"kinetic_energy", "material_momentum"}),
    "heavy top": (BODIES["heavy_top"], None, {"total_energy", "vertical_momentum"}),
    "two forces": (lambda: TWO_FORCES, None, {"total_energy"}),
    "heavy nontwisting": (lambda: nt.with_gravity(BODIES["nontwisting"](), 1, (0, 0.2, 0.4)), None, {"total_energy"}),
    "vectors along a line": (BODIES["standard"], ALONG_A_LINE, {"total_energy", "vertical_momentum"}),
    "pushed": (BODIES["standard"], PULSE, {"energy_balance"}),
    "heavy and pushed": (BODIES["heavy_top"], PULSE, {"energy_balance"}),
    "pushed on an orbit": (BODIES["standard"], nt.gravity_gradient(0.8) + PULSE, set()),
}


@pytest.mark.parametrize("case", CASES)
def test_kept_invariants(case):
    body, load, names = CASES[case]
    run = nt.simulate(body(), t_end=1, step=0.02, material_angular_velocity=[1, -2, 3], load=load, project=True)
    found = drifts(run)
    assert set(found) == names | {"orthonormality"}
    assert max(drift.relative for drift in found.values()) < 2e-14
    assert (twist_defect(run) is None) == (body().axis is None)
    assert (twist_defect(run) or 0) < 1e-14


@pytest.mark.parametrize(("scheme", "order"), [("energy-momentum", 2), ("lie-midpoint", 2), ("gauss", 4)])
@pytest.mark.parametrize("case", ["standard", "nontwisting", "suslov", "heavy top"])
def test_drift_over_many_steps(case, scheme, order):
    """Over more: validation, invariants."""
    body, load, names = CASES[case]
    how = {"t_end": 100, "step": 0.005, "store": 1000, "integrator": scheme, "order": order}
    found = drifts(nt.simulate(body(), material_angular_velocity=[2, -3, 1.5], load=load, project=True, **how))
    assert set(found) == names | {"orthonormality"}
    assert max(drift.relative for drift in found.values()) < 1e-12
    assert found["orthonormality"].relative < 1e-14


ENDLESS = nt.sine([1, 2, 3], 0.7, frame="space")
STEPPING = [(name, order) for name, scheme in INTEGRATORS.items() for order in scheme.orders]


@pytest.mark.parametrize(
    ("case", "lost"), [("standard", 0.5), ("heavy top", 0.4), ("vectors along a line", 2.5 / np.sqrt(54))]
)
def test_drift_is_measured(case, lost):
    body, load, _ = CASES[case]
    run = nt.simulate(body(), t_end=1, step=0.1, material_angular_velocity=[1, -2, 3], load=load)
    run["kinetic_energy"][4] += 0.5
    run["spatial_momentum"][7] += np.array([0.3, 0.0, -0.4])
    pi, size = float(np.linalg.norm(run.spatial_momentum, axis=1).max()), float(run.kinetic_energy.max())
    size += np.linalg.norm(body().dead_force, axis=1).sum() + np.ptp(run.potential_energy.values) * (load is not None)
    energy, momentum, _ = drifts(run).values()
    assert energy[2:] == pytest.approx((0.5 / size, 0.5))
    assert momentum[2:] == pytest.approx((lost / pi, lost))


def test_body_hanging_at_rest():
    """K is 1e-19 J of round-off there, and V is zero: neither is the size of an energy."""
    hanging = nt.with_gravity(nt.suslov([2, 2, 2], [0, 1, 0]), 0.001, [0, 1e-3, 0])
    run = nt.simulate(hanging, t_end=1, step=0.1)
    assert drifts(run)["total_energy"].relative < 1e-14


def test_scale_of_a_balance():
    run = nt.simulate(BODIES["standard"](), t_end=1, step=0.1, angular_velocity=[1, -2, 3], load=nt.damping(4.0))
    run["load_work"][3] += 0.5
    size = float(run.kinetic_energy.max()) + abs(np.cumsum(run.load_work.values)).max()
    size += 0.1 * (np.linalg.norm(run.moment, axis=1) * np.linalg.norm(run.angular_velocity[:-1], axis=1)).max()
    assert drifts(run)["energy_balance"][2:] == pytest.approx((0.5 / size, 0.5))  # the body slows down


def test_cancelled_work_in_the_scale():
    """A rod held across: m·w vanishes term by term but for round-off, eps |m||w|h, which K alone would magnify."""
    body = nt.suslov(nt.inertia.of_cuboid(1.0, (0.004, 0.001, 1.0)), (2.0, 2.0, 0.0))
    half_turn = Rotation.from_quat([1.0, 0.0, 0.0, 0.0])
    load = nt.space_moment([0.0, 1.0], [[2.0, 0.0, 0.0]] * 2)
    run = nt.simulate(body, t_end=1, step=1, order=2, rotation=half_turn, load=load)
    K, supply = run.kinetic_energy.max().item(), 2 * np.linalg.norm(run.angular_velocity.values, axis=1).max()
    found = drifts(run)["energy_balance"]
    assert found.relative == pytest.approx(found.absolute / (K + abs(run.load_work.item()) + supply), rel=1e-9, abs=0)
    assert supply > 1e4 * K
    assert found.relative < 1e-15


def test_balance_needs_work():
    body, how = BODIES["standard"](), {"t_end": 1, "step": 0.1}
    run = nt.integrate(body, load=PULSE, material_angular_velocity=(0.1, 2, 0), **how)
    many = nt.simulate_ensemble(body, material_angular_velocity=[(0.1, 2, 0)] * 2, **how)
    without = drifts(run.to_dataset().drop_vars("load_work"))  # which the balance needs
    assert without == {name: one for name, one in drifts(run).items() if name != "energy_balance"}
    assert "energy_balance" in drifts(run)
    for other in (many, run.to_dataset().drop_vars("kinetic_energy")):
        with pytest.raises(ValueError, match=r"^expected a run of nontwist\.simulate with 'kinetic_energy'; this Dat"):
            drifts(other)

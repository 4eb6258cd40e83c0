"""split: measured orders, what it keeps exactly, and the exact motion without load at any step."""

from itertools import product
from math import fsum

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import nontwist as nt
from conftest import BODIES, PAPER_J, compiled_load
from nontwist.analysis.variables import angular_velocity, material, orthonormality_defect
from nontwist.errors import SimulationError, Status
from nontwist.integrators import Split, stack_march
from nontwist.integrators.split import HALVES, fractions, substep_nodes
from nontwist.validation.orders import swing
from nontwist.validation.problems import FINE, pushed
from refusals import says

STANDARD, HELD = nt.standard(PAPER_J), nt.nontwisting(PAPER_J)
BODY, BOTH = pushed("body"), pushed("body") + pushed("space")
ALL = BOTH + compiled_load(swing) + nt.damping([0.1, 0.2, 0.3])


@pytest.mark.parametrize(("body", "bound"), [(HELD, 1e-12), (STANDARD, 2e-15)])
def test_free_bodies_do_not_drift(body, bound):
    how = {"step": 0.005, "store": 1000, "integrator": Split(order=2)}
    run = nt.integrate(body, t_end=5000, material_angular_velocity=[6, -18, body.axis is None], **how).to_dataset()
    assert run.orthonormality_defect.max() < 1e-12
    assert abs(run.kinetic_energy / run.kinetic_energy[0] - 1).max() < bound
    kept = run.spatial_momentum if body.axis is None else run.material_momentum
    assert abs(kept - kept[0]).max() < 1e-12 * 76


REST = {
    "after": nt.pulse([8.0, -3.0, 0.0], 0, 1),
    "before, between": nt.pulse([8.0, -3.0, 0.0], 0.303, 0.611) + nt.pulse([-2.0, 5.0, 0.0], 1.5, 2),
    "table": nt.body_moment([0, 0.4, 0.7, 0.9, 1.4, 1.6, 1.8, 2], np.outer([0, 0, 1, 0, 0, 3, 0, 0], [2, -3, 0])),
}


@pytest.mark.filterwarnings("ignore:.*off the grid of step")
@pytest.mark.parametrize(("load", "store"), [*zip(REST.values(), [1, 7, "end"], strict=True)], ids=REST)
@pytest.mark.parametrize("body", [HELD, STANDARD], ids=["non-twisting", "standard"])
def test_exact_motion_without_moments(body, load, store):
    """A function of time is not known to vanish, so every step is taken; means over intervals straddle the borders."""
    stepped = nt.body_moment(lambda t: load.sample([t], "body")[0], breakpoints=load.breakpoints)
    how = {"t_end": 2, "step": 0.01, "store": store, "integrator": Split(6), "material_angular_velocity": [1, -2, 0]}
    one, other = nt.integrate(body, load=load, **how), nt.integrate(body, load=stepped, **how)
    for quantity in ("directors", "director_velocities", "multipliers", "moment", "load_work"):
        assert getattr(one, quantity) == pytest.approx(getattr(other, quantity), abs=2e-12), quantity


@pytest.mark.parametrize("body", [HELD, STANDARD], ids=["non-twisting", "standard"])
def test_long_stretch_without_moments(body, monkeypatch):
    """As exact as that motion; where the march pauses and what it stores in it change no bit."""
    load = nt.pulse([1, 2, 0], 1, 2) + nt.pulse([3, -1, 0], 5_002, 5_003)
    how = {"t_end": 5_004, "step": 0.1, "load": load, "integrator": "split", "material_angular_velocity": [1, 2, 0]}
    run = nt.integrate(body, **how)
    a, b = 20, 50_020
    motion = nt.exact.free_standard if body.axis is None else nt.exact.free_nontwisting
    attitudes, since = run.rotation[a : b + 1].as_matrix(), run.time[a : b + 1] - run.time[a]
    truth, _ = motion(PAPER_J, run.material_angular_velocity[a], since, attitudes[0])
    bound = 5 * 2.2e-16 * 2.3 * 5e3  # 5 times the round-off of the angle |W| t
    assert abs(attitudes - truth).max() < bound
    between = nt.integrate(body, times=[2.01, 700.03, 4_999.99], **how)
    truth, _ = motion(PAPER_J, run.material_angular_velocity[a], between.time - run.time[a], attitudes[0])
    assert abs(between.rotation.as_matrix() - truth).max() < bound
    monkeypatch.setattr(stack_march, "NODES", 300)
    pauses = nt.integrate(body, **how, store=7)
    assert np.array_equal(pauses.directors, run.directors[run.time.searchsorted(pauses.time)])
    asked = nt.integrate(body, times=run.time[[0, 3, a, a + 1, 7_777, b - 1, b, b + 1, -1]], **how)
    assert np.array_equal(asked.directors, run.directors[run.time.searchsorted(asked.time)])


ENDLESS = {"standard": [[3.1, 0.2, -0.3], [0.2, 4.2, 0.1], [-0.3, 0.1, 5.5]], "non-twisting": PAPER_J}


def gaps(name, order, steps, start):
    """How far energy, momentum, W and Λ are off after 2 s under a load that lasts, too faint to change a digit."""
    J, rng = np.array(ENDLESS[name]), np.random.default_rng(start)
    body = nt.standard if name == "standard" else nt.nontwisting
    closed = nt.exact.free_standard if name == "standard" else nt.exact.free_nontwisting
    W, R = rng.normal(size=3) * [2, 2, 2 * (name == "standard")], Rotation.random(rng=rng)
    how = {"material_angular_velocity": W, "rotation": R, "load": nt.sine((1e-200, 0, 0), 0.7), "store": "end"}
    run = nt.integrate(body(J), t_end=2, step=2 / steps, integrator="split", order=order, **how)
    Lam, (A,), (w,) = run.directors[-1].T, *closed(J, W, [2], R)
    V = material(run.directors, angular_velocity(run.directors, run.director_velocities))[-1]
    kept = (Lam @ J @ V - R.apply(J @ W)) if name == "standard" else (J @ (V - W))[:2]
    momentum = np.linalg.norm(kept) / np.linalg.norm(J @ W)
    return V @ J @ V / (W @ J @ W) - 1, momentum, np.linalg.norm(V - w) / np.linalg.norm(W), np.linalg.norm(Lam - A)


@pytest.mark.parametrize("order", [2, 4, 6])
@pytest.mark.parametrize("name", ENDLESS)
def test_endless_load_does_not_drift(name, order):
    assert np.abs(gaps(name, order, 10_000, 0)).max() < 2e-14


@pytest.mark.filterwarnings("ignore:the run will take about:UserWarning")
@pytest.mark.long
@pytest.mark.parametrize("order", [2, 4, 6])
@pytest.mark.parametrize("name", ENDLESS)
def test_endless_load_over_million_steps(name, order):
    few, many = (np.array([gaps(name, order, n, start) for start in range(3)]) for n in (10_000, 1_000_000))
    assert np.abs(many).max() < 1e-12
    sizes = [np.sqrt((errors**2).mean(axis=0)) for errors in (few, many)]
    assert (sizes[1] <= np.maximum(sizes[0], 1e-15) * 100**0.6).all()


@pytest.mark.parametrize(("order", "steps"), [(2, (64, 128)), (4, (16, 32)), (6, (12, 16))])
@pytest.mark.parametrize(("body", "load"), [(HELD, BODY), (nt.with_gravity(HELD, 0.5, [0.1, 0.2, 0.3]), ALL)])
def test_order_of_moments_and_work(body, load, order, steps):
    """Whose attitudes inside a step are not those of a steady turn."""
    how = {"t_end": 2, "material_angular_velocity": (2, -3, 0), "load": load}
    fine, errors = nt.integrate(body, times=np.linspace(0, 2, 5), integrator=FINE, **how), []
    for n in steps:
        run = nt.integrate(body, step=2 / n, store=n // 4, integrator=Split(order), **how)
        errors.append([abs(getattr(run, x) - getattr(fine, x)).max() for x in ("moment", "multipliers", "load_work")])
    assert np.log(np.divide(*errors)) / np.log(steps[1] / steps[0]) == pytest.approx(order, abs=0.15)


def test_directors_stay_orthonormal():
    pull = nt.space_moment(lambda t: (1e-3 * np.sin(t), 0, 1e-3))
    for turn in (0.5, 2.0, 4.0, 6.0):
        start = {"material_angular_velocity": (turn, 0, 0), "t_end": 500, "step": 1.0}
        run = nt.integrate(nt.nontwisting([1, 1, 1]), load=pull, integrator="split", order=2, **start)
        assert np.linalg.norm(angular_velocity(run.directors[-1], run.director_velocities[-1])) > 0.7 * turn
        assert orthonormality_defect(run.directors).max() < 1e-14


@pytest.mark.parametrize("lasts", [True, False])
def test_near_principal_rotation_is_steady(lasts):
    """Whose squares across the axis are no numbers: the attitude was once NaN."""
    load = nt.sine((1e-200, 0, 0), 0.7) if lasts else None
    for axis, J, across in product(range(3), ([3, 4, 5], [3, 3, 5], [1, 4, 4.9999]), (1e-40, 1e-149, 1e-160)):
        W = np.where(np.arange(3) == axis, 1.0, across)
        how = {"t_end": 2, "step": 0.1, "integrator": "split", "load": load}
        run = nt.integrate(nt.standard(J), material_angular_velocity=W, **how)
        end = Rotation.from_rotvec(2 * np.eye(3)[axis]).as_matrix()
        assert run.directors[-1] == pytest.approx(end.T, abs=1e-14)


INTEGRATED = {
    "heavy top": (BODIES["heavy_top"](), nt.damping([1, 0.5, 0.3]) + BOTH),
    "non-twisting": (HELD, BOTH),
    "free after a pulse": (STANDARD, nt.pulse([3, 1, 0], 0, 1)),
}


@pytest.mark.parametrize("case", INTEGRATED)
def test_order_of_integrals(case):
    """Of steps, by the nodes of the load; of the exact motion after the load, which is much more accurate."""
    body, load = INTEGRATED[case]
    how = {"t_end": 2, "load": load, "reduce": ["averages", "total_twist"]}
    how |= {"material_angular_velocity": [1, -2, 0.5], "project": True}
    fine = nt.simulate_ensemble(body, step=1 / 200, order=8, **how)
    names = [name for name in fine.data_vars if name.endswith("_mean") or name == "total_twist"]
    for order, counts in ((2, (20, 40)), (4, (20, 40)), (6, (8, 16))):
        runs = [nt.simulate_ensemble(body, step=1 / n, integrator="split", order=order, **how) for n in counts]
        errors = np.array([[abs(run[name] - fine[name]).max() for name in names] for run in runs])
        seen = errors[:, errors[0] > 1e-10]
        assert seen.shape[1] >= 3
        assert np.log2(seen[0] / seen[1]) == pytest.approx(order, abs=0.5)


def test_refused_member_is_named():
    how, W = {"t_end": 1, "step": 0.1, "integrator": "split"}, [(0, 1, 0), (0, 1e16, 0)]
    with pytest.raises(ValueError, match=r"^member 1: split needs a constrained axis that is principal"):
        nt.simulate_ensemble(nt.DirectorSystem.stack([HELD, BODIES["suslov"]()]), **how)
    with says(UserWarning):
        many = nt.simulate_ensemble(nt.standard([3, 4, 5]), material_angular_velocity=W, **how)
    assert many.status.values.tolist() == [Status.OK, Status.TURN]


@pytest.mark.parametrize("body", [nt.standard, nt.nontwisting])
def test_too_large_turns_end_runs(body):
    how = {"load": nt.sine([1, 0, 0], 1.0), "t_end": 1, "step": 0.1, "material_angular_velocity": (0, 1e17, 0)}
    with pytest.raises(SimulationError, match=r"step 0 at t = 0 s: the body turns 1e\+16 rad in one step"):
        nt.simulate(body([3, 4, 5]), integrator="split", **how)
    how = {"load": nt.pulse([0, 1, 0], 0, 4), "t_end": 1e4, "step": 1, "material_angular_velocity": (0, 1e12, 0)}
    with pytest.raises(SimulationError, match=r"^step 4 at t = 4 s: the body turns by more than 1e\+15 rad") as caught:
        nt.simulate(body([3, 4, 5]), integrator="split", **how)
    assert caught.value.partial.time.tolist() == [0, 1, 2, 3, 4]


@pytest.mark.parametrize(
    ("integrator", "load"),
    [("split", None), ("split", nt.damping(0.3)), ("lie-midpoint", None), ("energy-momentum", nt.damping(0.3))],
)
def test_means_between_times(integrator, load):
    body = nt.with_gravity(HELD, 2, (0.1, 0.1, 0.5))
    how = {"t_end": 1, "step": 0.01, "material_angular_velocity": [1, 2, 0], "integrator": integrator, "load": load}
    nodes, times = nt.simulate(body, store=10, **how), nt.simulate(body, times=np.linspace(0, 1, 11), **how)
    assert abs(nodes.multipliers).max() > 0.1
    for name in ("multipliers", "spatial_reaction_moment", "load_work"):
        np.testing.assert_allclose(times[name], nodes[name], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("order", HALVES)
def test_coefficients_are_symmetric(order):
    """Σ γ = 1 and Σ γ³ = Σ γ⁵ = ... = 0: the conditions of a linear problem."""
    gamma, c = fractions(order), substep_nodes(order)
    for power in range(1, order, 2):
        assert fsum(g**power for g in gamma) == pytest.approx(float(power == 1), abs=1e-15)
    assert np.array_equal(gamma, gamma[::-1])
    assert len(gamma) == {2: 1, 4: 5, 6: 9}[order]
    assert 0.05 < c.min() <= c.max() < 0.95
    assert c + c[::-1] == pytest.approx(1, abs=1e-15)

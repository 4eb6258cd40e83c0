"""States between nodes by power series: against SciPy, their balances, and when substeps are taken instead."""

from itertools import product

import numpy as np
import pytest

import nontwist as nt
from nontwist.integrators import Continuous, Gauss, dense

J = np.array([[3, -1 / 7, 0.2], [-1 / 7, 4, 0.1], [0.2, 0.1, 5]])
TIMES = np.sort(np.random.default_rng(2).uniform(0, 3, 80))
BODIES = {
    "standard": (nt.standard(J), (1, -2, 3)),
    "top": (nt.heavy_top(J, 2.0, (0.1, 0.2, 0.5)), (1, -2, 6)),
    "nontwisting": (nt.nontwisting([3, 4, 5]), (2, -1, 0)),
    "suslov": (nt.suslov(J, (0, 0, 1)), (2, -1, 0)),
}
LOADS = {
    "none": None,
    "pulse": nt.pulse((4, 1, -2), 0.6, 1.8),
    "half-sine": nt.pulse((4, 1, -2), 0.6, 1.8, shape="half-sine", frame="space"),
    "table": nt.body_moment([0, 1, 2.1, 3], [[0, 0, 0], [1, 2, 1], [0, -2, 1], [1, 1, 0]]),
    "function": nt.space_moment(lambda t: (np.sin(2 * t), 0.3, t)),
    "sine and drag": nt.sine((1, 0.5, 2), 0.8) + nt.damping(0.4),
    "rotor": nt.rotor((0, 0.6, 0.8), [0, 1.5, 3], [1, 4, 2]),
}


@pytest.fixture
def expansions(monkeypatch):
    """Count the calls that find states between nodes, and those of them that nodes apart have made void."""
    found, own = [], dense.Between.find
    monkeypatch.setattr(dense.Between, "find", lambda self: found.append(own(self)) or found[-1])
    return found


CASES = [("standard", "none"), ("standard", "rotor"), ("standard", "half-sine"), ("top", "table"), ("top", "pulse")]
CASES += [("nontwisting", "half-sine"), ("nontwisting", "function"), ("suslov", "sine and drag")]


@pytest.mark.parametrize(
    ("body", "load"),
    [pytest.param(*case, marks=[pytest.mark.long] * (case not in CASES)) for case in product(BODIES, LOADS)],
)
def test_states_between_nodes_are_those_of_scipy(body, load, expansions):
    system, W = BODIES[body]
    how = {"t_end": 3, "times": TIMES, "material_angular_velocity": W, "load": LOADS[load]}
    run = nt.integrate(system, integrator=Gauss(order=12), step=0.05, **how)
    assert expansions == [True]
    fine = nt.integrate(system, integrator=Continuous(), **how)
    assert run.directors == pytest.approx(fine.directors, abs=2e-11)
    assert run.material_angular_velocity == pytest.approx(fine.material_angular_velocity, abs=2e-10)
    assert run.load_work == pytest.approx(fine.load_work, abs=1e-9)


@pytest.mark.parametrize("body", ["top", "suslov"])
def test_energy_and_momentum_are_kept_between_nodes_as_at_them(body, expansions):
    system, W = BODIES[body]
    run = nt.simulate(system, t_end=3, step=0.1, order=8, times=TIMES, material_angular_velocity=W)
    energy = (run.kinetic_energy + run.potential_energy).values
    assert expansions == [True]
    assert np.ptp(energy) < 1e-14 * abs(energy).max() + 1e-14
    assert run.orthonormality_defect.max() < 2e-15
    if body == "top":
        assert np.ptp(run.spatial_momentum.sel(axis="z").values) < 2e-14 * abs(run.spatial_momentum.values).max()


def test_substeps_are_taken_where_steps_have_errors(expansions):
    """Of order 4 a step of 0.7 rad is wrong by more than 1e-7: states in between keep the energy all the same."""
    system, W = BODIES["top"]
    how = {"t_end": 3, "step": 0.1, "times": TIMES, "material_angular_velocity": W}
    run = nt.simulate(system, order=4, **how)
    assert expansions == [False]
    energy = (run.kinetic_energy + run.potential_energy).values
    assert np.ptp(energy) < 2e-13 * abs(energy).max()
    assert nt.integrate(system, order=2, **how).time == pytest.approx(TIMES)
    assert len(expansions) == 1


def test_long_steps_are_expanded_far_enough(expansions):
    """And of a run that is resampled between its own states."""
    system, W = BODIES["top"]
    how = {"t_end": 3, "material_angular_velocity": W}
    fine = nt.integrate(system, integrator=Gauss(order=16), step=0.02, times=TIMES, **how)
    for order, step, close in ((8, 0.05, 1e-8), (16, 0.25, 1e-11)):
        run = nt.simulate(system, order=order, step=step, times=TIMES, **how)
        assert run.directors.values == pytest.approx(fine.directors, abs=close)
        again = nt.resample(nt.simulate(system, order=order, step=step, **how), TIMES)
        assert again.directors.values == pytest.approx(run.directors.values, abs=1e-14)
    assert expansions == 5 * [True]

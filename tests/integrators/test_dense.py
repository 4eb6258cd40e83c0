"""States between nodes by power series: against SciPy, their balances, and when substeps are taken instead."""

from itertools import product

import numpy as np
import pytest

import nontwist as nt
from conftest import or_long
from covering.problems import BODIES, made_load
from nontwist.integrators import Continuous, Gauss, dense

TIMES = np.sort(np.random.default_rng(2).uniform(0, 3, 80))
HOW = {"t_end": 3, "times": TIMES, "material_angular_velocity": (1, -2, 3), "project": True}
TOP = BODIES["heavy top"](1.0)


@pytest.fixture
def expansions(monkeypatch):
    """Count the calls that find states between nodes, and those of them that nodes apart have made void."""
    found, own = [], dense.Between.find
    monkeypatch.setattr(dense.Between, "find", lambda self: found.append(own(self)) or found[-1])
    return found


CASES = [("standard", "none"), ("standard", "rotor table"), ("standard", "half-sine"), ("heavy top", "body table")]
CASES += [("nontwisting", "space function of time"), ("suslov", "sum")]
EVERY = product(["standard", "heavy top", "nontwisting", "suslov"], [*(load for _, load in CASES), "triangle"])


@pytest.mark.parametrize(("body", "load"), or_long(CASES, [case for case in EVERY if case not in CASES]))
def test_states_between_nodes_by_scipy(body, load, expansions):
    system, how = BODIES[body](1.0), HOW | {"load": made_load(load)}
    step = 0.01 if load == "body table" else 0.05  # which has a kink at 2.33
    run = nt.integrate(system, integrator=Gauss(order=12), step=step, **how)
    assert expansions == [True]
    fine = nt.integrate(system, integrator=Continuous(), **how)
    assert run.directors == pytest.approx(fine.directors, abs=2e-11)
    assert run.material_angular_velocity == pytest.approx(fine.material_angular_velocity, abs=2e-10)
    assert run.load_work == pytest.approx(fine.load_work, abs=1e-9)


@pytest.mark.parametrize("body", ["heavy top", "suslov"])
def test_invariants_between_nodes(body, expansions):
    run = nt.simulate(BODIES[body](1.0), step=0.1, order=8, **HOW)
    energy = (run.kinetic_energy + run.potential_energy).values
    assert expansions == [True]
    assert np.ptp(energy) < 1e-14 * abs(energy).max() + 1e-14
    assert run.orthonormality_defect.max() < 2e-15
    if body == "heavy top":
        assert np.ptp(run.spatial_momentum.sel(axis="z").values) < 2e-14 * abs(run.spatial_momentum.values).max()


def test_substeps_where_steps_err(expansions):
    """Of order 4 a step of 0.4 rad is wrong by more than 1e-7: states in between keep the energy all the same."""
    run = nt.simulate(TOP, step=0.1, order=4, **HOW)
    assert expansions == [False]
    energy = (run.kinetic_energy + run.potential_energy).values
    assert np.ptp(energy) < 2e-13 * abs(energy).max()
    assert nt.integrate(TOP, step=0.1, order=2, **HOW).time == pytest.approx(TIMES)
    assert len(expansions) == 1


def test_long_steps(expansions):
    """And of a run that is resampled between its own states."""
    fine = nt.integrate(TOP, integrator=Gauss(order=16), step=0.02, **HOW)
    for order, step, close in ((8, 0.05, 1e-8), (16, 0.25, 1e-11)):
        run = nt.simulate(TOP, order=order, step=step, **HOW)
        assert run.directors.values == pytest.approx(fine.directors, abs=close)
        whole = nt.simulate(TOP, order=order, step=step, **HOW | {"times": None})
        assert nt.resample(whole, TIMES).directors.values == pytest.approx(run.directors.values, abs=1e-14)
    assert expansions == 5 * [True]

"""Loads of one's own: one class each, with fields and a text, from which all else follows."""

import json
from dataclasses import dataclass
from typing import Annotated
from unittest.mock import patch

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import nontwist as nt
from nontwist.analysis.invariants import drifts
from nontwist.geometry.arrays import Array
from nontwist.loads import LOADS, DirectorForces, Potential, Term
from nontwist.loads.kinds import load_of
from nontwist.spec import Spec

J = np.array([[3, 0.2, 0.4], [0.2, 4, -0.3], [0.4, -0.3, 5]])
DIPOLE, FIELD = np.array([0.3, -0.5, 1.2]), np.array([0.6, 1.0, -2.0])
START = {"rotation": Rotation.from_euler("XYZ", [0.3, 0.5, -0.2]), "material_angular_velocity": (0.4, -1.1, 0.7)}
NAMES = ("d_rotation", "d_material_angular_velocity")


@dataclass(frozen=True, eq=False)
class Needle(Term):
    """The moment of a field on a dipole."""

    needle: Annotated[Array, Spec("along the directors", unit="A m²", shape=(3,))]
    field: Annotated[Array, Spec("in space", unit="T", shape=(3,))]

    def moment(self, t, directors, angular_velocity):
        return np.cross(self.needle @ directors, self.field)


@dataclass(frozen=True, eq=False)
class Well(Potential):
    """The energy of a dipole in a field."""

    well: Annotated[Array, Spec("along the directors", unit="A m²", shape=(3,))]
    field: Annotated[Array, Spec("in space", unit="T", shape=(3,))]

    def potential(self, directors):
        return -(self.well @ directors) @ self.field


@dataclass(frozen=True, eq=False)
class Cord(Potential):
    """A spring between a point of the body and one of space."""

    cord: Annotated[float, Spec("the stiffness", unit="N/m", rule="positive")]
    point: Annotated[Array, Spec("in the body", unit="m", shape=(3,))]
    rest: Annotated[float, Spec("length", unit="m", rule="not negative")] = 0.0

    def potential(self, directors):
        apart = self.point @ directors - np.array([1.0, 0.5, 1.0])
        return 0.5 * self.cord * (np.sqrt(apart @ apart) - self.rest) ** 2


@dataclass(frozen=True, eq=False)
class Wave(Term):
    """A sine along fixed axes."""

    wave: Annotated[Array, Spec("the peak", unit="N m", shape=(3,))]
    rate: Annotated[float, Spec("of the wave", unit="Hz", rule="positive")]

    def space_moment(self, t):
        return np.sin(2 * np.pi * self.rate * t) * self.wave


@dataclass(frozen=True, eq=False)
class Tips(DirectorForces):
    """A dead force on each director."""

    tips: Annotated[Array, Spec("in space, a row for each director", unit="N m", shape=(3, 3))]

    def forces(self, t, directors, angular_velocity):
        return self.tips


KINDS = {"needle": Needle, "well": Well, "cord": Cord, "wave": Wave, "tips": Tips}
SPRING = nt.spring(3, (0, 0.2, 1), (1, 0.5, 1), 0.8)
PAIRS = {  # a load, that of the package, and a number of the first as one of the other, and how many times it changes
    "needle": (Needle(DIPOLE, FIELD), nt.dipole(DIPOLE, FIELD), {"needle[2]": ("linear[2]", -1)}),
    "well": (Well(DIPOLE, FIELD), nt.dipole(DIPOLE, FIELD), {"well[3]": ("linear[3]", -1)}),
    "cord": (Cord(3, (0, 0.2, 1), 0.8), SPRING, {"cord": ("stiffness", 1), "rest": ("rest_length", 1)}),
    "wave": (
        Wave((1, 2, 3), 0.7),
        nt.sine((1, 2, 3), 0.7, frame="space"),
        {"wave[y]": ("sine[y]", 1), "rate": ("frequency", 1)},
    ),
    "tips": (Tips(np.outer(DIPOLE, FIELD)), nt.dipole(DIPOLE, FIELD), {}),
}


@pytest.fixture(autouse=True)
def registered():
    with patch.dict(LOADS, KINDS):
        yield


@pytest.mark.filterwarnings("ignore:.*runs in Python")
@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("name", PAIRS)
def test_it_moves_the_body_as_that_of_the_package_and_has_its_derivatives(name, compiled):
    own, known, numbers = PAIRS[name]
    own = type(own)(*(getattr(own, field) for field in type(own).__annotations__), compiled=compiled)
    how = {"t_end": 1, "step": 0.1, "integrator": "gauss", "order": 8, "store": "end", **START}
    wrt = ["rotation", "load_scale", *(f"load[0].{word.partition('[')[0]}" for word in numbers)]
    found = nt.sensitivities(nt.standard(J), load=0.5 * own, wrt=wrt, **how)
    words = [f"load[0].{word.partition('[')[0]}" for word, _ in numbers.values()]
    truth = nt.sensitivities(nt.standard(J), load=0.5 * known, wrt=["rotation", "load_scale", *words], **how)
    assert abs(found.directors - truth.directors).max() < 1e-13
    columns = {name: (name, 1) for name in ("rotation[1]", "rotation[3]", "load_scale")}
    columns |= {f"load[0].{one}": (f"load[0].{other}", factor) for one, (other, factor) in numbers.items()}
    for own_column, (column, factor) in columns.items():
        for variable in NAMES:
            mine = found[variable].sel(parameter=own_column).values
            assert mine == pytest.approx(factor * truth[variable].sel(parameter=column).values, rel=1e-11, abs=1e-12)


@pytest.mark.parametrize("scheme", ["lie-midpoint", "energy-momentum"])
def test_a_potential_of_ones_own_is_conserved(scheme):
    """By a discrete gradient of its text; its axes are three, so that no momentum is."""
    run = nt.simulate(nt.standard(J), t_end=20, step=0.1, load=Cord(3, (0, 0.2, 1), 0.8), integrator=scheme, **START)
    total = run.kinetic_energy + run.potential_energy
    assert abs(total - total[0]).max() < 1e-12
    assert set(drifts(run)) == {"total_energy", "orthonormality"}


def test_other_ways_to_run():
    """Sums, ensembles, propagators and their Jacobians, gradients, comparisons, continued runs."""
    body, load = nt.standard(J), Needle(DIPOLE, FIELD) + nt.damping(0.1) - 0.5 * Wave((1, 2, 3), 0.7)
    how = {"t_end": 1, "step": 0.1, "load": load}
    run = nt.simulate(body, **how, **START)
    assert load == load_of(json.loads(run.attrs["load"]))
    assert json.loads(run.attrs["load"])[0] == {
        "kind": "state",
        "scale": 1.0,
        "needle": DIPOLE.tolist(),
        "field": FIELD.tolist(),
    }
    many = nt.simulate_ensemble(body, **how, **START, load_scale=[1.0, 2.0])
    assert abs(many.quaternion[0, -1] - run.quaternion[-1]).max() < 1e-14
    d = nt.sensitivities(body, wrt=["needle", "rate"], **how, **START)
    run_of = nt.propagator(body, **how)
    for given, one in zip(run_of.jacobian(wrt=["needle", "rate"], **START), NAMES, strict=True):
        assert given[-1] == pytest.approx(d[one].values[-1], abs=1e-14)
    last = np.zeros((11, 3))
    last[-1] = 1, -2, 0.5
    g = nt.gradient(body, wrt=["needle", "rate"], d_rotation=last, **how, **START)
    assert g.gradient.values == pytest.approx(last[-1] @ d.d_rotation.values[-1], abs=1e-13)
    loop = nt.stepper(body, step=0.1, load=load)  # of order 2
    loop.reset(**START)
    for _ in range(10):
        state = loop.step()
    same = nt.simulate(body, **how, **START, integrator=loop.integrator)
    assert state.material_angular_velocity == pytest.approx(same.material_angular_velocity[-1].values, abs=1e-14)
    data = nt.compare(body, t_end=1, load=load, steps=[0.1], integrators=["gauss", "split"], repeats=1, **START)
    assert (data.status == 0).all()
    assert "needle: needle (0.3, −0.5, 1.2) A m², field (0.6, 1, −2) T" in nt.view(run).html

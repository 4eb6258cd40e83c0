"""Derivatives of runs with memory: differences of runs, the adjoint, propagators, what is refused."""

from dataclasses import dataclass
from functools import partial
from typing import Annotated
from unittest.mock import patch

import numpy as np
import pytest

import nontwist as nt
from conftest import or_long
from integrators.test_contract import fading, remembered
from integrators.test_derivatives import require_tangents, require_transpose
from loads.test_wheels import BODIES, W0, J, drag, spin_up
from nontwist.loads import LOADS, Memory
from nontwist.spec import Spec

KINKS = [0.3, 0.5, 1.0], [0.0, 0.5, -0.3]
START = ["material_angular_velocity", "rotation"]
NUMBERS = {
    "load[0].wheel": np.array([1, 1, 0]) / np.sqrt(2),
    "load[0].inertia": 0.2,
    "load[0].speed": 3.0,
    "load[0].torque": 0.1,
    "load[0].viscous": 0.05,
}


def halting(speed):
    return 0.3 * speed if abs(speed) < 1 else 0.3 * speed / abs(speed)


def branching(t, z, directors, w):
    return [(0.8 if z[0] > 0 else 0.5) * w[0] - z[0]]


def holding(t, z, directors, w):
    return [z[0], -0.3 * z[0] * w[1], 0.1 * w[0]]


def resisting(t, directors, w):
    return [-0.3 * w[0] * abs(w[1]), 0.2 * directors[0, 2], 0.1 * np.sin(t) * directors[1, 1]]


def pulling(t, directors, w):
    d = directors
    return [[0.1 * d[0, 1], 0.2, 0.0], [0.0, 0.1 * w[0], 0.3], [0.2 * d[2, 0], 0.0, 0.1 * t]]


def level(g):
    return g[0] ** 2 / 2 + 0.3 * g[1] * g[2] + 0.1 * g[2] ** 4


def slope(g):
    return [g[0], 0.3 * g[2], 0.3 * g[1] + 0.4 * g[2] ** 3]


def loaded(beside="wheels", p=NUMBERS):
    *given, viscous = (p[name] for name in NUMBERS)
    own = nt.wheel(*given, viscous=viscous)
    if beside == "wheels":  # one that is driven, and one whose function takes no arrays
        others = nt.wheel("z", 0.1, 5, torque=KINKS) + nt.wheel("y", 0.1, 4, friction=halting, compiled=False)
        return own + nt.wheel((1, -1, 1), 0.3, -10, spin_up, friction=drag) + others
    if beside == "memory in space":
        others = nt.damping(0.1) + nt.sine((0.1, 0.2, 0.3), 0.4, frame="space") + nt.rotor("y", 0.7)
        table = nt.body_moment([0, 3], [[0, 0, 0], [0.3, 0.1, 0.2]])
        return own + 2 * nt.memory_load(fading, remembered, [0.3, 0.1], scale=[1, 1], compiled=True) + others + table
    if beside == "potentials":
        orbit = nt.gravity_gradient(1.5, (1, 0, 0), (0, 1, 0), eccentricity=0.3)
        others = nt.potential([(1, 2, 2), (0, 1, 0)], linear=np.eye(3)[:2], quadratic=[J / 9, np.eye(3)])
        others += 2 * nt.director_forces([0, 3], [J / 9, np.outer(W0, W0)])
        return own + 0.5 * nt.moment(resisting) + nt.director_forces(pulling, compiled=True) + orbit + others
    if beside == "springs":
        return own + nt.spring(2, (0, 0, 1), (1, 0, 0.5), 0.3) + 0.5 * nt.potential((1, 2, 2), level, slope)
    return 0.5 * (own + nt.memory_load(branching, holding, [0.3], scale=[1], frame="body"))


@dataclass(frozen=True, eq=False)
class Lag(Memory):
    """A load of one's own whose two internal states begin as its fields say."""

    frame = "body"
    state_scale = np.ones(2)
    line: Annotated[np.ndarray, Spec("", shape=(3,), rule="direction in the body")]
    lag: Annotated[float, Spec("", unit="s", rule="positive")]
    quadratic: Annotated[np.ndarray, Spec("", unit="N m s", shape=(3, 3), rule="symmetric")]
    first: Annotated[float, Spec("", unit="1")]

    @property
    def state0(self):
        return np.array([self.first**2, 0.3 * self.lag])

    def response(self, t, z, directors, angular_velocity):
        drag, n = self.quadratic @ angular_velocity, self.line
        moment = [-z[1] * drag[k] - z[0] * n[k] for k in range(3)]
        return [*moment, (n @ angular_velocity - z[0]) / self.lag, (z[0] - z[1]) * self.first]


LAG = {"load[0].line": np.array([2, -1, 2]) / 3, "load[0].lag": 0.5, "load[0].quadratic": 0.3 * J, "load[0].first": 0.7}

QUICK = [("wheels", "suslov", "gauss 8"), ("memory in space", "standard", "gauss 8")]
QUICK += [("memory in space", "top", "gauss 2"), ("memory in the body", "suslov", "gauss 4")]
QUICK += [("memory in space", "top", "lie-midpoint 2"), ("wheels", "suslov", "lie-midpoint 2")]
QUICK += [("potentials", "top", "lie-midpoint 2"), ("potentials", "suslov", "gauss 4"), ("springs", "top", "gauss 4")]


@pytest.mark.filterwarnings("ignore:the load .* runs in Python")
@pytest.mark.parametrize(
    ("beside", "body", "scheme"), or_long(QUICK[:5:2] + QUICK[5:], [*QUICK[1:5:2], ("wheels", "top", "gauss 8")])
)
def test_derivatives_are_those_of_differences(beside, body, scheme):
    """And the gradient their transpose. Of the axis of a wheel counts what is across it."""
    body, start = BODIES[body], {"material_angular_velocity": W0, "rotation": np.zeros(3), "duration": 0.5}
    own = {"inertia": body.inertia, "axis": body.axis, "dead_force": body.dead_force, "principal_inertia": np.zeros(3)}
    wrt, (name, order) = [*START, "inertia", *NUMBERS], scheme.split()
    how = {"order": int(order), "integrator": name, "h": 4e-4}
    require_tangents(NUMBERS | start | own, partial(loaded, beside), wrt, 5, 5e-9, **how)


@pytest.mark.parametrize(("scheme", "order"), [("gauss", 6), ("lie-midpoint", 2)])
def test_prescribed_spin(scheme, order):
    """A table, about an axis that is principal without the wheels as well."""
    body = {"inertia": np.diag([3.0, 4, 5]), "axis": np.array([0.0, 0, 1]), "spin": np.array([0.5, 1.5, 1.0])}
    start = {
        "material_angular_velocity": W0,
        "rotation": np.zeros(3),
        "duration": 0.5,
        "principal_inertia": np.zeros(3),
    }

    def made(p):
        along, across = (p[name] for name in own)
        wheels = nt.wheel("z", along, 3, viscous=0.1) + nt.wheel("x", across, 3, spin_up, friction=drag)
        return wheels + nt.gravity_gradient(2)

    own = {"load[0].inertia": 0.2, "load[1].inertia": 0.1}
    wrt, how = [*START, "principal_inertia", *own], {"order": order, "integrator": scheme, "h": 4e-4}
    require_tangents(body | start | own, made, wrt, 10, 5e-9, **how)


@patch.dict(LOADS, lag=Lag)
@pytest.mark.parametrize(("scheme", "order"), [("gauss", 4), ("lie-midpoint", 2)])
def test_fields_of_own_memory(scheme, order):
    """Beside the same load with other numbers, and wheels, whose states come first."""
    body, start = BODIES["suslov"], {"material_angular_velocity": W0, "rotation": np.zeros(3), "duration": 0.5}
    own = {"inertia": body.inertia, "axis": body.axis, "dead_force": body.dead_force, "principal_inertia": np.zeros(3)}
    others = loaded() + Lag(LAG["load[0].line"], 0.9, np.eye(3), 0.2)

    def made(p):
        return 2 * Lag(*(p[name] for name in LAG)) + others

    how = {"order": order, "integrator": scheme, "h": 4e-4}
    require_tangents(LAG | start | own, made, [*START, *LAG], 5, 5e-9, **how)


def test_adjoint_and_propagator_agree():
    how = {"t_end": 2, "step": 0.05, "load": 0.5 * loaded("memory in space"), "project": True}
    wrt = [*START, "load[0].torque", "load[0].speed"]
    found = require_transpose(nt.standard(J), wrt=wrt, material_angular_velocity=W0, store=20, **how)
    turn, velocity = nt.propagator(nt.standard(J), store=20, **how).jacobian(wrt=wrt, material_angular_velocity=W0)
    assert turn == pytest.approx(found.d_rotation.values, abs=1e-12)
    assert velocity == pytest.approx(found.d_material_angular_velocity.values, abs=1e-12)


@pytest.mark.parametrize(
    ("body", "load", "wrt", "words"),
    [
        (BODIES["standard"], loaded(), "load_scale", "load_scale is none of them"),
        (BODIES["suslov"], loaded(), "axis", "axis is none of them"),
        (BODIES["standard"], loaded(), "load[0].scale", r"load\[0\].scale is none of them"),
        (BODIES["top"], nt.wheel("x", 0.1, 3, friction=lambda speed: float(speed)), START, "cannot be differentiated"),
    ],
)
def test_what_has_none_is_refused(body, load, wrt, words):
    with pytest.raises(ValueError, match=words):
        nt.sensitivities(body, t_end=1, step=0.1, material_angular_velocity=W0, load=load, wrt=wrt, project=True)


@pytest.mark.parametrize(
    ("scheme", "beside", "words"),
    [
        ("energy-momentum", "wheels", "energy-momentum has no derivatives under loads with memory; use gauss, or"),
        ("lie-midpoint", "springs", "of lie-midpoint with memory have no derivatives beside spring .*; use gauss"),
    ],
)
def test_midpoint_schemes_without_derivatives(scheme, beside, words):
    with pytest.raises(ValueError, match=words):
        nt.sensitivities(nt.standard(J), t_end=1, step=0.1, load=loaded(beside), wrt=START, integrator=scheme)

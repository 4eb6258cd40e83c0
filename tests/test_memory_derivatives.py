"""Derivatives of runs with memory: differences of runs, the adjoint, propagators, what is refused."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import nontwist as nt
from test_derivatives import derivative, last, require_transpose
from test_wheels import BODIES, W0, J, drag, spin_up

KINKS = [0.3, 0.5, 1.0], [0.0, 0.5, -0.3]
START = ["material_angular_velocity", "rotation"]
FIELDS = {"speed": 3.0, "torque": 0.1, "viscous": 0.05}


def halting(speed):
    return 0.3 * speed if abs(speed) < 1 else 0.3 * speed / abs(speed)


def fading(t, z, directors, w):
    return np.array([0.5 * w[0] - z[0] + 0.1 * np.sin(t), 0.3 * directors[2, 0] - 0.2 * z[1] * z[0]])


def pulling(t, z, directors, w):
    return np.array([-0.2 * z[0], 0.1 * z[0] * w[2], 0.3 * z[1]])


def branching(t, z, directors, w):
    return [(0.8 if z[0] > 0 else 0.5) * w[0] - z[0]]


def holding(t, z, directors, w):
    return [z[0], -0.3 * z[0] * w[1], 0.1 * w[0]]


def loaded(beside="wheels", speed=3.0, torque=0.1, viscous=0.05):
    own = nt.wheel((1, 1, 0), 0.2, speed, torque, viscous=viscous)
    if beside == "wheels":  # one that is driven, and one whose function takes no arrays
        others = nt.wheel("z", 0.1, 5, torque=KINKS) + nt.wheel("y", 0.1, 4, friction=halting, compiled=False)
        return own + nt.wheel((1, -1, 1), 0.3, -10, spin_up, friction=drag) + others
    if beside == "memory in space":
        others = nt.damping(0.1) + nt.sine((0.1, 0.2, 0.3), 0.4, frame="space") + nt.rotor("y", 0.7)
        table = nt.body_moment([0, 3], [[0, 0, 0], [0.3, 0.1, 0.2]])
        return own + 2 * nt.memory_load(fading, pulling, [0.3, 0.1], scale=[1, 1], compiled=True) + others + table
    return 0.5 * (own + nt.memory_load(branching, holding, [0.3], scale=[1], frame="body"))


@pytest.mark.filterwarnings("ignore:the load .* runs in Python")
@pytest.mark.parametrize(
    ("beside", "body", "order"),
    [
        ("wheels", "suslov", 8),
        *(pytest.param("wheels", name, 8, marks=pytest.mark.long) for name in BODIES if name != "suslov"),
        ("memory in space", "standard", 8),
        ("memory in space", "top", 2),
        ("memory in the body", "suslov", 4),
    ],
)
def test_derivatives_are_those_of_differences(beside, body, order):
    body = BODIES[body]
    how = {"t_end": 1, "step": 0.1, "order": order, "load": loaded(beside), "material_angular_velocity": W0}
    how |= {"project": True, "integrator": "gauss"}
    found = nt.sensitivities(body, wrt=[*START, *(f"load[0].{name}" for name in FIELDS)], **how)

    weights = np.random.default_rng(2).normal(size=9) / 3  # along the sum of all directions, none of which is lost

    def run_of(e):
        own = {name: x + e * c for (name, x), c in zip(FIELDS.items(), weights[6:], strict=True)}
        start = {"material_angular_velocity": W0 + e * weights[:3], "rotation": Rotation.from_rotvec(e * weights[3:6])}
        return nt.integrate(body, **how | start | {"load": loaded(beside, **own)})

    assert last(found) @ weights == pytest.approx(derivative(run_of, 4e-4), abs=5e-9)


@pytest.mark.parametrize("body", BODIES)
def test_of_inertias_and_axes_they_are_those_of_differences(body):
    """Of the axis of a wheel counts what is across it."""
    made = {"standard": nt.standard, "suslov": lambda J: nt.suslov(J, (1, 0, 1))}
    make, axis = made.get(body, lambda J: nt.heavy_top(J, 1, (0, 0, 0.5))), np.array([0.6, 0.8, 0])
    how = {"t_end": 1, "step": 0.1, "order": 4, "integrator": "gauss", "material_angular_velocity": W0, "project": True}

    def rubbing(inertia=0.2, n=axis):
        own = 1.5 * nt.wheel(n, inertia, 3, 0.1, viscous=0.05) + nt.wheel("z", 0.1, 2, 0.1)
        return own + nt.memory_load(fading, pulling, [0.3, -0.2], scale=[1.0, 1.0], compiled=True)

    wrt = ["inertia", "load[0].inertia", "load[0].wheel"]
    found = nt.sensitivities(make(J + 0.2), wrt=wrt, load=rubbing(), **how)
    weights = np.random.default_rng(3).normal(size=10) / 10
    a, b, c, d, e, f = weights[:6]
    change = np.array([[a, f, e], [f, b, d], [e, d, c]])

    def run_of(x):
        own = rubbing(0.2 + x * weights[6], axis + x * weights[7:])
        return nt.integrate(make(J + 0.2 + x * change), load=own, **how)

    assert last(found) @ weights == pytest.approx(derivative(run_of, 4e-4), abs=5e-9)


def test_adjoint_propagator_and_continued_sums_agree():
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
        (BODIES["top"], loaded() + nt.spring(2, (0, 0, 1), (1, 0, 0.5), 0.3), START, "no derivatives beside .*spring"),
        (nt.nontwisting(J, spin=1), loaded("memory in space"), START, "where a spin is prescribed"),
        (BODIES["top"], nt.wheel("x", 0.1, 3, friction=lambda speed: float(speed)), START, "cannot be differentiated"),
    ],
)
def test_what_has_none_is_refused(body, load, wrt, words):
    with pytest.raises(ValueError, match=words):
        nt.sensitivities(body, t_end=1, step=0.1, material_angular_velocity=W0, load=load, wrt=wrt, project=True)

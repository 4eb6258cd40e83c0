"""Derivatives of runs are those of the discrete run, and obey the differentiated balances."""

import json
import pickle
import re
import tracemalloc
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import nontwist as nt
from complex_steps import Body, derivative
from nontwist.errors import SimulationError
from nontwist.inertia import euler_inertia
from nontwist.integrators import EnergyMomentum, LieMidpoint
from refusals import says

J = np.array([[3, 0.1, -0.2], [0.1, 4, 0.15], [-0.2, 0.15, 5]])
PRINCIPAL = np.array([[3, 0.1, 0], [0.1, 4, 0], [0, 0, 5.0]])
AXIS, E3 = np.array([1, 2, 2]) / 3, np.array([0, 0, 1.0])
R0, W0 = Rotation.from_rotvec([0.3, -0.5, 0.9]), np.array([0.4, -1.1, 0.7])
DEAD = np.array([[0.3, -1, 2], [0.5, 0.2, -1.5], [1, 1, -0.6]])
DOWN = np.array([0.3, -0.4, -0.8]) / np.sqrt(0.89)
WEIGHT = np.outer([0.3, 0.2, 1.4], DOWN)
C = np.array([[0.3, 0.05, 0], [0.02, 0.2, -0.03], [0, 0.01, 0.4]])
TIMES, VALUES = np.array([-0.01, 0.23, 0.47, 0.78, 1.22]), np.random.default_rng(1).normal(size=(5, 3))
WHEEL, SPEEDS, MOMENTA = np.array([2, -2, 1]) / 3, np.array([-0.3, 0.53, 1.7]), np.array([0.5, 1.5, -0.4])
PEAK, FREQUENCY, PHASE = np.array([0.6, -0.3, 0.8]), 0.7, 0.2
ENTRIES = [(0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1)]
START = {"material_angular_velocity": W0, "rotation": R0}


def inertia_entry(k):
    A = np.zeros((3, 3))
    i, j = ENTRIES[k]
    A[i, j] = A[j, i] = 1
    return A


def table(t, values):
    k = int(np.clip(np.searchsorted(TIMES, t, side="right") - 1, 0, 3))
    x = (t - TIMES[k]) / (TIMES[k + 1] - TIMES[k])
    return (1 - x) * values[k] + x * values[k + 1]


def momentum(t, values, axis):
    k = int(np.clip(np.searchsorted(SPEEDS, t, side="right") - 1, 0, 1))
    x = (t - SPEEDS[k]) / (SPEEDS[k + 1] - SPEEDS[k])
    return ((1 - x) * values[k] + x * values[k + 1]) * axis


LOADS = {
    "none": nt.Load(),
    "body": nt.body_moment(TIMES, VALUES),
    "space": nt.sine(PEAK, FREQUENCY, phase=PHASE, frame="space"),
    "all": nt.body_moment(TIMES, VALUES)
    + nt.sine(PEAK, FREQUENCY, phase=PHASE, frame="space")
    + nt.damping(C)
    + nt.rotor(WHEEL, SPEEDS, MOMENTA),
}


def plain(name, x=0.0, **changes):
    """The load `name` for the plain steps, with what `changes` name changed by x."""
    values, v = VALUES + x * changes.get("values", 0), changes
    peak, f = PEAK + x * v.get("sine", 0), FREQUENCY + x * v.get("frequency", 0)
    phase = PHASE + x * v.get("phase", 0)
    c = 1 + x * v.get("load_scale", 0)
    found = {}
    if name in ("body", "all"):
        found["moving"] = lambda t: c * table(t, values)
    if name in ("space", "all"):
        found["space"] = lambda t: c * np.sin(2 * np.pi * f * t + phase) * peak
    if name == "all":
        found["damping"] = c * (C + x * v.get("damping", 0))
        axis = WHEEL + x * (np.eye(3) - np.outer(WHEEL, WHEEL)) @ v.get("rotor", np.zeros(3))
        found["rotor"] = lambda t: c * momentum(t, MOMENTA + x * v.get("momenta", 0), axis)
    return found


def problem(body, load, x=0.0, step=0.1, steps=10, exact=False, **changes):
    """The problem for the plain steps, with what `changes` name changed by x."""
    inertia, axis, dead = body
    n = axis
    if "axis" in changes:
        n = axis + x * (changes["axis"] - (axis @ changes["axis"]) * axis)
    W = W0 if n is None else W0 - (W0 @ axis) * axis
    W = W + x * changes.get("material_angular_velocity", 0)
    if n is not None:
        W = W - (W @ n) * n
    R = R0.as_matrix()
    if "rotation" in changes:
        d = changes["rotation"]
        R = R @ (np.eye(3) + x * np.array([[0, -d[2], d[1]], [d[2], 0, -d[0]], [-d[1], d[0], 0]]))
    known = Body(
        inertia + x * changes.get("inertia", 0),
        n,
        dead + x * changes.get("dead_force", 0),
        exact=exact,
        **plain(load, x, **changes),
    )
    return known, R, W, step + x * changes.get("duration", 0) / steps


BODIES = {
    "standard": (J, None, np.zeros((3, 3))),
    "under forces": (J, None, DEAD),
    "heavy": (J, None, WEIGHT),
    "suslov": (J, AXIS, DEAD),
    "nontwisting": (PRINCIPAL, E3, np.zeros((3, 3))),
}
EYE = np.eye(3)
DIRECTIONS = {
    "material_angular_velocity[1]": {"material_angular_velocity": EYE[0]},
    "material_angular_velocity[3]": {"material_angular_velocity": EYE[2]},
    "rotation[2]": {"rotation": EYE[1]},
    "inertia[11]": {"inertia": inertia_entry(0)},
    "inertia[12]": {"inertia": inertia_entry(5)},
    "duration": {"duration": 1.0},
}
INERTIA = {"inertia[23]": {"inertia": inertia_entry(3)}}
FORCES = {
    "dead_force[1y]": {"dead_force": np.outer(EYE[0], EYE[1])},
    "dead_force[3x]": {"dead_force": np.outer(EYE[2], EYE[0])},
}
LOADED = {
    "load_scale": {"load_scale": 1.0},
    "load[0].values[2,2]": {"values": np.outer(np.eye(5)[2], EYE[1])},
    "load[1].sine[y]": {"sine": EYE[1]},
    "load[1].frequency": {"frequency": 1.0},
    "load[1].phase": {"phase": 1.0},
    "load[2].damping[12]": {"damping": np.outer(EYE[0], EYE[1])},
    "load[3].values[1]": {"momenta": EYE[1]},
    "load[3].rotor[2]": {"rotor": EYE[1]},
}
CASES = [  # body, load, more parameters, how gauss turns the body
    ("standard", "none", INERTIA, "momentum"),
    ("heavy", "none", INERTIA, DOWN),
    ("nontwisting", "none", {}, "steady"),
    ("under forces", "none", INERTIA | FORCES, "rows"),
    ("suslov", "none", INERTIA | FORCES | {"axis[1]": {"axis": EYE[0]}}, "rows"),
    ("standard", "body", INERTIA | {"load_scale": {"load_scale": 1.0}}, "rows"),
    ("suslov", "all", INERTIA | FORCES | LOADED | {"axis[2]": {"axis": EYE[1]}}, "rows"),
]
SCHEMES = [
    ("lie-midpoint", 2),
    ("energy-momentum", 2),
    pytest.param("gauss", 2, marks=pytest.mark.long),
    pytest.param("gauss", 4, marks=pytest.mark.long),
    ("gauss", 8),
    pytest.param("gauss", 16, marks=pytest.mark.long),
]


def fields(names):
    return list(dict.fromkeys(re.sub(r"\[[^\]]*\]$", "", name) for name in names))


@pytest.mark.filterwarnings("ignore:.*(breakpoint|table of the load)")
@pytest.mark.parametrize(("scheme", "order"), SCHEMES)
@pytest.mark.parametrize(("body", "load", "more", "turn"), CASES, ids=[f"{case[0]}, {case[1]}" for case in CASES])
def test_tangents_are_those_of_the_discrete_run(scheme, order, body, load, more, turn):
    step, steps = (0.1, 4) if order < 8 else (0.4, 2)
    directions = DIRECTIONS | more
    inertia, axis, dead = BODIES[body]
    W = W0 if axis is None else W0 - (W0 @ axis) * axis
    system = nt.DirectorSystem(euler_inertia(inertia), axis, dead)
    d = nt.sensitivities(
        system,
        wrt=fields(directions),
        t_end=step * steps,
        step=step,
        integrator=scheme,
        order=order,
        load=LOADS[load],
        rotation=R0,
        material_angular_velocity=W,
        store="end",
    )
    found = np.concatenate([d.d_rotation.values[-1], d.d_material_angular_velocity.values[-1]])
    for name, change in directions.items():
        expected = derivative(
            lambda x, change=change: problem(BODIES[body], load, x, step, steps, **change), steps, scheme, order, turn
        )
        column = found[:, d.parameter.values.tolist().index(name)]
        assert abs(column - expected).max() <= 1e-12 * max(1.0, abs(expected).max()), name


@pytest.mark.parametrize("order", [2, 4])
@pytest.mark.parametrize("inertia", [J, 2 * EYE], ids=["standard", "sphere"])
def test_forces_on_a_free_body_act_as_on_its_rows(inertia, order):
    """Under forces it would not turn about a line, so the turn of its rows is what a force changes."""
    d = nt.sensitivities(nt.standard(inertia), wrt="dead_force", t_end=0.3, step=0.3, order=order, **START)
    found = np.concatenate([d.d_rotation.values[-1], d.d_material_angular_velocity.values[-1]])
    for k, change in enumerate(np.eye(9).reshape(9, 3, 3)):
        body = (inertia, None, np.zeros((3, 3)))
        make = partial(problem, body, "none", step=0.3, steps=1, dead_force=change)
        assert abs(found[:, k] - derivative(make, 1, "gauss", order, "rows")).max() <= 1e-14


@pytest.mark.filterwarnings("ignore:.*(breakpoint|table of the load)")
def test_tangents_of_exact_moments_in_the_director_scheme():
    names = {**DIRECTIONS, **{key: LOADED[key] for key in ("load[0].values[2,2]", "load[2].damping[12]")}}
    d = nt.sensitivities(
        nt.standard(J),
        wrt=fields(names),
        t_end=0.3,
        step=0.1,
        integrator=EnergyMomentum(moments="exact"),
        load=LOADS["all"],
        **START,
    )
    found = np.concatenate([d.d_rotation.values[-1], d.d_material_angular_velocity.values[-1]])
    for name, change in names.items():
        make = lambda x, change=change: problem(BODIES["standard"], "all", x, 0.1, 3, exact=True, **change)  # noqa: E731
        expected = derivative(make, 3, "energy-momentum")
        column = found[:, d.parameter.values.tolist().index(name)]
        assert abs(column - expected).max() <= 1e-12 * max(1.0, abs(expected).max()), name


@pytest.mark.filterwarnings("ignore:.*(breakpoint|table of the load)")
@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("make", [LieMidpoint, EnergyMomentum])
def test_tangents_with_dissipation(make, order):
    """Under all loads; of the director scheme by moments about the principal axes, which stay."""
    scheme, step, steps = make(order=order, dissipation=0.7), 0.1, 3
    names = {key: DIRECTIONS[key] for key in ("material_angular_velocity[3]", "rotation[2]", "duration")} | FORCES
    names |= {
        key: LOADED[key] for key in ("load_scale", "load[2].damping[12]", "load[3].values[1]", "load[3].rotor[2]")
    }
    q = np.linalg.eigh(J)[1][:, 1]
    names["principal_inertia[2]"] = {"inertia": np.outer(q, q)}
    if make is LieMidpoint:
        names |= INERTIA
    how = {"t_end": step * steps, "step": step, "integrator": scheme, "load": LOADS["all"], **START}
    d = nt.sensitivities(nt.DirectorSystem(euler_inertia(J), None, DEAD), wrt=fields(names), **how)
    found = np.concatenate([d.d_rotation.values[-1], d.d_material_angular_velocity.values[-1]])
    for name, change in names.items():

        def made(x, change=change):
            body, R, W, h = problem((J, None, DEAD), "all", x, step, steps, **change)
            body.dissipation = (0.7, 0.0) if order == 1 else (0.0, 0.7)
            return body, R, W, h

        expected = derivative(made, steps, scheme.name)
        column = found[:, d.parameter.values.tolist().index(name)]
        assert abs(column - expected).max() <= 1e-12 * max(1.0, abs(expected).max()), name


@pytest.mark.parametrize("scheme", [LieMidpoint(dissipation=0.7), EnergyMomentum(order=1, dissipation=0.7)])
def test_dissipation_keeps_the_momentum_of_neighbours(scheme):
    """dπ of a free body stays over 2000 steps, while its energy falls; gradient and tangents are transposes."""
    how = {
        "t_end": 100.0,
        "step": 0.05,
        "integrator": scheme,
        "wrt": ["material_angular_velocity", "rotation"],
        **START,
    }
    d = nt.sensitivities(nt.standard(J), **how)
    R = Rotation.from_quat(d.quaternion.values).as_matrix()
    W, dW, delta = d.material_angular_velocity.values, d.d_material_angular_velocity.values, d.d_rotation.values
    change = np.einsum("ij,tjp->tip", J, dW) + np.cross(delta, (W @ J)[:, :, None], axis=1)
    spatial = np.einsum("txi,tip->txp", R, change)
    if scheme.name == "lie-midpoint":  # the other has N beside W
        assert abs(spatial - spatial[0]).max() <= 1e-13 * abs(change).max() * np.sqrt(2000)
    assert d.kinetic_energy.values[-1] < 0.995 * d.kinetic_energy.values[0]
    rows = np.random.default_rng(4).normal(size=(2, d.sizes["time"], 3))
    g = nt.gradient(nt.standard(J), d_rotation=rows[0], d_material_angular_velocity=rows[1], **how).gradient.values
    parts = np.einsum("ti,tip->p", rows[0], delta) + np.einsum("ti,tip->p", rows[1], dW)
    terms = np.einsum("ti,tip->p", abs(rows[0]), abs(delta)) + np.einsum("ti,tip->p", abs(rows[1]), abs(dW))
    assert (abs(g - parts) <= 1e-12 * terms).all()


@pytest.mark.parametrize("scheme", ["gauss", "lie-midpoint", "energy-momentum"])
def test_a_body_at_rest(scheme):
    """At rest a change of W turns the body by its integral, and one of the inertia does nothing."""
    d = nt.sensitivities(
        nt.standard(J), wrt=["material_angular_velocity", "inertia"], t_end=2, step=0.1, integrator=scheme
    )
    assert abs(d.d_rotation.values[-1, :, :3] - 2 * EYE).max() < 1e-14
    assert abs(d.d_material_angular_velocity.values[-1, :, :3] - EYE).max() < 2e-14  # some round-off in 20 steps
    assert abs(d.d_rotation.values[-1, :, 3:]).max() < 1e-25


@pytest.mark.filterwarnings("ignore:.*step")
@pytest.mark.parametrize("order", [2, 4, 6, 8, 16])
@pytest.mark.parametrize("speed", [0, 1e-100, 1e-16, 1e-9, 1e-6])
def test_a_body_that_hardly_turns(order, speed):
    """Its momentum has a direction, which a change of the start turns by any angle; the attitude turns by h dW."""
    how = {"t_end": 0.05, "step": 0.05, "material_angular_velocity": speed * W0}
    d = nt.sensitivities(
        nt.standard(J), wrt=["material_angular_velocity", "inertia"], integrator="gauss", order=order, **how
    )
    assert abs(d.d_rotation.values[-1, :, :3] / 0.05 - np.eye(3)).max() <= max(1e-14, speed)
    assert abs(d.d_rotation.values[-1, :, 3:]).max() <= speed


@pytest.mark.parametrize("order", [2, 4, 8])
def test_a_longer_run_of_a_body_that_hardly_turns(order):
    """It turns further by the velocity at the end."""
    how = {"t_end": 1, "step": 0.1, "integrator": "gauss", "order": order, "rotation": R0}
    d = nt.sensitivities(nt.standard(J), wrt="duration", material_angular_velocity=1e-6 * W0, **how)
    expected = d.material_angular_velocity.values[-1]
    assert abs(d.d_rotation.values[-1, :, 0] - expected).max() < 1e-12 * abs(expected).max()


@pytest.mark.parametrize("order", [2, 4, 8, 16])
def test_a_top_that_hangs_at_rest(order):
    """Linearised about equilibrium the motion is a pendulum, J dW' = -K δ, δ' = dW, K = m g l (I - u uᵀ)."""
    u = np.array([0.3, -0.2, 0.6]) / 0.7
    top, down = nt.heavy_top(J, 1.0, 0.7 * u, gravity=(0, 0, -2)), Rotation.align_vectors([[0, 0, -1]], [u])[0]
    how = {
        "t_end": 1,
        "rotation": down,
        "integrator": "gauss",
        "order": order,
        "step": 1 / (8000 if order == 2 else 50),
    }
    d = nt.sensitivities(top, wrt=["rotation", "material_angular_velocity"], **how)
    stiffness, o, unit = 1.4 * (np.eye(3) - np.outer(u, u)), np.zeros((3, 3)), np.eye(3)
    exact = expm(np.block([[o, unit], [-np.linalg.solve(J, stiffness), o]]))
    found = np.concatenate([d.d_rotation.values[-1], d.d_material_angular_velocity.values[-1]])
    assert abs(found - exact).max() <= {2: 4e-9, 4: 3e-10}.get(order, 3e-13)
    grown = nt.lyapunov(top, **how | {"t_end": 100, "step": 0.05})  # its steps were not solved again
    assert np.isfinite(grown.lyapunov_exponent.values).all()


def test_large_steps_are_solved_again():
    """Where fixed points do not contract, and where the run has taken Newton's iteration as well."""
    how = {"t_end": 6, "step": 1.5, "integrator": "gauss", "order": 4, "rotation": R0}
    how |= {"material_angular_velocity": 2 * W0, "load": nt.damping(C)}
    d = nt.sensitivities(SYSTEMS["heavy"], wrt="material_angular_velocity", **how)
    runs = [
        nt.integrate(SYSTEMS["heavy"], **(how | {"material_angular_velocity": 2 * W0 + x * EYE[1]}))
        for x in (1e-5, -1e-5)
    ]
    found = np.concatenate([d.d_rotation.values[-1, :, 1], d.d_material_angular_velocity.values[-1, :, 1]])
    assert abs(found - states_apart(*runs) / 2e-5).max() < 1e-7 * abs(found).max()


SYSTEMS = {
    "standard": nt.standard(J),
    "heavy": nt.DirectorSystem(euler_inertia(J), None, WEIGHT),
    "suslov": nt.DirectorSystem(euler_inertia(J), AXIS, DEAD),
    "spun": nt.nontwisting(PRINCIPAL, spin=([0, 0.4, 1.1], [0.5, 1.5, 1])),
}


def states_apart(a, b):
    """By how much two runs are apart at the end, as `sensitivities` counts it."""
    Ra, Rb = (Rotation.from_quat(run.states.quaternion[-1]) for run in (a, b))
    return np.concatenate([(Rb.inv() * Ra).as_rotvec(), a.states.velocity[-1] - b.states.velocity[-1]])


@pytest.mark.filterwarnings("ignore:.*(breakpoint|table of the load)")
@pytest.mark.parametrize("scheme", ["gauss", "lie-midpoint"])
def test_spin_is_a_parameter(scheme):
    how = {"t_end": 1, "step": 0.05, "integrator": scheme, "material_angular_velocity": (0.4, -1.1, 0), "project": True}
    d = nt.sensitivities(SYSTEMS["spun"], wrt=["spin", "duration"], **how)
    for k in range(3):
        runs = []
        for x in (1e-4, -1e-4):
            values = [0.5, 1.5, 1]
            values[k] += x
            runs.append(nt.integrate(nt.nontwisting(PRINCIPAL, spin=([0, 0.4, 1.1], values)), **how))
        found = np.concatenate([d.d_rotation.values[-1, :, k], d.d_material_angular_velocity.values[-1, :, k]])
        assert abs(found - states_apart(*runs) / 2e-4).max() < 2e-8


@pytest.mark.parametrize("spin", [0.7, -3.0])
def test_a_constant_spin_is_a_parameter(spin):
    how = {"t_end": 1, "step": 0.05, "material_angular_velocity": (0.4, -1.1, 0), "project": True}
    d = nt.sensitivities(nt.nontwisting(PRINCIPAL, spin=spin), wrt="spin", **how)
    runs = [nt.integrate(nt.nontwisting(PRINCIPAL, spin=spin + x), **how) for x in (1e-4, -1e-4)]
    found = np.concatenate([d.d_rotation.values[-1, :, 0], d.d_material_angular_velocity.values[-1, :, 0]])
    assert found[5] == 1
    assert abs(found - states_apart(*runs) / 2e-4).max() < 2e-8
    last = {"store": "end", "d_material_angular_velocity": [[0, 0, 0], [0, 0, 1]]}
    assert nt.gradient(
        nt.nontwisting(PRINCIPAL, spin=spin), wrt="spin", **how, **last
    ).gradient.item() == pytest.approx(1)


@pytest.mark.filterwarnings("ignore:.*(breakpoint|table of the load)")
@pytest.mark.parametrize(("scheme", "order"), SCHEMES)
@pytest.mark.parametrize(("body", "load"), [("standard", "none"), ("suslov", "all"), ("heavy", "none")])
def test_gradient_is_the_transpose_of_sensitivities(scheme, order, body, load):
    system, axis = SYSTEMS[body], SYSTEMS[body].axis
    names = ["material_angular_velocity", "rotation", "inertia", "principal_inertia", "axis", "dead_force", "duration"]
    how = {
        "wrt": [*names, "load_scale", *(["values", "damping", "sine", "rotor"] if load == "all" else [])],
        "t_end": 3.0,
        "step": 0.05,
        "integrator": scheme,
        "order": order,
        "load": LOADS[load],
        "rotation": R0,
        "material_angular_velocity": W0 if axis is None else W0 - (W0 @ axis) * axis,
        "store": 3,
    }
    d = nt.sensitivities(system, **how)
    by_rotation, by_velocity = np.random.default_rng(2).normal(size=(2, d.sizes["time"], 3))
    g = nt.gradient(system, d_rotation=by_rotation, d_material_angular_velocity=by_velocity, **how)
    rotations, velocities = d.d_rotation.values, d.d_material_angular_velocity.values
    forward = np.einsum("ti,tip->p", by_rotation, rotations) + np.einsum("ti,tip->p", by_velocity, velocities)
    terms = np.einsum("ti,tip->p", abs(by_rotation), abs(rotations))
    terms += np.einsum("ti,tip->p", abs(by_velocity), abs(velocities))
    assert (abs(g.gradient.values - forward) <= 1e-12 * terms).all()
    assert g.parameter.values.tolist() == d.parameter.values.tolist()
    assert g.parameter_unit.values.tolist() == d.parameter_unit.values.tolist()


@pytest.mark.parametrize(("scheme", "order"), [SCHEMES[0], *SCHEMES[2:]])  # the director scheme has N
@pytest.mark.parametrize("body", ["standard", "heavy"])
def test_differentiated_balances(scheme, order, body):
    """``dK + dV`` of a conservative run stays, and dπ of a free one, over 10⁴ steps."""
    system, steps, h = SYSTEMS[body], 10_000, 0.05
    how = {"t_end": steps * h, "step": h, "integrator": scheme, "order": order, **START}
    d = nt.sensitivities(system, wrt=["material_angular_velocity", "rotation", "inertia"], **how)
    W, dW, delta = d.material_angular_velocity.values, d.d_material_angular_velocity.values, d.d_rotation.values
    R = Rotation.from_quat(d.quaternion.values).as_matrix()
    dJ = np.zeros((12, 3, 3))
    dJ[6:] = [inertia_entry(k) for k in range(6)]
    F, Pi = np.einsum("ix,txk->tik", system.dead_force, R), W @ J
    dPi = np.einsum("ij,tjp->tip", J, dW) + np.einsum("pij,tj->tip", dJ, W)
    dK = np.einsum("ti,tip->tp", Pi, dW) + np.einsum("ti,pij,tj->tp", W, dJ, W) / 2
    dV = -np.einsum("tik,tpik->tp", F, np.cross(delta.swapaxes(1, 2)[:, :, None], EYE))
    sizes = np.linalg.norm(J, 2) * np.linalg.norm(W, axis=1).max() * abs(dW).max() + abs(F).max() * abs(delta).max()
    assert abs(dK + dV - (dK + dV)[0]).max() <= 1e-13 * sizes * np.sqrt(steps)
    if body == "standard":
        turned = np.cross(delta, Pi[:, :, None], axis=1)
        spatial = np.einsum("txi,tip->txp", R, dPi + turned)
        assert abs(spatial - spatial[0]).max() <= 1e-13 * (sizes + abs(turned).max()) * np.sqrt(steps)


def test_work_is_differentiated():
    """A moment along the frame of a body at rest about its axis: W changes by the impulse over J, exactly."""
    load = nt.body_moment([0, 1], [[0, 0, 2.0], [0, 0, 2.0]])
    d = nt.sensitivities(nt.standard([3, 4, 5]), wrt=["values", "principal_inertia"], t_end=1, step=0.1, load=load)
    spin = d.d_material_angular_velocity.values[-1, 2]
    labels = d.parameter.values.tolist()
    assert abs(spin[[labels.index("load[0].values[0,3]"), labels.index("load[0].values[1,3]")]] - 0.1).max() < 1e-14
    assert abs(spin[labels.index("principal_inertia[3]")] + 2 / 25) < 1e-14
    assert abs(spin[labels.index("principal_inertia[1]")]) < 1e-14


def test_principal_inertia_goes_with_the_axes_of_the_body():
    how = {"t_end": 2, "step": 0.1, **START}
    Q = np.linalg.eigh(J)[1]
    d = nt.sensitivities(nt.standard(J), wrt=["principal_inertia", "inertia"], **how)
    entries = d.d_rotation.values[-1, :, 3:]
    for i in range(3):
        A = np.outer(Q[:, i], Q[:, i])
        expected = sum(A[a, b] * entries[:, k] for k, (a, b) in enumerate(ENTRIES))
        assert abs(d.d_rotation.values[-1, :, i] - expected).max() < 1e-14 * max(1, abs(entries).max())
    straight = nt.sensitivities(nt.standard([5, 3, 4]), wrt=["principal_inertia", "inertia"], **how).d_rotation.values[
        -1
    ]
    assert np.array_equal(straight[:, :3], straight[:, 3:6])


def test_what_a_run_does_not_depend_on_is_zero():
    d = nt.sensitivities(nt.standard(J), wrt=["axis", "load_scale", "rotation"], t_end=1, step=0.1, **START)
    assert not d.d_rotation.values[..., :4].any()
    assert not d.d_material_angular_velocity.values[..., :4].any()
    assert np.array_equal(d.d_rotation.values[0, :, 4:], EYE)
    suslov = nt.sensitivities(SYSTEMS["suslov"], t_end=1, step=0.1, project=True, **START)
    assert abs(suslov.d_material_angular_velocity.values[..., :3].swapaxes(1, 2) @ AXIS).max() < 1e-14


@pytest.mark.parametrize("scheme", ["gauss", "lie-midpoint", "energy-momentum"])
def test_run_and_shape(scheme):
    how = {"t_end": 1, "step": 0.05, "store": 4, "integrator": scheme, **START}
    d, run = nt.sensitivities(SYSTEMS["heavy"], **how), nt.simulate(SYSTEMS["heavy"], **how)
    for name in run.data_vars:
        assert np.array_equal(d[name], run[name]), name
    assert d.attrs == run.attrs
    assert d.d_rotation.dims == ("time", "axis", "parameter")
    assert d.d_material_angular_velocity.dims == ("time", "director", "parameter")
    assert d.parameter.values[[0, 5]].tolist() == ["material_angular_velocity[1]", "rotation[3]"]
    assert d.parameter_unit.values[[0, 5]].tolist() == ["rad s-1", "rad"]
    assert (d.d_rotation.units, d.d_material_angular_velocity.units) == ("rad", "rad s-1")


def test_chosen_steps_and_continued_runs():
    how = {"t_end": 1.2, "load": LOADS["body"], **START}
    d = nt.sensitivities(SYSTEMS["standard"], tolerance=1e-6, **how)
    assert d.attrs["tolerance"] == 1e-6
    assert len(json.loads(d.attrs["stretches"])["borders"]) > 2
    exact = nt.sensitivities(SYSTEMS["standard"], tolerance=1e-11, **how)
    assert abs(d.d_rotation.values[-1] - exact.d_rotation.values[-1]).max() < 1e-5
    how |= {"load": None, "step": 0.05, "t_end": 2.0, "integrator": "lie-midpoint"}
    whole = nt.sensitivities(SYSTEMS["standard"], **how)
    first = nt.simulate(SYSTEMS["standard"], **(how | {"t_end": 1.0}))
    second = nt.sensitivities(SYSTEMS["standard"], start=first, t_end=2.0, step=0.05, integrator="lie-midpoint")
    X = np.concatenate([whole.d_rotation.values[20], whole.d_material_angular_velocity.values[20]])
    rows = [3, 4, 5, 0, 1, 2]  # second's parameters: velocity, then rotation
    assert abs(second.d_rotation.values[-1] @ X[rows] - whole.d_rotation.values[-1]).max() < 1e-13


@pytest.mark.parametrize(
    "more",
    [
        {"wrt": "inertai"},
        {"wrt": []},
        {"wrt": 3},
        {"wrt": "dampin", "load": nt.damping(0.1)},
        {"integrator": "split"},
        {"integrator": EnergyMomentum(dissipation=0.5), "wrt": "inertia"},
    ],
)
def test_what_is_refused(more):
    for function in (nt.sensitivities, nt.gradient):
        with says():
            function(nt.standard(J), **({"t_end": 1, "step": 0.1} | more))


@pytest.mark.long
@pytest.mark.parametrize("scheme", ["gauss", "energy-momentum"])
def test_a_gradient_holds_little_beside_the_states(scheme):
    """At most 200 bytes a step in all, of which the states have 56, and N of the director scheme 48."""
    steps, last = 200_000, np.array([[0, 0, 0], [0, 1.0, 0]])
    how = {"step": 0.05, "wrt": ["inertia", "load_scale"], "load": LOADS["space"], "integrator": scheme, **START}
    nt.gradient(nt.standard(J), d_rotation=last, store="end", t_end=1, **how)  # code is loaded
    tracemalloc.start()
    try:
        nt.gradient(nt.standard(J), d_rotation=last, store="end", t_end=steps * 0.05, **how)
        assert tracemalloc.get_traced_memory()[1] < 200 * steps
    finally:
        tracemalloc.stop()


def test_a_gradient_of_a_run_that_fails():
    """The part of the run that is known has no means over its steps."""
    with pytest.raises(SimulationError, match="the body turns") as caught:
        nt.gradient(nt.standard(J), t_end=10, step=5, integrator="lie-midpoint", **START)
    run = caught.value.partial
    assert len(run.material_angular_velocity) == 1
    assert run.to_dataset().sizes["time"] == 1


def test_gradient_refuses_other_shapes():
    with pytest.raises(ValueError, match=re.escape("d_rotation must have the shape (11, 3), got (2, 3)")):
        nt.gradient(nt.standard(J), t_end=1, step=0.1, d_rotation=np.zeros((2, 3)))


JACOBIANS = ["material_angular_velocity", "rotation", "inertia", "axis", "load_scale", "load[0].values"]


@pytest.mark.filterwarnings("ignore:.*(breakpoint|table of the load)")
@pytest.mark.parametrize("scheme", ["gauss", "lie-midpoint", "energy-momentum"])
@pytest.mark.parametrize(
    ("body", "load", "store"), [("standard", "body", 4), ("suslov", "all", 4), ("heavy", "none", "end")]
)
def test_jacobian_of_a_propagator_is_that_of_sensitivities(scheme, store, body, load):
    names = JACOBIANS if load != "none" else JACOBIANS[:-1]
    axis = SYSTEMS[body].axis
    W = W0 if axis is None else W0 - (W0 @ axis) * axis
    how = {"t_end": 1.0, "step": 0.05, "integrator": scheme, "load": LOADS[load], "store": store}
    run = nt.propagator(SYSTEMS[body], **how)
    for scale in (1.0, 1.0, 0.7):
        for W_ in (W, 0.5 * W):
            begin = {"material_angular_velocity": W_, "rotation": R0}
            found = run.jacobian(wrt=names, load_scale=scale, **begin)
            d = nt.sensitivities(SYSTEMS[body], wrt=names, **(how | {"load": scale * LOADS[load]}), **begin)
            one = np.where(np.char.startswith(d.parameter.values.astype(str), "load"), 1 / scale, 1.0)
            # by the factor itself, and by a table before it is multiplied
            one = np.where(np.char.find(d.parameter.values.astype(str), "values") >= 0, 1.0, one)
            for array, expected in zip(found, (d.d_rotation, d.d_material_angular_velocity), strict=True):
                again = expected.values * one
                assert array.shape == again.shape
                assert abs(array - again).max() <= 1e-14 * max(1, abs(again).max())


@pytest.mark.filterwarnings("ignore:.*(breakpoint|table of the load)")
@pytest.mark.parametrize("scheme", ["lie-midpoint", "energy-momentum"])
@pytest.mark.parametrize(("body", "load"), [("nontwisting", "none"), ("standard", "body"), ("heavy", "none")])
def test_jacobians_by_few_parameters(scheme, body, load):
    """Turns of the start alone turn all of a run that does not see its attitude; of a heavy body they do not."""
    inertia, axis, dead = BODIES[body]
    system = nt.DirectorSystem(euler_inertia(inertia), axis, dead)
    W = W0 if system.axis is None else W0 - (W0 @ system.axis) * system.axis
    how = {"t_end": 1.0, "step": 0.05, "integrator": scheme, "load": LOADS[load], "store": 4}
    names = ["material_angular_velocity", "rotation", "inertia", "duration"]
    start = {"material_angular_velocity": W, "rotation": R0}
    found = nt.propagator(system, **how).jacobian(wrt=names, **start)
    d = nt.sensitivities(system, wrt=names, **how, **start)
    for array, expected in zip(found, (d.d_rotation, d.d_material_angular_velocity), strict=True):
        assert abs(array - expected.values).max() <= 1e-14 * max(1, abs(expected.values).max())


def test_jacobian_serves_least_squares():
    run = nt.propagator(nt.standard(J), t_end=1.0, step=0.05)
    goal = run(material_angular_velocity=W0).rotation[-1].as_matrix()

    def gap(W):
        return nt.rotations.log(goal.T @ run(material_angular_velocity=W).rotation[-1].as_matrix())

    def slope(W):
        turned, _ = run.jacobian(material_angular_velocity=W, wrt="material_angular_velocity")
        return nt.rotations.dexp_inverse(-gap(W)) @ turned[-1]

    found = least_squares(gap, W0 + 0.3, jac=slope, xtol=1e-15, ftol=1e-15, gtol=1e-15)
    assert abs(found.x - W0).max() < 1e-12
    assert found.nfev < 12


def test_jacobian_from_threads_and_without_preparation():
    run = nt.propagator(nt.standard(J), t_end=1.0, step=0.05)
    starts = W0 * np.linspace(0.5, 1.5, 16)[:, None]
    expected = [run.jacobian(material_angular_velocity=W)[0] for W in starts]
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda W: run.jacobian(material_angular_velocity=W)[0], starts))
    assert np.array_equal(found, expected)
    other = nt.propagator(nt.standard(J), t_end=1.0)  # which chooses its steps for each start
    assert abs(other.jacobian(material_angular_velocity=starts[0])[0] - expected[0]).max() < 1e-6
    begin = nt.simulate(nt.standard(J), t_end=1, step=0.05, material_angular_velocity=starts[0])
    assert run.jacobian(start=begin)[0].shape == (2, 3, 6)
    pickle.loads(pickle.dumps(run)).jacobian(material_angular_velocity=W0)
    with pytest.raises(ValueError, match=re.escape("make the propagator without times=")):
        nt.propagator(nt.standard(J), times=[0.5, 1], step=0.05).jacobian()
    with pytest.raises(ValueError, match=re.escape("wrt has the unknown parameter 'velocity'")):
        run.jacobian(wrt="velocity")


@pytest.mark.parametrize("integrator", ["gauss", "lie-midpoint", "energy-momentum"])
def test_an_axis_turns_what_is_removed_of_the_start(integrator):
    """With project=True, W - n (n·W) turns with n in both factors; against central differences of the run."""
    J, n, W = [[2, 0.1, 0.3], [0.1, 2.5, -0.2], [0.3, -0.2, 3]], np.array([0.1, 0, 1]), (-1, 0.4, 0)
    how = {"t_end": 2, "step": 0.05, "load": nt.pulse((0.3, 0, 0), start=0.5, end=1.5), "integrator": integrator}
    start, size, e = {"material_angular_velocity": W}, np.linalg.norm(n), 1e-5

    def end(axis):
        run = nt.simulate(nt.suslov(J, axis), project=True, **start, **how)
        return run.material_angular_velocity.values[-1]

    differences = np.stack([(end(n + e * d) - end(n - e * d)) / (2 * e) for d in np.eye(3)], axis=1)
    body = nt.suslov(J, n)
    found = nt.sensitivities(body, wrt="axis", project=True, **start, **how).d_material_angular_velocity.values[-1]
    assert found / size == pytest.approx(differences, abs=1e-8)
    prepared = nt.propagator(body, project=True, **how)
    assert prepared.jacobian(wrt="axis", **start)[1][-1] == pytest.approx(found, abs=1e-12)
    c = np.array([1.0, 2, 0])
    slopes = np.vstack([np.zeros((40, 3)), c])
    of_c = nt.gradient(body, wrt="axis", project=True, d_material_angular_velocity=slopes, **start, **how)
    assert of_c.gradient.values == pytest.approx(c @ found, abs=1e-12)
    kept = np.array(W) - n * (n @ W) / size**2
    across = nt.sensitivities(
        body, wrt="axis", material_angular_velocity=kept, **how
    ).d_material_angular_velocity.values[-1]
    assert abs(across - found).max() > 1e-2  # another function: the start that is given is across the axis


@pytest.mark.parametrize("parameter", ["inertia", "axis", "dead_force"])
def test_inputs_change_the_equations_of_steps_that_are_explicit(parameter):
    """What vanishes in the run has derivatives nonetheless: those of `gauss`, to the order."""
    how = {"t_end": 0.5, "step": 0.005, "material_angular_velocity": (1, -2, 0), "load": nt.sine((0.3, 0.2, 0), 0.7)}
    found, expected = (
        nt.sensitivities(nt.nontwisting([3, 4, 5]), wrt=[parameter], integrator=name, **how)
        for name in ("lie-midpoint", "gauss")
    )
    for name in ("d_rotation", "d_material_angular_velocity"):
        gap = abs(found[name].values - expected[name].values).max()
        assert gap < 1e-4 * abs(expected[name].values).max() + 1e-12, name

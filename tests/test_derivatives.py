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
TIMES, VALUES = np.array([-0.01, 0.23, 0.47, 0.83, 1.22]), np.random.default_rng(1).normal(size=(5, 3))
WHEEL, SPEEDS, MOMENTA = np.array([2, -2, 1]) / 3, np.array([-0.3, 0.53, 1.7]), np.array([0.5, 1.5, -0.4])
PEAK, FREQUENCY, PHASE = np.array([0.6, -0.3, 0.8]), 0.7, 0.2
ENTRIES = [(0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1)]
START = {"material_angular_velocity": W0, "rotation": R0}


def inertia_entry(k):
    A = np.zeros((3, 3))
    i, j = ENTRIES[k]
    A[i, j] = A[j, i] = 1
    return A


def loaded(name, x=0.0, **change):
    """The load of this name, with what `change` names changed by x."""

    def at(own, value):
        return value + x * change.get(own, 0)

    moving = nt.body_moment(TIMES, at("values", VALUES))
    space = nt.sine(at("sine", PEAK), at("frequency", FREQUENCY), phase=at("phase", PHASE), frame="space")
    wheel = nt.rotor(WHEEL + x * across(change.get("rotor", 0 * WHEEL), WHEEL), SPEEDS, at("momenta", MOMENTA))
    every = moving + space + nt.damping(at("damping", C)) + wheel
    return at("load_scale", 1.0) * {"none": nt.Load(), "body": moving, "space": space, "all": every}[name]


def across(x, axis):
    return x if axis is None else x - (x @ axis) * axis


def derivative(run_of, h=0.01):
    """How the end of a run changes with a number at 0, attitude and W: differences of order 8 of eight runs."""
    first, total = run_of(1e-200).rotation[-1].inv(), np.zeros(6)
    for k, weight in enumerate((4 / 5, -1 / 5, 4 / 105, -1 / 280), 1):
        for x in (k * h, -k * h):
            run = run_of(x)
            state = np.append((first * run.rotation[-1]).as_rotvec(), run.material_angular_velocity[-1])
            total += weight / x * k * state
    return total


def require_tangents(
    body, load_of, directions, scheme, order=None, step=0.1, steps=2, bound=1e-12, by_time=1, h=0.01, beside=None
):
    """Compare the tangents of a run with its gradient, and with differences of runs in which `beside` acts as well.

    Along the sum of all directions, each by a random weight: a term that is wrong in one is wrong in the sum.
    """

    def run_of(x, change):
        inertia, axis, dead = body
        n = axis
        if "axis" in change:
            n = axis + x * across(change["axis"], axis)
            n = n / np.linalg.norm(n)
        W = across(across(W0, axis) + x * change.get("material_angular_velocity", 0), n)
        own = inertia + x * change.get("inertia", 0), n, dead + x * change.get("dead_force", 0)
        longer, load = step + x * change.get("duration", 0) / steps, load_of(x, **change) + (beside or nt.Load())
        how = {"t_end": steps * longer, "step": longer, "load": load, "store": "end", "project": True}
        how |= {"rotation": R0 * Rotation.from_rotvec(x * change.get("rotation", np.zeros(3)))}
        return nt.integrate(system_of(own), material_angular_velocity=W, integrator=scheme, order=order, **how)

    how = {"t_end": step * steps, "step": step, "integrator": scheme, "order": order, "store": "end"}
    how |= {"load": load_of(0.0), "rotation": R0, "material_angular_velocity": across(W0, body[1])}
    d, *_ = require_transpose(system_of(body), wrt=fields(directions), **how)
    labels, rng = d.parameter.values.tolist(), np.random.default_rng(6)
    for names, small, by in (({*directions} - {"duration"}, h, 1), ({*directions} & {"duration"}, 0.002, by_time)):
        weights = rng.normal(size=len(names)) / np.sqrt(max(1, len(names)))
        change, column = {}, 0.0
        for weight, label in zip(weights, sorted(names), strict=True):
            column = column + weight * last(d, labels.index(label))
            for name, way in directions[label].items():
                change[name] = change.get(name, 0) + weight * way
        expected = derivative(partial(run_of, change=change), small)  # 0.002: no node crosses a kink
        assert abs(column - expected).max() <= bound * by * max(1.0, abs(expected).max()), change


def require_transpose(system, **how):
    """Compare the gradient of random derivatives with the sum of the tangents; return both, and its terms."""
    d = nt.sensitivities(system, **how)
    changes = np.concatenate([d.d_rotation.values, d.d_material_angular_velocity.values], axis=1)
    rows = np.random.default_rng(2).normal(size=changes.shape[:2])
    g = nt.gradient(system, d_rotation=rows[:, :3], d_material_angular_velocity=rows[:, 3:], **how)
    terms = np.einsum("ti,tip->p", abs(rows), abs(changes))
    assert (abs(g.gradient.values - np.einsum("ti,tip->p", rows, changes)) <= 1e-12 * terms).all()
    return d, g, terms


def last(d, column=slice(None)):
    """The derivatives at the end, six rows."""
    return np.concatenate([d.d_rotation.values[-1, :, column], d.d_material_angular_velocity.values[-1, :, column]])


def system_of(body):
    inertia, axis, dead = body
    return nt.DirectorSystem(euler_inertia(inertia), axis, dead)


LOADS = {name: loaded(name) for name in ("none", "body", "space", "all")}
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
CASES = [  # body, load, more parameters
    ("standard", "none", INERTIA),
    ("heavy", "none", INERTIA),
    ("nontwisting", "none", {}),
    *(
        pytest.param(*case, marks=pytest.mark.long)  # parts of the last
        for case in (
            ("under forces", "none", INERTIA | FORCES),
            ("suslov", "none", INERTIA | FORCES | {"axis[1]": {"axis": EYE[0]}}),
        )
    ),
    ("standard", "body", INERTIA | {"load_scale": {"load_scale": 1.0}}),
    ("suslov", "all", INERTIA | FORCES | LOADED | {"axis[2]": {"axis": EYE[1]}}),
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
@pytest.mark.parametrize(
    ("body", "load", "more"), CASES, ids=["{}, {}".format(*getattr(case, "values", case)) for case in CASES]
)
def test_tangents_are_those_of_the_discrete_run(scheme, order, body, load, more):
    step, steps = (0.1, 4) if order < 8 else (0.4, 2)
    require_tangents(BODIES[body], partial(loaded, load), DIRECTIONS | more, scheme, order, step, steps)


@pytest.mark.parametrize("order", [2, 4])
@pytest.mark.parametrize("inertia", [J, 2 * EYE], ids=["standard", "sphere"])
def test_forces_on_a_free_body_act_as_on_its_rows(inertia, order):
    """Under forces it would not turn about a line, so the turn of its rows is what a force changes."""
    faint = nt.sine((1e-200, 0, 0), 0.7, frame="space")  # under which all rows are integrated
    names = [f"dead_force[{i}{x}]" for i in (1, 2, 3) for x in "xyz"]
    changes = {name: {"dead_force": F} for name, F in zip(names, np.eye(9).reshape(9, 3, 3), strict=True)}
    body = inertia, None, np.zeros((3, 3))
    require_tangents(body, partial(loaded, "none"), changes, "gauss", order, 0.3, 1, 1e-14, h=0.2, beside=faint)


@pytest.mark.long
@pytest.mark.filterwarnings("ignore:.*(breakpoint|table of the load)")
def test_tangents_of_exact_moments_in_the_director_scheme():
    names = {**DIRECTIONS, **{key: LOADED[key] for key in ("load[0].values[2,2]", "load[2].damping[12]")}}
    scheme = EnergyMomentum(moments="exact")
    require_tangents(BODIES["standard"], partial(loaded, "all"), names, scheme, steps=3)


@pytest.mark.filterwarnings("ignore:.*(breakpoint|table of the load)")
@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("make", [EnergyMomentum, pytest.param(LieMidpoint, marks=pytest.mark.long)])
def test_tangents_with_dissipation(make, order):
    """Under all loads; of the director scheme by moments about the principal axes, which stay."""
    names = {key: DIRECTIONS[key] for key in ("material_angular_velocity[3]", "rotation[2]", "duration")} | FORCES
    names |= {
        key: LOADED[key] for key in ("load_scale", "load[2].damping[12]", "load[3].values[1]", "load[3].rotor[2]")
    }
    q = np.linalg.eigh(J)[1][:, 1]
    names["principal_inertia[2]"] = {"inertia": np.outer(q, q)}
    names |= INERTIA if make is LieMidpoint else {}
    scheme = make(order=order, dissipation=0.7)
    require_tangents((J, None, DEAD), partial(loaded, "all"), names, scheme, steps=3)


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
    d, *_ = require_transpose(nt.standard(J), **how)
    R = Rotation.from_quat(d.quaternion.values).as_matrix()
    W, dW, delta = d.material_angular_velocity.values, d.d_material_angular_velocity.values, d.d_rotation.values
    change = np.einsum("ij,tjp->tip", J, dW) + np.cross(delta, (W @ J)[:, :, None], axis=1)
    spatial = np.einsum("txi,tip->txp", R, change)
    if scheme.name == "lie-midpoint":  # the other has N beside W
        assert abs(spatial - spatial[0]).max() <= 1e-13 * abs(change).max() * np.sqrt(2000)
    assert d.kinetic_energy.values[-1] < 0.995 * d.kinetic_energy.values[0]


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
    assert abs(last(d) - exact).max() <= {2: 4e-9, 4: 3e-10}.get(order, 3e-13)
    grown = nt.lyapunov(top, **how | {"t_end": 100, "step": 0.05})  # its steps were not solved again
    assert np.isfinite(grown.lyapunov_exponent.values).all()


def test_large_steps_are_solved_again():
    """Where fixed points do not contract, and where the run has taken Newton's iteration as well."""
    how = {"t_end": 6, "step": 1.5, "integrator": "gauss", "order": 4, "rotation": R0}
    how |= {"material_angular_velocity": 2 * W0, "load": nt.damping(C)}
    found = last(nt.sensitivities(SYSTEMS["heavy"], wrt="material_angular_velocity", **how), 1)
    by = derivative(
        lambda x: nt.integrate(SYSTEMS["heavy"], **how | {"material_angular_velocity": 2 * W0 + x * EYE[1]}), 1e-3
    )
    assert abs(found - by).max() < 1e-10 * abs(found).max()


SYSTEMS = {name: system_of(body) for name, body in BODIES.items()}


@pytest.mark.filterwarnings("ignore:.*(breakpoint|table of the load)")
@pytest.mark.parametrize("scheme", ["gauss", "lie-midpoint"])
@pytest.mark.parametrize("values", [[0.5, 1.5, 1], [0.7], [-3.0]])
def test_spin_is_a_parameter(scheme, values):
    """A table, and a constant one, which is the velocity at the end."""
    how = {"t_end": 1, "step": 0.05, "integrator": scheme, "material_angular_velocity": (0.4, -1.1, 0), "project": True}

    def body(change=0.0):
        spin = np.add(values, change)
        return nt.nontwisting(PRINCIPAL, spin=([0, 0.4, 1.1], spin) if len(spin) > 1 else spin[0])

    d = nt.sensitivities(body(), wrt=["spin", "duration"], **how)
    for k, e in enumerate(np.eye(len(values))):
        by = derivative(lambda x, e=e: nt.integrate(body(x * e), **how), 1e-3)
        assert abs(last(d, k) - by).max() < 1e-11
    if len(values) == 1:
        assert last(d, 0)[5] == 1
        end = {"store": "end", "d_material_angular_velocity": [[0, 0, 0], [0, 0, 1]]}
        assert nt.gradient(body(), wrt="spin", **how, **end).gradient.item() == pytest.approx(1)


@pytest.mark.filterwarnings("ignore:.*(breakpoint|table of the load)")
@pytest.mark.parametrize(("scheme", "order"), SCHEMES)
def test_gradient_is_the_transpose_of_sensitivities(scheme, order):
    """Of states on the way, in a longer run."""
    names = ["material_angular_velocity", "rotation", "inertia", "principal_inertia", "axis", "dead_force", "duration"]
    names += ["load_scale", "values", "damping", "sine", "rotor"]
    how = {"wrt": names, "t_end": 3.0, "step": 0.05, "integrator": scheme, "order": order, "store": 3}
    how |= {"rotation": R0, "material_angular_velocity": across(W0, AXIS), "load": LOADS["all"]}
    d, g, _ = require_transpose(SYSTEMS["suslov"], **how)
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
    ("body", "load", "store", "few"),
    [
        *[("standard", "body", 4, False), ("suslov", "all", 4, False), ("heavy", "none", "end", False)],
        *[("nontwisting", "none", 4, True), ("standard", "body", 4, True), ("heavy", "none", 4, True)],
    ],
)
def test_jacobian_of_a_propagator_is_that_of_sensitivities(scheme, store, body, load, few):
    """By few parameters: turns of the start alone turn all of a run that does not see its attitude."""
    names = JACOBIANS if load != "none" else JACOBIANS[:-1]
    names = ["material_angular_velocity", "rotation", "inertia", "duration"] if few else names
    how = {"t_end": 1.0, "step": 0.05, "integrator": scheme, "load": LOADS[load], "store": store}
    run, W = nt.propagator(SYSTEMS[body], **how), across(W0, SYSTEMS[body].axis)
    for scale, slower in ((1.0, 1.0), (1.0, 0.5), (0.7, 1.0))[: 2 if few else 3]:
        begin = {"material_angular_velocity": slower * W, "rotation": R0}
        found = run.jacobian(wrt=names, load_scale=scale, **begin)
        d = nt.sensitivities(SYSTEMS[body], wrt=names, **(how | {"load": scale * LOADS[load]}), **begin)
        one = np.where(np.char.startswith(d.parameter.values.astype(str), "load"), 1 / scale, 1.0)
        # by the factor itself, and by a table before it is multiplied
        one = np.where(np.char.find(d.parameter.values.astype(str), "values") >= 0, 1.0, one)
        for array, expected in zip(found, (d.d_rotation, d.d_material_angular_velocity), strict=True):
            again = expected.values * one
            assert array.shape == again.shape
            assert abs(array - again).max() <= 1e-14 * max(1, abs(again).max())


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
    start, size = {"material_angular_velocity": W}, np.linalg.norm(n)
    body = nt.suslov(J, n)
    found, *_ = require_transpose(body, wrt="axis", project=True, **start, **how)
    for k, d in enumerate(np.eye(3)):
        by = derivative(lambda x, d=d: nt.integrate(nt.suslov(J, n + x * d), project=True, **start, **how), 1e-3)
        assert last(found, k) / size == pytest.approx(by, abs=1e-11)
    found = found.d_material_angular_velocity.values[-1]
    prepared = nt.propagator(body, project=True, **how)
    assert prepared.jacobian(wrt="axis", **start)[1][-1] == pytest.approx(found, abs=1e-12)
    kept = np.array(W) - n * (n @ W) / size**2
    other = nt.sensitivities(body, wrt="axis", material_angular_velocity=kept, **how)
    assert (
        abs(other.d_material_angular_velocity.values[-1] - found).max() > 1e-2
    )  # another function: the start that is given is across the axis


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

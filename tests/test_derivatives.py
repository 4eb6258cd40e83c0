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
from scipy.spatial.transform import Rotation

import nontwist as nt
from nontwist.errors import SimulationError
from nontwist.inertia import euler_inertia
from nontwist.integrators import EnergyMomentum, LieMidpoint
from refusals import refused_as

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

    how = {"t_end": step * steps, "step": step, "integrator": scheme, "order": order, "store": 2}
    how |= {"load": load_of(0.0), "rotation": R0, "material_angular_velocity": across(W0, body[1])}
    d = require_transpose(system_of(body), wrt=fields(directions), **how)
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
    """Compare the gradient of random derivatives of all states with the sum of the tangents; return these."""
    d = nt.sensitivities(system, **how)
    changes = np.concatenate([d.d_rotation.values, d.d_material_angular_velocity.values], axis=1)
    rows = np.random.default_rng(2).normal(size=changes.shape[:2])
    g = nt.gradient(system, d_rotation=rows[:, :3], d_material_angular_velocity=rows[:, 3:], **how)
    terms = np.einsum("ti,tip->p", abs(rows), abs(changes))
    for name in ("parameter", "parameter_unit"):
        assert g[name].values.tolist() == d[name].values.tolist()
    assert (abs(g.gradient.values - np.einsum("ti,tip->p", rows, changes)) <= 1e-12 * terms).all()
    return d


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
MORE = {  # of a body and a load
    ("standard", "none"): INERTIA,
    ("nontwisting", "none"): {},
    ("under forces", "none"): INERTIA | FORCES,
    ("suslov", "none"): INERTIA | FORCES | {"axis[1]": {"axis": EYE[0]}},
    ("standard", "body"): INERTIA | {"load_scale": {"load_scale": 1.0}},
    ("heavy", "none"): INERTIA,
    ("suslov", "all"): INERTIA | FORCES | LOADED | {"axis[2]": {"axis": EYE[1]}},
}
SCHEMES = [("lie-midpoint", 2), ("energy-momentum", 2), *(("gauss", order) for order in (8, 2, 4, 16))]
QUICK = [("heavy", "none", "gauss", 4), ("standard", "body", "gauss", 4), ("nontwisting", "none", "gauss", 4)]
QUICK += [("standard", "none", "energy-momentum", 2), *(("suslov", "all", *scheme) for scheme in SCHEMES[:3])]
LONG = [case for case in ((*pair, *scheme) for pair in MORE for scheme in SCHEMES) if case not in QUICK]


def or_long(quick, long):
    """The cases of the quick suite, and more for the long one."""
    return [*quick, *(pytest.param(*case, marks=pytest.mark.long) for case in long)]


def fields(names):
    return list(dict.fromkeys(re.sub(r"\[[^\]]*\]$", "", name) for name in names))


@pytest.mark.filterwarnings("ignore:.*(breakpoint|table of the load)")
@pytest.mark.parametrize(("body", "load", "scheme", "order"), or_long(QUICK, LONG))
def test_tangents_are_those_of_the_discrete_run(body, load, scheme, order):
    step, steps = (0.1, 4) if order < 8 else (0.4, 2)
    require_tangents(BODIES[body], partial(loaded, load), DIRECTIONS | MORE[body, load], scheme, order, step, steps)


@pytest.mark.parametrize(("inertia", "order"), [(J, 2), (2 * EYE, 4)], ids=["standard", "sphere"])
def test_forces_on_a_free_body_act_as_on_its_rows(inertia, order):
    """Under forces it would not turn about a line, so the turn of its rows is what a force changes."""
    faint = nt.sine((1e-200, 0, 0), 0.7, frame="space")  # under which all rows are integrated
    names = [f"dead_force[{i}{x}]" for i in (1, 2, 3) for x in "xyz"]
    changes = {name: {"dead_force": F} for name, F in zip(names, np.eye(9).reshape(9, 3, 3), strict=True)}
    body = inertia, None, np.zeros((3, 3))
    require_tangents(body, partial(loaded, "none"), changes, "gauss", order, 0.3, 1, 1e-14, h=0.2, beside=faint)


@pytest.mark.filterwarnings("ignore:.*(breakpoint|table of the load)")
@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("make", [EnergyMomentum, pytest.param(LieMidpoint, marks=pytest.mark.long)])
def test_tangents_with_dissipation(make, order):
    """Under all loads; of the director scheme by moments about the principal axes, which stay."""
    names = {key: DIRECTIONS[key] for key in ("material_angular_velocity[3]", "rotation[2]", "duration")} | FORCES
    loads = ("load_scale", "load[2].damping[12]", "load[3].values[1]", "load[3].rotor[2]")
    names |= {key: LOADED[key] for key in loads} | (INERTIA if make is LieMidpoint else {})
    q = np.linalg.eigh(J)[1][:, 1]
    names["principal_inertia[2]"] = {"inertia": np.outer(q, q)}
    scheme = make(order=order, dissipation=0.7)
    require_tangents((J, None, DEAD), partial(loaded, "all"), names, scheme, steps=3)


@pytest.mark.filterwarnings("ignore:.*step")
@pytest.mark.parametrize(("scheme", "order"), or_long([*SCHEMES[:2], ("gauss", 2), ("gauss", 16)], [("gauss", 4)]))
def test_a_body_that_hardly_turns(scheme, order):
    """Its attitude turns by t dW, though its momentum turns by any angle, and in a longer run by W."""
    how = {"wrt": ["material_angular_velocity", "inertia", "duration"], "integrator": scheme, "order": order}
    for speed, steps in ((0.0, 20), (1e-100, 1), (1e-9, 1), (1e-6, 1)):
        if speed and scheme != "gauss":
            continue
        start = {"step": 0.05, "t_end": 0.05 * steps, "material_angular_velocity": speed * W0}
        d = nt.sensitivities(nt.standard(J), **start, **how)
        W, turn = d.material_angular_velocity.values[-1], d.d_rotation.values[-1]
        assert abs(turn[:, :3] / start["t_end"] - EYE).max() <= max(1e-14, speed)
        assert abs(d.d_material_angular_velocity.values[-1, :, :3] - EYE).max() < max(2e-14, speed)
        assert abs(turn[:, 3:9]).max() <= max(1e-25, speed)
        assert abs(turn[:, 9] - W).max() <= 1e-12 * abs(W).max()


@pytest.mark.parametrize(("order", "steps", "bound"), [(4, 50, 3e-10), (16, 50, 3e-13)])
def test_a_top_that_hangs_at_rest(order, steps, bound):
    """Linearised about equilibrium the motion is a pendulum, J dW' = -K δ, δ' = dW, K = m g l (I - u uᵀ)."""
    u, o = np.array([0.3, -0.2, 0.6]) / 0.7, np.zeros((3, 3))
    top, down = nt.heavy_top(J, 1.0, 0.7 * u, gravity=(0, 0, -2)), Rotation.align_vectors([[0, 0, -1]], [u])[0]
    how = {"t_end": 1, "rotation": down, "integrator": "gauss", "order": order}
    d = nt.sensitivities(top, wrt=["rotation", "material_angular_velocity"], step=1 / steps, **how)
    exact = expm(np.block([[o, EYE], [-np.linalg.solve(J, 1.4 * (EYE - np.outer(u, u))), o]]))
    assert abs(last(d) - exact).max() <= bound
    grown = nt.lyapunov(top, **how | {"t_end": 100, "step": 0.05})  # its steps were not solved again
    assert np.isfinite(grown.lyapunov_exponent.values).all()


SYSTEMS = {name: system_of(body) for name, body in BODIES.items()}


@pytest.mark.filterwarnings("ignore:.*(breakpoint|table of the load)")
@pytest.mark.parametrize(("scheme", "values"), [("gauss", [0.5, 1.5, 1]), ("lie-midpoint", [0.5, 2]), ("gauss", [-3])])
def test_spin_is_a_parameter(scheme, values):
    """A table, and a constant one, which is the velocity at the end."""
    how = {"t_end": 1, "step": 0.05, "integrator": scheme, "material_angular_velocity": (0.4, -1.1, 0), "project": True}

    def body(change=0.0):
        spin = np.add(values, change)
        return nt.nontwisting(PRINCIPAL, spin=([0, 0.4, 1.1][: len(spin)], spin) if len(spin) > 1 else spin[0])

    d = require_transpose(body(), wrt=["spin", "duration"], **how)
    weights = np.random.default_rng(4).normal(size=len(values))
    by = derivative(lambda x: nt.integrate(body(x * weights), **how), 1e-3)
    assert abs(last(d)[:, : len(values)] @ weights - by).max() < 1e-11
    if len(values) == 1:
        assert last(d, 0)[5] == 1


BALANCED = [("standard", "lie-midpoint", 2), ("standard", LieMidpoint(dissipation=0.7), None)]
MORE_ORDERS = [(body, "gauss", order) for body in ("standard", "heavy") for order in (2, 4, 16)]
BALANCED += [("heavy", "lie-midpoint", 2), ("standard", "gauss", 8), ("heavy", "gauss", 8)]


@pytest.mark.parametrize(("body", "scheme", "order"), or_long(BALANCED, MORE_ORDERS))
def test_differentiated_balances(body, scheme, order):
    """``dK + dV`` of a conservative run stays, and dπ of a free one, over 2000 steps."""
    system, steps, h = SYSTEMS[body], 2000, 0.05
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
    if order:
        assert abs(dK + dV - (dK + dV)[0]).max() <= 1e-13 * sizes * np.sqrt(steps)
    else:
        assert d.kinetic_energy.values[-1] < 0.995 * d.kinetic_energy.values[0]
    if body == "standard":
        turned = np.cross(delta, Pi[:, :, None], axis=1)
        spatial = np.einsum("txi,tip->txp", R, dPi + turned)
        assert abs(spatial - spatial[0]).max() <= 1e-13 * (sizes + abs(turned).max()) * np.sqrt(steps)


def test_principal_inertia_goes_with_the_axes_of_the_body():
    how = {"t_end": 2, "step": 0.1, "wrt": ["principal_inertia", "inertia"], **START}
    straight = last(nt.sensitivities(nt.standard([5, 3, 4]), **how))
    assert np.array_equal(straight[:, :3], straight[:, 3:6])


@pytest.mark.parametrize("scheme", ["gauss", "lie-midpoint", "energy-momentum"])
def test_run_and_shape(scheme):
    """The run, its derivatives beside it, and zeros of what it does not depend on."""
    how = {"t_end": 1, "step": 0.05, "store": 4, "integrator": scheme, "project": True, **START}
    wrt = ["axis", "load_scale", "rotation", "material_angular_velocity"]
    d, run = nt.sensitivities(nt.standard(J), wrt=wrt, **how), nt.simulate(nt.standard(J), **how)
    for name in run.data_vars:
        assert np.array_equal(d[name], run[name]), name
    assert d.attrs == run.attrs
    assert d.d_rotation.dims == ("time", "axis", "parameter")
    assert d.d_material_angular_velocity.dims == ("time", "director", "parameter")
    assert d.parameter.values[[9, 6]].tolist() == ["material_angular_velocity[3]", "rotation[3]"]
    assert d.parameter_unit.values[[9, 6]].tolist() == ["rad s-1", "rad"]
    assert (d.d_rotation.units, d.d_material_angular_velocity.units) == ("rad", "rad s-1")
    assert not d.d_rotation.values[..., :4].any()
    assert not d.d_material_angular_velocity.values[..., :4].any()
    assert np.array_equal(d.d_rotation.values[0, :, 4:7], EYE)
    if scheme != "energy-momentum":  # which has the constraint in the mean
        dW = nt.sensitivities(SYSTEMS["suslov"], wrt=wrt[3:], **how).d_material_angular_velocity.values
        assert abs(dW.swapaxes(1, 2) @ AXIS).max() < 1e-14


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


HOW, NO_WEIGHT = {"t_end": 1, "step": 0.1}, {"integrator": EnergyMomentum(dissipation=0.5), "wrt": "inertia"}
WRONG = [{"wrt": "inertai"}, {"wrt": []}, {"wrt": 3}, {"wrt": "dampin", "load": nt.damping(0.1)}]
WRONG += [{"integrator": "split"}, NO_WEIGHT]


def jacobian(wrt=None, **how):
    return nt.propagator(nt.standard(J), **how).jacobian(wrt=wrt)


test_what_is_refused = refused_as(
    [partial(nt.sensitivities, nt.standard(J), **HOW | wrong) for wrong in WRONG]
    + [partial(nt.gradient, nt.standard(J), **HOW | wrong) for wrong in [NO_WEIGHT, {"d_rotation": np.zeros((2, 3))}]]
    + [partial(jacobian, wrt="velocity", **HOW), partial(jacobian, times=[0.5, 1], step=0.1)]
    + [partial(nt.sensitivities, nt.standard(J), load=nt.wheel("x", 0.01), **HOW | NO_WEIGHT)]
)


def test_a_gradient_of_a_run_that_fails():
    """The part of the run that is known has no means over its steps."""
    with pytest.raises(SimulationError, match="the body turns") as caught:
        nt.gradient(nt.standard(J), t_end=10, step=5, integrator="lie-midpoint", **START)
    run = caught.value.partial
    assert len(run.material_angular_velocity) == 1
    assert run.to_dataset().sizes["time"] == 1


JACOBIANS = [("gauss", "suslov", "all", 4, False), ("lie-midpoint", "suslov", "all", 4, False)]
JACOBIANS += [("gauss", "heavy", "none", "end", False), ("gauss", "nontwisting", "none", 4, True)]
JACOBIANS += [("energy-momentum", "standard", "body", 4, True), ("lie-midpoint", "heavy", "none", 4, True)]


@pytest.mark.filterwarnings("ignore:.*(breakpoint|table of the load)")
@pytest.mark.parametrize(
    ("scheme", "body", "load", "store", "few"),
    or_long(JACOBIANS, [("energy-momentum", "suslov", "all", 4, False)]),
)
def test_jacobian_of_a_propagator_is_that_of_sensitivities(scheme, store, body, load, few):
    """By few parameters: turns of the start alone turn all of a run that does not see its attitude."""
    names = ["material_angular_velocity", "rotation", "inertia"]
    names += ["duration"] if few else ["axis", "load_scale", *(["load[0].values"] if load == "all" else [])]
    how = {"t_end": 1.0, "step": 0.05, "integrator": scheme, "load": LOADS[load], "store": store}
    run, W = nt.propagator(SYSTEMS[body], **how), across(W0, SYSTEMS[body].axis)
    for scale, slower in ((1.0, 1.0), (1.0, 0.5), (0.7, 1.0))[: 2 if few else 3]:
        begin = {"material_angular_velocity": slower * W, "rotation": R0}
        found = run.jacobian(wrt=names, load_scale=scale, **begin)
        d = nt.sensitivities(SYSTEMS[body], wrt=names, **(how | {"load": scale * LOADS[load]}), **begin)
        by_scale = d.parameter.values == "load_scale"  # by the factor itself, and by a table before it is multiplied
        for array, expected in zip(found, (d.d_rotation, d.d_material_angular_velocity), strict=True):
            again = expected.values * np.where(by_scale, 1 / scale, 1.0)
            assert array.shape == again.shape
            assert abs(array - again).max() <= 1e-14 * max(1, abs(again).max())


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
    d = nt.sensitivities(nt.standard(J), t_start=0, t_end=1, step=0.05, start=begin, store="end")
    for found, array in zip(run.jacobian(start=begin), (d.d_rotation, d.d_material_angular_velocity), strict=True):
        assert np.array_equal(found, array)
    again = pickle.loads(pickle.dumps(run)).jacobian(material_angular_velocity=starts[0])[0]
    assert np.array_equal(again, expected[0])


@pytest.mark.parametrize("integrator", ["gauss", "energy-momentum"])
def test_an_axis_turns_what_is_removed_of_the_start(integrator):
    """With project=True, W - n (n·W) turns with n in both factors; against central differences of the run."""
    J, n, W = [[2, 0.1, 0.3], [0.1, 2.5, -0.2], [0.3, -0.2, 3]], np.array([0.1, 0, 1]), (-1, 0.4, 0)
    how = {"t_end": 2, "step": 0.05, "load": nt.pulse((0.3, 0, 0), start=0.5, end=1.5), "integrator": integrator}
    body, start, d = nt.suslov(J, n), {"material_angular_velocity": W}, np.array([0.6, -0.5, 0.3])
    found = require_transpose(body, wrt="axis", project=True, **start, **how)
    by = derivative(lambda x: nt.integrate(nt.suslov(J, n + x * d), project=True, **start, **how), 1e-3)
    assert last(found) @ d / np.linalg.norm(n) == pytest.approx(by, abs=1e-11)
    prepared = nt.propagator(body, project=True, **how).jacobian(wrt="axis", **start)[1][-1]
    assert prepared == pytest.approx(last(found)[3:], abs=1e-12)
    kept = np.array(W) - n * (n @ W) / (n @ n)  # another function: the start that is given is across the axis
    other = nt.sensitivities(body, wrt="axis", material_angular_velocity=kept, **how)
    assert abs(last(other) - last(found)).max() > 1e-2


def test_inputs_change_the_equations_of_steps_that_are_explicit():
    """What vanishes in the run has derivatives nonetheless: those of `gauss`, to the order."""
    how = {"t_end": 0.5, "step": 0.005, "material_angular_velocity": (1, -2, 0), "load": nt.sine((0.3, 0.2, 0), 0.7)}
    for name, size in (("inertia", 6), ("axis", 3), ("dead_force", 9)):
        found, expected = (
            last(nt.sensitivities(nt.nontwisting([3, 4, 5]), wrt=name, integrator=scheme, **how))
            for scheme in ("lie-midpoint", "gauss")
        )
        assert found.shape == (6, size)
        for rows in (slice(3), slice(3, 6)):
            assert abs(found - expected)[rows].max() < 1e-4 * abs(expected[rows]).max() + 1e-12, name

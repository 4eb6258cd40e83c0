"""Derivatives of runs are those of the discrete run, and obey the differentiated balances."""

import json
import re
import tracemalloc
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

import nontwist as nt
from conftest import or_long
from nontwist.errors import SimulationError
from nontwist.geometry.attitudes import BASIS
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
PEAK = np.array([0.6, -0.3, 0.8])
EYE = np.eye(3)
START = {"material_angular_velocity": W0, "rotation": R0}
NUMBERS = {  # what runs are differentiated by; and what is beside J along its principal axes, and beside R0
    "material_angular_velocity": W0,
    "rotation": np.zeros(3),
    "principal_inertia": np.zeros(3),
    "load_scale": 1.0,
    "load[0].mean_motion": 1.3,
    "load[0].values": VALUES,
    "load[1].sine": PEAK,
    "load[1].frequency": 0.7,
    "load[1].phase": 0.2,
    "load[2].damping": C,
    "load[3].values": MOMENTA,
    "load[3].rotor": WHEEL,
}
BASIC = ["material_angular_velocity", "rotation", "inertia", "duration"]
FORCED, LOADED = [*BASIC, "dead_force"], ["load_scale", *list(NUMBERS)[5:]]


def loaded(name, p=NUMBERS):
    """The load of this name with these numbers."""
    moving = nt.body_moment(TIMES, p["load[0].values"])
    sine = p["load[1].sine"], p["load[1].frequency"]
    space = nt.sine(*sine, phase=p["load[1].phase"], frame="space")
    wheel = nt.rotor(p["load[3].rotor"], SPEEDS, p["load[3].values"])
    loads = {"none": nt.Load(), "body": moving, "space": space, "orbit": nt.gravity_gradient(p["load[0].mean_motion"])}
    loads["all"] = moving + space + nt.damping(p["load[2].damping"]) + wheel
    return p["load_scale"] * loads[name]


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


def system_of(p):
    """The body of these numbers, whose axis has any length."""
    axes = np.linalg.eigh(p["inertia"])[1]
    axis = p.get("axis") if p.get("axis") is None else p["axis"] / np.linalg.norm(p["axis"])
    inertia, spin = p["inertia"] + (axes * p["principal_inertia"]) @ axes.T, p.get("spin")
    if spin is not None:  # constant, or a table
        spin = spin[0] if len(spin) == 1 else ([0, 0.15, 0.5], spin)
    return nt.DirectorSystem(euler_inertia(inertia), axis, p.get("dead_force", np.zeros((3, 3))), spin=spin)


def moved(p, names, weights):
    """The numbers moved along their derivatives by these weights."""
    p, k = dict(p), 0
    for name in names:
        is_symmetric = name == "inertia" or name.endswith("quadratic")
        size = 6 if is_symmetric else np.size(p[name])
        change = weights[k : k + size]
        k += size
        if is_symmetric:
            change = np.einsum("k,kij->ij", change, BASIS)
        p[name] = p[name] + np.reshape(change, np.shape(p[name]))
    assert k == len(weights)
    return p


def require_tangents(p, load_of, wrt, steps, bound=1e-12, by_time=1, h=0.01, beside=None, **how):
    """Compare the tangents of a run with its gradient, and with differences of runs in which `beside` acts as well.

    Along the sum of all directions, each by a random weight: a term that is wrong in one is wrong in the sum. Along
    the time apart: no node may cross a kink.
    """

    def posed(p, **more):
        system = system_of(p)
        start = {"rotation": R0 * Rotation.from_rotvec(p["rotation"])}
        start |= {"material_angular_velocity": p["material_angular_velocity"], "project": True}
        grid = {"t_end": p["duration"], "step": p["duration"] / steps}
        return {"system": system, "load": load_of(p), **grid, **start, **how, **more}

    d, rng = require_transpose(**posed(p), wrt=wrt, store=2), np.random.default_rng(6)
    for names, small, by in (([x for x in wrt if x != "duration"], h, 1), ({"duration"} & {*wrt}, 0.002, by_time)):
        columns = [re.sub(r"\[[^\]]*\]$", "", x) in names or x in names for x in d.parameter.values]
        weights = rng.normal(size=sum(columns)) / np.sqrt(max(1, sum(columns)))

        def run_of(x, names=names, weights=weights):
            given = posed(moved(p, names, x * weights), store="end")
            return nt.integrate(**given | {"load": given["load"] + (beside or nt.Load())})

        expected = derivative(run_of, small)
        gap = last(d)[:, columns] @ weights - expected
        assert abs(gap).max() <= bound * by * max(1.0, abs(expected).max()), names


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


BODIES = {
    "standard": {"inertia": J},
    "under forces": {"inertia": J, "dead_force": DEAD},
    "heavy": {"inertia": J, "dead_force": WEIGHT},
    "suslov": {"inertia": J, "axis": AXIS, "dead_force": DEAD},
    "nontwisting": {"inertia": PRINCIPAL, "axis": E3, "dead_force": np.zeros((3, 3))},
    "spinning": {"inertia": PRINCIPAL, "axis": E3, "spin": np.array([0.5, 1.5, 1.0])},
    "spinning steadily": {"inertia": PRINCIPAL, "axis": E3, "spin": np.array([-3.0])},
}


def numbers_of(body, duration, **more):
    """Numbers of a body of this name in a run, and of loads."""
    return NUMBERS | BODIES[body] | {"duration": duration} | more


MORE = {  # what a body under a load is differentiated by
    ("standard", "none"): BASIC,
    ("nontwisting", "none"): [*START, "principal_inertia", "duration"],  # its axis stays principal
    ("under forces", "none"): FORCED,
    ("suslov", "none"): [*FORCED, "axis"],
    ("standard", "body"): [*BASIC, "load_scale"],
    ("heavy", "none"): [*BASIC, "principal_inertia"],
    ("suslov", "all"): [*FORCED, *LOADED, "axis"],
    ("spinning", "none"): [*START, "principal_inertia", "spin", "duration"],
    ("spinning steadily", "none"): [*START, "principal_inertia", "spin", "duration"],
    ("spinning", "orbit"): [*START, "spin", "duration", "load[0].mean_motion"],
    ("nontwisting", "body"): [*FORCED, "axis"],  # by a step that is explicit in the run
}
SCHEMES = [("lie-midpoint", 2), ("energy-momentum", 2), *(("gauss", order) for order in (8, 2, 4, 16))]
QUICK = [("heavy", "none", "gauss", 4), ("nontwisting", "none", "gauss", 4)]
QUICK += [("standard", "none", "energy-momentum", 2), ("nontwisting", "body", "lie-midpoint", 2)]
QUICK += [*(("suslov", "all", *scheme) for scheme in SCHEMES[:3])]
QUICK += [("spinning", "none", "gauss", 8), ("spinning", "none", "lie-midpoint", 2), ("spinning", "orbit", "gauss", 4)]
QUICK += [("spinning steadily", "none", "gauss", 2)]
LONG = [case for case in ((*pair, *scheme) for pair in MORE for scheme in SCHEMES) if case not in QUICK]
LOSING = [kind(order, dissipation=0.7) for kind in (EnergyMomentum, LieMidpoint) for order in (1, 2)]
LOSING = [("under forces", "all", scheme, None) for scheme in LOSING]
LONG = [case for case in LONG if case[2] != "energy-momentum" or "spinning" not in case[0]]


@pytest.mark.filterwarnings("ignore:.*(breakpoint|table of the load)")
@pytest.mark.parametrize(("body", "load", "scheme", "order"), or_long([*QUICK, *LOSING[:2]], [*LONG, *LOSING[2:]]))
def test_tangents_of_the_discrete_run(body, load, scheme, order):
    """With dissipation in the director scheme by moments about the principal axes, which stay."""
    duration, steps = (0.4, 4) if order is None or order < 8 else (0.8, 2)
    how, own = (
        {"integrator": scheme, "order": order},
        "inertia" if "lie" in str(scheme).lower() else "principal_inertia",
    )
    wrt = MORE.get((body, load), [*START, own, "duration", "dead_force", *LOADED])
    require_tangents(numbers_of(body, duration), partial(loaded, load), wrt, steps, **how)


@pytest.mark.parametrize(("inertia", "order"), [(J, 2), (2 * EYE, 4)], ids=["standard", "sphere"])
def test_forces_on_a_free_body(inertia, order):
    """Under forces it would not turn about a line, so the turn of its rows is what a force changes."""
    faint = nt.sine((1e-200, 0, 0), 0.7, frame="space")  # under which all rows are integrated
    numbers = numbers_of("standard", 0.3, inertia=inertia, dead_force=np.zeros((3, 3)))
    how = {"integrator": "gauss", "order": order, "h": 0.2, "beside": faint}
    require_tangents(numbers, partial(loaded, "none"), ["dead_force"], 1, 1e-14, **how)


@pytest.mark.filterwarnings("ignore:.*step")
@pytest.mark.parametrize(("scheme", "order"), or_long([*SCHEMES[:2], ("gauss", 2)], [("gauss", 4), ("gauss", 16)]))
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


@pytest.mark.parametrize(("order", "bound"), or_long([(4, 3e-10)], [(16, 3e-13)]))
def test_top_hanging_at_rest(order, bound):
    """Linearised about equilibrium the motion is a pendulum, J dW' = -K δ, δ' = dW, K = m g l (I - u uᵀ)."""
    u, o = np.array([0.3, -0.2, 0.6]) / 0.7, np.zeros((3, 3))
    top, down = nt.heavy_top(J, 1.0, 0.7 * u, gravity=(0, 0, -2)), Rotation.align_vectors([[0, 0, -1]], [u])[0]
    how = {"t_end": 1, "rotation": down, "integrator": "gauss", "order": order}
    d = nt.sensitivities(top, wrt=["rotation", "material_angular_velocity"], step=0.02, **how)
    exact = expm(np.block([[o, EYE], [-np.linalg.solve(J, 1.4 * (EYE - np.outer(u, u))), o]]))
    assert abs(last(d) - exact).max() <= bound
    grown = nt.lyapunov(top, **how | {"t_end": 100, "step": 0.05})  # its steps were not solved again
    assert np.isfinite(grown.lyapunov_exponent.values).all()


LOADS = {name: loaded(name) for name in ("none", "body", "space", "all")}
SYSTEMS = {name: system_of(numbers_of(name, 1.0)) for name in BODIES}


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
    d = nt.sensitivities(nt.standard([5, 3, 4]), wrt=["principal_inertia", "inertia"], **how)
    dW = d.d_material_angular_velocity.values
    assert np.array_equal(dW[..., :3], dW[..., 3:6])  # in the order of the directors, not of size


def test_chosen_steps_and_continued_runs():
    how = {"t_end": 1.2, "load": LOADS["body"], **START}
    d = nt.sensitivities(SYSTEMS["standard"], tolerance=1e-6, **how)
    assert d.attrs["tolerance"] == 1e-6
    assert len(json.loads(d.attrs["segments"])["borders"]) > 2
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
def test_gradient_needs_little_memory(scheme):
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
ENDS = [(11, NO_WEIGHT), (2, {})]


def jacobian(wrt=None, **how):
    return nt.propagator(nt.standard(J), **how).jacobian(wrt=wrt)


test_what_is_refused = refused_as(
    [partial(nt.sensitivities, nt.standard(J), **HOW | wrong) for wrong in WRONG]
    + [partial(nt.gradient, nt.standard(J), **HOW | {"d_rotation": np.zeros((n, 3))} | how) for n, how in ENDS]
    + [partial(jacobian, wrt="velocity", **HOW), partial(jacobian, times=[0.5, 1], step=0.1)]
)


def test_gradient_without_f():
    with pytest.raises(ValueError, match=r"^give d_rotation= or d_material_angular_velocity=, the derivatives of f"):
        nt.gradient(nt.nontwisting([3, 4, 5]), t_end=1, material_angular_velocity=(1, 2, 0), wrt="inertia")


def test_gradient_of_failing_run():
    """The part of the run that is known has no means over its steps."""
    with pytest.raises(SimulationError, match="the body turns") as caught:
        nt.gradient(nt.standard(J), t_end=10, step=5, integrator="lie-midpoint", d_rotation=np.eye(3), **START)
    run = caught.value.partial
    assert len(run.material_angular_velocity) == 1
    assert run.to_dataset().sizes["time"] == 1


def test_jacobian_from_threads():
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

"""Derivatives of runs under loads that depend on the state: functions, director forces, potentials."""

import math
import warnings
from dataclasses import dataclass
from functools import cache, partial, wraps
from typing import Annotated
from unittest.mock import patch

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import nontwist as nt
from conftest import or_long
from integrators import test_derivatives
from integrators.test_derivatives import AXIS, EYE, R0, START, W0, C, J, derivative, last, numbers_of
from nontwist.driver.ensembles import jacobian_of
from nontwist.engine.marching import Step, Text, turned_by_half
from nontwist.engine.records import State
from nontwist.errors import SimulationError
from nontwist.geometry.attitudes import BASIS
from nontwist.integrators import EnergyMomentum, LieMidpoint
from nontwist.integrators.compiled import Compiled
from nontwist.kernels.vectors import compensated, cross, sum_of
from nontwist.loads import LOADS as KINDS
from nontwist.loads import Term
from nontwist.loads.functions import Moment
from nontwist.spec import Spec
from refusals import says

FIELD, ANCHOR, POINT = np.array([0.3, 0.4, -0.8]), np.array([1, 0.5, 1]), np.array([0, 0.2, 1.0])
LINE, Q = np.array([1, 0.2, 0.3]), np.array([[1, 0.2, 0.3], [0.2, -2, 0.5], [0.3, 0.5, 0.7]])
STIFFNESS, REST = 3.0, 0.8
ORBIT = MOTION, RADIAL, NORMAL = 1.3, np.array([2, 2, -1]) / 3, np.array([2, -1, 2]) / 3
TIMES, FORCES = np.array([-0.1, 0.35, 1.1]), np.random.default_rng(3).normal(size=(3, 3, 3))


def push(t, d, w):
    """A moment of all arguments that complex numbers pass through."""
    x, y, z = d[2]
    return np.array([2 * y * z + 0.3 * t, x * d[0, 1] - 2 * x, 0.3 * x * y]) - 0.3 * w * np.sqrt(1 + w @ w)


def push_slope(t, d, w):
    x, y, z = d[2]
    by = np.zeros((3, 3, 3))
    by[0, 2, 1], by[0, 2, 2] = 2 * z, 2 * y
    by[1, 2, 0], by[1, 0, 1] = d[0, 1] - 2, x
    by[2, 2, 0], by[2, 2, 1] = 0.3 * y, 0.3 * x
    r = np.sqrt(1 + w @ w)
    return by, -0.3 * (r * np.eye(3) + np.outer(w, w) / r)


def pull(t, d, w):
    """Forces on the directors."""
    return np.array([d[1] * d[2] + 0.2 * w, t * d[0], w[0] * w])


def hill(g):
    return np.sin(g[0]) + g[1] * g[2] ** 2 + 0.3 * g[0] * g[1]


def hill_slope(g):
    return np.array([np.cos(g[0]) + 0.3 * g[1], g[2] ** 2 + 0.3 * g[0], 2 * g[1] * g[2]])


def in_floats(function):
    """A function that takes no numbers with derivatives."""

    @wraps(function)
    def rough(*given):
        return function(*(np.asarray(x, dtype=float) for x in given))

    return rough


NUMBERS = {  # of the load "all"
    "load[0].scale": 1.0,
    "load[1].linear": LINE,
    "load[1].quadratic": Q,
    "load[2].stiffness": STIFFNESS,
    "load[2].rest_length": REST,
    "load[3].values": FORCES,
    "load[4].damping": C,
    "load[5].scale": 0.9,
    "load[5].mean_motion": MOTION,
    "load[6].values": FORCES[::-1],
}
OF_ORBIT = {"load[0].scale": 0.9, "load[0].mean_motion": MOTION}


def loaded(name, p=NUMBERS | {"load_scale": 1.0}):
    """The load of this name with these numbers."""
    if name in ("duals", "compiled", "differences"):
        return p["load_scale"] * of_functions(name)
    place = "load[5]" if name == "all" else "load[0]"
    load = p[f"{place}.scale"] * nt.gravity_gradient(p[f"{place}.mean_motion"], RADIAL, NORMAL)
    if name == "all":
        pulled = 0.7 * nt.potential(FIELD, linear=p["load[1].linear"], quadratic=p["load[1].quadratic"])
        sprung = nt.spring(p["load[2].stiffness"], POINT, ANCHOR, p["load[2].rest_length"])
        before = p["load[0].scale"] * nt.moment(push, derivative=push_slope) + pulled + sprung
        before += nt.director_forces(TIMES, p["load[3].values"]) + nt.damping(p["load[4].damping"])
        load = before + load + nt.director_forces(TIMES, p["load[6].values"], frame="body")
    return p["load_scale"] * load


@cache
def of_functions(name):
    """A moment, forces and a potential of functions: that take duals, compiled, or that take floats alone."""
    how, functions = {"compiled": name == "compiled"}, (push, pull, hill, hill_slope)
    own, forces, V, slope = map(in_floats, functions) if name == "differences" else functions
    return 0.5 * nt.moment(own, **how) + nt.director_forces(forces, **how) + nt.potential(ANCHOR, V, slope, **how)


QUICK = [("lie-midpoint", 2), (EnergyMomentum(moments="exact"), None), ("gauss", 4)]
LONG = [("energy-momentum", 2), *(("gauss", order) for order in (2, 8, 16))]
LONG += [(LieMidpoint(dissipation=0.6), None), (EnergyMomentum(dissipation=0.6), None)]


IGNORED = "ignore:.*(breakpoint|table of the load|runs in Python|central differences)"


def compared(scheme, order, load, wrt, own=None, bound=1e-12, steps=2):
    """Compare the tangents of a run with differences of runs; by the time a function is differenced."""
    numbers = numbers_of("heavy", 0.1 * steps, **NUMBERS | (own or {}))
    wrt, how = [*test_derivatives.BASIC, "load_scale", *wrt], {"integrator": scheme, "order": order}
    if getattr(scheme, "dissipation", 0):
        wrt.remove("inertia")
    test_derivatives.require_tangents(numbers, partial(loaded, load), wrt, steps, bound, by_time=10, **how)


@pytest.mark.filterwarnings(IGNORED)
@pytest.mark.parametrize(("scheme", "order"), or_long(QUICK, LONG))
def test_tangents_of_the_discrete_run(scheme, order):
    """With potentials, tables of forces, an orbit, damping, and a function that brings its own derivative.

    The inertia is in the load as well; the radius depends on the mean motion, and on the time.
    """
    wrt, own = [*NUMBERS, "dead_force", "principal_inertia"], {}
    if "energy-momentum" not in (scheme, getattr(scheme, "name", "")):  # to the others these are moments
        wrt.remove("load[6].values")
    if not getattr(scheme, "dissipation", 0):
        wrt, own = [*wrt, "axis"], {"axis": AXIS}
    compared(scheme, order, "all", wrt, own)


FEW = [("gauss", 4, "duals"), ("energy-momentum", 2, "compiled"), ("gauss", 4, "differences")]
MANY = [(*scheme, load) for scheme in [*QUICK, *LONG[:4]] for load in ("duals", "compiled", "differences")]


@pytest.mark.filterwarnings(IGNORED)
@pytest.mark.parametrize(("scheme", "order", "load"), or_long(FEW, [case for case in MANY if case not in FEW]))
def test_functions_by_duals_or_differences(scheme, order, load):
    """Of the functions alone: where they do not take duals ten digits, and a warning."""
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        compared(scheme, order, load, [], bound=1e-9 if load == "differences" else 1e-12)
    assert any("central differences" in str(one.message) for one in told) == (load == "differences")


@pytest.mark.filterwarnings(IGNORED)
@pytest.mark.parametrize("order", [8, 4, pytest.param(2, marks=pytest.mark.long)])
def test_rows_turning_with_an_orbit(order):
    """Of a body which no forces act on: with a weight, `gauss` does not turn its rows with the orbit."""
    own = OF_ORBIT | {"dead_force": np.zeros((3, 3))} | ({"axis": AXIS} if order == 4 else {})
    extra = {8: ["dead_force"], 4: ["axis"], 2: []}[order]  # rows of a run under forces do not turn with the orbit
    compared("gauss", order, "orbit alone", [*OF_ORBIT, *extra], own, steps=3)


BALANCED = [("standard", "lie-midpoint", 2), ("standard", LieMidpoint(dissipation=0.7), None), ("orbit", "gauss", 2)]
BALANCED += [("heavy", "lie-midpoint", 2), ("standard", "gauss", 8), ("potential", "gauss", 4)]
MORE_ORDERS = [(kind, "gauss", order) for kind in ("standard", "heavy") for order in (2, 4, 8, 16)]
MORE_ORDERS.remove(("standard", "gauss", 8))


@pytest.mark.parametrize(("kind", "scheme", "order"), or_long(BALANCED, [*MORE_ORDERS, ("orbit", "gauss", 4)]))
def test_differentiated_balances(kind, scheme, order):
    """``dK + dV`` stays, in an orbit ``dH``, H = K + V - n o·π, and dπ of a free body, over 1000 steps."""
    system, steps = test_derivatives.SYSTEMS["heavy" if kind == "heavy" else "standard"], 1000
    loads = {"potential": nt.potential(FIELD, linear=LINE, quadratic=Q), "orbit": nt.gravity_gradient(*ORBIT)}
    how = {"t_end": steps * 0.1, "step": 0.1, "integrator": scheme, "order": order, "load": loads.get(kind), **START}
    has_inertia = kind in ("standard", "heavy")
    d = nt.sensitivities(system, wrt=["rotation", "material_angular_velocity", *["inertia"] * has_inertia], **how)
    dJ = np.concatenate([np.zeros((6, 3, 3)), *[BASIS] * has_inertia])
    W, dW, delta = d.material_angular_velocity.values, d.d_material_angular_velocity.values, d.d_rotation.values
    turned, angle = Rotation.from_quat(d.quaternion.values), MOTION * d.time.values[:, None]
    R, back, o = turned.as_matrix(), turned.inv(), np.zeros(3)
    by_turn = -np.cross(EYE, np.einsum("ix,txk->tik", system.dead_force, R)).sum(1)
    if kind == "orbit":
        gamma, o = back.apply(np.cos(angle) * RADIAL + np.sin(angle) * np.cross(NORMAL, RADIAL)), back.apply(NORMAL)
        by_turn, o = np.cross(3 * MOTION**2 * gamma @ J, gamma) - MOTION * np.cross(W @ J, o), MOTION * o
    elif kind == "potential":
        gamma = back.apply(FIELD)
        by_turn = np.cross(LINE + gamma @ Q, gamma)
    by_velocity = (W - o) @ J
    change = np.einsum("ti,tip->tp", by_turn, delta) + np.einsum("ti,tip->tp", by_velocity, dW)
    change += np.einsum("ti,pij,tj->tp", W, dJ, W) / 2
    sizes = abs(by_turn).max() * abs(delta).max() + abs(by_velocity).max() * abs(dW).max()
    if order:
        assert abs(change - change[0]).max() <= 1e-13 * sizes * np.sqrt(steps)
    else:
        assert d.kinetic_energy.values[-1] < 0.995 * d.kinetic_energy.values[0]
    if kind == "standard":
        spatial = R @ (np.cross(delta, (W @ J)[:, :, None], axis=1) + J @ dW + np.einsum("pij,tj->tip", dJ, W))
        sizes += abs(W @ J).max() * abs(delta).max()
        assert abs(spatial - spatial[0]).max() <= 1e-13 * sizes * np.sqrt(steps)


def test_dropped_derivatives_are_found():
    """It takes floats alone, reads the memory of its arguments, or gives another value: that of the floats tells."""

    def raw(t, d, w):
        return push(
            float(np.float64(t)) if isinstance(t, float) else 0.0, *(np.zeros_like(x, float) + x for x in (d, w))
        )

    def other(t, d, w):
        return push(t, d, w) if isinstance(t, float) else np.zeros(3)

    how = {"t_end": 0.5, "step": 0.1, "rotation": R0, "integrator": "lie-midpoint"}
    exact = nt.sensitivities(nt.standard(J), load=nt.moment(push, derivative=push_slope), **how).d_rotation.values
    raw.__module__, raw.__qualname__ = "__main__", "vane"  # of a script: named as it names it
    for function, name in ((in_floats(push), r"\S+\.push"), (raw, "vane"), (other, r"\S+\.other")):
        with pytest.warns(UserWarning, match=f"^derivatives of {name} are central differences") as told:
            found = nt.sensitivities(nt.standard(J), load=nt.moment(function), **how).d_rotation.values
        assert [one.filename for one in told if "central differences" in str(one.message)] == [__file__]
        assert abs(found - exact).max() < 1e-9


def test_function_of_time():
    """As `duration` needs it: by duals, or by differences, which are announced."""
    how = {"t_end": 1, "step": 0.1, "wrt": "duration", "integrator": "lie-midpoint"}
    exact = nt.sensitivities(nt.standard(J), load=nt.sine((0, 3, 0), 2), **how).d_rotation.values
    found = nt.sensitivities(nt.standard(J), load=nt.body_moment(lambda t: (0, 3 * np.sin(4 * np.pi * t), 0)), **how)
    assert abs(found.d_rotation.values - exact).max() < 1e-14
    with pytest.warns(UserWarning, match=r"^derivatives of \S+<lambda> are central differences"):
        rough = nt.sensitivities(
            nt.standard(J), load=nt.body_moment(lambda t: (0, 3 * math.sin(4 * np.pi * t), 0)), **how
        )
    assert abs(rough.d_rotation.values - exact).max() < 1e-9


@dataclass(frozen=True, eq=False)
class Push(Term):
    """A term of one's own, `push` times a number."""

    strength: Annotated[float, Spec("", unit="N m")]

    def moment(self, t, directors, angular_velocity):
        return self.strength * push(t, directors, angular_velocity)


class Rough(Push):
    def moment(self, t, directors, angular_velocity):
        return self.strength * in_floats(push)(t, directors, angular_velocity)


class Sloped(Push):
    @property
    def derivative(self):
        return lambda t, d, w: tuple(self.strength * part for part in push_slope(t, d, w))


@patch.dict(KINDS, push=Push)
@pytest.mark.filterwarnings("ignore:.*runs in Python")
@pytest.mark.parametrize("scheme", ["gauss", pytest.param("energy-momentum", marks=pytest.mark.long)])
def test_user_term(scheme):
    """By its own derivative; by differences, which are announced; by duals: `test_loads`."""
    how = {"t_end": 1, "step": 0.1, "rotation": R0, "wrt": ["rotation", "load[0].scale"], "integrator": scheme}
    truth = last(nt.sensitivities(nt.standard(J), load=1.5 * nt.moment(push, derivative=push_slope), **how))
    by_scale = 3 * truth[:, 3:]  # by 0.5 of what is multiplied by 3
    expected, how["wrt"] = np.concatenate([truth[:, :3], by_scale, by_scale / 6], axis=1), [*how["wrt"], "strength"]
    for make, bound, ways in ((Sloped, 2e-13, (False, True)), (Rough, 1e-9, (False,))):
        for compiled in ways:
            with warnings.catch_warnings(record=True) as told:
                warnings.simplefilter("always")
                found = nt.sensitivities(nt.standard(J), load=make(3.0, scale=0.5, compiled=compiled), **how)
            texts = [str(one.message).split(" are ")[0] for one in told if "runs in Python" not in str(one.message)]
            assert texts == [f"derivatives of {__name__}.Rough.moment"] * (make is Rough)
            assert found.parameter.values[-1] == "load[0].strength"
            assert found.parameter_unit.values[-1] == "N m"
            assert abs(last(found) - expected).max() < bound * max(1, abs(expected).max())


@pytest.mark.filterwarnings("ignore:.*runs in Python")
def test_derivatives_that_are_wrong():
    for slope in (
        lambda t, d, w: np.zeros((3, 3)),
        lambda t, d, w: (np.zeros((3, 3, 3)), np.full((3, 3), np.nan)),
        lambda t, d, w: 1 / 0,
    ):
        with says():
            nt.sensitivities(nt.standard(J), t_end=0.2, step=0.1, load=nt.moment(push, derivative=slope))
    with says():
        nt.moment(push, derivative=3)


JACOBIANS = [("gauss", "suslov", "all", 4, False), ("lie-midpoint", "suslov", "all", 4, False)]
JACOBIANS += [("gauss", "heavy", "none", "end", False), ("gauss", "nontwisting", "none", 4, True)]
JACOBIANS += [("energy-momentum", "standard", "body", 4, True), ("lie-midpoint", "standard", "functions", "end", True)]
MORE = [("energy-momentum", "suslov", "all", 4, False), ("energy-momentum", "standard", "functions", 4, True)]
MORE += [("lie-midpoint", "heavy", "none", 4, True), ("gauss", "standard", "functions", 4, False)]


@pytest.mark.filterwarnings(IGNORED)
@pytest.mark.parametrize(("scheme", "body", "load", "store", "few"), or_long(JACOBIANS, MORE))
def test_propagator_jacobian(scheme, store, body, load, few):
    """By few parameters: turns of the start alone turn all of a run that does not see its attitude."""
    called = nt.spring(STIFFNESS, POINT, ANCHOR, REST) + nt.moment(push, compiled=True)
    called += nt.potential(POINT, hill, hill_slope, compiled=True)
    names = ["material_angular_velocity", "rotation", "inertia"]
    names += ["duration"] if few else ["axis", "load_scale", *(["load[0].values"] if load == "all" else [])]
    system, load = test_derivatives.SYSTEMS[body], called if load == "functions" else test_derivatives.LOADS[load]
    how = {"t_end": 1.0, "step": 0.05, "integrator": scheme, "load": load, "store": store, "project": True}
    run = nt.propagator(system, **how)
    for scale, slower in ((1.0, 1.0), (1.0, 0.5), (0.7, 1.0))[: 2 if few else 3]:
        begin = {"material_angular_velocity": slower * W0, "rotation": R0}
        with patch("nontwist.driver.ensembles.jacobian_of", wraps=jacobian_of) as unprepared:
            found = run.jacobian(wrt=names, load_scale=scale, **begin)
        assert not unprepared.called or (scale != 1 and "load[0].values" in names)
        d = nt.sensitivities(system, wrt=names, **(how | {"load": scale * load}), **begin)
        by_scale = d.parameter.values == "load_scale"  # by the factor itself, and by a table before it is multiplied
        for array, expected in zip(found, (d.d_rotation, d.d_material_angular_velocity), strict=True):
            again = expected.values * np.where(by_scale, 1 / scale, 1.0)
            assert array.shape == again.shape
            assert abs(array - again).max() <= 1e-14 * max(1, abs(again).max())


def test_prepared_jacobians_warn_of_differences():
    def drag(t, d, w, m):
        m[0], m[1], m[2] = -w[0], -w[1], -w[2]

    run = nt.propagator(nt.standard(J), t_end=1, step=0.05, load=nt.moment(Moment(drag)))
    with pytest.warns(UserWarning, match="central differences"):
        run.jacobian(**START)


def test_load_with_own_derivative():
    one, other = nt.moment(push, derivative=push_slope), nt.moment(push)
    assert one == nt.moment(push, derivative=push_slope)
    assert one != other
    assert "derivative" not in other.description[0]
    assert one.description[0]["derivative"] == f"{__name__}.push_slope"


TWO_ROOTS = (
    nt.standard(np.diag([2.52322427, 2.59698229, 3.62845148]) + 0.1),
    np.array([1.44486174, 0.42114362, 0.56807629]),
)
LARGE = {  # body, W, load
    "fixed points find no stages": (nt.standard(J), W0, nt.moment(push, derivative=push_slope) + nt.damping(0.5)),
    "the run has taken Newton's iteration": (
        test_derivatives.system_of(numbers_of("heavy", 1.0)),
        2 * W0,
        nt.damping(C),
    ),
    "a first guess leads to another solution": (*TWO_ROOTS, nt.spring(20.0, POINT, ANCHOR, 0.8)),
}


@pytest.mark.filterwarnings(IGNORED, "ignore:the step")
@pytest.mark.parametrize(("case", "t_end", "step"), [*zip(LARGE, (6, 6, 4), (1.5, 1.5, 2), strict=True)])
def test_large_step_is_solved_again(case, t_end, step):
    (body, W, load), e = LARGE[case], np.array([1, -0.7, 0.4])
    how = {"load": load, "integrator": "gauss", "order": 4, "t_end": t_end, "step": step}
    d = nt.sensitivities(body, **how, material_angular_velocity=W, wrt="material_angular_velocity")
    by = derivative(lambda x: nt.integrate(body, **how, material_angular_velocity=W + x * e), 1e-4)
    assert abs(last(d) @ e - by).max() < 1e-10 * max(1, abs(by).max())


def test_function_changes_its_result():
    calls, how = [], {"integrator": "gauss", "order": 4, "t_end": 0.5, "step": 0.1, "material_angular_velocity": W0}

    def fickle(t, directors, w):
        calls.append(t)
        return np.array([0.0, 0.3, 0.0]) * (1 + (len(calls) > limit))

    limit = np.inf
    nt.integrate(nt.standard(J), load=nt.moment(fickle), **how)
    limit = 2 * len(calls)
    warnings.simplefilter("ignore")  # until the end of the test: central differences are told of
    with pytest.raises(SimulationError, match="not solved again; try a smaller step"):
        nt.sensitivities(nt.standard(J), load=nt.moment(fickle), **how, wrt=["load_scale"])


def explicit_midpoint(nodes, state, is_active):
    """Take a step that calls functions at its beginning and half a step on; they see the directors of the middle."""
    body, h, P, loads = nodes.body, nodes.h, state.s, nodes.loads()

    def moment(P):
        W = body.velocity_of(P)
        return cross(P, W) + loads.functions.moment(0.5 * h * W, W)

    middle = P + 0.5 * h * moment(P)
    half, no = 0.5 * h * body.velocity_of(middle), h < h
    p, c, gap = turned_by_half(state.p, state.c, half)
    after, compensation = compensated(P, state.compensation, h * moment(middle))
    found = Step(State(p, after, compensation, c, state.auxiliary), no, no, gap, 0.0 * h, 0.0 * h, half @ half)
    return found._replace(mu=0.0 * h, twist=0.0 * h, moment=0.0 * P, work=0.0 * h)


class Explicit(Compiled):
    name, orders = "explicit", (2,)

    def text(self, motion):
        return Text(explicit_midpoint)


def test_user_step_with_several_calls():
    drag = nt.moment(lambda t, d, w: -0.3 * np.sqrt(w @ w) * w + d[2], compiled=True)
    body, how = nt.standard([2, 4, 5]), {"t_end": 2, "step": 0.1, "load": drag, "integrator": Explicit()}
    d = nt.sensitivities(body, material_angular_velocity=W0, wrt="material_angular_velocity", **how)
    for k, e in enumerate(EYE):
        expected = derivative(lambda x, e=e: nt.integrate(body, material_angular_velocity=W0 + x * e, **how))
        assert last(d, k) == pytest.approx(expected, abs=1e-10)


def explicit_step(nodes, state, h, moments):
    """Take Euler's step, given the moments at its nodes and their weights."""
    P, W, no = state.s, nodes.body.velocity_of(state.s), h < h
    change, half = cross(P, W), 0.5 * h * W
    for weight, loads in moments:
        wheel = cross(loads.rotor, W) - loads.rotor_rate - loads.damping @ W
        called = None if loads.functions is None else loads.functions.moment(0.0 * W, W)
        change = change + weight * sum_of(wheel, loads.moving, loads.space, called)
    p, c, gap = turned_by_half(state.p, state.c, half)
    after, compensation = compensated(P, state.compensation, h * change)
    found = Step(State(p, after, compensation, c, state.auxiliary), no, no, gap, 0.0 * h, 0.0 * h, half @ half)
    return found._replace(mu=0.0 * h, twist=0.0 * h, moment=0.0 * P, work=0.0 * h)


def from_both_ends(nodes, state, is_active):
    """Take a step with a quarter of the moments at its beginning and three at its end."""
    return explicit_step(nodes, state, nodes.h, [(0.25, nodes.loads(0)), (0.75, nodes.loads(1))])


def in_two_parts(nodes, state, is_active):
    """Take a quarter of the step, and the rest."""
    first = nodes.node
    for j, part in enumerate((0.25, 0.75)):
        nodes.begin(first + j, state.p)
        found = explicit_step(nodes, state, part * nodes.h, [(1.0, nodes.loads())])
        state = found.state
    return found


@dataclass(frozen=True)
class TwoNodes(Compiled):
    name, orders = "two-nodes", (1,)
    order: int = 1
    is_parted: bool = False

    def stages(self, parts):
        return np.ones(1), np.array([0.0, 0.25 if self.is_parted else 1.0])

    def text(self, motion):
        return Text(in_two_parts if self.is_parted else from_both_ends)


@pytest.mark.filterwarnings(IGNORED)
@pytest.mark.parametrize("is_parted", [False, True])
def test_user_step_with_several_nodes(is_parted):
    """The columns of inputs of both nodes; of a function the time there; both kernels."""
    sampled, numbers = partial(test_derivatives.loaded, "all"), numbers_of("standard", 0.4)
    gust = nt.moment(lambda t, d, w: np.sin(3 * t) * d[1] - 0.2 * w, compiled=True)
    wrt, how = [*START, "inertia", "duration", *test_derivatives.LOADED], {"integrator": TwoNodes(is_parted=is_parted)}
    test_derivatives.require_tangents(numbers, sampled, wrt, 4, **how)

    def with_gust(p):
        return sampled(p) + p["load_scale"] * gust

    test_derivatives.require_tangents(numbers, with_gust, wrt, 4, by_time=10, **how)
    how |= {"t_end": 0.4, "step": 0.1, "load": sampled(numbers)}
    few, given = ["load[1].sine", "inertia", "duration"], {"material_angular_velocity": W0, "rotation": R0}
    found = np.concatenate(nt.propagator(nt.standard(J), **how).jacobian(wrt=few, **given), axis=1)
    d = nt.sensitivities(nt.standard(J), wrt=few, **how, **given)
    assert found[-1] == pytest.approx(last(d), abs=1e-14)

"""Dry friction: closed forms, SciPy with events of its own, balances, refusals; loads that jump with the state."""

import re

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

import nontwist as nt
from conftest import cross
from nontwist.errors import SimulationError, Status
from nontwist.kernels import machine_code
from nontwist.loads.load import moment_at, of_body
from refusals import refused_as

PENDULUM = nt.heavy_top([1.01, 1.01, 0.01], mass=1, centre_of_mass=(0, 0, 1))
TILTED = {"rotation": Rotation.from_euler("x", np.pi - 1)}
SCHEMES = {"gauss": 1e-12, "lie-midpoint": 0.04}  # of errors, the second times h²
J = np.diag([3.0, 4.0, 5.0])


def rest_angle():
    """The angle from below at which the pendulum rests, by its energy: m g sin φ ± c does no work over a swing."""
    weight, c, angle = 9.81, 1.0, -1.0
    while abs(weight * np.sin(angle)) > c:
        start, side = angle, np.sign(angle)

        def gained(x, start=start, side=side):
            return weight * (np.cos(x) - np.cos(start)) - c * side * (start - x)

        angle = brentq(gained, -start, start - 1e-3 * side)
    return angle


@pytest.mark.parametrize(
    ("axis", "how"),
    [("-x", {"step": 0.002, "integrator": "lie-midpoint"}), (None, {})],
)
def test_a_pendulum_sticks_and_stays(axis, how):
    run = nt.simulate(PENDULUM, t_end=6, load=nt.dry_friction(1, axis), **TILTED, **how)
    energy = (run.kinetic_energy + run.potential_energy).values
    assert np.diff(energy).max() <= 1e-14
    assert energy[0] - energy[-1] == pytest.approx(run.dissipated_energy.sum().item(), rel=1e-13)
    angle = np.arctan2(run.directors[-1, 2, 1], -run.directors[-1, 2, 2]).item()
    assert angle == pytest.approx(rest_angle(), abs=1e-6 if "integrator" in how else 1e-11)
    assert angle == pytest.approx(-0.0746508, abs=1e-6)
    assert run.moment.values[-1] == pytest.approx([9.81 * np.sin(angle), 0, 0], abs=1e-13)  # it carries the weight
    t, W = run.time.values, run.material_angular_velocity.values
    rests = (t > 0) & (W == 0).all(axis=1)
    assert t[rests][0] == pytest.approx(5.150753, abs=max(how.get("step", 0.02), 1e-3) + 1e-6)
    assert rests[t > t[rests][0]].all()
    assert (run.sticking.values == (W == 0).all(axis=1)).all()


@pytest.mark.parametrize(
    ("body", "axis", "scheme"),
    [
        (nt.standard(J), None, "gauss"),
        (nt.nontwisting(J), "x", "lie-midpoint"),
        (nt.suslov(J, "y"), None, "gauss"),
        (nt.suslov([[3, 0, 0], [0, 4, 1], [0, 1, 5]], "z"), "x", "gauss"),
    ],
)
def test_rest_ends_at_the_limit(body, axis, scheme):
    """J w' = 2 sin t - 1 from t = π/6 until w = 0, then 2 sin t + 1, since the moment is larger than the limit."""
    load = nt.sine((2, 0, 0), 0.5 / np.pi) + nt.dry_friction(1, axis)
    run = nt.simulate(body, t_end=4.3, step=0.05, load=load, integrator=scheme)
    first = np.pi / 6
    last = brentq(lambda t: 2 * (np.cos(first) - np.cos(t)) - (t - first), 2, 6)
    t, W = run.time.values, run.material_angular_velocity.values
    w = np.where(t < first, 0.0, 2 * (np.cos(first) - np.cos(t)) - (t - first))
    w[t > last] = (2 * (np.cos(last) - np.cos(t)) + (t - last))[t > last]
    assert abs(W[:, 0] - w / 3).max() < (1e-13 if scheme == "gauss" else 2e-4)
    assert (W[t < first] == 0).all()
    assert (abs(W[:, 1:]) == 0).all()
    impulse = run.moment.values + (run.spatial_reaction_moment.values if "spatial_reaction_moment" in run else 0)
    assert abs(np.diff(run.spatial_momentum.values, axis=0) - np.diff(t)[:, None] * impulse).max() < 1e-14
    assert abs(np.diff(run.kinetic_energy.values) - run.load_work.values).max() < 1e-14


def drive(t):
    return np.array([0.9 * np.sin(1.3 * t), 0.4 * np.cos(t), 0.3])


def test_axial_friction_in_both_schemes():
    """By `gauss` as SciPy has it: test_dry_wheels."""
    about, times = np.array([1, 2, 2]) / 3, np.linspace(0, 12, 25)
    how = {"load": nt.body_moment(drive) + nt.dry_friction(0.6, about), "step": 0.025, "times": times}
    found = [
        nt.integrate(nt.standard(J), material_angular_velocity=(0.2, 0.3, 0.1), integrator=scheme, **how)
        for scheme in SCHEMES
    ]
    for run in found:
        momentum, energy = run.observables(["spatial_momentum", "kinetic_energy"]).values()
        assert abs(np.diff(momentum, axis=0) - np.diff(times)[:, None] * run.moment).max() < 1e-13
        assert abs(np.diff(energy) - run.load_work).max() < 1e-13
        assert (run.sticking == (abs(run.material_angular_velocity @ about) < 1e-12)).all()
        assert set(run.sticking.tolist()) == {0, 1}
        assert (run.dissipated_energy >= -1e-15).all()
    one, other = (run.material_angular_velocity for run in found)
    assert abs(one - other).max() < SCHEMES["lie-midpoint"] * 0.025**2


def test_tumbling_body_comes_to_rest():
    """Without an axis the direction of w turns without end as it vanishes; friction takes the whole energy."""
    W = np.array([1.0, 0.5, -0.7])
    times = np.array([0, 1, 2, 3, 4, 4.8])
    rate = lambda t, W: np.linalg.solve(J, cross(J @ W, W) - W / np.linalg.norm(W))  # noqa: E731
    right = solve_ivp(rate, (0, 4.8), W, "DOP853", times, rtol=1e-13, atol=1e-14).y.T
    for how, bound in (({"step": 0.0125, "integrator": "lie-midpoint"}, 3e-6), ({}, 1e-12)):
        run = nt.integrate(
            nt.standard(J), times=[*times, 8], material_angular_velocity=W, load=nt.dry_friction(1), **how
        )
        assert abs(run.material_angular_velocity[:-1] - right).max() < bound
        assert (run.material_angular_velocity[-1] == 0).all()
        assert run.dissipated_energy.sum() == pytest.approx(W @ J @ W / 2, rel=1e-13)


def test_body_starts_beyond_the_limit():
    """Its direction is then that of W', and turns: SciPy's Radau, from 1e-7 s later on, W = t²/2 W''."""
    turn, most = Rotation.from_rotvec([0.3, -0.5, 0.8]).as_matrix(), np.array([1.2, 0.7, -0.5])
    inertia = turn @ np.diag([1.0, 1.4, 1.9]) @ turn.T

    def push(t):
        return most * np.sin(t) + np.array([0, 0.3, 0.2])

    def rate(t, W):
        return np.linalg.solve(inertia, push(t) + cross(inertia @ W, W) - W / np.linalg.norm(W))

    first = brentq(lambda t: push(t) @ push(t) - 1, 0, 1.5)
    u, times, start = push(first), np.array([0.4, 0.8, 1.2]), first + 1e-7
    W = u * (u @ most) * np.cos(first) / (u @ inertia @ u) * 1e-14 / 2
    W = solve_ivp(rate, (start, first + 0.03), W, "Radau", rtol=1e-8, atol=1e-20).y[:, -1]
    right = solve_ivp(rate, (first + 0.03, 1.2), W, "DOP853", times[1:], rtol=1e-12, atol=1e-15).y.T
    for scheme, bound in {"gauss": 1e-10, "lie-midpoint": 0.05 * 0.02**2}.items():
        how = {"step": 0.02, "integrator": scheme, "load": nt.body_moment(push) + nt.dry_friction(1)}
        run = nt.integrate(nt.standard(inertia), times=times, **how)
        assert (run.material_angular_velocity[0] == 0).all()
        assert abs(run.material_angular_velocity[1:] - right).max() < bound


SKEW = np.array([[3, 0.2, 0.1], [0.2, 4, 0.5], [0.1, 0.5, 5]])
HEAVY = [nt.with_gravity(make(J), 1.5, (0.2, -0.3, 0.4)) for make in (nt.nontwisting, nt.standard)]
MANY = nt.spring(2, (0, 0, 1), (1, 0, 0.5), 0.3) + nt.damping([0.1, 0.2, 0.3])
MANY += nt.body_moment(lambda t: np.array([3 * t, 1, 0.2 * t]))  # which moves it about x after 3.2 s
ABOUT_Y = [  # body, axes of friction, load, scheme, and how many of 21 states stick about all others
    (HEAVY[0], "x", MANY, "gauss", 17),
    (HEAVY[1], "xz", MANY, "lie-midpoint", 17),
    (nt.suslov(SKEW, "z"), "x", nt.spring(1, (0.2, 0.3, 0.4), (0, 0.5, 1)), "gauss", 21),
    (nt.suslov(SKEW, "z"), "x", nt.spring(2, (0, 1, 1), (1, 0, 0.5), 0.3), "lie-midpoint", 21),
    (nt.standard(SKEW), "xz", nt.dipole((0.3, 0, 1), (1, 2, 0)), "gauss", 21),
    (nt.standard(SKEW), "xz", nt.gravity_gradient(0.4, (1, 0, 0.5), (-0.5, 1, 1)), "gauss", 21),
]


@pytest.mark.parametrize(("body", "axes", "load", "scheme", "count"), ABOUT_Y)
def test_one_free_axis_turns(body, axes, load, scheme, count):
    """As the moments in Python turn it; under the load of `MANY` it slides about x as well at last."""
    start, y, acts, times = (
        Rotation.from_rotvec([0.3, -0.5, 0.8]),
        np.eye(3)[1],
        of_body(load, body.inertia),
        np.linspace(0, 4, 21),
    )

    def rate(t, x):
        q = (start * Rotation.from_rotvec(x[0] * y)).as_matrix().T
        moment = moment_at(acts, t, q, x[1] * q[1]) + cross(q, body.dead_force).sum(axis=0)
        return [x[1], q[1] @ moment / body.convected_inertia[1, 1]]

    angle, speed = solve_ivp(rate, (0, 4), [0, 0.7], "DOP853", times, rtol=1e-12, atol=1e-14).y
    how = {"rotation": start, "material_angular_velocity": 0.7 * y, "times": times, "integrator": scheme, "step": 0.02}
    run = nt.integrate(body, load=sum((nt.dry_friction(15, axis) for axis in axes), load), **how)
    stuck, bound = run.sticking == len(axes), 3e-12 if scheme == "gauss" else 1.5 * 0.02**2
    assert abs(run.material_angular_velocity - np.outer(speed, y))[stuck].max() < bound
    assert not run.material_angular_velocity[stuck][:, [0, 2]].any()
    turned = start * Rotation.from_rotvec(np.outer(angle, y))
    assert (run.rotation.inv() * turned)[stuck].magnitude().max() < 1.5 * bound
    assert stuck.sum() == count
    energy = sum(run.observables(["kinetic_energy", "potential_energy"]).values())
    if acts is load:  # else the gradient of gravity turns in space
        assert abs(np.diff(energy) - run.load_work).max() < 1e-14


def test_holding_moment_about_one_axis():
    """The body of axis z sticks about x: ``μ = M_z + ω² J_xy - ω' J_yz`` under M, in the mean of each step."""
    J = np.array([[3, 0.4, 0.1], [0.4, 4, 0.3], [0.1, 0.3, 5]])
    load = nt.body_moment([0, 5], [[0, 1, 0], [5, 1, 2.5]]) + nt.dry_friction(9, "x")
    run = nt.simulate(nt.suslov(J, "z"), t_end=2, step=0.01, load=load, material_angular_velocity=(0, 0.5, 0))
    middles = (run.time.values[1:] + run.time.values[:-1]) / 2
    speed = 0.5 + middles / 4
    assert (run.sticking == 1).all()
    assert run.material_angular_velocity.values[:, 1] == pytest.approx(0.5 + run.time.values / 4, abs=1e-13)
    assert run.multipliers.values[:, 0] == pytest.approx(
        middles / 2 - 0.3 / 4 + 0.4 * (speed**2 + 0.0025**2 / 12), abs=1e-13
    )
    n = (run.directors.values[1:, 2] + run.directors.values[:-1, 2]) / 2
    held = run.moment.values + run.reaction_moment.values[:, None] * n
    assert np.diff(run.spatial_momentum.values, axis=0) / 0.01 == pytest.approx(held, abs=1.5e-5)
    assert run.load_work.values == pytest.approx(0.01 * speed, rel=1e-12)


@pytest.mark.parametrize(("axes", "scheme"), [("x", "gauss"), ("xz", "lie-midpoint")])
def test_rotors_push_the_body(axes, scheme):
    """About y, with kinks of the momentum between steps."""
    times, values = [0, 1.013, 2.027], [0.5, 2.5, 1]
    load = sum((nt.dry_friction(10, axis) for axis in axes), nt.rotor((0, 1, 0), times, values))
    how = {"t_end": 3, "step": 0.05, "material_angular_velocity": (0, 0.7, 0), "integrator": scheme}
    with pytest.warns(UserWarning, match="breakpoints of the load off the grid"):
        run = nt.integrate(nt.standard(J), load=load, **how)
    total = 4 * run.material_angular_velocity[:, 1] + np.interp(run.time, times, values)
    assert total == pytest.approx(4 * 0.7 + 0.5, abs=1e-14)
    momentum = run.observables(["spatial_momentum"])["spatial_momentum"]
    assert np.diff(momentum, axis=0) / 0.05 == pytest.approx(run.moment, abs=1e-12)


@pytest.mark.parametrize("axis", [None, (1, 2, 0)])
def test_a_massless_rod_slows_down(axis):
    along, load = np.array([1, 2, 0]) / np.sqrt(5), nt.dry_friction(0.1, axis)
    run = nt.simulate(nt.nontwisting([1, 1, 0]), t_end=15, step=0.1, load=load, material_angular_velocity=along)
    left = np.maximum(1 - 0.1 * run.time.values, 0)
    assert run.material_angular_velocity.values == pytest.approx(np.outer(left, along), abs=1e-13)


def test_wheel_turns_the_free_axis():
    """About y J ω + I Ω stays, and Ω' = (torque - friction) (1/I + 1/(J - I))."""
    load = nt.wheel("y", 0.1, 5.0, torque=0.4, viscous=0.03, coulomb=0.05) + nt.dry_friction(1, "x")
    run = nt.simulate(nt.nontwisting(J), t_end=2, step=0.1, load=load, material_angular_velocity=(0, 0.7, 0))
    turning = 35 / 3 - 20 / 3 * np.exp(-0.03 * (1 / 0.1 + 1 / 3.9) * run.time.values)
    assert run.wheel_speed.values[:, 0] == pytest.approx(turning, rel=2e-15, abs=0)
    assert run.material_angular_velocity.values[:, 1] == pytest.approx(0.7 + 0.1 * (5 - turning) / 4, rel=2e-15, abs=0)
    assert not run.material_angular_velocity.values[:, [0, 2]].any()


HYSTERESIS = nt.memory_load(
    lambda t, z, q, w: [w[1] - z[0] / 0.7], lambda t, z, q, w: [0.1 * z[0], -0.3 * z[0], 0.05], [0.0], scale=1
)


def test_friction_beside_a_constraint():
    """A body without a constraint on which friction about x and z sticks, and one that does not twist: both about y."""
    J, load = np.array([[3, 0.2, 0], [0.2, 4, 0], [0, 0, 5]]), nt.wheel("y", 0.1, 5.0, torque=0.2) + HYSTERESIS
    load += nt.wheel((1, 2, 3), 0.2, 3.0, viscous=0.05, coulomb=0.1)
    how = {"t_end": 3, "material_angular_velocity": (0.1, 1, 0)}
    free = nt.simulate(nt.standard(J), step=0.05, load=load + nt.dry_friction(5, "x") + nt.dry_friction(5, "z"), **how)
    momentum = free.spatial_momentum.values
    assert np.diff(momentum, axis=0) / 0.05 == pytest.approx(free.moment.values, abs=1e-12)
    held, finer = (
        nt.simulate(nt.nontwisting(J), step=h, load=load + nt.dry_friction(5, "x"), **how) for h in (0.05, 0.025)
    )
    for run in (free, held):
        assert np.diff(run.kinetic_energy) == pytest.approx(run.load_work.values, abs=1e-14)
    assert held.quaternion.values == pytest.approx(free.quaternion.values, abs=3e-15)
    assert held.wheel_momentum.values == pytest.approx(free.wheel_momentum.values, abs=3e-15)
    mean = finer.multipliers.values.reshape(-1, 2).mean(axis=1)
    assert held.multipliers.values[3:, 0] == pytest.approx(mean[3:], abs=1e-9)


def test_unphysical_inertia():
    body, load = nt.standard([1, 1, 3], physical=False), nt.dry_friction(1, "x") + nt.dry_friction(1, "y")
    run = nt.simulate(body, t_end=2, step=0.1, load=load, material_angular_velocity=(0.1, 0.2, 0.5))
    assert run.material_angular_velocity.values[-1] == pytest.approx([0, 0, 0.5], abs=1e-15)
    assert run.sticking.values[-1] == 2


# ---- everywhere


test_what_is_refused = refused_as(
    [
        lambda: nt.dry_friction(-1),
        lambda: -nt.dry_friction(1),
        lambda: nt.dry_friction(1, "x") + nt.dry_friction(2, (-3, 0, 0)),
        lambda: nt.dry_friction(1, "x") + nt.dry_friction(2),
        lambda: nt.simulate(nt.nontwisting(J), t_end=1, load=nt.dry_friction(1, "z")),
        lambda: nt.sensitivities(nt.standard(J), t_end=1, load=nt.dry_friction(1)),
    ]
)


# ---- other loads that jump


@pytest.mark.parametrize(
    ("compiled", "how"), [(True, {"step": 0.005}), (False, {"step": 0.01, "integrator": "split"}), (True, {})]
)
def test_a_stall_names_the_jump(how, compiled):
    def relay(t, directors, w):
        return -(1.0 + t) * np.sign(w[0]), 0.0, 0.0

    def slow(t, state):
        return abs(state.angular_velocity[0]) - 0.1

    how = how | TILTED | {"t_end": 6, "load": nt.moment(relay, compiled=compiled)}
    with pytest.raises(SimulationError, match="relay jumps with the state") as failed, np.errstate(all="ignore"):
        nt.simulate(PENDULUM, **how)
    assert failed.value.status == Status.JUMP
    text = str(failed.value)
    (at,), signs = re.findall(r"about t = (\S+) s", text), re.findall(r"\((−?)(\S+), 0, 0\)", text)
    assert [float(value) for _, value in signs] == pytest.approx([1 + float(at)] * 2, abs=1e-3)
    assert {sign for sign, _ in signs} == {"", "−"}
    assert all(way in text for way in ("before with events=", "stepper", "dry_friction", "np.tanh"))
    slow.terminal, slow.direction = True, -1
    run = nt.simulate(PENDULUM, events=slow, **how)
    assert abs(run.angular_velocity.values[-1, 0]) == pytest.approx(0.1)


def test_steep_smooth_law():
    def steep(t, directors, w):
        return -np.tanh(w[0] / 1e-7), 0.0, 0.0

    with pytest.raises(SimulationError) as failed:
        nt.simulate(PENDULUM, t_end=6, step=0.1, load=nt.moment(steep, compiled=True), **TILTED)
    assert failed.value.status != Status.JUMP


@pytest.mark.parametrize("axis", ["x", None])
def test_ever_slower_sliding(axis, monkeypatch):
    """In thick oil, where |W| falls to round-off: at the attitude where gravity has the moment of the limit."""
    from nontwist.driver.rubbing import Rubbed

    calls, advance = [], Rubbed.advance

    def counted(self):
        calls.append(self.t)
        assert len(calls) < 1000
        advance(self)

    monkeypatch.setattr(Rubbed, "advance", counted)
    body, load = nt.heavy_top([1.1, 1, 0.4], 1.3, (0, 0, 0.8)), nt.damping(1e3) + nt.dry_friction(0.5, axis)
    run = nt.simulate(body, t_end=4500, rotation=Rotation.from_euler("x", 1.2), load=load)
    assert run.directors.values[-1, 2, 1] == pytest.approx(-0.5 / (1.3 * 9.81 * 0.8), rel=1e-10)
    speed = abs(run.material_angular_velocity.values).max(axis=1)
    assert speed[-1] == 0
    assert speed[speed > 0].min() > np.finfo(float).eps / 4500  # a slower one turns it by nothing in all that time
    assert run.sticking.values[-1].all()


def test_moment_equal_to_friction():
    load = nt.constant((0.5, 0, 0)) + nt.dry_friction(0.5, "x")
    run = nt.simulate(nt.standard([1, 2, 3 - 1e-9]), t_end=50, step=0.5, material_angular_velocity=(1, 0, 0), load=load)
    assert np.allclose(run.material_angular_velocity, [1, 0, 0], rtol=0, atol=1e-13)


def test_jump_after_the_last_state(monkeypatch):
    """And not from the start, with half of all calls of a load in Python."""
    from nontwist.driver import completion

    marched, march = [], completion.unchecked
    monkeypatch.setattr(completion, "unchecked", lambda *a, **b: (marched.append(a[1].steps), march(*a, **b))[1])
    body = nt.heavy_top([1.2, 1.1, 0.5], 1.7, (0, 0, 0.6))
    load = nt.moment(lambda t, directors, w: (-0.8 * np.sign(w[0]), 0, 0))
    how = {"load": load, "rotation": Rotation.from_euler("x", np.pi - 2.1), "t_end": 12, "step": 0.02}
    said, again = set(), []
    for choice in ({}, {"store": 7}, {"store": "end"}):
        with pytest.raises(SimulationError, match="jumps with the state") as caught:
            nt.simulate(body, **how | choice)
        said.add(str(caught.value))
        again.append(sum(marched) - 600)
        marched.clear()
    assert len(said) == 1
    assert again[0] == 0 < again[1] < 7 < again[2]


def test_limits_are_arguments(monkeypatch):
    """Another limit needs no other machine code."""
    compiled, own = [], machine_code.function_of
    monkeypatch.setattr(machine_code, "function_of", lambda *a, **b: compiled.append(a) or own(*a, **b))
    how, counts = {"t_end": 0.2, "step": 0.05, "material_angular_velocity": (1, 2, 3)}, []
    for k in range(1, 5):
        run = nt.simulate(nt.standard([3, 4, 5]), load=nt.dry_friction(0.37 * k), integrator="lie-midpoint", **how)
        assert run.dissipated_energy.sum() > 0.1 * k
        counts.append(len(compiled))
    assert counts == counts[:1] * 4

"""Loads with memory: order, hysteresis, exchanged momentum, continuation, ensembles, tolerance, refusals."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Annotated

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import nontwist as nt
from conftest import cross, or_long
from nontwist import integrate, memory_load, simulate, standard
from nontwist.integrators import EnergyMomentum, Gauss, LieMidpoint
from nontwist.loads import LOADS, Memory
from nontwist.spec import Spec
from nontwist.validation.conserved import AXIS, friction, reaction
from refusals import refused_as

J, FIELD, START = np.array([1.0, 2.0, 3.0]), np.array([0.3, 0.2, 1.0]), np.array([0.5, 1.2, -0.4])
Z0 = [0.1, -0.2]
EXACT = EnergyMomentum(moments="exact")
MIDPOINT = [(LieMidpoint(), False), (LieMidpoint(), True), (EnergyMomentum(), True), (EXACT, False), (EXACT, True)]
RUN = {"t_end": 1, "step": 0.1}
HOW = {"t_end": 4, "step": 0.1, "material_angular_velocity": START}


def lags(t, z, directors, W):
    """Two magnets along the first directors that follow the field, and its rate, with a lag and with saturation."""
    b = directors @ FIELD
    return np.array([(1.2 * b[0] - z[0]) / 0.4 + 0.3 * np.cross(b, W)[0], np.tanh(3 * b[1] + z[0]) - z[1] * np.cos(t)])


def torque(t, z, directors, W):
    return np.cross(np.array([z[0], z[1], 0.0]), directors @ FIELD) - 0.1 * z[1] * W


def pull(t, z, directors, w):
    """The same moment in space."""
    return torque(t, z, directors, directors @ w) @ directors


def lags_in_space(t, z, directors, w):
    return lags(t, z, directors, directors @ w)


def load(derivative=lags, compiled=True):
    return memory_load(derivative, torque, Z0, frame="body", compiled=compiled)


@cache
def reference(t_end):
    """Return directors, W and z by DOP853."""

    def rates(t, y):
        q, W, z = y[:9].reshape(3, 3), y[9:12], y[12:]
        turned = cross(W @ q, q)
        return np.concatenate([turned.ravel(), (torque(t, z, q, W) - cross(W, J * W)) / J, lags(t, z, q, W)])

    y0 = np.concatenate([np.eye(3).ravel(), START, Z0])
    return solve_ivp(rates, (0, t_end), y0, method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]


def end(run):
    return np.concatenate([run.directors[-1].ravel(), run.material_angular_velocity[-1], run.states.internal[-1]])


@pytest.mark.parametrize(
    ("scheme", "in_space"),
    or_long(
        [(Gauss(2), False), (Gauss(8), True), *MIDPOINT[::2]], [(Gauss(4), True), (Gauss(6), False), *MIDPOINT[1::2]]
    ),
)
def test_order(scheme, in_space):
    known, errors = reference(4), []
    made = memory_load(lags_in_space, pull, Z0, compiled=True) if in_space else load()
    for n in (32, 64):
        run = integrate(standard(J), **HOW | {"step": 4 / n}, load=made, integrator=scheme)
        errors.append(abs(end(run) - known).max())
    assert np.log2(errors[0] / errors[1]) == pytest.approx(scheme.order, abs=0.25)


WHEEL = memory_load(friction, reaction, 0.4, frame="body", compiled=True)


@pytest.mark.parametrize("scheme", [Gauss(2), Gauss(8), LieMidpoint(), EnergyMomentum(), EXACT])
def test_exchanged_momentum_is_kept(scheme):
    """The total momentum of body and wheel over 2·10^3 steps, and K less the work."""
    run = integrate(standard(J + 1), **HOW | {"t_end": 200, "load": WHEEL, "integrator": scheme})
    total = run.observables("spatial_momentum")["spatial_momentum"] + run.rotation.apply(run.states.internal * AXIS)
    assert abs(total - total[0]).max() < 2e-14
    K = run.observables("kinetic_energy")["kinetic_energy"]
    assert abs(np.diff(K) - run.load_work).max() < 1e-14
    assert np.ptp(run.states.internal) > 0.1


def test_internal_states_are_seen():
    times = [0.05, 1.23, 3.3]
    at = simulate(standard(J), times=times, step=0.1, material_angular_velocity=START, load=load())
    known = [reference(t)[12:] for t in times]
    assert at.internal_state.values == pytest.approx(np.array(known), abs=1e-8)
    run = simulate(standard(J), **HOW, load=load(), events=lambda t, state: state.internal_state[1] + 0.5)
    assert run.t_events.size
    for t in run.t_events.values:
        assert nt.resample(run, [t], load=load()).internal_state.values[0, 1] == pytest.approx(-0.5, abs=1e-11)
    other = run.assign(internal_state=0 * run.internal_state)
    rest = simulate(standard(J), start=other, t_end=5, step=0.1, load=load())
    assert rest.internal_state.values[0].tolist() == [0, 0]


def test_a_stepper_has_internal_states():
    loop = nt.stepper(standard(J), 0.1, integrator="gauss", order=8, load=load())
    state = loop.reset(material_angular_velocity=START)
    assert state.internal_state == tuple(Z0)
    rubbed = nt.stepper(standard(J), 0.1, integrator="gauss", load=load() + nt.dry_friction(0.1, "x"))
    assert rubbed.reset(material_angular_velocity=START).internal_state == tuple(Z0)
    kept, state = loop.step(), loop.step()
    run = simulate(standard(J), **HOW, load=load())
    assert state.internal_state == pytest.approx(run.internal_state.values[2], abs=1e-14)
    loop.state = kept
    assert loop.step() == state
    loop.reset(start=run)
    assert loop.state.internal_state == tuple(run.internal_state.values[-1].tolist())


def test_sum_of_memory_loads():
    """A factor multiplies the moment, not z; moments of other kinds act as without memory. Also in Python."""
    other = nt.damping(0.1) + nt.sine((0, 0.2, 0), 0.3)
    both = simulate(standard(J), **HOW, load=load() + 0.0 * WHEEL + other)
    assert both.internal_state.shape == (41, 3)
    assert both.newton_iterations.max() < 18  # z settles with the turn, without a matrix
    one = simulate(standard(J), **HOW, load=load(compiled=False) + other)
    assert both.internal_state.values[:, :2] == pytest.approx(one.internal_state.values, abs=1e-13)
    assert np.ptp(both.internal_state.values[:, 2]) > 0.1


@dataclass(frozen=True, eq=False)
class Motor(Memory):
    """A moment that is reached with a lag."""

    lag: Annotated[float, Spec("", unit="s", rule="positive")]
    frame = "body"
    state0 = np.zeros(1)
    state_scale = np.ones(1)

    def response(self, t, z, directors, angular_velocity):
        return np.array([z[0], 0.0, 0.0, (2 - z[0]) / self.lag])


def test_a_class_of_ones_own(monkeypatch):
    monkeypatch.setitem(LOADS, "motor", Motor)

    def several_stretches():
        return simulate(standard(J), t_end=1, load=3 * Motor(0.5) + nt.pulse((0, 0, 1), 0.2, 0.47))

    run = several_stretches()
    assert run.internal_state.values[:, 0] == pytest.approx(2 - 2 * np.exp(-2 * run.time.values), abs=1e-12)
    monkeypatch.setattr(Motor, "state0", (0.0,))
    monkeypatch.setattr(Motor, "state_scale", [1])
    assert np.array_equal(several_stretches().internal_state, run.internal_state)
    run = simulate(standard(J), **RUN, load=3 * Motor(0.5))
    assert run.spatial_momentum.values[-1, 0] == pytest.approx(3 * (2 - (1 - np.exp(-2))), abs=1e-12)
    again = nt.resample(run, [0.55])  # the record has all of it
    assert again.internal_state.item() == pytest.approx(2 - 2 * np.exp(-1.1), abs=1e-12)


def followed(lag, scheme, unit=1.0, start=0.0):
    """A run with a state that follows a slow motion, and drives it, with this lag."""

    def follows(t, z, directors, W):
        return (unit * np.array([np.sin(t), W[1]]) - z) / lag - np.array([0, z[1] ** 3 / unit**2])

    def weak(t, z, directors, W):
        return 0.1 * z[0] / unit, -0.3 * z[1] / unit, 0.0

    begin = unit * np.array([start, START[1]])
    made = memory_load(follows, weak, begin, scale=unit, frame="body", compiled=True)
    return integrate(standard(J), **HOW, load=made, integrator=scheme)


@pytest.mark.filterwarnings("ignore:internal states of the load decay")
@pytest.mark.parametrize(("scheme", "within"), [(Gauss(2), 2e-3), (Gauss(8), 1e-8), (LieMidpoint(), 2e-3)])
def test_state_faster_than_steps(scheme, within):
    """Newton's iteration, as the lag is a hundredth of the step."""
    lag = 1e-3
    slow = [(np.sin(t) - lag * np.cos(t)) / (1 + lag**2) for t in (0, 4)]
    run = followed(lag, scheme, start=slow[0])

    def rates(t, W):
        return (np.array([0.1 * np.sin(t), -0.3 * W[1], 0.0]) - cross(W, J * W)) / J

    W = solve_ivp(rates, (0, 4), START, rtol=1e-10, atol=1e-12).y[:, -1]
    assert run.material_angular_velocity[-1] == pytest.approx(W, abs=2e-3)  # as the lag, and the step at order 2
    assert run.states.internal[-1, 1] == pytest.approx(W[1], abs=2e-3)
    assert run.states.internal[-1, 0] == pytest.approx(slow[1], abs=within)


@pytest.mark.parametrize("how", [{}, {"tolerance": 1e-6}])
def test_tolerance_resolves_fast_states(how):
    lag, scale = 0.01, 1e-3

    def lagging(t, z, d, w):
        return (scale * np.sin(t) - z) / lag

    made = memory_load(lagging, lambda t, z, d, w: (1e-9 * z[0], 0.0, 0.0), 0, scale=scale, compiled=True)
    run = simulate(standard(J), t_end=1, load=made, **how)
    t = run.time.values
    exact = scale * (np.sin(t) - lag * np.cos(t) + lag * np.exp(-t / lag)) / (1 + lag**2)
    error = abs(run.internal_state.values[:, 0] - exact).max() / scale
    assert error < how.get("tolerance", 1e-8)
    assert run.error_estimate >= error


test_refused_by_name = refused_as(
    [
        lambda: memory_load(lags, torque, []),
        lambda: memory_load(lags, torque, 1j),
        lambda: memory_load(lags, torque, [[1.0]]),
        lambda: memory_load(lags, torque, Z0, scale=[1, 0]),
        lambda: memory_load(lags, torque, Z0, scale=[1, 1, 1]),
        lambda: memory_load(lags, torque, Z0, frame="b"),
        lambda: memory_load(lags, torque, 1.0, compiled=True),
        lambda: memory_load(friction, lambda t, z, d, w: z, Z0, compiled=True),
        lambda: memory_load(lambda t, z, d, w: z[:1], reaction, Z0, compiled=True),
        lambda: memory_load(lambda t, z, d, w: z[0], reaction, 0.0, compiled=True),
        lambda: simulate(standard(J), **RUN, load=load(), integrator="split"),
        lambda: nt.sensitivities(standard(J), wrt="load_scale", **RUN, load=load()),
        lambda: simulate(standard(J), start=simulate(standard(J), **HOW, load=WHEEL), t_end=5, load=load()),
        lambda: load().moment(0, np.eye(3), np.zeros(3)),
        lambda: simulate(standard(J), **RUN, load=load(), integrator=LieMidpoint(dissipation=1)),
    ]
)


def failing(derivative, moment=lambda t, z, d, w: (z[0], 0, 0)):
    return lambda: simulate(standard(J), **RUN, load=memory_load(derivative, moment, 0.5))


FAILING = {
    "shape": failing(lambda t, z, d, w: [1.0, 2.0]),
    "complex": failing(lambda t, z, d, w: 1j * z),
    "not finite": failing(lambda t, z, d, w: z / 0.0 if t > 0.5 else z),
    "arguments": failing(lambda t, z, d: z),
}
divided = pytest.mark.filterwarnings("ignore:divide by zero:RuntimeWarning")
test_a_derivative_that_fails = divided(refused_as(FAILING, nt.errors.SimulationError))


@pytest.mark.filterwarnings("ignore:internal states of the load decay")
@pytest.mark.parametrize("scheme", [Gauss(4), LieMidpoint()])
@pytest.mark.parametrize(("lag", "unit"), [(1.0, 2.0**-20), (1.0, 2.0**20), (1e-3, 2.0**20)])
def test_unit_of_internal_states(lag, unit, scheme):
    """By fixed-point and by Newton's iteration, what is small is relative to z; only pivots depend on the unit."""
    one, other = followed(lag, scheme), followed(lag, scheme, unit)
    assert np.array_equal(other.newton_iterations, one.newton_iterations)
    assert other.states.internal / unit == pytest.approx(one.states.internal, abs=2e-15)
    assert other.material_angular_velocity == pytest.approx(one.material_angular_velocity, abs=2e-15)


@pytest.mark.parametrize("size", [1e-6, 1e12])
def test_large_states_relative_errors(size):
    """Of z beyond its scale the error counts relative to its size: of size sin(t) it is a round-off far above 1e-8."""

    def derivative(t, z, directors, W):
        return [size * np.cos(t)]

    def moment(t, z, directors, W):
        return z[0] / size, 0.0, 0.0

    load = nt.memory_load(derivative, moment, state0=0, compiled=True)
    run = nt.simulate(nt.standard([1, 2, 3]), t_end=8, load=load, tolerance=1e-9)
    assert run.material_angular_velocity.values[-1, 0] == pytest.approx(1 - np.cos(8), abs=3e-9)
    assert run.internal_state.values[:, 0] / size == pytest.approx(np.sin(run.time.values), abs=1e-9 / min(size, 1))


@pytest.mark.parametrize(
    ("derivative", "moment", "words"),
    [
        (lambda t, z, d, w: -np.sign(z), lambda t, z, d, w: (-z[0], 0, 0), "in z' from (−1) to (1),"),
        (lambda t, z, d, w: -z, lambda t, z, d, w: (-np.sign(w[0]), 0, 0), "from (1, 0, 0) to (−1, 0, 0) N m"),
    ],
)
def test_jump_is_named(derivative, moment, words):
    made = memory_load(lambda t, z, d, w: (-z[1], z[0]), lambda t, z, d, w: (0.01 * z[0], 0, 0), (1, 0), compiled=True)
    made += memory_load(derivative, moment, 1.0, compiled=True)
    with pytest.raises(nt.errors.SimulationError) as found:
        simulate(standard(J), t_end=6, material_angular_velocity=(-1, 0, 0), load=made)
    assert found.value.status == nt.errors.Status.JUMP
    assert words in str(found.value)
    loop = nt.stepper(standard(J), 0.07, load=made, integrator="gauss")
    loop.reset(material_angular_velocity=(-1, 0, 0))
    with pytest.raises(nt.errors.SimulationError, match="jumps with the state") as failed:
        [loop.step() for _ in range(100)]
    assert (failed.value.status, failed.value.time) == (nt.errors.Status.JUMP, loop.time)


@pytest.mark.parametrize("make", [
    lambda f: memory_load(f, f, 0.0), lambda f: nt.wheel("x", 0.1, torque=f, compiled=False),
    lambda f: nt.wheel("x", 0.1, friction=f, compiled=False), nt.moment, nt.director_forces,
    lambda f: nt.potential([[0, 0, 1]], lambda g: 0.0, f),
])  # fmt: skip
def test_python_loads_warn(make):
    def slow(*given):
        return 0.0 * np.asarray(given[-1])

    with pytest.warns(UserWarning, match=r"^the load \S+slow runs in Python, .* compiled=True"):
        nt.stepper(standard(J), 0.1, load=make(slow))

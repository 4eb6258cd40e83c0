"""Gauss collocation against a plain solution of its equations, and the balances that its module derives."""

from __future__ import annotations

import warnings
from dataclasses import replace
from itertools import product

import mpmath
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import nontwist as nt
from conftest import BODIES, LOADS, NONTWISTING, PAPER_J, STANDARD, cross, thinned
from covering.problems import FULL as TILTED
from nontwist.inertia import convected_inertia
from nontwist.integrators import EnergyMomentum, Gauss, LieMidpoint
from nontwist.integrators.gauss_coefficients import matrix, nodes, weights
from nontwist.validation.problems import SHARP

ORDERS = Gauss.orders
FEW = [pytest.param(k, marks=[] if k in (2, 6) else [pytest.mark.long]) for k in ORDERS]
START = {"angular_velocity": [1, -2, 0.5], "rotation": [0.5, 0.5, -0.5, 0.5], "scalar_first": False, "project": True}
HOW = {**START, "t_end": 2, "step": 0.1, "integrator": "gauss"}


@pytest.mark.parametrize("order", ORDERS)
def test_coefficients_are_the_nearest_doubles(order):
    """And symplectic and symmetric to the last bit."""
    s, mu, b, c = order // 2, matrix(order), weights(order), nodes(order)
    with mpmath.workdps(50):
        near = np.polynomial.legendre.leggauss(s)[0]
        x = [(1 + mpmath.findroot(lambda y: mpmath.legendre(s, y), y)) / 2 for y in near]
        inner = mpmath.matrix([[y**m for m in range(s)] for y in x]) ** -1
        integrals = mpmath.matrix([[y ** (m + 1) / (m + 1) for m in range(s)] for y in [mpmath.mpf(1), *x]]) * inner
        ratios = [[float(integrals[i, j] / integrals[0, j]) for j in range(s)] for i in range(1, s + 1)]
        exact = [float(y) for y in x], [float(integrals[0, j]) for j in range(s)]
    assert (c.tolist(), b.tolist()) == exact
    assert abs(mu - ratios).max() <= 2.0**-52
    assert (mu + mu.T == 1).all()
    assert np.array_equal(mu[::-1, ::-1], mu.T)
    assert np.array_equal(b, b[::-1])
    assert c + c[::-1] == pytest.approx(1, abs=2**-52)


@pytest.mark.parametrize("order", FEW)
def test_body_at_rest_falls(order):
    """From rest gravity acts on P, then on g, then on P again; and the iteration of Newton has no speed yet."""
    for scale, step in product((1e-8, 1.0, 1e6), (0.002, 0.2)):
        J, step = scale * convected_inertia(np.diag([30.0, 5.5, 1.9])), step * scale**0.25
        body = nt.with_gravity(nt.nontwisting(J), 1.0, [0, 0, 0.4 * np.sqrt(scale)])
        how = {"t_end": 20 * step, "step": step, "rotation": Rotation.from_rotvec([2, 0, 0])}
        run = nt.simulate(body, integrator="gauss", order=order, **how)
        K = run.kinetic_energy.values
        E = K + run.potential_energy.values
        assert K[-1] > 0
        assert abs(E - E[0]).max() <= 1e-12 * (abs(E[0]) + K.max())


@pytest.mark.parametrize("order", FEW)
def test_the_faintest_turns_are_sound(order):
    """Squares of 1e-204 are zero."""
    free, held = nt.standard([30.0, 27.0, 25.0]), nt.nontwisting([30.0, 27.0, 25.0])
    for body, W in product((free, held, nt.with_gravity(held, 1, [0, 0, 0.1])), (1e-300, 1e-204, 1e-160, 1e-100)):
        run = nt.integrate(body, t_end=2, step=1, material_angular_velocity=(W, W, 0), integrator="gauss", order=order)
        assert np.linalg.norm(run.quaternion, axis=1) == pytest.approx(1, abs=1e-15)
        assert abs(run.quaternion[:, :3]).max() <= 10 * W + 1e-17  # round-off


def wave(t):
    return 9 * np.sin(9 * t), 3, 1


def collocated(body, q, W, h, order, load):
    """Return Λ and W after a step: the equations of the module for P and the rows of Λ, iterated."""
    s, c, b = order // 2, nodes(order), weights(order)
    a = matrix(order) * b
    J, n = body.inertia, body.axis

    def rates(t, P, L):
        W = np.linalg.solve(J, P) if n is None else on_axis(P)
        M = cross(P, W) - load.damping @ W + load.sample([t], "body")[0]
        m = load.sample([t], "space")[0] + (load.called.state_moment(t, L.T, L @ W) if load.called.terms else 0)
        M = M + np.linalg.solve(L, m) + cross(np.eye(3), body.dead_force @ L).sum(0)
        if n is not None:  # W' = J⁻¹ (M - μ n) has no component along n
            M = M - (n @ np.linalg.solve(J, M)) / (n @ np.linalg.solve(J, n)) * n
        return np.concatenate([M, cross(L, W).ravel()])

    def on_axis(P):
        W = np.linalg.solve(J, P)
        return W - (n @ W) * n

    y, k = np.concatenate([J @ W, q.ravel()]), np.zeros((s, 12))
    for _ in range(200):
        before, pairs = k, zip(c, y + h * a @ k, strict=True)
        k = np.array([rates(h * t, x[:3], x[3:].reshape(3, 3)) for t, x in pairs])
        if np.allclose(k, before, rtol=0, atol=1e-16 * abs(k).max()):
            break
    end = y + h * b @ k
    return end[3:].reshape(3, 3), np.linalg.solve(J, end[:3])


@pytest.mark.parametrize("order", [2, 6, pytest.param(4, marks=pytest.mark.long)])
@pytest.mark.parametrize(("name", "load"), [*thinned(3, BODIES, LOADS), ("several", "sum")])
def test_equations_of_collocation(name, load, order):
    """Where a load acts, or a heavy body stands under one: the rows are those of collocation."""
    several = replace(nt.standard(TILTED), dead_force=np.array([[1.0, 2, -1], [0.5, -3, 1], [2, 1, 0.4]]))
    body, load = several if name == "several" else BODIES[name](), LOADS[load]()
    R = Rotation.from_quat(START["rotation"]).as_matrix()
    W = R.T @ START["angular_velocity"]
    W = W if body.axis is None else W - (body.axis @ W) * body.axis
    end, V = collocated(body, R, W, 0.2, order, load)
    start = {"rotation": R, "material_angular_velocity": W}
    run = nt.integrate(body, t_end=0.2, step=0.2, load=load, integrator=Gauss(order), **start)
    assert run.rotation[-1].as_matrix() == pytest.approx(end, abs=1e-12)
    assert run.material_angular_velocity[-1] == pytest.approx(V, abs=1e-12)


FAST = {
    "free standard": (nt.standard(TILTED), None),
    "heavy top": (nt.with_gravity(nt.standard(TILTED), 2.0, [0.1, 0.2, 0.5]), None),
    "non-twisting, load in the body": (nt.nontwisting(PAPER_J), nt.body_moment(wave)),
    "Suslov, load in space": (nt.suslov(TILTED, [0.3, 0.2, 1]), nt.space_moment(wave)),
}
KEYS = "directors", "director_velocities", "multipliers", "moment", "load_work"
STEPS = {2: (256, 512), 4: (128, 192), 6: (96, 128), 8: (64, 80), 12: (14, 20), 16: (10, 16)}


@pytest.mark.parametrize("order", [16, *(pytest.param(k, marks=pytest.mark.long) for k in STEPS if k < 16)])
@pytest.mark.parametrize("name", FAST)
def test_orders_of_fast_motions(name, order):
    """Of attitude, velocity, multiplier, mean moment and work."""
    body, load = FAST[name]
    how = {"t_end": 2, "angular_velocity": [12, -18, 8], "project": True, "load": load, "store": "end"}
    exact = nt.integrate(body, step=1, integrator=SHARP, **how)
    errors = []
    for n in STEPS[order]:
        run = nt.integrate(body, step=2 / n, integrator="gauss", order=order, **how)
        pairs = ((getattr(run, key), getattr(exact, key)) for key in KEYS)
        errors.append([abs(x[-1] - y[-1]).max() if np.size(x) else 0.0 for x, y in pairs])
    coarse, fine = np.array(errors)
    slope = np.log(coarse[0] / fine[0]) / np.log(STEPS[order][1] / STEPS[order][0])
    assert slope == pytest.approx(order, abs=0.15 * order)
    assert (fine < np.maximum(300 * fine[0], 1e-11)).all()


@pytest.mark.parametrize("order", FEW)
def test_momenta(order):
    """Of the non-twisting body, by the impulse of a moment and without; the vertical one of a heavy body.

    And that of a free body, with its energy, in steps of two radians, where fixed points of low orders do not contract.
    """
    M, how = np.array([1.0, -2, 0.7]), {**HOW, "order": order}
    run = nt.simulate(nt.nontwisting(PAPER_J), load=nt.body_moment(lambda t: M * t), **how)
    impulse = np.outer(run.midtime, M[:2]) * 0.1
    assert np.diff(run.material_momentum.values[:, :2], axis=0) == pytest.approx(impulse, abs=1e-13)
    free = nt.simulate(nt.nontwisting(PAPER_J), **how)
    assert np.ptp(free.material_momentum.values, axis=0).max() < 1e-14
    pi = nt.simulate(nt.with_gravity(nt.standard(TILTED), 0.5, [0.1, 0.3, 0.2]), **how).spatial_momentum.values
    assert np.ptp(pi[:, 2]) < 1e-14 * abs(pi).max()
    assert np.ptp(pi[:, 0]) > 0.1
    run = nt.simulate(nt.standard(TILTED), **how | {"t_end": 20, "step": 0.25, "angular_velocity": [4, -6, 2]})
    for kept in (run.kinetic_energy.values, run.spatial_momentum.values):
        assert np.ptp(kept, axis=0).max() < 1e-13 * abs(kept).max()


def push(t, d, w):
    return d[0, 1] - 900 * w[0], d[1, 2] * w[0] - 1000 * w[1], -d[2, 0] - 100 * w[2]


@pytest.mark.parametrize("order", FEW)
def test_drag_and_stiff_moments(order):
    """At h λ up to a million, where a run says that modes are not resolved; energy goes where the work says."""
    bodies = nt.suslov(TILTED, [0.3, 0.2, 1]), nt.nontwisting(PAPER_J), nt.standard(TILTED)
    loads = [nt.damping([drag, 2 * drag, 3 * drag]) for drag in (0.1, 10.0, 1e4, 2e6)]
    for body, load in [*product(bodies, loads), (bodies[-1], nt.moment(push, compiled=True))]:
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            run = nt.simulate(body, load=load, order=order, **{**HOW, "step": 0.25, "t_end": 5})
        slow = [one for one in told if "damping slows the body down" in str(one.message)]
        assert bool(slow) == (load.damping.max() > 50 or load not in loads)
        K = run.kinetic_energy.values
        assert np.diff(K) == pytest.approx(run.load_work.values, abs=1e-14 * K[0])
        assert np.diff(K).max() <= 4e-16 * K[0] or not load.damping.any()
        if body is bodies[-1] and load not in loads[:3]:
            assert run.newton_iterations.max() < 20


def test_unresolved_damping_warns():
    how = {"t_end": 1, "step": 0.25, "integrator": "gauss", "order": 4, "angular_velocity": [1, 0, 0]}
    with pytest.warns(UserWarning, match=r"a rate of up to 20 1/s, which step = 0\.25 s .* try step <= 0\.2"):
        nt.simulate(STANDARD, load=nt.damping([60, 1, 1]), **how)
    with pytest.warns(UserWarning, match="at a rate of up to 40 1/s"):
        nt.simulate_ensemble(STANDARD, load=nt.damping([60, 1, 1]), load_scale=[0.1, 2], **how)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        nt.simulate(NONTWISTING, load=nt.damping([1, 1, 600]), **how)


@pytest.mark.parametrize("scheme", [LieMidpoint(), EnergyMomentum(), *map(Gauss, (2, 4, 6, 8))])
def test_lag_of_steady_rotation(scheme):
    start = {"material_angular_velocity": (0, 0.9, 0), "load": nt.space_moment([0, 1], np.zeros((2, 3)))}
    run = nt.integrate(STANDARD, t_end=1, step=1, integrator=scheme, **start)
    assert scheme.lag(0.9) == pytest.approx(abs(run.rotation[1].magnitude() - 0.9), rel=1e-6)


@pytest.mark.long
@pytest.mark.filterwarnings("ignore:the run will take about:UserWarning")
@pytest.mark.parametrize("order", [2, 6, 12, 16])
@pytest.mark.parametrize("turn", [0.05, 1.0])
def test_drift_over_a_million_steps(turn, order):
    """Below 1e-12, and growing like the root of the number of steps: the rounding of stages and turns has no bias.

    The exponent is that of the r.m.s. change within n steps, over all starts and all windows of n steps: it is known to
    0.02, where the change since the start would give it to 0.04.
    """
    rng = np.random.default_rng(7)
    W = rng.normal(size=(128, 3))
    W *= turn / np.linalg.norm(W, axis=1)[:, None]
    how = {"t_end": 1e6, "step": 1.0, "store": 10_000, "integrator": "gauss", "order": order, "variables": "all"}
    run = nt.simulate_ensemble(nt.standard(TILTED), material_angular_velocity=W, **how)
    K, pi = run.kinetic_energy.values[..., None], run.spatial_momentum.values
    for kept in (K / K[:, :1] - 1, (pi - pi[:, :1]) / np.linalg.norm(pi[:, :1], axis=2, keepdims=True)):
        assert abs(kept).max() < 1e-12
        windows = [5, 10, 20, 50, 100]
        changes = [np.linalg.norm(kept[:, n:] - kept[:, :-n], axis=2) for n in windows]
        rms = [np.sqrt((change**2).mean()) for change in changes]
        assert np.polyfit(np.log(windows), np.log(rms), 1)[0] <= 0.6

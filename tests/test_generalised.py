"""Director forces, moments that act exactly on directors, and potentials: against SciPy, closed forms, references."""

import json
from dataclasses import dataclass
from functools import cache
from typing import Annotated
from unittest.mock import patch

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation
from scipy.special import ellipk

from conftest import cross, thinned
from nontwist import (
    damping,
    dipole,
    director_forces,
    gravity_gradient,
    integrate,
    moment,
    nontwisting,
    potential,
    pulse,
    rotation,
    rotor,
    simulate,
    simulate_ensemble,
    space_moment,
    spring,
    standard,
    suslov,
    with_gravity,
)
from nontwist.analysis.invariants import drifts
from nontwist.errors import SimulationError
from nontwist.integrators import Continuous, EnergyMomentum
from nontwist.loads import LOADS as KINDS
from nontwist.loads.forces import DirectorForces
from nontwist.loads.kinds import load_of
from nontwist.spec import Spec
from nontwist.validation.compiled_steps import ReferenceEnergyMomentum
from refusals import refused_as, says

J = np.array([[3, 0.2, 0.4], [0.2, 4, -0.3], [0.4, -0.3, 5]])
FREE, HELD, SLANTED = standard(J), nontwisting([3, 4, 5]), suslov(J, (0.3, 0.2, 1))
START = {
    "rotation": Rotation.from_quat([0.5, 0.1, 0.2, 0.8]),
    "material_angular_velocity": (1, 2, 0.5),
    "project": True,
}
TIMES = np.linspace(0, 2, 5)
FORCES = np.random.default_rng(1).standard_normal((5, 3, 3)) * 3
EXACT = EnergyMomentum(moments="exact")
STEPPING = [("gauss", 4), ("lie-midpoint", 2), ("energy-momentum", 2), (EXACT, None), ("split", 4)]


def well(g):
    return 2 * np.cos(g[0]) + g[1] ** 3 + np.exp(0.5 * g[2])


def slope(g):
    return np.array([-2 * np.sin(g[0]), 3 * g[1] ** 2, 0.5 * np.exp(0.5 * g[2])])


def pair(g):
    return 2 * g[0][0] * g[1][1] + g[0][2] ** 4


def slope_of_pair(g):
    return np.array([[2 * g[1][1], 0, 4 * g[0][2] ** 3], [0, 2 * g[0][0], 0]])


def forces(t, d, w):
    return np.array([[np.sin(t), w[0], d[0][1]], [1, d[2][0], 0], [0.3 * w[2], 0, -2.0]])


Q = np.array([[2, 0.3, 0], [0.3, -1, 0.5], [0, 0.5, 4]])
QUADRATIC = potential((0, 0, 1), linear=(1, 2, -1), quadratic=Q)
POTENTIALS = {
    "quadratic": QUADRATIC,
    "spring": spring(8, (0.2, 0.1, 0.8), (0, 0, 1.5), 0.7),
    "function": potential((0, 0, 1.0), well, slope),
    "linear": spring(8, (0.2, 0.1, 0.8), (0, 0, 1.5)) + dipole((1, 2, -3), (0, 0, 2)),
}
TWO = potential([(0, 0, 1), (1, 0, 0)], pair, slope_of_pair)


def truth(load, t_end=2.0, J=J):
    """Directors at t_end, and the work of the load, from Euler's equations for (Λ, π, A) alone."""
    q0 = START["rotation"].as_matrix().T

    def rates(t, y):
        q, pi = y[:9].reshape(3, 3), y[9:12]
        w = np.linalg.solve(J, q @ pi) @ q
        m, work = np.zeros(3), 0.0
        for f in load(t, q, w):
            m, work = m + cross(q, f).sum(0), work + np.sum(f * cross(w, q))
        return np.concatenate([cross(w, q).ravel(), m, [work]])

    start = np.concatenate([q0.ravel(), (J @ START["material_angular_velocity"]) @ q0, [0.0]])
    done = solve_ivp(rates, (0, t_end), start, "DOP853", rtol=1e-12, atol=1e-13, max_step=0.05).y[:, -1]
    return done[:9].reshape(3, 3), done[12]


def table_at(t):
    return np.array([np.interp(t, TIMES, column) for column in FORCES.reshape(5, 9).T]).reshape(3, 3)


@dataclass(frozen=True, eq=False)
class Forces(DirectorForces):
    """A term of one's own, `forces` times a number."""

    strength: Annotated[float, Spec("")]

    def forces(self, t, directors, angular_velocity):
        return self.strength * forces(t, directors, angular_velocity)


LOADS = {
    "table in space": (lambda: director_forces(TIMES, FORCES), lambda t, q, w: [table_at(t)]),
    "table along directors": (lambda: director_forces(TIMES, FORCES, frame="body"), lambda t, q, w: [table_at(t) @ q]),
    "function": (lambda: director_forces(forces), lambda t, q, w: [forces(t, q, w)]),
    "function along directors": (lambda: director_forces(forces, frame="body"), lambda t, q, w: [forces(t, q, w) @ q]),
    "term of one's own": (lambda: 2 * Forces(0.5), lambda t, q, w: [forces(t, q, w)]),
    "compiled": (lambda: 2 * director_forces(forces, compiled=True), lambda t, q, w: [2 * forces(t, q, w)]),
}


@cache
def made(name):
    return LOADS[name][0]()


@patch.dict(KINDS, strength=Forces)
@pytest.mark.parametrize("name", LOADS)
def test_director_forces_in_every_integrator(name):
    load, of_truth = made(name), LOADS[name][1]
    directors, work = truth(of_truth)
    assert load.breakpoints == (tuple(TIMES) if name.startswith("table") else ())
    for form in ("split", "director"):
        run = simulate(FREE, times=[0, 2.0], load=load, integrator=Continuous(form=form), **START)
        assert abs(run.directors.values[-1] - directors).max() < 1e-9
    for scheme, order in STEPPING:
        errors = []
        for n in (64, 128):
            run = simulate(FREE, t_end=2, step=2 / n, load=load, integrator=scheme, order=order, **START)
            off = abs(run.directors.values[-1] - directors).max()
            errors.append((off, abs(run.load_work.values.sum() - work)))
        assert np.log2(errors[0][0] / errors[1][0]) == pytest.approx(order or 2, abs=0.25)
        assert np.log2(errors[0][1] / errors[1][1]) == pytest.approx(order or 2, abs=0.25)
        gained = np.diff(run.kinetic_energy.values[[0, -1]])[0]
        assert gained == pytest.approx(run.load_work.values.sum(), abs=1e-12 * abs(work).max() + 1e-12)
        impulse = run.moment.values.T @ np.diff(run.time.values)
        assert impulse == pytest.approx(np.diff(run.spatial_momentum.values[[0, -1]], axis=0)[0], abs=1e-12)


@pytest.mark.parametrize("body", [FREE, HELD, SLANTED], ids=["standard", "nontwisting", "suslov"])
@pytest.mark.parametrize("name", ["table in space", "table along directors", "function", "term of one's own"])
@patch.dict(KINDS, strength=Forces)
def test_director_scheme_is_that_of_the_paper(body, name):
    how = {
        "t_end": 0.4,
        "step": 0.02,
        "load": made(name) + moment(lambda t, d, w: np.cross(d[2], [0, 0, 2.0])),
        **START,
    }
    run = integrate(body, integrator="energy-momentum", **how)
    known = integrate(body, integrator=ReferenceEnergyMomentum(), **how)
    assert abs(run.directors - known.directors).max() < 1e-13
    assert abs(run.multipliers - known.multipliers).max() < 1e-10 * abs(known.multipliers).max()
    assert abs(run.moment - known.moment).max() < 1e-12
    assert abs(run.load_work - known.load_work).max() < 1e-13


def test_director_forces_as_dead_forces():
    """A table that is constant is a dead force, to round-off, with its multipliers."""
    rho, g = np.array([0.1, 0.2, 0.5]), np.array([0, 0, -9.81])
    heavy = with_gravity(FREE, 1.5, rho, g)
    load = director_forces([0, 1], [1.5 * np.outer(rho, g)] * 2)
    for scheme in ("lie-midpoint", "energy-momentum", "gauss"):
        known = integrate(heavy, t_end=1, step=0.02, integrator=scheme, **START)
        run = integrate(FREE, t_end=1, step=0.02, integrator=scheme, load=load, **START)
        assert abs(run.directors - known.directors).max() < 1e-12
        assert abs(run.multipliers - known.multipliers).max(initial=0) < 1e-10
        drop = abs(run.load_work.sum() - 1.5 * g @ ((run.directors[-1] - run.directors[0]).T @ rho))
        assert drop < 1e-12


def test_exact_moments_have_the_moment_and_the_work():
    load = space_moment(lambda t: (3, -2, 1)) + pulse((0, 2, 1), end=0.8)
    exact = integrate(FREE, t_end=1, step=0.1, load=load, integrator=EXACT, **START)
    paper = integrate(FREE, t_end=1, step=0.1, load=load, integrator="energy-momentum", **START)
    h_m = 0.1 * np.array([3, -2, 1.0])
    for run, is_exact in ((exact, True), (paper, False)):
        Pi = run.to_dataset().spatial_momentum.values
        gap = abs(np.diff(Pi, axis=0)[-2:] - h_m).max()  # the pulse is over
        assert (gap < 1e-13) == is_exact
        balance = np.diff(run.to_dataset().kinetic_energy.values) - run.load_work
        assert abs(balance).max() < 1e-13
    mean = (exact.directors[1:] + exact.directors[:-1]) / 2
    assert abs(np.swapaxes(mean, 1, 2) @ mean - np.eye(3)).max() > 1e-3  # so the paper's moment is another one


def test_exact_moments_are_what_director_forces_are():
    """The same moment as forces x × d_i, computed at the mean directors."""

    def as_forces(t, d, w):
        D = d.T @ d
        return np.cross(np.linalg.solve(np.trace(D) * np.eye(3) - D, [3.0, -2, 1]), d)

    how = {"t_end": 1, "step": 0.05, **START}
    known = integrate(FREE, load=director_forces(as_forces), integrator="energy-momentum", **how)
    run = integrate(FREE, load=space_moment(lambda t: (3, -2, 1)), integrator=EXACT, **how)
    assert abs(run.directors - known.directors).max() < 1e-13
    assert abs(run.multipliers - known.multipliers).max() < 1e-10
    assert abs(run.load_work - known.load_work).max() < 1e-13


@pytest.mark.parametrize(("body", "name"), thinned(2, [FREE, HELD, SLANTED], [*POTENTIALS, "two"]))
def test_energy_and_vertical_momentum_are_kept_at_large_steps(body, name):
    load = TWO if name == "two" else POTENTIALS[name]
    by_coefficients = name in ("quadratic", "linear")
    for scheme, order in (("lie-midpoint", 2), ("energy-momentum", 2), (EXACT, None), ("gauss", 2), ("gauss", 6)):
        run = simulate(body, t_end=20, step=0.1, load=load, integrator=scheme, order=order, **START)
        found = drifts(run)
        if by_coefficients or scheme != "gauss":
            assert found["total_energy"].relative < 2e-13, scheme
        assert np.ptp(run.potential_energy.values) > 0.5
        assert abs(run.load_work.values).max() == abs(run.moment.values).max() == 0
        assert ("vertical_momentum" in found) == (body is FREE and name != "two")
        if "vertical_momentum" in found:
            assert found["vertical_momentum"].relative < 2e-13, scheme


def test_gauss_keeps_other_potentials_to_its_order():
    errors = []
    for n in (40, 80):
        run = simulate(FREE, t_end=4, step=4 / n, load=POTENTIALS["function"], integrator="gauss", order=4, **START)
        errors.append(drifts(run)["total_energy"].relative)
    assert 1e-10 < errors[1] < errors[0] / 10


@pytest.mark.parametrize("name", [*POTENTIALS, "two", "orbit"])
def test_motion_under_potentials(name):
    load = {**POTENTIALS, "two": TWO, "orbit": gravity_gradient(0.7, (1, 1, 0), (0, 0, 2), 0.3)}[name]
    by_hand = {
        "quadratic": lambda t, q: [((0, 0, 1.0), (1, 2, -1) + Q @ q[:, 2])],
        "spring": lambda t, q: [_spring_by_hand(q, 8, (0.2, 0.1, 0.8), (0, 0, 1.5), 0.7)],
        "linear": lambda t, q: [
            _spring_by_hand(q, 8, (0.2, 0.1, 0.8), (0, 0, 1.5), 0.0),
            ((0, 0, 1.0), -2 * np.array([1.0, 2, -3])),
        ],
        "function": lambda t, q: [((0, 0, 1.0), slope(q[:, 2]))],
        "two": lambda t, q: list(zip(np.eye(3)[[2, 0]], slope_of_pair(q.T[[2, 0]]), strict=True)),
        "orbit": lambda t, q: [(r := _radius(0.7 * (t - 0.3)), 3 * 0.49 * J @ (q @ r))],
    }[name]
    directors, _ = truth(lambda t, q, w: [-np.outer(dV, a) for a, dV in by_hand(t, q)])
    run = simulate(FREE, times=[0, 2.0], load=load, integrator="continuous", **START)
    assert abs(run.directors.values[-1] - directors).max() < 1e-9
    for scheme, order in (*STEPPING, ("gauss", 8)):
        errors = []
        for n in (64, 128):
            run = integrate(FREE, t_end=2, step=2 / n, load=load, integrator=scheme, order=order, **START)
            errors.append(abs(run.directors[-1] - directors).max())
        if order == 8:
            assert errors[0] < 1e-9
        else:
            assert np.log2(errors[0] / errors[1]) == pytest.approx(order or 2, abs=0.25)


def _spring_by_hand(q, k, rho, anchor, rest):
    length = np.linalg.norm(np.array(rho) @ q - anchor)
    return np.array(anchor), -k * (1 - rest / length) * np.array(rho)


def _radius(angle):
    c, s = np.cos(angle) / np.sqrt(2), np.sin(angle) / np.sqrt(2)
    return np.array([c - s, c + s, 0])


def test_potential_is_its_forces_on_directors():
    """The discrete gradient of a quadratic potential is that at the mean, so the multipliers λ are those of forces."""
    a = np.array([0, 0, 1.0])
    by_forces = director_forces(lambda t, d, w: -np.outer(np.array([1.0, 2, -1]) + Q @ (d @ a), a))
    for body in (FREE, HELD):
        for scheme in ("lie-midpoint", "energy-momentum"):
            known = integrate(body, t_end=1, step=0.05, load=by_forces, integrator=scheme, **START)
            run = integrate(body, t_end=1, step=0.05, load=QUADRATIC, integrator=scheme, **START)
            assert abs(run.directors - known.directors).max() < 1e-12
            assert abs(run.multipliers - known.multipliers).max(initial=0) < 1e-9


def test_compiled_potential_is_the_one_in_python():
    compiled = potential((0, 0, 1.0), _compilable, _its_slope, compiled=True)
    plain = potential((0, 0, 1.0), _compilable, _its_slope)
    for scheme in ("gauss", "lie-midpoint", "energy-momentum", "split"):
        runs = [
            integrate(FREE, t_end=1, step=0.05, load=load, integrator=scheme, **START) for load in (compiled, plain)
        ]
        assert abs(runs[0].directors - runs[1].directors).max() < 1e-12
        assert runs[0].to_dataset().potential_energy.values == pytest.approx(
            runs[1].to_dataset().potential_energy.values
        )


def _compilable(g):
    return 2 * np.cos(g[0]) + g[1] ** 3


def _its_slope(g):
    return -2 * np.sin(g[0]), 3 * g[1] ** 2, 0.0


def test_nutation_of_a_symmetric_top_on_a_spring():
    """The angle of the axis moves between two turning points in a time that is a quadrature."""
    J1, J3, k, rho, a, rest, spin = 2.0, 1.0, 30.0, 0.8, 1.5, 0.9, 3.0
    load = spring(k, (0, 0, rho), (0, 0, a), rest)
    angle = 1.0
    start = {"rotation": Rotation.from_euler("x", angle), "material_angular_velocity": (0, 0, spin)}

    def V(u):
        return k * (np.sqrt(rho**2 + a**2 - 2 * rho * a * u) - rest) ** 2 / 2

    u0 = np.cos(angle)
    p = J3 * spin * u0  # momentum about the vertical; that about the axis is J3 spin

    def square(u):  # of du/dt
        return 2 / J1 * (V(u0) - V(u)) * (1 - u * u) - ((p - J3 * spin * u) / J1) ** 2

    u1 = brentq(square, u0 + 1e-6, 1 - 1e-9)
    mid, half = (u0 + u1) / 2, (u1 - u0) / 2
    rate = lambda s: half * np.cos(s) / np.sqrt(square(mid + half * np.sin(s)))  # noqa: E731
    period = 2 * quad(rate, -np.pi / 2, np.pi / 2, epsabs=1e-12)[0]

    def turns_back(t, state):
        d3 = state.rotation.as_matrix()[:, 2]
        return np.cross(state.angular_velocity, d3)[2]

    turns_back.direction = -1
    how = {"load": load, "order": 12, "events": [turns_back], **start}
    run = simulate(standard([J1, J1, J3]), t_end=20.5 * period, step=period / 60, **how)
    times = run.t_events.values
    assert len(times) == 20 or len(times) == 21
    assert np.diff(times) == pytest.approx(period, rel=1e-9)


def test_pitch_of_a_satellite_at_finite_amplitude():
    """θ'' = -(3n²/2)((J_roll - J_yaw)/J_pitch) sin 2θ is a pendulum: 100 periods against the elliptic integral."""
    n, yaw, roll, pitch, amplitude = 1.0, 2.0, 4.0, 5.0, 0.9
    rate = n * np.sqrt(3 * (roll - yaw) / pitch)
    period = 4 * ellipk(np.sin(amplitude) ** 2) / rate

    def upright(t, state):
        r = np.array([np.cos(n * t), np.sin(n * t), 0])
        return np.cross(r, state.rotation.as_matrix()[:, 0])[2]

    upright.direction = 1
    start = {"rotation": Rotation.from_euler("z", amplitude), "material_angular_velocity": (0, 0, n)}
    how = {"load": gravity_gradient(n), "order": 12, "events": [upright]}
    run = simulate(standard([yaw, roll, pitch]), t_end=101 * period, step=101 * period / 4000, **start, **how)
    times = run.t_events.values
    assert len(times) == 101
    assert (times[100] - times[0]) / 100 == pytest.approx(period, rel=1e-9)
    assert times[0] == pytest.approx(0.75 * period, rel=1e-9)
    assert drifts(run)["jacobi_integral"].relative < 1e-13


def test_roll_and_yaw_of_a_satellite():
    """Small oscillations: the eigenvalues of the tangent of a run against those of the linear equations."""
    n, (A, B, C) = 1.0, (2.0, 4.0, 5.0)  # about the radius, along the track, normal to the orbit
    k_r, k_y = (C - A) / B, (C - B) / A
    # Roll φ about the track, yaw ψ about the radius: φ'' + 4n²k_r φ = n(1 - k_r)ψ', ψ'' + n²k_y ψ = -n(1 - k_y)φ'.
    b, c = 1 + 3 * k_r + k_r * k_y, 4 * k_r * k_y
    known = n * np.sqrt((b + np.array([-1, 1]) * np.sqrt(b * b - 4 * c)) / 2)
    body, t_end, e = standard([A, B, C]), 0.5, 1e-5

    def after(x):
        """The state relative to the orbit: the rotation vector and the rates of its beginning."""
        turn = Rotation.from_rotvec([x[0], x[1], 0])
        W = turn.inv().apply([0, 0, n]) + np.array([x[2], x[3], 0])
        how = {"t_end": t_end, "step": 0.01, "order": 12, "load": gravity_gradient(n), "store": "end"}
        run = integrate(body, rotation=turn, material_angular_velocity=W, **how)
        orbit = Rotation.from_rotvec([0, 0, n * t_end])
        end = orbit.inv() * run.rotation[-1]
        rates = run.material_angular_velocity[-1] - end.inv().apply([0, 0, n])
        return np.concatenate([end.as_rotvec()[:2], rates[:2]])

    tangent = np.array([(after(e * x) - after(-e * x)) / (2 * e) for x in np.eye(4)]).T
    found = np.sort(abs(np.angle(np.linalg.eigvals(tangent))) / t_end)[::2]
    assert found == pytest.approx(known, rel=1e-8)


@pytest.mark.parametrize("order", [2, 4, 8, 12])
def test_gauss_keeps_the_integral_of_the_orbit(order):
    load = gravity_gradient(0.7, (1, 1, 0), (0, 0, 2), 0.3)
    run = simulate(FREE, t_end=100, step=0.25, load=load, integrator="gauss", order=order, **START)
    assert drifts(run)["jacobi_integral"].relative < 1e-13
    assert run.orthonormality_defect.max() < 1e-14
    energy = (run.kinetic_energy + run.potential_energy).values
    assert np.ptp(energy) > 0.1  # K + V is not kept
    if order == 8:
        other = simulate(FREE, t_end=100, step=0.25, load=load + 0 * pulse((1, 0, 0)), order=order, **START)
        assert abs(other.directors.values - run.directors.values)[:40].max() < 1e-6


@pytest.mark.parametrize("wheel", [rotor((0.6, 0, 0.8), 2), rotor((0.6, 0, 0.8), [0, 1.5, 30], [0, 3, 1])])
def test_the_integral_of_an_orbit_counts_the_wheels(wheel):
    """K + V - A - n o·(π + Λh), to the error of the run; other loads and constraints leave none."""
    n, o = 0.7, np.array([0, 0, 1.0])
    load = gravity_gradient(n, (1, 1, 0), o, 0.3) + wheel
    runs = [
        simulate(FREE, t_end=30, step=h, load=load, order=order, **START)
        for order, h in ((4, 0.1), (4, 0.05), (12, 0.05))
    ]
    coarse, half, fine = (drifts(run)["jacobi_integral"] for run in runs)
    assert fine.symbol == "K+V−A−n o·(π+Λh)"
    assert fine.relative < 1e-13
    assert coarse.relative / half.relative == pytest.approx(16, rel=0.25)
    run = runs[-1]
    energy = run.kinetic_energy + run.potential_energy
    work = np.append(0, np.cumsum(run.load_work.values))
    kept = energy.values - work - n * run.total_momentum.values @ o
    assert np.ptp(kept) < 1e-12
    assert np.ptp(energy.values - work) > 0.1
    assert np.ptp(kept + n * (run.total_momentum - run.spatial_momentum).values @ o) > 0.1  # without the wheel
    for other in (load + pulse((0, 1, 0), end=1), load + POTENTIALS["spring"]):
        assert "jacobi_integral" not in drifts(simulate(FREE, t_end=1, step=0.1, load=other, **START))


def test_large_steps_on_an_orbit_take_newtons_iteration():
    load, start = gravity_gradient(0.5), {"material_angular_velocity": (0.2, 0.1, 3.0)}
    run = simulate(FREE, t_end=30, step=0.6, load=load, order=8, **start)
    fine = simulate(FREE, t_end=30, step=0.1, load=load, order=12, **start)
    assert drifts(run)["jacobi_integral"].relative < 1e-12
    assert abs(run.directors.values[-1] - fine.directors.values[-1]).max() < 1e-2


def test_what_is_good_of_a_run_is_kept():
    def fails(g):
        return float("nan") if g[2] < -0.3 else float(g[2])

    load = potential((0, 0, 1.0), lambda g: float(g[2]) ** 2, lambda g: np.array([0, 0, 2 * g[2]]))
    broken = potential((0, 0, 1.0), lambda g: float(g[2]), lambda g: np.array([0, 0, 1.0]))
    term = broken.terms[0]
    vars(term)["potential"] = fails
    start = {"rotation": Rotation.from_euler("x", 1.2), "material_angular_velocity": (1, 0, 0.5)}
    for scheme in ("lie-midpoint", "energy-momentum", "gauss", "split", "continuous"):
        with pytest.raises(SimulationError, match="the potential fails is not finite at γ = ") as caught:
            simulate(FREE, t_end=5, step=0.05, load=load + broken, integrator=scheme, **start)
        if scheme != "continuous":
            assert len(caught.value.partial.time) > 2


test_refusals = refused_as(
    [
        lambda: potential((0, 0, 1), well, lambda g: 2 * slope(g)),
        lambda: potential((0, 0, 1), lambda g: np.nan, slope),
        lambda: potential((0, 0, 1), well),
        lambda: potential(np.ones((5, 3)), linear=np.ones((5, 3))),
        lambda: gravity_gradient(1, normal=(1, 0, 1)),
        lambda: gravity_gradient(1.0, start=1.0, eccentricity=0.1, perigee_time=2.0),
        lambda: gravity_gradient(1.0, eccentricity=1.0),
        lambda: director_forces([0, 1]),
        lambda: EnergyMomentum(moments="other"),
        lambda: simulate(FREE, t_end=1, step=0.1, load=director_forces(lambda t, d, w: (1, 2, 3))),
        lambda: simulate(FREE, t_end=1, load=QUADRATIC, integrator="exact"),
        lambda: simulate_ensemble(FREE, t_end=1, step=0.1, load=gravity_gradient(0.4), reduce="drift"),
    ],
    kind=(ValueError, SimulationError),
)


def test_records_make_the_load_again():
    load = sum((POTENTIALS["spring"], gravity_gradient(0.3, start=2), director_forces(TIMES, FORCES)), QUADRATIC)
    assert load_of(json.loads(json.dumps(load.description))) == load
    with says():
        load_of(POTENTIALS["function"].description)


@pytest.mark.parametrize(
    ("integrator", "order"), [("lie-midpoint", 2), ("energy-momentum", 2), (EXACT, None), ("gauss", 4)]
)
@pytest.mark.parametrize("name", ["quadratic", "linear"])
def test_a_gyrostat_under_a_potential_keeps_energy_and_vertical_momentum(integrator, order, name):
    wheel = rotor((1, 0, 0.5), 0.8)
    run = simulate(FREE, t_end=2, step=0.05, integrator=integrator, order=order, load=POTENTIALS[name] + wheel, **START)
    kept = drifts(run)
    assert {"K+V−A", "(π+Λh)·g"} <= {drift.symbol for drift in kept.values()}
    assert max(drift.relative for drift in kept.values()) < 1e-13
    assert np.ptp(run.spatial_momentum.values[:, 2]) > 0.1  # of the body alone it is not kept


@pytest.mark.parametrize(("integrator", "order", "bound"), [("lie-midpoint", 2, 2e-3), ("gauss", 8, 1e-11)])
def test_a_prescribed_spin_under_potentials_and_forces(integrator, order, bound):
    load = POTENTIALS["spring"] + director_forces(TIMES, FORCES, frame="body") + rotor((0, 0, 1), 0.5)
    how = {"load": load, "rotation": START["rotation"], "material_angular_velocity": (1, 2, 0)}
    body, asked = nontwisting([3, 4, 5], spin=0.7), [0, 1, 2.0]
    known = simulate(body, times=asked, integrator=Continuous(form="split"), **how)
    run = simulate(body, t_end=2, step=0.02, store=50, integrator=integrator, order=order, **how)
    assert abs(run.directors.values - known.directors.values).max() < bound


def test_the_moment_of_the_constraint_is_left_out_where_that_of_a_potential_is_not_known():
    start = START | {"material_angular_velocity": (1, 2, 0)}
    for integrator in ("lie-midpoint", "energy-momentum", "gauss", "split"):
        how = {"t_end": 1, "step": 1 / 64, "integrator": integrator, **start}
        run = simulate(HELD, load=POTENTIALS["quadratic"], **how)
        assert "spatial_reaction_moment" not in run
        run = simulate(HELD, load=dipole((1, 2, -3), (0, 0, 2)), **how)
        d3 = (run.directors.values[1:, 2] + run.directors.values[:-1, 2]) / 2
        assert abs(run.spatial_reaction_moment.values - run.reaction_moment.values[:, None] * d3).max() < 0.05
    run = simulate(
        HELD, times=[0, 1.0], load=dipole((1, 2, -3), (0, 0, 2)), integrator=Continuous(form="split"), **start
    )
    assert "spatial_reaction_moment" not in run


@pytest.mark.parametrize(
    ("name", "order"),
    [
        ("gauss", 2),
        ("gauss", 8),
        pytest.param("gauss", 16, marks=pytest.mark.long),
        ("lie-midpoint", 2),
        ("energy-momentum", 2),
    ],
)
@pytest.mark.parametrize("kind", [standard, nontwisting])
def test_bodies_that_springs_and_drag_bring_to_rest_stay_there(name, order, kind):
    """The moments cancel up to their round-off, which no iteration can undercut: the run is completed all the same."""
    for seed in (1, 2, 3):
        rng = np.random.default_rng(seed)
        J, p = rng.uniform(2, 4, 3), rng.normal(size=3)
        anchor = Rotation.random(random_state=seed).apply(3 * p)
        load = spring(300.0, p, anchor, rest_length=np.linalg.norm(p)) + damping(4.0)
        run = simulate(kind(J), t_end=60, step=0.02, load=load, store="end", integrator=name, order=order)
        end = rotation(run)[-1]
        torque = end.inv().apply(np.cross(end.apply(p), anchor)) / np.linalg.norm(p) / np.linalg.norm(anchor)
        assert abs(torque[: 2 if kind is nontwisting else 3]).max() < 1e-13, seed

"""Closed-form solutions: free motions against 40 digits, on every branch; the discrete scheme, loads, Suslov, phases;
the integrator `exact`."""

import re

import mpmath
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import exact_reference as reference
import nontwist as nt
from conftest import BODIES, NONTWISTING, PAPER_J, STANDARD, thinned
from covering.problems import FULL as TILTED
from exact_reference import FULL, distance
from nontwist.errors import SimulationError
from nontwist.integrators import Continuous
from nontwist.models.system import euler_inertia
from refusals import refused_as


def turns(W, n):
    """The time in which a body that turns at |W| makes `n` revolutions."""
    return 2 * np.pi * n / np.linalg.norm(W)


BRANCHES = {  # beside those of the checks of validation, which are compared with many digits as well
    "all signs negative": ([3, 4, 5], [-3, -1, -0.2]),
    "moments in another order": ([5, 3, 4], [1, 2, -3]),
    "moments in an odd order": ([4, 5, 3], [-1, 2, -3]),
    "pole on the axis that M circles": ([3, 4.6, 5], [1, 0.2, 5]),
    "k² just below 1/2": ([3, 4, 5], [1.5, 1, 1.95]),
    "k² just above 1/2": ([3, 4, 5], [1.5, 1, 1.94]),
    "rod": ([0.2, 4, 4.1], [30, 2, 1]),
    "plate": ([1, 2, 3], [1, 2, 3]),
    "moments far apart in scale": ([3e-9, 4e-9, 5e-9], [1e5, 2e5, 1e5]),
    "nearly prolate": ([3, 5, 5 * (1 + 1e-11)], [1, 2, 3]),
    "nearly oblate, across": ([3, 3 * (1 + 1e-8), 5], [1, 2, 1e-5]),
    "nearly spherical": ([3, 3 * (1 + 1e-9), 3 * (1 + 3e-9)], [1, 2, 3]),
    "near the largest axis": ([3, 4, 5], [1e-7, 2e-7, 3]),
    "near the smallest axis": ([3, 4, 5], [3, 2e-7, -1e-7]),
    "near the middle axis": ([3, 4, 5], [1e-7, 2, 1e-6]),
    "near the middle axis, the other side": ([3, 4, 5], [1e-6, -2, 1e-7]),
}


def ulp_effect(at, moments, W, t):
    """Largest change of the attitude when one number of the input moves by one ulp."""
    here, changes = at(moments, W, t), [0.0]
    for k in range(3):
        moved = np.array(moments, float)
        moved[k] = np.nextafter(moved[k], np.inf)
        changes.append(distance(at(moved, W, t), here))
        moved = np.array(W, float)
        moved[k] = np.nextafter(moved[k], np.inf)
        changes.append(distance(at(moments, moved, t), here))
    return max(changes)


@pytest.mark.parametrize("branch", thinned(2, BRANCHES))
def test_every_branch_against_40_digits(branch):
    moments, W = BRANCHES[branch]
    W = np.asarray(W, float)
    times = turns(W, 10) * np.array([0.3, 1.0])
    got, velocity = nt.exact.free_standard(moments, W, times)
    wanted = [reference.elliptic_top(moments, W, t) for t in times]
    allowed = max(1e-13, 10 * ulp_effect(reference.elliptic_top, moments, W, times[-1]))
    assert distance(got[0], wanted[0]) <= allowed
    assert distance(got[1], wanted[1]) <= allowed
    # the velocity, at many phases: momentum in space, and energy
    got, velocity = nt.exact.free_standard(moments, W, np.linspace(0, times[-1], 400))
    pi = np.asarray(moments) * W
    assert np.abs(got @ (moments * velocity)[..., None] - pi[:, None]).max() < 1e-14 * np.linalg.norm(pi)
    assert (moments * velocity**2).sum(1) == pytest.approx(moments @ W**2, rel=2e-14)


@pytest.mark.parametrize("W", [[1.5, 1, 1.95], [1.5, 1, 1.94], [1 / 3, 1e-3, 0.91 / 5], [1 / 3, 1e-3, 0.92 / 5]])
def test_phases_at_the_largest_nome(W):
    """k² on both sides of 1/2 and both poles: the last terms of the series count, each somewhere in the period."""
    T = nt.exact.momentum_period([3, 4, 5], W)
    times = np.linspace(-T / 4, T, 21)
    got, _ = nt.exact.free_standard([3, 4, 5], W, times)
    for R, t in zip(got, times, strict=True):
        assert distance(R, reference.elliptic_top([3, 4, 5], W, t)) < 1e-14


DEGENERATE = {  # beside those of the checks of validation
    "oblate, across": ([3, 3, 5], [1, 2, 0]),
    "oblate, along": ([3, 3, 5], [0, 0, -3]),
    "prolate, across": ([3, 3, 1], [-1, 2, 0]),
    "rest": ([3, 4, 5], [0, 0, 0]),
}


@pytest.mark.parametrize("case", DEGENERATE)
def test_degenerate_bodies_and_permanent_rotations(case):
    moments, W = map(np.array, DEGENERATE[case])
    A, C = (moments[0], moments[2]) if moments[0] == moments[1] else (1.0, 1.0)
    times = turns(W if np.any(W) else [1, 0, 0], 10) * np.array([-0.2, 0, 0.5, 1])
    got, velocity = nt.exact.free_standard(moments, W, times)
    spin = Rotation.from_rotvec(np.outer(times, [0, 0, (A - C) / A * W[2]]))
    known = (Rotation.from_rotvec(np.outer(times, W * [1, 1, C / A])) * spin).as_matrix()
    assert max(map(distance, got, known)) <= 1e-13
    assert nt.exact.momentum_period([3, 3, 5], [1, 2, 3]) == pytest.approx(np.pi)
    assert got @ (moments * velocity)[..., None] == pytest.approx(np.tile((moments * W)[:, None], (4, 1, 1)))


@pytest.mark.parametrize(("J", "W"), [(FULL, [3, -1, 0.3]), (2 * np.eye(3) + 1e-9 * FULL, [1, 2, 3])])
def test_principal_axes_off_the_directors(J, W):
    t = turns(W, 3)
    got, velocity = nt.exact.free_standard(J, W, [t])
    R, w = reference.taylor_top(J, W, t)
    assert distance(got[0], R) <= 1e-13
    assert velocity[0] == pytest.approx(w, abs=1e-13 * np.linalg.norm(W))


def chained(steps, start):
    """How far K, π, W and Λ are off after 2 s in as many calls, of which each starts where the last one ended."""
    J, rng = FULL, np.random.default_rng(start)
    W, R = 2 * rng.normal(size=3), Rotation.random(rng=rng).as_matrix()
    (A,), (w,) = nt.exact.free_standard(J, W, [2], R)
    V, Lam, h = W, R, [2 / steps]
    for _ in range(steps):
        (Lam,), (V,) = nt.exact.free_standard(J, V, h, Lam)
    momentum = np.linalg.norm(Lam @ J @ V - R @ J @ W) / np.linalg.norm(J @ W)
    return V @ J @ V / (W @ J @ W) - 1, momentum, np.linalg.norm(V - w) / np.linalg.norm(W), np.linalg.norm(Lam - A)


def test_chained_calls_do_not_drift():
    assert np.abs(chained(5000, 0)).max() < 1e-13


@pytest.mark.long
def test_million_chained_calls():
    assert np.abs(chained(1_000_000, 0)).max() < 1e-12


@pytest.mark.long
def test_growth_of_chained_calls():
    """They grow like n^0.5, to 1.6 times of which n^0.6 leaves room: more than the scatter of 16 starts."""
    few, many = (np.array([chained(n, start) for start in range(m)]) for n, m in ((1000, 100), (100_000, 16)))
    sizes = [np.sqrt((errors**2).mean(axis=0)) for errors in (few, many)]
    assert (sizes[1] <= sizes[0] * 100**0.6).all()


def test_start_and_order_of_times():
    R0 = Rotation.from_rotvec([1, 2, 3])
    for solution, J, W in (
        (nt.exact.free_standard, FULL, [1, -2, 3]),
        (nt.exact.free_nontwisting, PAPER_J, [6, -18, 0]),
    ):
        a, v = solution(J, W, [2, 0, 1], R0)
        assert np.array_equal(a[[1, 2, 0]], solution(J, W, [0, 1, 2], R0.as_matrix())[0])
        assert a[1] == pytest.approx(R0.as_matrix(), abs=2e-15)
        assert v[1] == pytest.approx(W, abs=1e-14)
        assert a[2] == pytest.approx(R0.as_matrix() @ solution(J, W, [1])[0][0], abs=1e-15)
        assert solution(J, W, 0.5)[0].shape == (1, 3, 3)
        assert solution(J, W, [])[0].shape == (0, 3, 3)
        assert np.array_equal(solution(J, [0, 0, 0], [3])[0], np.eye(3)[None])
    times = turns(W, 10), 0.5
    for R, w, t, bound in zip(*solution(J, W, times), times, (3e-14, 1e-15), strict=True):  # the last, steady one
        assert distance(R, reference.steady(W, t)) <= bound
        assert np.array_equal(w, W)


@pytest.mark.parametrize("body", [nt.standard, nt.nontwisting])
@pytest.mark.parametrize("integrator", ["exact", "split"])
def test_turns_without_a_digit(body, integrator):
    run = {"t_end": 1.0, "step": 0.5, "integrator": integrator}
    assert np.isfinite(nt.integrate(body([3, 4, 5]), material_angular_velocity=(0, 5e14, 0), **run).directors).all()
    words = "the body turns by more than 1e+15 rad: round-off leaves no digit of its attitude"
    error, where = (ValueError, "") if integrator == "exact" else (SimulationError, "step 0 at t = 0 s: ")
    with pytest.raises(error, match=f"^{re.escape(where + words)}$"):
        nt.integrate(body([3, 4, 5]), material_angular_velocity=(0, 2e15, 0), **run)
    with pytest.raises(ValueError, match=re.escape(words)):
        nt.simulate_ensemble(body([3, 4, 5]), t_end=1, integrator="exact", material_angular_velocity=[(0, 2e15, 0)])
    solved = nt.exact.free_standard if body is nt.standard else nt.exact.free_nontwisting
    with pytest.raises(ValueError, match=re.escape(words)):
        solved([3, 4, 5], (0, 2e15, 0), [1.0])


AXIS = np.array([0.3, 0.2, 1])
W_SUSLOV = np.array([1.0, -2.0, 0.1])  # 0.3 - 0.4 + 0.1 = 0
FINE = Continuous(rtol=1e-13, atol=1e-14)


def test_discrete_scheme():
    """Of lie-midpoint; of energy-momentum: nontwist.validation."""
    W, h = [6, -18, 0], 0.02
    run = nt.integrate(nt.nontwisting(PAPER_J), t_end=2, step=h, material_angular_velocity=W, integrator="lie-midpoint")
    R, w = nt.exact.discrete_free(PAPER_J, W, h, 100)
    assert np.swapaxes(R, 1, 2) == pytest.approx(run.directors, abs=1e-13)
    assert np.array_equal(w, np.tile(W, (101, 1)))
    assert nt.exact.discrete_angle(W, h) == pytest.approx(2 * np.arctan(np.sqrt(360) * 0.01), rel=1e-15)
    assert nt.exact.discrete_free(PAPER_J, [0, 0, 0], h, 1)[0] == pytest.approx(np.tile(np.eye(3), (2, 1, 1)))


@pytest.mark.parametrize("W", [[6, -18, 0], [0.3, 0.1, 0]])
@pytest.mark.parametrize("h", [0.1, 1e-3, 1e-8, 2e-103, 2e-104, 1e-120])
def test_accuracy_of_the_second_quotient(W, h):
    """Against the formula in 400 digits, where the differences of the angles have cancelled 240 of them."""
    steps = np.array([1, 2, 3, 7, 33])
    with mpmath.workdps(400):
        w, H = mpmath.sqrt(sum(mpmath.mpf(x) ** 2 for x in W)), mpmath.mpf(h)
        one, two, four = (2 * k * mpmath.atan(w * H / k / 2) for k in (1, 2, 4))
        expected = [float(mpmath.sin(n * (one - two) / 2) / mpmath.sin(n * (two - four) / 2)) for n in steps.tolist()]
    assert nt.exact.discrete_second_quotient(W, h, steps * h) == pytest.approx(
        expected, rel=1e-13 if h > 0.01 else 1e-15
    )
    assert nt.exact.discrete_second_quotient(W, h, [0]) == pytest.approx(expected[0], rel=2e-2)
    assert nt.exact.discrete_second_quotient([1e-300, 0, 0], 1e-80, [0, 1e-80]) == pytest.approx(4, rel=1e-15)


def test_suslov_from_the_unstable_equilibrium():
    """Other motions are checks of validation."""
    J, W, times = [[3, 0, 0.4], [0, 4, -0.3], [0.4, -0.3, 5]], np.array([0.3, -0.4001, 0.0]), [9.0, 0.0, 3.0]
    for R, w, t in zip(*nt.exact.suslov(J, [0, 0, 2], W, times), times, strict=True):
        attitude, velocity = reference.taylor_top(J, W, t, axis3=True)
        assert pytest.approx(velocity, abs=1e-13) == w
        assert pytest.approx(attitude, abs=1e-12 if t else 1e-15) == R
    flat = nt.exact.suslov_velocity([3, 4, 5], [0, 0, 1], [1, 2, 0], [0, 7.0])
    assert np.array_equal(flat, np.tile([1, 2, 0], (2, 1)))
    settled = nt.exact.suslov_velocity(TILTED, AXIS, W_SUSLOV, 400.0)[0]
    assert (TILTED @ settled) @ AXIS == pytest.approx(0, abs=1e-13)  # M3 = 0: nothing turns W any more
    assert nt.exact.suslov_velocity(TILTED, AXIS, settled, 5)[0] == pytest.approx(settled, abs=1e-13)


STRONG = np.array([[2, 0, 0.8], [0, 2.5, -0.6], [0.8, -0.6, 3]])
START = np.array([-1, 0.4, 0])


def test_suslov_after_settling():
    """50 digits until W is steady, from there exp(t Ŵ) of the W that the energy gives: round-off of the turn."""
    settled, times = 80.0, np.array([80.0, 81.0, 1e6, 1e8, 1e12])
    attitude, velocity = nt.exact.suslov(STRONG, [0, 0, 1], START, times)
    R, _ = reference.taylor_top(STRONG, START, settled, axis3=True, order=60, turn=0.8)
    with mpmath.workdps(40):
        J, W = mpmath.matrix(STRONG), mpmath.matrix(START)
        e = mpmath.matrix([-J[1, 2], J[0, 2], 0])  # n × J n
        e *= mpmath.sqrt((W.T * J * W)[0] / (e.T * J * e)[0])
        for t, got, w in zip(times, attitude, velocity, strict=True):
            turn = reference.steady(e, mpmath.mpf(t) - settled)
            bound = 1e-13 + 8 * np.finfo(float).eps * (t - settled) * float(mpmath.norm(e))
            assert got == pytest.approx(R @ turn, abs=bound)
            assert w == pytest.approx(np.array(e.T.tolist()[0], float), abs=1e-15)
    back, _ = nt.exact.suslov(STRONG, [0, 0, 1], -START, -times)  # a film of it run backwards
    assert back[:3] == pytest.approx(attitude[:3], abs=1e-8)


ANOTHER = nt.DirectorSystem(euler_inertia([3, 4, 5]), [2, 0, 0])
FREE = {
    "standard": (BODIES["standard"](), (1, -2, 0.5), None),
    "another axis": (ANOTHER, (0, -2, 0.5), None),
    "another axis, under load": (ANOTHER, (0, -2, 0.5), nt.sine([1, -8, 2.5], 0.8)),
}


@pytest.mark.parametrize("case", FREE)
def test_integrator_solves_the_continuous_equations(case):
    body, W, load = FREE[case]
    how = {"t_start": 0.1, "times": [0.1, 0.35, 1, 1.7], "rotation": Rotation.from_rotvec([1, 2, 3])}
    how |= {"material_angular_velocity": W, "load": load}
    a, b = (nt.integrate(body, integrator=integrator, **how) for integrator in ("exact", FINE))
    for name in ("directors", "director_velocities", "multipliers", "moment", "load_work"):
        assert getattr(a, name).shape == getattr(b, name).shape
        bound = 1e-11 if name == "directors" else 1e-10
        assert getattr(a, name) == pytest.approx(getattr(b, name), abs=bound), name
    assert a.newton_iterations is None


@pytest.mark.filterwarnings("error")
def test_spin_about_one_axis():
    """μ = (J W × W)·D3 + M3 is that of the load alone."""
    start = {"rotation": nt.rotations.exp([1e-293, 0.2, 0]), "material_angular_velocity": (0, -3, 0)}
    load = nt.pulse([0, 0, 2.0], 0, 1, shape="rectangle")
    run = nt.simulate(NONTWISTING, times=[0, 0.5, 1], load=load, integrator="exact", **start)
    assert run.reaction_moment.values == pytest.approx(-2.0)


MOVE = nt.sine([1, 0, 0], 1)


def solved(body, load):
    how = {"t_end": 1, "step": 0.1, "material_angular_velocity": W_SUSLOV, "project": True}
    return nt.integrate(body, load=load, integrator="exact", **how)


test_refusals = refused_as(
    {
        "not a body": lambda: nt.exact.free_standard([1, 1, 3], [1, 0, 0], [1]),
        "no rotation": lambda: nt.exact.free_standard([1, 1, 1], [1, 0, 0], [1], 1.1 * np.eye(3)),
        "not symmetric": lambda: nt.exact.symmetric_top([3, 4, 5], [1, 2, 3], [1]),
        "nearly symmetric": lambda: nt.exact.symmetric_top([3e-5, 3.0001e-5, 5e-5], [1, 2, 3], [1]),
        "not principal": lambda: nt.exact.free_nontwisting(FULL, [1, 0, 0], [1]),
        "twisting": lambda: nt.exact.free_nontwisting(PAPER_J, [1, 0, 0.1], [1]),
        "the axis moves": lambda: nt.exact.loaded_nontwisting(PAPER_J, [0, 1, 0], MOVE, [1]),
        "damping": lambda: nt.exact.loaded_momentum(PAPER_J, [0, 1, 0], MOVE + nt.damping(0.1), [1]),
        "before the start": lambda: nt.exact.loaded_momentum(PAPER_J, [0, 1, 0], MOVE, [1, 0], t_start=0.5),
        "Suslov, along the axis": lambda: nt.exact.suslov_velocity(TILTED, AXIS, [1, 1, 1], [0]),
        "Suslov, far": lambda: nt.exact.suslov(STRONG, [0, 0, 1], START, [0, 1e16]),
        "colatitude": lambda: nt.exact.latitude_turn(4),
        "one vertex": lambda: nt.exact.polygon_turn([[1, 0, 0]]),
        "antipodal vertices": lambda: nt.exact.polygon_turn([[1, 0, 0], [0, 1, 0], [0, -1, 0]]),
        "middle axis": lambda: nt.exact.momentum_period([3, 4, 5], [0, 1, 0]),
        "rest": lambda: nt.exact.momentum_period([3, 4, 5], [0, 0, 0]),
        "sphere": lambda: nt.exact.momentum_period([2, 2, 2], [1, 2, 3]),
        "across": lambda: nt.exact.momentum_period([3, 3, 5], [1, 2, 0]),
        "gravity": lambda: solved(BODIES["heavy_top"](), None),
        "Suslov body": lambda: solved(nt.suslov(TILTED, AXIS), None),
        "of the state": lambda: solved(STANDARD, nt.damping(0.1)),
        "standard body": lambda: solved(STANDARD, MOVE),
        "in space": lambda: solved(nt.nontwisting(PAPER_J), nt.sine([1, 0, 0], 1, frame="space")),
        "moving axis": lambda: solved(nt.nontwisting(PAPER_J), MOVE),
    }
)

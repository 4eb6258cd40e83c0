"""Free gyrostats in closed form, on every branch, against 50 digits, SciPy, and what is known otherwise."""

import itertools

import numpy as np
import pytest

import exact_reference as reference
from conftest import NONTWISTING, STANDARD, random_inertia, thinned
from exact_reference import FULL, distance
from nontwist import damping, exact, integrate, rotations, rotor, simulate, simulate_ensemble, standard
from nontwist.exact.gyrostats import gyrostat
from nontwist.geometry.attitudes import attitudes
from refusals import refused_as

AXIS = np.array([0.5, -0.3, 0.8])
UNSTABLE = 3.6 * AXIS - FULL @ AXIS  # with this rotor a rotation about AXIS is permanent, and a saddle


def period(J, c, W):
    """The period of the momentum in the body, as the closed form has it."""
    found = gyrostat(J, c, W)
    return 2 * found.lattice.half / found.unit


BRANCHES = {
    "one curve, real nome below": (FULL, [1, -2, 0.5], [0.4, -1.1, 0.7]),
    "two curves": ([3, 4, 5], [0.1, 0, 0.2], [0.3, 0.2, -1]),
    "no rotor to speak of": ([3, 4, 5], [1e-8, 2e-8, -1e-8], [0.3, 1, -0.4]),
    "symmetric, rotor along": ([3, 3, 4], [0, 0, 2], [0.5, -0.3, 0.8]),
    "rotor along the smallest axis, backwards": ([3, 4, 5], [-4, 0, 0], [0.6, -0.3, 0.7]),
    "motion in a plane of symmetry": ([3, 4, 5], [0, 0, 0.5], [0.6, 0, 0.7]),
    "a pole on the imaginary axis": ([3, 4, 5], [0, 0, 0.05], [0.5, 0, 0.01]),
    "a pole below, on that axis": ([5, 4, 3], [-0.05, 0, 0], [0.01, -0.5, 0]),
    "symmetric, rotor across": ([3, 3, 4], [0.3, -0.4, 2], [0.5, -0.3, 0.8]),
    "rotor along the largest axis": ([3, 4, 5], [0, 0, 2], [0.6, -0.3, 0.7]),
    "total momentum along an axis": ([3, 4, 5], [-1.5, 1.2, 2], [0.5, -0.3, 0.8]),
    "at rest, permanent": ([3, 4, 5], [0.3, -0.4, 2], [0, 0, 0]),
    "sphere": ([3, 3, 3], [0.3, -0.4, 2], [0.5, -0.3, 0.8]),
    "little total momentum": ([3, 4, 5], [-1.5 + 1e-12, 1.2 - 2e-12, -4], [0.5, -0.3, 0.8]),
    "rotor that outweighs the body": ([3, 4, 5], [3, -4, 20], [0.5, -0.3, 0.8]),
    "rod": ([0.2, 4, 4.1], [0.05, 0.3, 1], [3, 0.2, 0.1]),
    **{f"separatrix {d:g}": (FULL, UNSTABLE, AXIS + d * np.array([1, -0.4, 0.2])) for d in (1e-3, 1e-6, 1e-9)},
    **{f"rotor on the middle axis {d:g}": ([3, 4, 5], [0, 0.3, 0], [d, 1, d / 2]) for d in (1e-3, 1e-9, 1e-16, 1e-30)},
    **{f"rotor that is as small {d:g}": ([3, 4, 5], [d, 0, d / 3], [d, 1, d / 2]) for d in (1e-3, 1e-9, 1e-16)},
    **{f"near the largest axis {d:g}": ([3, 4, 5], [0, 0, 2], [d, 0, 1]) for d in (1e-6, 1e-16, 1e-30)},
}


@pytest.mark.parametrize("branch", thinned(2, BRANCHES))
def test_every_branch_against_50_digits(branch):
    J, c, W = BRANCHES[branch]
    turns = 6 / period(np.diag(J) if np.ndim(J) == 1 else J, np.array(c), np.array(W)) if any(W) else 0
    (R,), (w,) = exact.free_gyrostat(J, c, W, [-6.0])
    wanted, rate = reference.taylor_top(J, W, -6.0, rotor=c)
    assert distance(R, wanted) < 1e-14 + 3e-15 * turns
    assert abs(w - rate).max() < 2e-14 * max(1, np.linalg.norm(W))


def past_a_saddle(d):
    """The start at a distance d from the permanent rotation, and the period."""
    W = AXIS + d * np.array([1, -0.4, 0.2])
    return W, period(FULL, UNSTABLE, W)


@pytest.mark.parametrize("d", thinned(3, [1e-3, 1e-6, 1e-9]))
def test_error_past_a_saddle(d):
    """Half a period and more from the permanent rotation: an ulp of the start has grown by some 1/d."""
    W, T = past_a_saddle(d)
    R, _ = exact.free_gyrostat(FULL, UNSTABLE, W, [0.55 * T])
    wanted, _ = reference.taylor_top(FULL, W, 0.55 * T, rotor=UNSTABLE, turn=1.5, order=80)
    assert distance(R[0], wanted) < 5e-14


def test_period_near_a_saddle():
    """By 2 ln(1000)/σ where the distance falls by 1000, σ its rate of growth; a thousandth of 1e-9 has lost digits."""
    rate = np.linalg.inv(FULL) @ (rotations.hat(FULL @ AXIS + UNSTABLE) - rotations.hat(AXIS) @ FULL)
    periods = np.array([past_a_saddle(d)[1] for d in (1e-3, 1e-6, 1e-9)])
    assert abs(periods - [135, 285, 435]).max() < 5
    assert periods[2] - periods[1] == pytest.approx(2 * np.log(1000) / max(np.linalg.eigvals(rate).real), rel=2e-5)


def test_long_motions_keep_invariants():
    """To 10³/|W| against gauss of order 16, whose steps leave round-off alone; the phase is in the attitude."""
    r = np.random.default_rng(6)
    for _ in range(6):
        J, c, W = random_inertia(r), r.normal(size=3), r.normal(size=3)
        times = np.linspace(0, np.floor(1000 / np.linalg.norm(W)), 41)[[0, 1, 20, 40]]
        how = {"times": times, "material_angular_velocity": W, "load": rotor(c, np.linalg.norm(c)), "step": 0.05}
        run = integrate(standard(J), integrator="gauss", order=16, **how)
        R, w = exact.free_gyrostat(J, c, W, times)
        assert abs(R - attitudes(run.states.quaternion)).max() < 2e-11
        P = J @ W + c
        assert abs(R @ (w @ J + c)[:, :, None] - P[:, None]).max() < 3e-14 * np.linalg.norm(P)
        assert np.sum(w @ J * w, axis=1) == pytest.approx(W @ J @ W, rel=1e-13)


def test_free_body_without_rotors():
    """With 0 to the last bit; the limit is of order 1, and with 1e-200 reached."""
    W, times = [0.3, 1, -0.4], [-3, 0, 40]
    free = exact.free_standard(FULL, W, times)
    for a, b in zip(free, exact.free_gyrostat(FULL, [0, 0, 0], W, times), strict=True):
        assert np.array_equal(a, b)
    c = np.array([1, -2, 0.5])
    gaps = [abs(exact.free_gyrostat(FULL, h * c, W, times)[0] - free[0]).max() for h in (1e-3, 1e-6, 1e-9, 1e-200)]
    assert gaps[0] / gaps[1] == pytest.approx(1000, rel=0.02)
    assert gaps[1] / gaps[2] == pytest.approx(1000, rel=0.02)
    assert gaps[3] < 5e-14


@pytest.mark.parametrize("factor", [7.0, 4.05, 3.6, 2.0, 0.0, -3.0])
def test_permanent_rotations(factor):
    """P = λ W stays; λ = 0 is a body without total momentum; of the unstable one, λ = 3.6, the first time units."""
    times = np.linspace(-20, 20, 9)
    R, w = exact.free_gyrostat(FULL, factor * AXIS - FULL @ AXIS, AXIS, times)
    assert abs(w - AXIS).max() < 1e-14
    assert abs(R - rotations.exp(np.outer(times, AXIS))).max() < 2e-14


def test_shortest_times():
    R, W = exact.free_gyrostat([3, 4, 5], [0.3, -0.4, 2], [0.5, -0.3, 0.8], [5e-324, -1e-310])
    assert abs(R - np.eye(3)).max() < 1e-300
    assert (W == [0.5, -0.3, 0.8]).all()


def test_units_do_not_matter():
    """Motions that differ by a factor of time and mass have the same attitudes."""
    J, c, times = np.array([3.0, 4, 5]), np.array([0, 1, 0.5]), np.array([1.0, 20.0])
    R, w = exact.free_gyrostat(J, c, AXIS, times)
    for mass, rate in itertools.product((2.0**150, 2.0**-150), (2.0**150, 2.0**-150)):
        turned, velocity = exact.free_gyrostat(mass * J, mass * rate * c, rate * AXIS, times / rate)
        assert abs(turned - R).max() < 5e-14
        assert abs(velocity / rate - w).max() < 5e-14


def test_integrator_agrees_with_gauss():
    load, W = rotor((1, -1, 2), 2.0) + rotor("z", [0, 9], [0.7, 0.7]), np.array([0.4, -1.1, 0.7])
    how = {"times": [1, 1.5, 4, 30], "t_start": 1, "rotation": rotations.exp([0.3, 2, 1]), "load": load}
    run = simulate(standard(FULL), integrator="exact", material_angular_velocity=W, **how)
    R, w = exact.free_gyrostat(FULL, load.rotor_momentum([0])[0], W, [0, 0.5, 3, 29], how["rotation"])
    assert abs(run.directors.values.swapaxes(1, 2) - R).max() < 2e-15
    assert np.array_equal(run.material_angular_velocity.values, w)
    stepped = simulate(standard(FULL), integrator="gauss", order=16, step=0.05, material_angular_velocity=W, **how)
    for name in ("director_velocities", "total_momentum", "spatial_momentum", "moment", "quaternion"):
        assert abs(run[name] - stepped[name]).max() < 5e-13, name
    assert not run.load_work.values.any()


def test_ensembles_scale_the_rotor():
    """Each member is the run of its own; a factor of 0 leaves a free body."""
    W, scales = np.array([[0.4, -1.1, 0.7], [0.1, 2, 0.3], [0.4, -1.1, 0.7]]), [0, 1.0, -2.5]
    load, how = rotor((1, -1, 2), 3.0), {"times": [0, 3, 7.0], "integrator": "exact"}
    many = simulate_ensemble(standard(FULL), material_angular_velocity=W, load=load, load_scale=scales, **how)
    for i, scale in enumerate(scales):
        one = simulate(standard(FULL), material_angular_velocity=W[i], load=scale * load if scale else None, **how)
        for name in ("quaternion", "material_angular_velocity"):
            assert np.array_equal(many[name][i], one[name]), (i, name)


def test_rotor_constant_during_the_run():
    how = {"load": rotor("z", [0, 1, 2, 3], [0, 2, 2, 5]), "integrator": "exact", "material_angular_velocity": AXIS}
    run = simulate(standard(FULL), t_start=1, times=[1, 2], **how)
    assert np.array_equal(run.material_angular_velocity[1:], exact.free_gyrostat(FULL, [0, 0, 2], AXIS, [1])[1])


def solved(body, load):
    return simulate(body, t_end=1, load=load, integrator="exact")


test_refusals = refused_as(
    {
        "spins up": lambda: solved(STANDARD, rotor("z", [0.2, 0.5], [0, 1])),
        "up and down again": lambda: solved(STANDARD, rotor("z", [0.2, 0.5, 0.8], [1, 2, 1])),
        "damped": lambda: solved(STANDARD, rotor("z", 1) + damping(0.1)),
        "constrained": lambda: solved(NONTWISTING, rotor("z", 1)),
        "far": lambda: exact.free_gyrostat([3, 4, 5], (0, 0, 1), AXIS, [1e17]),
    }
)

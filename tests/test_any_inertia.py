"""Bodies whose inertia no distribution of mass has, and points on massless rods: what the equations allow.

The motions are compared with Euler's equations and the rows d_i' = w × d_i, by SciPy at 1e-13; where an axis is held,
with W along it taken out by the moment that the plane leaves.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from nontwist import (
    DirectorSystem,
    exact,
    heavy_top,
    inertia,
    least_effort,
    moment,
    nontwisting,
    potential,
    sensitivities,
    simulate,
    simulate_ensemble,
    standard,
    suslov,
    with_gravity,
)
from nontwist.inertia import principal_frame
from refusals import refused_as

TILT = [[2 / 3, -1 / 3, 2 / 3], [2 / 3, 2 / 3, -1 / 3], [-1 / 3, 2 / 3, 2 / 3]]
TILTED = [[1, 0, 0], [0, 0.8, -0.6], [0, 0.6, 0.8]]
W0 = np.array([0.4, -0.3, 0.6])
FREE = {
    "Hairer, Lubich and Wanner": ([2, 1, 2 / 3], [np.cos(1.1) / 2, 0, 1.5 * np.sin(1.1)]),
    "Krogh": ([1, 0.5, 1 / 3], W0),
    "Krogh 2": ([1 / 6, 1, 2 / 3], W0),
    "Dzhanibekov": ([3, 5, 9], [0.01, 1, 0.01]),
    "short fat top": ([3, 3, 9], W0),
    "Mathematica": ([8, 4, 0.4], W0),
}
TOPS = {
    "Simo and Wong": ([5, 5, 1], 20, (0, 0, 1), (0, 0, -1.0)),
    "Géradin and Cardona": ([0.8 + 5 * 1.69, 0.8 + 5 * 1.69, 1.8], 5, (0, 0, 1.3), (0, 0, -9.81)),
}
HEAVY = heavy_top([2, 1, 4.5], 0.3, (0.1, 0.2, 0.5), physical=False)


def reference(body, W, t_end, rotation=None):
    """Return Λ and W at the end."""
    J, n = body.inertia, body.axis
    plane = np.eye(3) if n is None else np.linalg.svd(n[None])[2][1:]

    def rates(t, y):
        q, W = y[:9].reshape(3, 3), y[9:]
        m = np.cross(J @ W, W) + q @ np.cross(q, body.dead_force).sum(0)
        return np.append(np.cross(W @ q, q).ravel(), plane.T @ np.linalg.solve(plane @ J @ plane.T, plane @ m))

    q = np.eye(3) if rotation is None else np.transpose(rotation)
    end = solve_ivp(rates, (0, t_end), [*q.ravel(), *W], method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
    return end[:9].reshape(3, 3).T, end[9:]


def test_the_published_momentum_of_hairer_lubich_and_wanner():
    """Π(100), printed by GeometricProblems.jl and by DOP853."""
    J, W = FREE["Hairer, Lubich and Wanner"]
    printed = [-0.17734831, -0.59041852, 0.78737129]
    assert np.allclose(exact.free_standard(J, W, [100.0], physical=False)[1][0] * J, printed, atol=1e-8)
    run = simulate(standard(J, physical=False), t_end=100, material_angular_velocity=W)
    assert np.allclose(run.material_momentum.values[-1], printed, atol=1e-7)


@pytest.mark.parametrize("name", FREE)
def test_free_bodies_of_the_literature(name):
    J, W = FREE[name]
    body, how = standard(J, physical=False), {"t_end": 10.0, "material_angular_velocity": W}
    Lam, end = reference(body, W, 10.0)
    found, velocity = exact.free_standard(J, W, [10.0], physical=False)
    assert np.allclose(found[0], Lam, atol=1e-11)
    assert np.allclose(velocity[0], end, atol=1e-11)
    for scheme in (
        {"integrator": "exact"},
        {"integrator": "gauss", "order": 8, "step": 0.05},
        {"integrator": "continuous"},
    ):
        run = simulate(body, **how, **({"step": 0.05} | scheme if scheme["integrator"] != "exact" else scheme))
        tolerance = 1e-8 if scheme["integrator"] == "continuous" else 1e-10
        assert np.allclose(run.directors.values[-1].T, Lam, atol=tolerance), scheme


@pytest.mark.parametrize("name", TOPS)
def test_tops_of_the_literature(name):
    body, W, tilt = heavy_top(*TOPS[name], physical=False), (0, 0, 50.0), [[1, 0, 0], [0, 0.8, -0.6], [0, 0.6, 0.8]]
    Lam, _ = reference(body, W, 1.5, tilt)
    run = simulate(body, t_end=1.5, step=2.5e-3, order=8, rotation=tilt, material_angular_velocity=W)
    assert np.allclose(run.directors.values[-1].T, Lam, atol=1e-10)
    with pytest.raises(ValueError, match="physical=False"):
        heavy_top(*TOPS[name])


def test_the_director_scheme_keeps_energy_and_momentum_though_E_is_indefinite():
    """E has an eigenvalue of -0.75: K + V and the vertical momentum stay, the lengths too, and the order is 2."""
    assert np.linalg.eigvalsh(HEAVY.euler_inertia)[0] == pytest.approx(-0.75)
    how = {"t_end": 2.0, "material_angular_velocity": (1, -2, 3), "integrator": "energy-momentum"}
    Lam, errors = reference(HEAVY, np.array([1.0, -2, 3]), 2.0)[0], []
    for step in (0.01, 0.005):
        run = simulate(HEAVY, step=step, **how)
        energy = (run.kinetic_energy + run.potential_energy).values
        assert abs(energy / energy[0] - 1).max() < 1e-13
        assert np.ptp(run.spatial_momentum.values[:, 2]) < 1e-12
        q = run.directors.values
        assert abs(q @ q.swapaxes(1, 2) - np.eye(3)).max() < 1e-13
        errors.append(abs(q[-1].T - Lam).max())
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2, abs=0.05)


@pytest.mark.parametrize(
    "scheme", [("gauss", 8), ("lie-midpoint", 2), ("energy-momentum", 2), ("split", 4), ("continuous", None)]
)
@pytest.mark.parametrize(
    "body", [nontwisting([1, 1, 0]), nontwisting([1, 2, 0], physical=False)], ids=["point", "flat"]
)
def test_a_point_on_a_massless_rod_is_the_spherical_pendulum(scheme, body):
    """The rod turns by the rates of the plane alone; of the point the constraint exerts no moment at all."""
    name, order = scheme
    body, W = with_gravity(body, 1, (0, 0, 1.0)), np.array([1.5, -0.7, 0])
    tilt = np.array([[1, 0, 0], [0, 0.6, -0.8], [0, 0.8, 0.6]])
    Lam, _ = reference(body, W, 2.0, tilt)
    how = {"integrator": name, "step": 0.01 if order == 8 else 1e-3} | ({"order": order} if order else {})
    run = simulate(body, t_end=2.0, rotation=tilt, material_angular_velocity=W, **how)
    tolerance = 1e-5 if order == 2 else 1e-8
    assert np.allclose(run.directors.values[-1].T, Lam, atol=tolerance)
    if body.physical:
        x0, v0 = tilt[:, 2], np.cross(tilt @ W, tilt[:, 2])

        def sphere(t, y):
            x, v = y[:3], y[3:]
            g = np.array([0, 0, -9.81])
            return np.append(v, g - (g @ x + v @ v) * x)

        end = solve_ivp(sphere, (0, 2), [*x0, *v0], method="DOP853", rtol=1e-13, atol=1e-14).y[:3, -1]
        assert np.allclose(run.directors.values[-1, 2], end, atol=tolerance)


@pytest.mark.filterwarnings("error")
def test_steps_and_moments_are_chosen_for_a_point_too():
    body, how = with_gravity(nontwisting([1, 1, 0]), 1, (0, 0, -1)), {"t_end": 1, "rotation": TILTED}
    fine = simulate(body, step=1e-3, order=8, **how).directors.values[-1]
    for chosen in ({}, {"tolerance": 1e-9}):
        assert abs(simulate(body, **how, **chosen).directors.values[-1] - fine).max() < 1e-7
    turn, like = np.array([[0.8, 0, 0.6], [0, 1, 0], [-0.6, 0, 0.8]]), nontwisting([1, 1, 1])
    for body in (nontwisting([1, 1, 0]), nontwisting([1, 1, 3], physical=False)):
        found, other = (least_effort(one, np.eye(3), turn, t_end=1.0) for one in (body, like))
        assert found.length == pytest.approx(other.length, rel=1e-8)


def test_closed_forms_of_held_bodies_need_no_moment_about_the_axis():
    times, W = [0.0, 1.0, 3.0], (0.3, 0.8, 0)
    assert np.array_equal(
        exact.free_nontwisting([1, 1, 0], W, times)[0], exact.free_nontwisting([1, 1, 1], W, times)[0]
    )
    run = simulate(nontwisting([1, 1, 0]), times=times, material_angular_velocity=W, integrator="exact")
    assert np.allclose(run.directors.values[-1].T, exact.free_nontwisting([1, 1, 0], W, times)[0][-1], atol=1e-14)
    J = inertia.of_points([2.0], [(0, 0, 0.5)])
    assert np.allclose(J, np.diag([0.5, 0.5, 0]), atol=1e-15)
    assert nontwisting(J).inertia[2, 2] == 0
    T = exact.momentum_period([1, 2, 6], (0.1, 2, 0.1), physical=False)
    assert np.allclose(
        exact.free_standard([1, 2, 6], (0.1, 2, 0.1), [T], physical=False)[1], [[0.1, 2, 0.1]], atol=1e-12
    )


def test_the_word_goes_with_the_body():
    body, ordinary = standard([1, 2, 6], physical=False), standard([3, 4, 5])
    again = DirectorSystem.from_json(body.to_json())
    assert not again.physical
    assert np.array_equal(again.euler_inertia, body.euler_inertia)
    assert "physical=False" in repr(replace(body, name="x"))
    assert "physical" not in ordinary.to_json()
    assert np.array_equal(standard([3, 4, 5], physical=False).euler_inertia, ordinary.euler_inertia)
    runs = simulate_ensemble(
        DirectorSystem.stack([body, ordinary]), t_end=1, step=0.1, material_angular_velocity=(1, 2, 3)
    )
    alone = simulate(body, t_end=1, step=0.1, material_angular_velocity=(1, 2, 3))
    assert abs(runs.quaternion.values[0][-1] @ alone.quaternion.values[-1]) == pytest.approx(1, abs=1e-14)
    assert np.allclose(principal_frame(body.inertia, physical=False)[0], [1, 2, 6])
    how = {"t_end": 1, "step": 0.1, "material_angular_velocity": (1, 2, 3)}
    slope = sensitivities(body, wrt=["inertia"], **how)
    ahead, behind = (simulate(standard([1 + e, 2, 6], physical=False), **how) for e in (1e-5, -1e-5))
    change = (ahead.material_angular_velocity.values[-1] - behind.material_angular_velocity.values[-1]) / 2e-5
    assert np.allclose(slope.d_material_angular_velocity.values[-1][:, 0], change, atol=1e-8)


test_refused_by_name = refused_as(
    {
        "digits": lambda: simulate(HEAVY, t_end=1, rotation=np.round(TILT, 4)),
        "coefficients": lambda: potential((0, 0, 1), (0, 0, 5)),
        "indefinite": lambda: standard([1, 2, -1], physical=False),
        "indefinite, held": lambda: nontwisting([1, 2, -1], physical=False),
        "nothing across the axis": lambda: nontwisting([0, 1, 1], physical=False),
        "not symmetric": lambda: standard([[3, 0.1, 0], [0.2, 4, 0], [0, 0, 5]], physical=False),
        "free": lambda: standard([1, 1, 0], physical=False),
        "another axis": lambda: suslov([1, 1, 0], (1, 0, 1)),
        "spin": lambda: nontwisting([1, 1, 0], spin=1.0),
        "exact": lambda: exact.free_standard([1, 1, 3], W0, [1.0]),
    }
)


def test_a_moment_of_the_state_acts_on_a_point():
    """The moment -k e3 × d3 of a spring across the vertical, on the point of the pendulum."""
    push = moment(lambda t, directors, w: np.cross(directors[2], (0.0, 0.0, 2.0)))
    run = simulate(nontwisting([1, 1, 0]), t_end=1, step=0.01, load=push, rotation=[[1, 0, 0], [0, 0, -1], [0, 1, 0]])
    height = run.directors.values[:, 2, 2]
    kinetic = run.kinetic_energy.values
    assert abs(kinetic - 2 * height - (kinetic[0] - 2 * height[0])).max() < 1e-6

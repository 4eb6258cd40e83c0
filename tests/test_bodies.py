"""Bodies: their inertias, what is refused, JSON; inertias that no distribution of mass has, points on massless rods.

The motions are compared with Euler's equations and the rows d_i' = w × d_i, by SciPy at 1e-13; where an axis is held,
with W along it taken out by the moment that the plane leaves.
"""

import json
import pickle
import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from conftest import PAPER_J, random_inertia
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
from nontwist.inertia import convected_inertia, euler_inertia, principal_frame
from nontwist.split_form import split_inertia
from refusals import refused_as


def test_euler_inertia_of_the_paper():
    assert euler_inertia(PAPER_J) == pytest.approx(np.array([[3, 1 / 7, 0], [1 / 7, 2, 0], [0, 0, 1]]), abs=1e-15)


def test_euler_inertia_is_the_second_moment_of_mass():
    rng = np.random.default_rng(1)
    x, m = rng.normal(size=(50, 3)), rng.uniform(0.1, 1, 50)
    J = sum(mi * (xi @ xi * np.eye(3) - np.outer(xi, xi)) for mi, xi in zip(m, x, strict=True))
    assert euler_inertia(J) == pytest.approx((x.T * m) @ x, rel=1e-13, abs=1e-13)


def test_inertias_are_inverse_to_each_other():
    J = random_inertia(np.random.default_rng(2))
    assert convected_inertia(euler_inertia(J)) == pytest.approx(J, rel=1e-15, abs=1e-15)


def test_split_of_the_inertia():
    J_perp, J_par = split_inertia(PAPER_J)
    assert J_par == 5
    assert np.array_equal(J_perp + J_par * np.outer([0, 0, 1], [0, 0, 1]), PAPER_J)
    assert np.array_equal(J_perp @ [0, 0, 1], np.zeros(3))
    with pytest.raises(ValueError, match=re.escape("J[0,2] = 0.6")):
        split_inertia([[3, 0, 0.6], [0, 4, 0], [0.6, 0, 5]])


test_refused_with_reason_and_number = refused_as(
    {
        "shape": lambda: standard([[1, 2], [2, 1]]),
        "asymmetric": lambda: standard([[3, 0.1, 0], [0.2, 4, 0], [0, 0, 5]]),
        "indefinite": lambda: standard([1, 2, -1]),
        "rod of no thickness": lambda: standard([1, 1, 0]),
        "rod with a spin": lambda: nontwisting([1, 1, 0], spin=2.0),
        "triangle": lambda: standard([1, 1, 3]),
        "D3": lambda: nontwisting([[3, 0, 0.6], [0, 4, 0], [0.6, 0, 5]]),
        "axis zero": lambda: suslov([1, 1, 1], [0, 0, 0]),
        "inertia of the centre of mass": lambda: heavy_top([1, 1, 1], 5, [0, 0, 1]),
    }
)


def test_plates_and_thin_rods_are_bodies():
    assert np.linalg.eigvalsh(standard([1, 1, 2]).euler_inertia)[0] == 0
    assert np.linalg.eigvalsh(standard([1, 1, 1e-9]).euler_inertia)[0] == pytest.approx(5e-10)
    tiny = standard([1, 1, 2 + 3e-9]).euler_inertia
    assert np.diag(tiny) == pytest.approx([1 + 1.5e-9, 1 + 1.5e-9, 0], abs=1e-15)
    with pytest.raises(ValueError, match="triangle"):
        standard([1, 1, 2 + 1e-8])


@pytest.mark.parametrize("asymmetry", [1e-13, 1e-11])
def test_symmetry_is_asked_to_1e_12(asymmetry):
    J = PAPER_J.copy()
    J[0, 1] += 5 * asymmetry
    if asymmetry < 1e-12:
        assert np.array_equal(standard(J).euler_inertia, standard(J).euler_inertia.T)
    else:
        with pytest.raises(ValueError, match="not symmetric"):
            standard(J)


def test_a_nearly_principal_direction_is_made_principal():
    J = PAPER_J.copy()
    J[0, 2] = J[2, 0] = 1e-10
    assert nontwisting(J).euler_inertia[0, 2] == 0


def test_suslov_normalises_its_axis():
    assert suslov(PAPER_J, [0, 3, 4]).axis == pytest.approx([0, 0.6, 0.8], abs=1e-16)


def test_a_system_is_frozen():
    body = standard(PAPER_J)
    with pytest.raises(AttributeError):
        body.axis = None
    with pytest.raises(ValueError, match="read-only"):
        body.euler_inertia[0, 0] = 1


def test_gravity_adds_to_every_body():
    body = with_gravity(suslov(PAPER_J, [0, 0, 1]), 0.5, [0, 0.1, 0.2], (0, 0, -10))
    assert body.dead_force == pytest.approx(np.array([[0, 0, 0], [0, 0, -0.5], [0, 0, -1.0]]))
    assert body.axis is not None


def test_json_round_trip_is_exact():
    body = heavy_top(random_inertia(np.random.default_rng(3)), 0.01, [0.1, 0.2, 0.3])
    copy = DirectorSystem.from_json(body.to_json())
    assert np.array_equal(copy.euler_inertia, body.euler_inertia)
    assert np.array_equal(copy.dead_force, body.dead_force)
    assert copy.axis is None
    assert copy.name == body.name == json.loads(body.to_json())["name"]


@pytest.mark.parametrize("size", [1e-161, 1e-200, 1e90, 3.0])
def test_an_axis_of_any_length_becomes_a_unit_vector(size):
    assert suslov([2, 3, 4], np.array([0.36, 0.48, 0.8]) * size).axis == pytest.approx([0.36, 0.48, 0.8], rel=1e-15)


def test_a_body_is_short_to_show_and_has_its_inertia():
    body = with_gravity(nontwisting(PAPER_J), 2.0, [0, 0, 0.1])
    rows = "[(3, −0.1429, 0), (−0.1429, 4, 0), (0, 0, 5)] kg m²"
    assert repr(body) == f"<DirectorSystem 'nontwisting under gravity': inertia {rows}, axis (0, 0, 1), dead forces>"
    assert np.array_equal(body.inertia, body.convected_inertia)
    stack = DirectorSystem.stack([standard([3, 4, 5])] * 1000)
    assert repr(stack) == "<SystemStack 'standard': 1000 bodies, the first of inertia diag(3, 4, 5) kg m²>"
    assert np.array_equal(stack.inertia, stack.convected_inertia)


def test_axes_have_letters():
    assert np.array_equal(suslov([3, 4, 5], "-y").axis, [0, -1, 0])
    assert np.array_equal(inertia.of_cylinder(1, 2, 3, axis="x"), inertia.of_cylinder(1, 2, 3, axis=(1, 0, 0)))
    with pytest.raises(ValueError, match=r"^axis must be x, y or z, with a minus or without, or 3 numbers; got 'w'$"):
        suslov([3, 4, 5], "w")


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


def test_a_weight_at_the_fixed_point_is_told():
    with pytest.warns(UserWarning, match="gravity has no moment"):
        heavy_top([2, 2, 1], mass=1, centre_of_mass=(0, 0, 0))


def test_bodies_are_equal_by_their_numbers():
    body = nontwisting([1, 2, 3], spin=([0, 1], [2, 3]))
    same = [nontwisting([1, 2, 3], spin=([0, 1], [2, 3])), pickle.loads(pickle.dumps(body))]
    assert {body, *same} == {body}
    assert body != nontwisting([1, 2, 3], spin=([0, 1], [2, 3.5]))
    assert body != standard([1, 2, 3])

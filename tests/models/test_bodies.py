"""Bodies: their inertias, what is refused, JSON; inertias that no distribution of mass has, points on massless rods.

The motions are compared with Euler's equations, by SciPy.
"""

import json
import pickle
import warnings
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import nontwist as nt
from conftest import NONTWISTING, PAPER_J, STANDARD, random_inertia
from exact_reference import EYE, by_scipy
from nontwist.inertia import convected_inertia, euler_inertia, principal_frame
from nontwist.split_form import split_inertia
from refusals import refused_as

allclose = partial(np.allclose, rtol=0)


def test_euler_inertia():
    rng = np.random.default_rng(1)
    x, m = rng.normal(size=(50, 3)), rng.uniform(0.1, 1, 50)
    J = sum(mi * (xi @ xi * np.eye(3) - np.outer(xi, xi)) for mi, xi in zip(m, x, strict=True))
    assert euler_inertia(J) == pytest.approx((x.T * m) @ x, rel=1e-13, abs=1e-13)
    assert convected_inertia(euler_inertia(J)) == pytest.approx(J, rel=1e-15, abs=1e-14)
    assert euler_inertia(PAPER_J) == pytest.approx(np.array([[3, 1 / 7, 0], [1 / 7, 2, 0], [0, 0, 1]]), abs=1e-15)


test_refused_with_reason_and_number = refused_as(
    {
        "shape": lambda: nt.standard([[1, 2], [2, 1]]),
        "asymmetric": lambda: nt.standard([[3, 0.1, 0], [0.2, 4, 0], [0, 0, 5]]),
        "indefinite": lambda: nt.standard([1, 2, -1]),
        "rod of no thickness": lambda: nt.standard([1, 1, 0]),
        "rod with a spin": lambda: nt.nontwisting([1, 1, 0], spin=2.0),
        "D3": lambda: nt.nontwisting([[3, 0, 0.6], [0, 4, 0], [0.6, 0, 5]]),
        "split": lambda: split_inertia([[3, 0, 0.6], [0, 4, 0], [0.6, 0, 5]]),
        "axis zero": lambda: nt.suslov([1, 1, 1], [0, 0, 0]),
        "inertia of the centre of mass": lambda: nt.heavy_top([1, 1, 1], 5, [0, 0, 1]),
    }
)


def test_plates_and_rods():
    assert np.linalg.eigvalsh(nt.standard([1, 1, 2]).euler_inertia)[0] == 0
    assert np.linalg.eigvalsh(nt.standard([1, 1, 1e-9]).euler_inertia)[0] == pytest.approx(5e-10)
    tiny = nt.standard([1, 1, 2 + 3e-9]).euler_inertia
    assert np.diag(tiny) == pytest.approx([1 + 1.5e-9, 1 + 1.5e-9, 0], abs=1e-15)
    J = PAPER_J.copy()
    J[0, 1] += 5e-13
    assert np.array_equal(nt.standard(J).euler_inertia, nt.standard(J).euler_inertia.T)
    J = PAPER_J.copy()
    J[0, 2] = J[2, 0] = 1e-10  # nearly principal
    body = nt.nontwisting(J)
    assert body.euler_inertia[0, 2] == 0
    with pytest.raises(ValueError, match="read-only"):
        body.euler_inertia[0, 0] = 1
    with pytest.raises(AttributeError):
        body.axis = None


def test_gravity_adds_to_every_body():
    body = nt.with_gravity(nt.suslov(PAPER_J, [0, 0, 1]), 0.5, [0, 0.1, 0.2], (0, 0, -10))
    assert body.dead_force == pytest.approx(np.array([[0, 0, 0], [0, 0, -0.5], [0, 0, -1.0]]))
    assert body.axis is not None
    with pytest.warns(UserWarning, match="gravity has no moment"):
        nt.heavy_top([2, 2, 1], mass=1, centre_of_mass=(0, 0, 0))
    for tilt, length in ((0.98e-12, 1), (1.02e-12, 0)):  # of forces that have a direction in common, or have none
        forces = [(0, 0, 0), (0, 0, -3), (0, 3 * tilt, 2)]
        stack = nt.DirectorSystem.stack([nt.DirectorSystem(np.eye(3), dead_force=forces)])
        assert np.array_equal(stack.vertical, [[0, 0, -length]])


def test_equality_and_json():
    body = nt.heavy_top(random_inertia(np.random.default_rng(3)), 0.01, [0.1, 0.2, 0.3])
    copy = nt.DirectorSystem.from_json(body.to_json())
    assert np.array_equal(copy.euler_inertia, body.euler_inertia)
    assert np.array_equal(copy.dead_force, body.dead_force)
    assert copy.axis is None
    assert copy.name == body.name == json.loads(body.to_json())["name"]
    body = nt.nontwisting([1, 2, 3], spin=([0, 1], [2, 3]))
    same = [nt.nontwisting([1, 2, 3], spin=([0, 1], [2, 3])), pickle.loads(pickle.dumps(body))]
    assert {body, *same, nt.DirectorSystem.from_json(body.to_json())} == {body}
    assert nt.with_gravity(body, 1, (0.1, 0, 0)).spin.is_like(body.spin)
    assert "spin" not in NONTWISTING.to_json()
    assert body not in (nt.nontwisting([1, 2, 3], spin=([0, 1], [2, 3.5])), nt.standard([1, 2, 3]))


@pytest.mark.parametrize("size", [1e-200, 1e90, 3.0])
def test_axis_of_any_length(size):
    assert nt.suslov([2, 3, 4], np.array([0.36, 0.48, 0.8]) * size).axis == pytest.approx([0.36, 0.48, 0.8], rel=1e-15)


def test_repr():
    body = nt.with_gravity(nt.nontwisting(PAPER_J), 2.0, [0, 0, 0.1])
    rows = "[(3, −0.1429, 0), (−0.1429, 4, 0), (0, 0, 5)] kg m²"
    assert repr(body) == f"<DirectorSystem 'nontwisting under gravity': inertia {rows}, axis (0, 0, 1), dead forces>"
    assert np.array_equal(body.inertia, body.convected_inertia)
    stack = nt.DirectorSystem.stack([STANDARD] * 1000)
    assert repr(stack) == "<SystemStack 'standard': 1000 bodies, the first of inertia diag(3, 4, 5) kg m²>"
    assert np.array_equal(stack.inertia, stack.convected_inertia)
    assert len(repr(nt.DirectorSystem(np.eye(3), name="x" * 90)).partition(":")[0]) == len("<DirectorSystem ") + 80


def test_axes_have_letters():
    assert np.array_equal(nt.suslov([3, 4, 5], "-y").axis, [0, -1, 0])
    assert np.array_equal(nt.inertia.of_cylinder(1, 2, 3, axis="x"), nt.inertia.of_cylinder(1, 2, 3, axis=(1, 0, 0)))
    with pytest.raises(ValueError, match=r"^axis must be x, y or z, with a minus or without, or 3 numbers; got 'w'$"):
        nt.suslov([3, 4, 5], "w")


TILTED = [[1, 0, 0], [0, 0.8, -0.6], [0, 0.6, 0.8]]
HEAVY = nt.heavy_top([2, 1, 4.5], 0.3, (0.1, 0.2, 0.5), physical=False)


def reference(body, W, t_end, rotation=EYE):
    """Return Λ and W at the end."""
    q = np.transpose(rotation)
    directors, W, _ = by_scipy(body.inertia, W, lambda t, q, w: body.dead_force, t_end, q, body.axis)
    return directors.T, W


def test_momentum_of_hairer():
    """Π(100), printed by GeometricProblems.jl and by DOP853."""
    J, W = [2, 1, 2 / 3], [np.cos(1.1) / 2, 0, 1.5 * np.sin(1.1)]
    printed = [-0.17734831, -0.59041852, 0.78737129]
    assert allclose(nt.exact.free_standard(J, W, [100.0], physical=False)[1][0] * J, printed, atol=1e-8)
    run = nt.simulate(nt.standard(J, physical=False), t_end=100, material_angular_velocity=W)
    assert allclose(run.material_momentum.values[-1], printed, atol=1e-7)


@pytest.mark.filterwarnings("ignore:energy-momentum is unstable")
def test_indefinite_director_scheme():
    """E has an eigenvalue of -0.75: K + V and the vertical momentum stay, the lengths too, and the order is 2."""
    assert np.linalg.eigvalsh(HEAVY.euler_inertia)[0] == pytest.approx(-0.75)
    how = {"t_end": 2.0, "material_angular_velocity": (1, -2, 3), "integrator": "energy-momentum"}
    Lam, errors = reference(HEAVY, np.array([1.0, -2, 3]), 2.0)[0], []
    fine = nt.simulate(HEAVY, step=0.01, **how | {"integrator": "gauss"}, order=8).directors.values[-1].T
    assert allclose(fine, Lam, atol=1e-10)
    for step in (0.01, 0.005):
        run = nt.simulate(HEAVY, step=step, **how)
        energy = (run.kinetic_energy + run.potential_energy).values
        assert abs(energy / energy[0] - 1).max() < 1e-13
        assert np.ptp(run.spatial_momentum.values[:, 2]) < 1e-12
        q = run.directors.values
        assert abs(q @ q.swapaxes(1, 2) - np.eye(3)).max() < 1e-13
        errors.append(abs(q[-1].T - Lam).max())
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2, abs=0.05)


@pytest.mark.parametrize(("turning", "others"), [(0, (1, 2)), (1, (0, 2)), (2, (0, 1))])
def test_indefinite_director_velocities_grow(turning, others):
    """About a principal axis at the rate Ω √(-E_i E_j/(J_i J_j)), which is real but about the axis where E < 0."""
    J = np.array([5, 1.2, 0.7])
    i, j = others
    rate = np.sqrt(max(-np.prod((J.sum() / 2 - J)[[i, j]] / J[[i, j]]), 0.0))
    start = np.full(3, 1e-4)
    start[turning] = 1.0
    how = {"step": 0.005, "integrator": "energy-momentum", "material_angular_velocity": start}
    with pytest.warns(UserWarning, match="unstable where Euler's inertia is indefinite"):
        run = nt.simulate(nt.standard(J, physical=False), t_end=12, **how)
    V = run.director_velocities.values @ run.directors.values.swapaxes(1, 2)
    size = abs(V + V.swapaxes(1, 2)).max(axis=(1, 2))
    if rate:
        assert np.log(size[2400] / size[1600]) / 4 == pytest.approx(rate, rel=0.1)
    else:
        assert size[1600:].max() < 3 * size[:800].max()


def test_indefinite_director_scheme_warns():
    body, how = nt.standard([5, 1.2, 0.7], physical=False), {"integrator": "energy-momentum"}
    problem = nt.Problem(body, t_end=1, material_angular_velocity=(0.4, 1.1, -0.3), **how)
    for run in (nt.simulate, nt.simulate_ensemble):
        with pytest.warns(UserWarning, match="use gauss, lie-midpoint or split"):
            run(problem)
    with pytest.warns(UserWarning, match="use gauss, lie-midpoint or split"):
        nt.stepper(body, 0.01, **how)
    assert any("use gauss, lie-midpoint or split" in text for text in problem.forecast().warnings)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        nt.simulate(nt.standard([1, 2, 3]), t_end=1, step=0.01, **how)  # E is 0 about an axis


@pytest.mark.filterwarnings("ignore:energy-momentum is unstable")
@pytest.mark.parametrize(
    ("name", "body", "order"),
    [
        ("gauss", "flat", 8),
        ("lie-midpoint", "point", 2),
        ("energy-momentum", "flat", 2),
        ("split", "point", 4),
        ("continuous", "point", None),
    ],
)
def test_point_is_a_spherical_pendulum(name, body, order):
    """The rod turns by the rates of the plane alone; of the point the constraint exerts no moment at all."""
    rod = nt.nontwisting([1, 1, 0]) if body == "point" else nt.nontwisting([1, 2, 0], physical=False)
    body, W = nt.with_gravity(rod, 1, (0, 0, 1.0)), np.array([1.5, -0.7, 0])
    Lam, _ = reference(body, W, 1.0, TILTED)
    how = {"integrator": name, "step": 0.01 if order == 8 else 1e-3} | ({"order": order} if order else {})
    run = nt.simulate(body, t_end=1.0, rotation=TILTED, material_angular_velocity=W, **how)
    tolerance = 1e-5 if order == 2 else 1e-8
    assert allclose(run.directors.values[-1].T, Lam, atol=tolerance)
    if body.physical:
        x0, v0 = np.array(TILTED)[:, 2], np.cross(TILTED @ W, np.array(TILTED)[:, 2])

        def sphere(t, y):
            x, v, g = y[:3], y[3:], np.array([0, 0, -9.81])
            return np.append(v, g - (g @ x + v @ v) * x)

        end = solve_ivp(sphere, (0, 1), [*x0, *v0], method="DOP853", rtol=1e-13, atol=1e-14).y[:3, -1]
        assert allclose(run.directors.values[-1, 2], end, atol=tolerance)


@pytest.mark.filterwarnings("error")
def test_point_in_stepper():
    body, how = nt.with_gravity(nt.nontwisting([1, 1, 0]), 1, (0, 0, -1)), {"t_end": 1, "rotation": TILTED}
    fine = nt.simulate(body, step=1e-2, order=8, **how).directors.values[-1]
    for chosen in ({}, {"tolerance": 1e-9}):
        assert abs(nt.simulate(body, **how, **chosen).directors.values[-1] - fine).max() < 1e-7
    turn, like = np.array([[0.8, 0, 0.6], [0, 1, 0], [-0.6, 0, 0.8]]), nt.nontwisting([1, 1, 1])
    for body in (nt.nontwisting([1, 1, 0]), nt.nontwisting([1, 1, 3], physical=False)):
        found, other = (nt.least_effort(one, np.eye(3), turn, t_end=1.0) for one in (body, like))
        assert found.length == pytest.approx(other.length, rel=1e-8)


def test_held_bodies_without_axial_moment():
    times, W = [0.0, 1.0, 3.0], (0.3, 0.8, 0)
    point, sphere = (nt.exact.free_nontwisting(J, W, times)[0] for J in ([1, 1, 0], [1, 1, 1]))
    assert np.array_equal(point, sphere)
    run = nt.simulate(nt.nontwisting([1, 1, 0]), times=times, material_angular_velocity=W, integrator="exact")
    assert allclose(run.directors.values[-1].T, point[-1], atol=1e-14)
    J = nt.inertia.of_points([2.0], [(0, 0, 0.5)])
    assert allclose(J, np.diag([0.5, 0.5, 0]), atol=1e-15)
    assert nt.nontwisting(J).inertia[2, 2] == 0
    how = {"physical": False}
    T = nt.exact.momentum_period([1, 2, 6], (0.1, 2, 0.1), **how)
    again = nt.exact.free_standard([1, 2, 6], (0.1, 2, 0.1), [T], **how)[1]
    assert allclose(again, [[0.1, 2, 0.1]], atol=1e-12)


def test_physical_is_kept():
    body, ordinary = nt.standard([1, 2, 6], physical=False), STANDARD
    again = nt.DirectorSystem.from_json(body.to_json())
    assert not again.physical
    assert np.array_equal(again.euler_inertia, body.euler_inertia)
    assert "physical=False" in repr(replace(body, name="x"))
    assert "physical" not in ordinary.to_json()
    assert np.array_equal(nt.standard([3, 4, 5], physical=False).euler_inertia, ordinary.euler_inertia)
    assert allclose(principal_frame(body.inertia, physical=False)[0], [1, 2, 6])
    how = {"t_end": 1, "step": 0.1, "material_angular_velocity": (1, 2, 3)}
    runs = nt.simulate_ensemble(nt.DirectorSystem.stack([body, ordinary]), **how)
    alone, ahead, behind = (nt.simulate(nt.standard([1 + e, 2, 6], physical=False), **how) for e in (0, 1e-5, -1e-5))
    assert abs(runs.quaternion.values[0][-1] @ alone.quaternion.values[-1]) == pytest.approx(1, abs=1e-14)
    slope = nt.sensitivities(body, wrt=["inertia"], **how)
    change = (ahead.material_angular_velocity.values[-1] - behind.material_angular_velocity.values[-1]) / 2e-5
    assert allclose(slope.d_material_angular_velocity.values[-1][:, 0], change, atol=1e-8)


test_refused_by_name = refused_as(
    {
        "indefinite, held": lambda: nt.nontwisting([1, 2, -1], physical=False),
        "nothing across the axis": lambda: nt.nontwisting([0, 1, 1], physical=False),
        "another axis": lambda: nt.suslov([1, 1, 0], (1, 0, 1)),
    }
)

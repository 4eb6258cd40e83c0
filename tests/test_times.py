"""Output at any times: the order and the balances of the integrator, nodes that do not heed it, resampling."""

import re

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from conftest import cross
from nontwist import (
    DirectorSystem,
    body_moment,
    damping,
    exact,
    heavy_top,
    integrate,
    moment,
    nontwisting,
    pulse,
    resample,
    simulate,
    simulate_ensemble,
    sine,
    standard,
    suslov,
)
from nontwist.errors import SimulationError, SimulationInterrupt, Status
from nontwist.integrators import INTEGRATORS, Continuous, Gauss, Split
from nontwist.validation.compiled_steps import ReferenceEnergyMomentum
from refusals import says

TOP = heavy_top([[3, -1 / 7, 0], [-1 / 7, 4, 0], [0, 0, 5]], 2.0, (0.1, 0.2, 0.5))
R0, W0 = Rotation.from_rotvec([0.5, 0.1, 0]), (1.0, -2.0, 6.0)
START = {"rotation": R0, "material_angular_velocity": W0}
SPACE = sine((1, 0.3, -0.2), 0.7, frame="space")
RNG = np.random.default_rng(5)
TIMES = np.sort(RNG.uniform(0, 2, 40))
STEPPING = [name for name, scheme in INTEGRATORS.items() if not scheme.any_times]
ARRAYS = "quaternion", "material_angular_velocity", "multipliers", "moment", "load_work", "newton_iterations"


def reference(t):
    """Return the directors of the heavy top at times, by SciPy in quaternions."""
    J, f = TOP.convected_inertia, TOP.dead_force
    inverse = np.linalg.inv(J)

    def rates(t, y):
        p, W = y[:4] / np.linalg.norm(y[:4]), y[4:]
        q = Rotation.from_quat(p).as_matrix().T
        M = sum(cross(np.eye(3)[i], q @ f[i]) for i in range(3))
        v = np.array([*(p[3] * W + cross(p[:3], W)), -p[:3] @ W]) / 2
        return np.concatenate([v, inverse @ (cross(J @ W, W) + M)])

    y0 = np.concatenate([R0.as_quat(), W0])
    y = solve_ivp(rates, (0, 2), y0, "DOP853", t_eval=t, rtol=2.3e-14, atol=1e-14, max_step=0.01).y
    return Rotation.from_quat(y[:4].T).as_matrix().swapaxes(1, 2)


@pytest.mark.parametrize("name", STEPPING)
@pytest.mark.parametrize("body", [standard([3, 4, 5]), nontwisting([3, 4, 5])], ids=["standard", "nontwisting"])
def test_outputs_change_no_node_and_no_other_output(name, body):
    how = {"t_end": 2, "step": 0.05, "integrator": name, "material_angular_velocity": (1, -2, 0), "load": SPACE}
    run = integrate(body, **how)
    same = integrate(body, times=run.time, **how)
    for array in ARRAYS[:2]:
        assert np.array_equal(getattr(run, array), getattr(same, array)), array
    for array in ARRAYS[2:5]:
        size = max(1.0, abs(getattr(run, array)).max(initial=0.0))
        assert getattr(same, array) == pytest.approx(getattr(run, array), abs=3e-14 * size), array
    assert np.array_equal(same.newton_iterations, run.newton_iterations)
    many, few = (integrate(body, times=x, **how) for x in (TIMES, TIMES[::3]))
    assert np.array_equal(many.material_angular_velocity[::3], few.material_angular_velocity)
    assert np.array_equal(many.quaternion[::3], few.quaternion)


@pytest.mark.parametrize(("scheme", "order", "counts", "within"), [
    ("gauss", 2, (200, 400), None), ("gauss", 6, (30, 60), None), ("gauss", 8, (24, 36), None),
    ("gauss", 16, (7, 9), None), ("gauss", 4, (100, 200), 0.35), ("lie-midpoint", 2, (100, 200), 0.35),
    ("energy-momentum", 2, (100, 200), 0.35), ("split", 2, (100, 200), 0.35), ("split", 4, (100, 200), 0.35),
    pytest.param("gauss", 4, (60, 120), None, marks=pytest.mark.long),
])  # fmt: skip
def test_outputs_have_the_order_of_the_integrator(scheme, order, counts, within):
    truth, errors = reference(TIMES), []
    for n in counts:
        run = integrate(TOP, t_end=2, step=2 / n, times=TIMES, integrator=scheme, order=order, **START)
        errors.append(abs(run.directors - truth).max())
    found = np.log(errors[0] / errors[1]) / np.log(counts[1] / counts[0])
    assert found > order - 0.7
    assert within is None or found == pytest.approx(order, abs=within)


@pytest.mark.parametrize("order", [2, 8, 16])
def test_a_top_keeps_its_invariants_between_the_nodes(order):
    run = simulate(TOP, t_end=2, step=0.1, times=TIMES, integrator="gauss", order=order, **START)
    energy = run.kinetic_energy + run.potential_energy
    assert np.ptp(energy.values) < 2e-13 * abs(energy.values).max()
    assert np.ptp(run.spatial_momentum.sel(axis="z").values) < 2e-13 * abs(run.spatial_momentum.values).max()
    assert run.orthonormality_defect.max() < 2e-15


@pytest.mark.parametrize("name", ["gauss", "lie-midpoint", "split"])
def test_impulse_and_work_balance_between_any_outputs(name):
    run = simulate(
        standard([3, 4, 5]), t_end=2, step=0.1, times=TIMES, integrator=name, load=SPACE, material_angular_velocity=W0
    )
    impulse = np.diff(TIMES)[:, None] * run.moment.values
    gained = np.diff(run.spatial_momentum.values, axis=0)
    assert gained == pytest.approx(impulse, abs=5e-14)
    if name == "gauss":
        assert np.diff(run.kinetic_energy.values) == pytest.approx(run.load_work.values, abs=5e-13)
    assert run.midtime.values == pytest.approx((TIMES[1:] + TIMES[:-1]) / 2)


def test_the_reaction_of_a_suslov_body_balances_between_outputs():
    body = suslov([[3, 0.1, 0.2], [0.1, 4, 0.3], [0.2, 0.3, 5]], [1, 2, 3])
    how = {"material_angular_velocity": (2, -1, 0.5), "project": True, "integrator": "gauss", "step": 0.1}
    run = simulate(body, t_end=2, times=TIMES, **how)
    assert np.ptp(run.kinetic_energy.values) < 1e-13
    fine = simulate(body, t_end=2, times=TIMES, **{**how, "step": 0.02})
    assert run.reaction_moment.values == pytest.approx(fine.reaction_moment.values, abs=1e-7)


def test_no_output_crosses_a_kink():
    load, w = pulse((30, -20, 0), 0.313, 0.777), (0, 1, 0)
    x = np.sort(np.concatenate([[0.3129, 0.3131, 0.544, 0.546, 0.7769, 0.7771], TIMES]))
    run = integrate(nontwisting([3, 4, 5]), t_end=2, times=x, load=load, integrator="gauss", angular_velocity=w)
    fine = integrate(nontwisting([3, 4, 5]), times=x, load=load, integrator=Continuous(), angular_velocity=w)
    assert run.directors == pytest.approx(fine.directors, abs=1e-10)
    assert run.load_work == pytest.approx(fine.load_work, abs=1e-9)


def test_free_motion_after_the_load_is_reached_in_one():
    body, how = standard([3, 4, 5]), {"load": pulse((3, 2, 1), end=1), "integrator": Split(order=4), "step": 0.1}
    nodes = integrate(body, t_end=1000, **how, material_angular_velocity=W0)
    run = integrate(
        body, times=np.concatenate([nodes.time[5:31], [3.01, 700.03, 1000]]), **how, material_angular_velocity=W0
    )
    assert np.array_equal(run.material_angular_velocity[:26], nodes.material_angular_velocity[5:31])
    W = nodes.material_angular_velocity[10]
    truth, _ = exact.free_standard([3, 4, 5], W, [2.01, 699.03, 999], nodes.rotation[10].as_matrix())
    assert run.rotation[-3:].as_matrix() == pytest.approx(truth, abs=1e-11)


@pytest.mark.parametrize("name", ["gauss", "lie-midpoint", "split", "exact", "continuous"])
def test_a_member_is_a_run_with_outputs_as_well(name):
    W = RNG.normal(size=(3, 3))
    load = None if name == "exact" else SPACE
    own = {} if name in ("exact", "continuous") else {"t_end": 2, "step": 0.1}
    how = {"times": TIMES[::4], "load": load, "integrator": name, **own}
    many = simulate_ensemble(standard([3, 4, 5]), material_angular_velocity=W, **how)
    for i in range(3):
        run = simulate(standard([3, 4, 5]), material_angular_velocity=W[i], **how)
        for variable in ("quaternion", "material_angular_velocity"):
            assert np.array_equal(run[variable].values, many[variable].values[i]), variable


def test_integrators_in_python_have_outputs_too():
    how = {"t_end": 1, "step": 0.1, "material_angular_velocity": W0, "load": SPACE}
    x = np.array([0.05, 0.1, 0.37, 0.99])
    run = integrate(standard([3, 4, 5]), times=x, integrator=ReferenceEnergyMomentum(), **how)
    fast = integrate(standard([3, 4, 5]), times=x, integrator="energy-momentum", order=2, **how)
    for array in ("directors", "director_velocities", "multipliers", "moment", "load_work"):
        assert getattr(run, array) == pytest.approx(getattr(fast, array), abs=1e-11), array


def test_a_run_that_is_stopped_keeps_its_outputs():
    calls = []

    def stopping(t, d, w):
        calls.append(t)
        if t > 1.5:
            raise KeyboardInterrupt
        return 0.0, 0.0, 0.0

    body, how = standard([3, 4, 5]), {"step": 0.001, "integrator": "lie-midpoint", "order": 2}
    with pytest.warns(UserWarning, match="runs in Python"), pytest.raises(SimulationInterrupt) as info:
        integrate(body, t_end=2, times=TIMES, load=moment(stopping), material_angular_velocity=W0, **how)
    part = info.value.partial
    assert part.status == Status.INTERRUPTED
    full = integrate(body, t_end=2, times=TIMES, load=moment(lambda t, d, w: 0 * w, compiled=True), **START | how)
    n = len(part.time) - 1
    assert n == np.searchsorted(TIMES, part.time[-1])
    assert part.material_angular_velocity[:n] == pytest.approx(full.material_angular_velocity[:n], abs=1e-13)


def test_outputs_before_a_failure_are_kept():
    load = moment(lambda t, d, w: np.array([0.0, 0.0, np.where(t > 1.0, np.nan, 0.0)]), compiled=True)
    with pytest.raises(SimulationError, match=re.escape("step 10 at t = 1 s: the load")) as info:
        integrate(standard([3, 4, 5]), t_end=2, step=0.1, times=TIMES, load=load, integrator="gauss", **START)
    part = info.value.partial
    assert part.time.tolist() == TIMES[TIMES <= 1].tolist()
    assert len(part.moment) == len(part.time) - 1


def test_statistics_are_of_the_whole_run():
    how = {"t_end": 2, "step": 0.1, "integrator": "gauss", "reduce": "extrema", **START}
    run, few = simulate_ensemble(TOP, **how), simulate_ensemble(TOP, times=[0.3, 0.61], **how)
    assert few.kinetic_energy_max.equals(run.kinetic_energy_max)


def test_times_are_checked():
    body = standard([3, 4, 5])
    for how, message in (
        ({"times": [0, 1], "store": 2}, "with times= leave store= out"),
        ({"times": [0.5, 0.5]}, "times must increase, but times[1] = 0.5 follows times[0] = 0.5"),
        ({"times": [0.5, 3], "t_end": 2}, "times contains 3 s, outside of the run from 0 s to 2 s"),
        ({}, "give t_end= or times="),
    ):
        with pytest.raises(ValueError, match=re.escape(message)):
            simulate(body, **how)


@pytest.mark.parametrize("name", STEPPING)
def test_resampling_is_what_the_run_has_passed_through(name):
    how = {"t_end": 2, "step": 0.05, "integrator": name, "load": SPACE + damping(0.1), **START}
    asked = simulate(TOP, times=TIMES, **how)
    for store in (1, 7, "end"):
        got = resample(simulate(TOP, store=store, **how), TIMES)
        assert got.directors.values == pytest.approx(asked.directors.values, abs=2e-13)
        assert got.material_angular_velocity.values == pytest.approx(asked.material_angular_velocity.values, abs=2e-12)
    assert "moment" not in got
    assert got.attrs["resampled"] == "between stored states"


def test_resampling_needs_the_functions_of_a_load():
    load = body_moment(lambda t: (np.sin(t), 1.0, 0.0)) + SPACE
    run = simulate(standard([3, 4, 5]), t_end=1, step=0.1, load=load, integrator="gauss", material_angular_velocity=W0)
    with says():
        resample(run, [0.55])
    asked = simulate(run_system(run), t_end=1, step=0.1, times=[0.55], load=load, integrator="gauss", **W_ONLY)
    assert resample(run, [0.55], load).directors.values == pytest.approx(asked.directors.values, abs=1e-14)


W_ONLY = {"material_angular_velocity": W0}


def run_system(run):
    return DirectorSystem.from_json(run.attrs["system"])


def test_resampling_takes_times_in_any_order():
    run = simulate(TOP, t_end=2, step=0.1, integrator=Gauss(order=8), **START)
    x = np.array([0.73, 0.1, 1.99, 0.1, 2.0])
    got = resample(run, x)
    assert got.time.values.tolist() == x.tolist()
    assert np.array_equal(got.quaternion.values[1], got.quaternion.values[3])
    assert np.array_equal(got.directors.values[4], run.directors.values[-1])

"""Output at any times: the order and the balances of the integrator, nodes that do not heed it, resampling."""

from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from conftest import cross
from nontwist import (
    Load,
    body_moment,
    damping,
    heavy_top,
    integrate,
    moment,
    nontwisting,
    propagator,
    pulse,
    resample,
    simulate,
    simulate_ensemble,
    sine,
    standard,
    suslov,
)
from nontwist.errors import SimulationError, SimulationInterrupt, Status
from nontwist.integrators import INTEGRATORS, Continuous, stack_march
from nontwist.validation.compiled_steps import ReferenceEnergyMomentum
from refusals import refused_as, says

TOP = heavy_top([[3, -1 / 7, 0], [-1 / 7, 4, 0], [0, 0, 5]], 2.0, (0.1, 0.2, 0.5))
R0, W0 = Rotation.from_rotvec([0.5, 0.1, 0]), (1.0, -2.0, 6.0)
START = {"rotation": R0, "material_angular_velocity": W0}
SPACE = sine((1, 0.3, -0.2), 0.7, frame="space")
RNG = np.random.default_rng(5)
TIMES = np.sort(RNG.uniform(0, 2, 40))
STEPPING = [name for name, scheme in INTEGRATORS.items() if not scheme.any_times]
ARRAYS = "quaternion", "material_angular_velocity"


def top_rates(t, y):
    """The rates of the heavy top, quaternions and velocity."""
    J, f = TOP.convected_inertia, TOP.dead_force
    p, W = y[:4] / np.linalg.norm(y[:4]), y[4:]
    q = Rotation.from_quat(p).as_matrix().T
    M = sum(cross(np.eye(3)[i], q @ f[i]) for i in range(3))
    return [*(p[3] * W + cross(p[:3], W)) / 2, -p[:3] @ W / 2, *np.linalg.solve(J, cross(J @ W, W) + M)]


@cache
def reference():
    """Return the directors of the heavy top at the times, by SciPy in quaternions."""
    how = {"rtol": 2.3e-14, "atol": 1e-14, "max_step": 0.01}
    y = solve_ivp(top_rates, (0, 2), [*R0.as_quat(), *W0], "DOP853", t_eval=TIMES, **how).y
    return Rotation.from_quat(y[:4].T).as_matrix().swapaxes(1, 2)


@pytest.mark.parametrize("name", STEPPING)
def test_outputs_move_no_node(name):
    body = nontwisting([3, 4, 5])
    how = {"t_end": 2, "step": 0.05, "integrator": name, "material_angular_velocity": (1, -2, 0), "load": SPACE}
    run = integrate(body, **how)
    same, many, few = (integrate(body, times=x, **how) for x in (run.time, TIMES, TIMES[::3]))
    for array in ARRAYS:
        assert np.array_equal(getattr(run, array), getattr(same, array)), array
        assert np.array_equal(getattr(many, array)[::3], getattr(few, array)), array
    for array in ("multipliers", "moment", "load_work"):
        size = max(1.0, abs(getattr(run, array)).max(initial=0.0))
        assert getattr(same, array) == pytest.approx(getattr(run, array), abs=3e-14 * size), array
    assert np.array_equal(same.newton_iterations, run.newton_iterations)


ORDERS = [("gauss", 6, (30, 60), None), ("gauss", 16, (5, 6), None), ("lie-midpoint", 2, (100, 200), 0.35)]
ORDERS += [("energy-momentum", 2, (100, 200), 0.35), ("split", 2, (100, 200), 0.35), ("split", 4, (50, 100), 0.35)]


@pytest.mark.parametrize(("scheme", "order", "counts", "within"), ORDERS)
def test_order_of_outputs(scheme, order, counts, within):
    truth, errors = reference(), []
    for n in counts:
        run = integrate(TOP, t_end=2, step=2 / n, times=TIMES, integrator=scheme, order=order, **START)
        errors.append(abs(run.directors - truth).max())
    found = np.log(errors[0] / errors[1]) / np.log(counts[1] / counts[0])
    assert found > order - 0.7
    assert within is None or found == pytest.approx(order, abs=within)


@pytest.mark.parametrize("name", ["gauss", "split"])
def test_impulse_and_work_balance(name):
    how = {"integrator": name, "load": SPACE, "material_angular_velocity": W0}
    run = simulate(standard([3, 4, 5]), t_end=2, step=0.1, times=TIMES, **how)
    gained = np.diff(run.spatial_momentum.values, axis=0)
    assert gained == pytest.approx(np.diff(TIMES)[:, None] * run.moment.values, abs=5e-14)
    if name == "gauss":
        assert np.diff(run.kinetic_energy.values) == pytest.approx(run.load_work.values, abs=5e-13)
    assert run.midtime.values == pytest.approx((TIMES[1:] + TIMES[:-1]) / 2)


def test_suslov_reaction_balances():
    body = suslov([[3, 0.1, 0.2], [0.1, 4, 0.3], [0.2, 0.3, 5]], [1, 2, 3])
    how = {"times": TIMES, "material_angular_velocity": (2, -1, 0.5), "project": True, "integrator": "gauss"}
    run, fine = (simulate(body, t_end=2, step=step, **how) for step in (0.1, 0.02))
    assert np.ptp(run.kinetic_energy.values) < 1e-13
    assert run.reaction_moment.values == pytest.approx(fine.reaction_moment.values, abs=1e-7)


def test_no_output_crosses_a_kink():
    load, w = pulse((30, -20, 0), 0.313, 0.777), (0, 1, 0)
    x = np.sort(np.concatenate([[0.3129, 0.3131, 0.544, 0.546, 0.7769, 0.7771], TIMES]))
    run = integrate(nontwisting([3, 4, 5]), t_end=2, times=x, load=load, integrator="gauss", angular_velocity=w)
    fine = integrate(nontwisting([3, 4, 5]), times=x, load=load, integrator=Continuous(), angular_velocity=w)
    assert run.directors == pytest.approx(fine.directors, abs=1e-10)
    assert run.load_work == pytest.approx(fine.load_work, abs=1e-9)


@pytest.mark.parametrize("name", ["gauss", "lie-midpoint", "split", "exact", "continuous"])
def test_members_and_prepared_runs(name):
    load, scale, W = SPACE, (1.0, 0.5, -2.0), RNG.normal(size=(3, 3))
    how = {"times": TIMES[::4], "integrator": name}
    how |= {} if name in ("exact", "continuous") else {"t_end": 2, "step": 0.05}
    if name == "exact":
        load, scale = Load(), (1, 1, 1)
    many = simulate_ensemble(standard([3, 4, 5]), material_angular_velocity=W, load=load, load_scale=scale, **how)
    call = propagator(standard([3, 4, 5]), load=load, **how)
    for i, c in enumerate(scale):
        run = integrate(standard([3, 4, 5]), material_angular_velocity=W[i], load=c * load, **how)
        again = call(material_angular_velocity=W[i], load_scale=c)
        for array in ("quaternion", "material_angular_velocity"):
            assert np.array_equal(getattr(run, array), many[array].values[i]), array
        for array in (*ARRAYS, "moment", "load_work"):
            assert np.array_equal(getattr(run, array), getattr(again, array)), array


def test_python_integrators():
    """Also over steps of three sizes, from a start that is not 0, and in means over several steps."""
    load = SPACE + pulse((3, 2, 1), 0.71, 1.2)
    how = {"t_start": 0.5, "t_end": 1.5, "material_angular_velocity": (1, -2, 0), "load": load}
    for outputs in ({"times": np.array([0.55, 0.6, 0.87, 1.49])}, {"store": 7}):
        run = integrate(standard([3, 4, 5]), integrator=ReferenceEnergyMomentum(), **outputs, **how)
        fast = integrate(standard([3, 4, 5]), integrator="energy-momentum", order=2, **outputs, **how)
        for array in ("directors", "director_velocities", "multipliers", "moment", "load_work", "time"):
            assert getattr(run, array) == pytest.approx(getattr(fast, array), abs=1e-11), array


@pytest.mark.parametrize(("error", "kind"), [(KeyboardInterrupt, SimulationInterrupt), (ValueError, SimulationError)])
def test_stopped_run_keeps_outputs(error, kind, monkeypatch):
    """One that is stopped at an output, here at the beginning of the last ten steps, has it once."""

    def ending(t, d, w):
        if t > stop:
            raise error
        return 0.0, 0.0, t

    monkeypatch.setattr(stack_march, "CALLED_NODES", 10)
    times, stop = np.sort([*TIMES, 1.4]), np.inf
    how = {"step": 0.02, "integrator": "lie-midpoint", "t_end": 2, "times": times, "load": moment(ending), **START}
    full, stop = integrate(standard([3, 4, 5]), **how), 1.5
    with pytest.warns(UserWarning, match="runs in Python"), pytest.raises(kind) as info:
        integrate(standard([3, 4, 5]), **how)
    part, n = info.value.partial, len(info.value.partial.time)
    assert n > 20
    assert (part.status == Status.INTERRUPTED) == (kind is SimulationInterrupt)
    assert (part.time[-1] == 1.4) == (kind is SimulationInterrupt)
    assert part.time.tolist() == times[:n].tolist()
    assert np.array_equal(part.quaternion, full.quaternion[:n])
    assert np.array_equal(part.material_angular_velocity, full.material_angular_velocity[:n])
    assert part.moment == pytest.approx(full.moment[: n - 1], abs=1e-14)


def test_python_step_is_stopped():
    def striking(t, d, w):
        if 0.105 < t < 0.115:  # seen from the step from 0.1 to 0.12 alone
            raise KeyboardInterrupt
        return 0.0, 0.0, 0.0

    how = {"t_end": 0.3, "step": 0.1, "times": [0.05, 0.1, 0.12, 0.25], "integrator": ReferenceEnergyMomentum()}
    with pytest.raises(SimulationInterrupt, match="after 1 of 3 steps") as info:
        integrate(standard([3, 4, 5]), load=moment(striking), **how)
    assert info.value.partial.time.tolist() == [0.05, 0.1]


def test_statistics_of_the_whole_run():
    how = {"t_end": 2, "step": 0.1, "integrator": "gauss", "reduce": "extrema", **START}
    run, few = simulate_ensemble(TOP, **how), simulate_ensemble(TOP, times=[0.3, 0.61], **how)
    assert few.kinetic_energy_max.equals(run.kinetic_energy_max)


test_times_are_checked = refused_as(
    [
        lambda how=how: simulate(TOP, **how)
        for how in ({"times": [0, 1], "store": 2}, {"times": [0.5, 0.5]}, {"times": [0.5, 3], "t_end": 2}, {})
    ]
)


@pytest.mark.parametrize(("name", "step"), [("gauss", 0.05), ("split", 0.05), ("lie-midpoint", None)])
def test_resampling(name, step):
    """At times in any order, also where steps of different lengths lie between two stored states."""
    load = SPACE + damping(0.1) + pulse((5, 0, 2), 0.35, 0.45)
    how = {"t_end": 2, "step": step, "integrator": name, "load": load, **START}
    asked, order = simulate(TOP, times=TIMES, **how), [*range(len(TIMES))[::-1], 3]
    for store in (1, 7):
        got = resample(simulate(TOP, store=store, **how), TIMES[order])
        assert got.time.values.tolist() == TIMES[order].tolist()
        assert got.directors.values == pytest.approx(asked.directors.values[order], abs=2e-13)
        velocity = asked.material_angular_velocity.values[order]
        assert got.material_angular_velocity.values == pytest.approx(velocity, abs=2e-12)
        assert np.array_equal(got.quaternion.values[-1], got.quaternion.values[-5])
    assert "moment" not in got
    assert got.attrs["resampled"] == "between stored states"


def test_resampling_needs_functions():
    load = body_moment(lambda t: (np.sin(t), 1.0, 0.0)) + SPACE
    how = {"t_end": 1, "step": 0.1, "load": load, "integrator": "gauss", "material_angular_velocity": W0}
    run, asked = simulate(standard([3, 4, 5]), **how), simulate(standard([3, 4, 5]), times=[0.55], **how)
    with says():
        resample(run, [0.55])
    assert resample(run, [0.55], load).directors.values == pytest.approx(asked.directors.values, abs=1e-14)

"""The time grid in segments: kinks of a load are nodes, steps are equal between them, states are carried over."""

import json
from dataclasses import replace

import numpy as np
import pytest

import nontwist as nt
from conftest import thinned
from nontwist.driver.grid import kinks, segments_of
from nontwist.driver.planning import planned
from nontwist.driver.single_run import integrated
from nontwist.driver.starts import starts
from nontwist.errors import SimulationInterrupt
from nontwist.integrators import INTEGRATORS, stack_march
from nontwist.integrators.ivp import segmented
from refusals import says

BODY = nt.standard([[3.1, 0.2, -0.3], [0.2, 4.2, 0.1], [-0.3, 0.1, 5.5]])
W = {"material_angular_velocity": (1.3, -0.7, 2.1)}
KINKS = (0.1234, 0.4567, 0.7777)
LOAD = (
    nt.body_moment([*KINKS, 1.3], [[3, 1, 0.5], [-1, 2, 0], [0, 4, 1], [0, 0, 0]])
    + nt.pulse((2, 0, 1), start=0.3, end=1.0 / 3, shape="rectangle", frame="space")
    + nt.damping(0.1)
)
STEPPING = ["lie-midpoint", "energy-momentum", "split", "gauss"]


def bits(run):
    return [run.time, run.quaternion, run.material_angular_velocity, run.multipliers, run.moment, run.load_work]


def assert_same(first, second, since=0):
    for k, (a, b) in enumerate(zip(bits(first), bits(second), strict=True)):
        assert np.array_equal(a[since:] if k < 6 else a, b), k


@pytest.mark.parametrize("name", INTEGRATORS)
def test_kinks_are_nodes(name):
    body, load = (nt.nontwisting([3, 4, 5]), 2 * nt.pulse((1, 0, 0), 0.1, 1.7)) if name == "exact" else (BODY, LOAD)
    how = {"tolerance": 1e-8} if name == "gauss" else {}  # then steps are stored
    run = nt.integrate(body, t_end=2, material_angular_velocity=(1, 0, 0), load=load, integrator=name, **how)
    assert set(load.breakpoints) <= set(run.time.tolist())
    assert (run.time[0], run.time[-1]) == (0, 2)
    sizes = np.concatenate([np.diff(run.time[a : b + 1]) for a, b in zip(*ends(run), strict=True)])
    assert len(sizes) == run.segments.steps
    for a, b in zip(*ends(run), strict=True):
        assert np.ptp(np.diff(run.time[a : b + 1])) <= 1e-15
    assert run.step == max(run.segments.sizes)


def ends(run):
    return run.segments.numbers[:-1], run.segments.numbers[1:]


def started(name, order, store, velocities=((1.3, -0.7, 2.1),)):
    """A plan, starts, and a grid of segments."""
    plan = planned(BODY, LOAD, name, order, 0, 2, None, None, store)
    begin = starts(BODY, material_angular_velocity=(1, 1, 1))
    velocities = np.array(velocities)
    begin = begin._replace(velocity=velocities, quaternion=np.repeat(begin.quaternion, len(velocities), axis=0))
    return plan, begin, segments_of(LOAD, 0, 2, 0.05)


def test_jumps_cost_no_order():
    """A rectangle at times that no equal steps meet; order 4 at half the step is 16 times nearer to the truth."""
    scheme = INTEGRATORS["continuous"](rtol=1e-12, atol=1e-14)
    truth = nt.integrate(BODY, times=[2.0], integrator=scheme, load=LOAD, **W).directors[-1]
    plan, begin, _ = started("gauss", 4, "end")
    runs = [integrated(plan, begin, segments_of(LOAD, 0, 2, h)) for h in (0.04, 0.02)]
    errors = [abs(run.directors[-1] - truth).max() for run in runs]
    assert errors[0] / errors[1] == pytest.approx(16, rel=0.2)
    with pytest.warns(UserWarning, match="off the grid of step"):
        equal = nt.integrate(BODY, t_end=2, step=0.02, load=LOAD, store="end", integrator="gauss", order=4, **W)
    assert abs(equal.directors[-1] - truth).max() > 100 * errors[1]


@pytest.mark.parametrize("name", STEPPING)
def test_member_equals_run(name):
    plan, many, grid = started(name, 2 if name == "gauss" else None, 7, np.random.default_rng(0).normal(size=(11, 3)))
    for threads in (1, 3):
        outcome = plan.scheme.march(replace(plan.problem(many, grid), intervals=True), threads)
        for i in range(11):
            one = many._replace(velocity=many.velocity[i : i + 1], quaternion=many.quaternion[:1])
            run = integrated(plan, one, grid)
            assert np.array_equal(outcome.states.quaternion[i], run.quaternion)
            assert np.array_equal(outcome.states.velocity[i], run.material_angular_velocity)
            assert np.array_equal(outcome.intervals.moment[i], run.moment)
            assert np.array_equal(outcome.intervals.load_work[i], run.load_work)


@pytest.mark.parametrize("name", STEPPING)
def test_means_are_weighted_by_time(name):
    """The impulse of the mean moments is the change of momentum, over intervals with steps of several sizes."""
    how, means = {"t_end": 2, "load": LOAD, "integrator": name, **W}, []
    for store in (1, 10, "end"):
        run = nt.simulate(BODY, store=store, **how)
        impulse = run.moment.values * np.diff(run.time.values)[:, None]
        assert np.allclose(impulse, np.diff(run.spatial_momentum.values, axis=0), rtol=0, atol=2e-13)
        assert run.load_work.values == pytest.approx(np.diff(run.kinetic_energy.values), abs=2e-13)
        means.append(np.trapezoid(run.kinetic_energy, run.time) / 2)
    many = nt.simulate_ensemble(BODY, store=10, reduce=["drift", "averages"], **how)
    assert float(many.energy_drift.max()) <= 1e-13
    assert many.kinetic_energy_mean.item() == pytest.approx(means[0], rel=2e-3)


@pytest.mark.parametrize("name", STEPPING)
def test_propagator_grids(name):
    how = {"t_end": 2, "load": LOAD, "integrator": name, "store": "end" if name == "gauss" else 4}
    run = nt.propagator(BODY, **how)
    for speed in (1.0, 3.0, 3.0):
        start = {"material_angular_velocity": (0, speed, 0.1)}
        assert_same(run(**start), nt.integrate(BODY, **how, **start))


@pytest.mark.parametrize(("after", "name"), thinned(3, [2, 3, 4], STEPPING))
def test_interrupted_grid(name, after, monkeypatch, tmp_path):
    """Stopped inside a segment and at the end of one, with the step left open; from a file to round-off."""
    how = {"t_end": 2, "load": LOAD, "integrator": name, "order": 2}
    whole, sound, calls = nt.integrate(BODY, **W, **how), stack_march.StackMarch._run, []
    numbers = whole.segments.numbers

    def struck(*arguments):
        calls.append(1)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return sound(*arguments)

    stop = numbers[after] - (after == 3)
    monkeypatch.setattr(stack_march, "NODES", stop)
    monkeypatch.setattr("nontwist.integrators.marched_stacks.KEPT_NODES", 0)
    monkeypatch.setattr(stack_march.StackMarch, "_run", struck)
    with pytest.raises(SimulationInterrupt) as info:
        nt.integrate(BODY, store=7, **W, **how)
    monkeypatch.undo()
    partial = info.value.partial
    assert partial.time[-1] == whole.time[stop]
    rest = nt.integrate(BODY, start=partial, **how)
    assert_same(whole, rest, stop)
    nt.save_run(partial.to_dataset(), tmp_path / "part.nc")
    again = nt.integrate(BODY, start=nt.open_run(tmp_path / "part.nc"), **how)
    assert np.array_equal(again.time, rest.time)
    assert np.allclose(again.material_angular_velocity, rest.material_angular_velocity, rtol=0, atol=1e-14)
    other = nt.integrate(BODY, start=partial, **how | {"load": LOAD + nt.pulse((1, 0, 0), 1.5, 1.6), "t_end": 3})
    assert {1.5, 1.6, 3.0} <= set(other.time.tolist())


def test_given_step_is_constant():
    with says(UserWarning):
        run = nt.integrate(BODY, t_end=2, step=0.1, load=LOAD, **W)
    assert run.segments == segmented((0.0, 2.0), (20,))
    assert "segments" not in run.record()


def test_the_record_tells_the_segments():
    run = nt.simulate(BODY, t_end=2, load=LOAD, tolerance=1e-8, **W)
    record = json.loads(run.attrs["segments"])
    assert set(LOAD.breakpoints) <= set(record["borders"])
    assert run.time.values[record["numbers"]].tolist() == record["borders"]
    for damaged in ("{", '{"borders": [0, 1], "numbers": [0]}', '{"borders": [1, 0], "numbers": [0, 3]}'):
        with pytest.raises(ValueError, match=r"the attribute segments of start= is damaged"):
            nt.simulate(BODY, t_end=3, start=run.assign_attrs(segments=damaged))


def test_indistinguishable_kinks():
    near = 1 + 4 * np.spacing(1.0)
    load = nt.body_moment(lambda t: (t, 0, 0), breakpoints=[0.0, 1e-16, 0.5, 1.0, near, 2 - 1e-15, 2.0, 5.0])
    assert kinks(load, 0.0, 2.0).tolist() == [0.5, 1.0]
    run = nt.integrate(BODY, t_end=2, load=load)
    assert (np.diff(run.time) > 0).all()


def test_short_pulse():
    load = nt.pulse((1, 0, 0), 50, 50.001, shape="half-sine")
    grid = segments_of(load, 0.0, 100.0, 1.0)
    assert (grid.numbers, grid.longest) == ((0, 50, 70, 120), 1.0)
    assert segments_of(load + nt.sine((1, 0, 0), 0.5), 0.0, 100.0, 1.0).numbers == (0, 500, 520, 1020)
    assert segments_of(load, 0.0, 100.0, 2.0, even=True, higher=5).numbers == (0, 26, 30, 56)

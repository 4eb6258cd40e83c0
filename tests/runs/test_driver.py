import json
import pickle
import warnings
from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import nontwist as nt
from conftest import PAPER_J, STANDARD
from nontwist.driver.grid import count_steps, free_memory
from nontwist.errors import InputError, Option, SimulationError, Status
from refusals import refused_as, says

W = {"material_angular_velocity": [1, 2, 0]}


def paper(**arguments):
    return nt.simulate(nt.nontwisting(PAPER_J), **{"t_end": 0.1, "step": 0.01, **W, **arguments})


def twisting():
    return nt.simulate(nt.standard(PAPER_J), t_end=0.1, step=0.01, angular_velocity=[0, 0, 1])


STARTS = {
    "stretched": {"rotation": np.diag([1, 1, 1 + 1e-6])},
    "left": {"rotation": np.diag([1, 1, -1])},
    "not finite": {"rotation": np.full((3, 3), np.nan)},
    "shape": {"rotation": [1, 2, 3]},
    "quaternion": {"rotation": [1, 0, 0, 0]},
    "quaternion length": {"rotation": [2, 0, 0, 0], "scalar_first": True},
    "velocity shape": {"material_angular_velocity": [1, 2]},
    "velocity twice": {"angular_velocity": [1, 0, 0]},
    "spin": {"material_angular_velocity": [1, 2, 0.5]},
}
TIMES = {"negative": {"step": -0.1}, "long": {"step": 0.2}, "unfit": {"step": 0.03}, "t_end": {"t_end": -1}}
TIMES |= {"short": {"step": 1e-25, "store": "end"}, "nan": {"t_end": np.nan}}
TIMES |= {f"store {given}": {"store": given} for given in (0, [2])}
SCHEMES = {"euler": {"integrator": "euler"}, "odd": {"order": 5}}
SCHEMES |= {"too high": {"order": 6, "integrator": "energy-momentum"}}
SCHEMES |= {f"gone of {name}": {"order": 8, "integrator": name} for name in ("lie-midpoint", "split")}
FAST = {"t_end": 1e9, "angular_velocity": [1, 0, 0], "integrator": "lie-midpoint"}
test_refused_with_the_value = refused_as(
    {name: lambda given=given: paper(**given) for name, given in (STARTS | TIMES | SCHEMES).items()}
    | {
        "load": lambda: paper(order=2, load=nt.space_moment(lambda t: (np.inf, 0, 0))),
        "start twice": lambda: paper(start=paper(), rotation=np.eye(3)),
        "start velocity": lambda: paper(start=paper()),
        "start of entries": lambda: nt.simulate(nt.standard(PAPER_J), t_end=1, start={"angular_velocity": (1, 2, 3)}),
        "velocity in space": lambda: nt.simulate(
            nt.standard(PAPER_J), t_end=1, material_angular_velocity=paper().angular_velocity[-1]
        ),
        "class of an integrator": lambda: paper(integrator=nt.integrators.Gauss),
        "start that twists": lambda: nt.simulate(nt.nontwisting(PAPER_J), t_end=0.2, step=0.01, start=twisting()),
        "no step small enough": lambda: nt.simulate(nt.standard([1, 1, 1]), **FAST),
    }
)


@pytest.mark.parametrize("span", [1 / 3, 7e50])
def test_usable_step(span):
    with pytest.raises(ValueError, match="is too short") as info:
        count_steps(span, 1e-13 * span)
    assert count_steps(span, float(str(info.value).split()[-2])) == 10**11


@pytest.mark.parametrize(("store", "ends"), [(4, [0, 4, 8, 10]), ("end", [0, 10])])
def test_grid_and_intervals(store, ends):
    load = nt.pulse([3, -1, 2], 0.01, 0.09) + nt.space_moment([0, 0.1], [[1, 0, 0], [0, 0, 0]])
    full, some = paper(load=load), paper(load=load, store=store)
    assert np.array_equal(full.time, 0.1 * np.arange(11) / 10)
    assert np.array_equal(some.time, full.time[ends])
    assert np.array_equal(some.directors, full.directors[ends])
    for k, (a, b) in enumerate(pairwise(ends)):
        for name in ("moment", "multipliers", "reaction_moment"):
            assert some[name][k].values == pytest.approx(full[name][a:b].mean("midtime").values, rel=1e-13, abs=1e-14)
        assert float(some.load_work[k]) == pytest.approx(float(full.load_work[a:b].sum()), rel=1e-13)
        assert int(some.newton_iterations[k]) == int(full.newton_iterations[a:b].max())


R0 = Rotation.from_rotvec([0.3, -0.2, 0.9])


def test_a_start_takes_every_form():
    W0, run = np.array([1.0, 2, 0]), nt.simulate(nt.standard([1, 1, 1]), t_end=1, step=1, rotation=R0)
    first = paper(rotation=R0)
    for form in (
        {"rotation": R0.as_matrix()},
        {"rotation": R0.as_quat(), "scalar_first": False},
        {"rotation": R0.as_quat(scalar_first=True), "scalar_first": True},
        {"rotation": run.directors[0]},
        {"rotation": run.quaternion[0]},
        {"rotation": R0.as_matrix()[None]},
        {"rotation": nt.integrate(nt.standard([1, 1, 1]), t_end=1, step=1, rotation=R0)},
        {"rotation": R0, "material_angular_velocity": None, "angular_velocity": R0.apply(W0)},
    ):
        assert paper(**form).directors.values == pytest.approx(first.directors.values, abs=1e-14)
    assert first.directors[0].values == pytest.approx(R0.as_matrix().T, abs=1e-15)


MANY = Rotation.from_rotvec([[0.0, 0, 0.1], [0, 0, 0.2]])


@pytest.mark.parametrize("several", [MANY, MANY.as_matrix(), MANY.as_quat().tolist()])
def test_several_attitudes(several):
    """But for `start=`, which takes a motion."""
    body, how = nt.standard([3, 4, 5]), {"t_end": 1, "rotation": several, "scalar_first": False}
    for call in (
        lambda: nt.simulate(body, **how),
        lambda: nt.integrate(nt.Problem(body, **how)),
        lambda: nt.sensitivities(body, wrt="inertia", **how),
        lambda: nt.lyapunov(body, **how),
        lambda: nt.propagator(body, t_end=1, step=0.1)(rotation=several, scalar_first=False),
        lambda: nt.stepper(body, 0.1).reset(rotation=several, scalar_first=False),
    ):
        with pytest.raises(ValueError, match=r"^rotation must be one attitude, got 2: rotation=Q\[0\] is the first"):
            call()
    for call in (nt.steer, lambda *a, **k: nt.least_effort(nt.nontwisting([3, 4, 5]), *a, t_end=1, **k)):
        with pytest.raises(ValueError, match=r"^target must be one attitude, got 2"):
            call(R0, several, scalar_first=False)
    many = nt.simulate_ensemble(body, **how)
    with pytest.raises(ValueError, match=r"^rotation must be one attitude"):
        nt.simulate(body, t_end=1, rotation=many.quaternion.isel(time=-1))
    began = nt.integrate(body, t_end=1, start=several, scalar_first=False).quaternion[0]
    np.testing.assert_allclose(began, MANY[1].as_quat(), atol=1e-15)


def test_project_removes_the_spin_only():
    how = {"material_angular_velocity": [1, 2, 0.5], "project": True}
    assert paper(**how).material_angular_velocity[0].values == pytest.approx([1, 2, 0], abs=1e-15)


@pytest.mark.parametrize("size", [1.0, 1e-90])
def test_velocity_along_constrained_axis(size):
    body = nt.suslov([2, 2, 2], [1, 1, 0])
    how = {"t_end": 1 / size, "step": 0.5 / size, "integrator": "lie-midpoint", "project": True}
    along, across = (
        nt.integrate(body, material_angular_velocity=[size, size * (1 + more), 0], **how).states.velocity
        for more in (0, 1e-12)
    )
    assert not along.any()
    assert across[:, :2].all()


def test_partial_states():
    def fails(t, d, w):
        return [0, 0, 1 / int(t < 0.5)]

    with pytest.raises(SimulationError, match=r"the load fails raised ZeroDivisionError at t = 0\.55 s") as info:
        nt.simulate(nt.standard([1, 1, 1]), t_end=1, step=0.1, load=nt.moment(fails), order=2)
    for error in (info.value, pickle.loads(pickle.dumps(info.value))):
        assert (error.status, error.time) == (Status.LOAD, pytest.approx(0.5))
        assert error.partial.time == pytest.approx([0, 0.1, 0.2, 0.3, 0.4, 0.5])
        assert error.partial.status == Status.LOAD
        assert error.partial.to_dataset().attrs["message"] == str(error) == str(info.value)


def test_input_error_is_pickled():
    error = InputError("type", "run.toml", name=Option("rate"), words="a number", value="'x'")
    again = pickle.loads(pickle.dumps(error))
    assert (again.code, again.within, again.fields, again.args) == (error.code, error.within, error.fields, error.args)


def test_steps_follow_reached_speed():
    """By 2 % more than it takes: of 100 steps at first the last is too far to be taken."""
    load = nt.moment(lambda t, d, w: (0.0, 0.0, 5 * 390.1), compiled=True)
    run = nt.integrate(STANDARD, t_end=1, load=load, integrator="lie-midpoint")
    assert len(run.time) - 1 == np.ceil(1.02 * 390.1 / 0.05)


def test_steps_follow_the_load():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        run = nt.simulate(nt.standard([1, 1, 1]), t_end=1, load=nt.pulse([1, 0, 0], 0.1, 0.12))
    acts = run.time.values[(run.time.values >= 0.1) & (run.time.values <= 0.12)]
    assert np.diff(acts).max() <= 0.001 + 1e-15
    assert {0.1, 0.11, 0.12} <= set(acts.tolist())
    assert float(run.spatial_momentum[-1, 0]) == pytest.approx(0.01, rel=1e-4)


def test_breakpoints_warn_once():
    for load in (nt.pulse([1, 0, 0], 0, 0.05), nt.body_moment([0, 0.05], [[1, 0, 0], [1, 0, 0]])):
        with says(UserWarning) as seen:
            paper(load=load)
        assert [one.filename for one in seen] == [__file__]


def test_run_beyond_memory(monkeypatch):
    monkeypatch.setattr("nontwist.driver.grid.free_memory", lambda: 1_000_000)
    monkeypatch.setattr("nontwist.driver.grid.SMALL", 0)
    with says():
        paper(step=1e-5)
    assert paper(step=1e-4, store=10).sizes["time"] == 101
    monkeypatch.undo()
    assert 1e8 < free_memory() < 1e15
    with pytest.raises(ValueError, match=r"1e\+11 stored states need 8e\+04 GB"):
        nt.simulate(nt.standard([1, 1, 1]), t_end=1e3, step=1e-8)


def test_gauss_is_the_default():
    body, how = nt.standard([1, 2, 2.5]), {"t_end": 1, "step": 0.1}
    runs = nt.simulate(body, **how), nt.integrate(body, **how).to_dataset(), nt.simulate_ensemble(body, **how)
    for run in (*runs, nt.propagator(body, **how)().to_dataset()):
        assert json.loads(run.attrs["integrator"]) == {"name": "gauss", "order": 8}


def test_code_without_module_name():
    """As functions of a script that IPython's %run has left behind."""
    exec("def go(simulate, *a, **k):\n    return simulate(*a, **k)", nameless := {})
    load = nt.moment(lambda t, d, w: -0.1 * w)
    with pytest.warns(UserWarning, match="runs in Python"):
        nameless["go"](nt.simulate, nt.standard([2, 3, 4]), t_end=0.1, step=0.05, load=load)


@pytest.mark.parametrize("integrator", ["energy-momentum", "lie-midpoint"])
def test_turn_without_a_digit(integrator):
    """The equations of a step have a root at which the velocity reverses; here it is below the last digit of W."""
    attitude = Rotation.from_rotvec([1, 2, 2.5])
    load = nt.sine([-1.56e75, -2.6e37, 0], 1.0, frame="space")
    how = {"t_end": 1, "step": 0.05, "order": 2, "rotation": attitude, "material_angular_velocity": (0, 0, 2.2e73)}
    with pytest.raises(SimulationError, match=r"^step 0 at t = 0 s: the body turns 1\.1e\+72 rad in one step"):
        nt.simulate(nt.standard([0.97, 8.36, 7.39]), load=load, integrator=integrator, **how)

"""A problem is one description: functions take it or its keywords, files hold it, and what does not fit is refused."""

import copy
import dataclasses
import pickle
import re
from dataclasses import FrozenInstanceError

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import nontwist as nt
from nontwist import Problem
from nontwist.integrators import Continuous, LieMidpoint

BODY = nt.standard([3, 4, 5])
START = {"material_angular_velocity": (0.1, 2, 0.3), "rotation": Rotation.from_rotvec([0.3, -0.2, 0.5])}
PROBLEM = Problem(BODY, t_end=1, step=0.1, load=nt.sine((0, 0, 1), frequency=0.5), **START)
LAST = np.array([[0.0, 0, 0], [0, 1, 0]])
COMPARED = {"integrators": ["lie-midpoint"], "repeats": 1}

# Each function with a problem, and with its keywords.
CALLS = {
    "simulate": lambda *a, **k: nt.simulate(*a, **k).directors,
    "integrate": lambda *a, **k: nt.integrate(*a, **k).quaternion,
    "sensitivities": lambda *a, **k: nt.sensitivities(*a, wrt="inertia", **k).d_rotation,
    "gradient": lambda *a, **k: nt.gradient(*a, wrt="inertia", store="end", d_rotation=LAST, **k).gradient,
    "lyapunov": lambda *a, **k: nt.lyapunov(*a, **k).lyapunov_exponent,
    "lyapunov_ensemble": lambda *a, **k: nt.lyapunov_ensemble(*a, **k).lyapunov_exponent,
    "compare": lambda *a, step=0.1, **k: nt.compare(*a, **COMPARED, steps=[step], **k).attitude_error,
    "simulate_ensemble": lambda *a, **k: nt.simulate_ensemble(*a, **k).quaternion,
}


@pytest.mark.parametrize("name", CALLS)
def test_problem_equals_keywords(name):
    whole, apart = CALLS[name](PROBLEM), CALLS[name](BODY, **PROBLEM.given)
    assert np.array_equal(whole, apart)
    assert not np.array_equal(whole, CALLS[name](PROBLEM, load=nt.sine((0, 0, 2), frequency=0.5)))


def test_starts_of_calls_win():
    run = nt.propagator(PROBLEM)
    assert np.array_equal(run(**START).quaternion[-1], nt.integrate(PROBLEM).quaternion[-1])
    loop = nt.stepper(PROBLEM.replace(load=None, integrator="lie-midpoint", order=2))
    for _ in range(10):
        state = loop.step()
    expected = nt.integrate(PROBLEM, load=None, integrator="lie-midpoint").quaternion[-1]
    np.testing.assert_allclose(state.quaternion, expected, atol=1e-14)


@pytest.mark.parametrize("change", [{"times": [0.5, 1.0]}, {"events": nt.spin_below(0.1)}, {"load_scale": 2.0}])
def test_unexpected_keyword(change):
    (name,), problem = change, PROBLEM.replace(**change)
    with pytest.raises(ValueError, match=f"lyapunov does not take {name}"):
        nt.lyapunov(problem)
    nt.lyapunov(problem.replace(**{name: None}))
    nt.lyapunov(problem, **{name: None})


def test_missing_in_a_run(tmp_path):
    stepped, scaled = PROBLEM.replace(events=nt.spin_below(0.1)), PROBLEM.replace(load_scale=2.0)
    for call, words in (
        (lambda: nt.stepper(stepped), "stepper does not take events"),
        (lambda: nt.propagator(Problem(BODY, start=nt.integrate(PROBLEM), t_end=2)), "propagator does not take start"),
        (lambda: nt.simulate(scaled), "load_scale"),
        (scaled.forecast, "load_scale"),
        (lambda: scaled.write(tmp_path / "run.toml"), "load_scale"),
        (lambda: PROBLEM.write(tmp_path / "run.txt"), "suffix"),
    ):
        with pytest.raises(ValueError, match=words):
            call()


def test_keyword_none():
    for function in (nt.simulate, nt.lyapunov, nt.propagator, nt.simulate_ensemble, Problem):
        with pytest.raises(TypeError, match=r"argument 't_endd'; did you mean t_end=\?"):
            function(BODY, t_endd=1)
    for others, meant in {
        "dt": "step",
        "omega": "angular_velocity= or material_angular_velocity",
        "method": "integrator",
        "torque": "load",
    }.items():
        with pytest.raises(TypeError, match=rf"argument '{others}'; did you mean {meant}="):
            nt.simulate(BODY, t_end=1, **{others: 1})
    with pytest.raises(TypeError, match=r"argument 'zz'; it takes t_end, step"):
        nt.simulate(BODY, t_end=1, zz=1)
    with pytest.raises(
        ValueError, match=r"unknown integrator 'rk45'; RK45 of SciPy is integrators.Continuous\('RK45'\)"
    ):
        nt.simulate(BODY, t_end=1, integrator="rk45")
    with pytest.raises(TypeError, match="unexpected keyword argument 'store'"):
        nt.lyapunov(PROBLEM, store=3)


def test_a_problem_cannot_be_changed():
    with pytest.raises(FrozenInstanceError):
        PROBLEM.t_end = 2
    with pytest.raises(FrozenInstanceError):
        del PROBLEM.given
    with pytest.raises(TypeError):
        PROBLEM.given["step"] = 0.2
    assert (PROBLEM.replace(t_end=2).t_end, PROBLEM.t_end) == (2, 1)
    assert PROBLEM.replace(nt.standard([1, 1, 1])).system.inertia[0, 0] == 1
    assert nt.stepper(PROBLEM.replace(integrator="lie-midpoint"), integrator="gauss").integrator.name == "gauss"
    with pytest.raises(TypeError, match="did you mean t_end"):
        PROBLEM.replace(tend=1)
    with pytest.raises(AttributeError):
        PROBLEM.mass  # noqa: B018
    W, times = np.array([1.0, 2, 3]), [0, 0.5]
    own = nt.Problem(nt.standard([3, 4, 5]), times=times, material_angular_velocity=W)
    W[:], times[1] = 0, 1
    with pytest.raises(ValueError, match="read-only"):
        own.material_angular_velocity[0] = 0
    run = nt.integrate(own.replace(integrator="exact"))
    assert [*run.material_angular_velocity[0], *run.time] == [1, 2, 3, 0, 0.5]


TABLE = ([0, 0.4, 1], [[0, 0, 1], [1, 0, 0], [0, 0.5, 0]])


def posed(body=BODY, t_end=1, **how):
    """A problem with this start, unless another velocity is given."""
    moving = {"material_angular_velocity", "angular_velocity"} & set(how)
    return Problem(body, t_end=t_end, **({} if moving else START), **how)


SPUN = nt.nontwisting([3, 4, 5], spin=([0, 1], [0, 2]))
EVENTS = [nt.axis_crosses((1, 0, 0), (0, 1, 0), terminal=2, direction=0.5), nt.spin_below(0.1)]
LOADS = nt.pulse((0, 1, 0), 0.2, 0.6) + 0.5 * nt.sine((0, 0, 1), frequency=0.5) + nt.body_moment(*TABLE)
LOADS += nt.space_moment(*TABLE) + nt.damping(0.1) + nt.rotor((0, 0, 1), [0, 1], [0, 1])
LOADS += nt.dipole((0, 0, 1), (1, 0, 0)) + nt.spring(3.0, (0, 0, 1), (1, 0, 1), rest_length=0.5)
LOADS += nt.gravity_gradient(0.1, (1, 0, 0), (0, 0, 1))
WRITTEN = {
    "rod with an axis": posed(dataclasses.replace(BODY, axis=[0, 1, 0]), material_angular_velocity=(1, 0, 2)),
    "named as another": posed(nt.DirectorSystem(np.diag([3, 2, 1.5]), name="nontwisting probe")),
    "tolerance": posed(nt.standard(np.diag([3.0, 4, 5]) + 0.1), tolerance=1e-9),
    "turning": posed(nt.nontwisting([3, 4, 5], spin=0.5), step=0.1, angular_velocity=(1, 0, 0)),
    "spun": posed(SPUN, step=0.1, angular_velocity=(1, 0, 0)),
    "rod": posed(nt.nontwisting([1, 1, 0]), step=0.1, angular_velocity=(1, 0, 0)),
    "suslov": posed(nt.suslov([3, 4, 5], (1, 1, 0)), step=0.1, material_angular_velocity=(0, 0, 1)),
    "unphysical": posed(nt.standard([1, 1, 3], physical=False), step=0.1),
    "top": posed(nt.heavy_top([2, 2, 1], 1.5, (0.1, 0, 0.6)), step=0.1, load=nt.rotor((1, 2, 2), 3.0)),
    "weight": posed(nt.with_gravity(BODY, 2, (0, 0.1, 0.2), (0, 1, -9)), step=0.1),
    "loads": posed(step=0.1, load=LOADS, integrator="gauss", order=np.int64(4), store="end"),
    "wheel": posed(step=0.1, load=nt.wheel("z", 0.1, 3, ([0, 1], [0, 0.2]), viscous=0.01, coulomb=0.02)),
    "friction": posed(step=0.1, load=nt.dry_friction(0.5, axis=(0, 0, 1))),
    "options": posed(integrator=Continuous(rtol=1e-9), times=[0.5, 1]),
    "dissipation": posed(step=0.1, integrator=LieMidpoint(dissipation=0.5)),
    "event": posed(t_end=8, events=EVENTS),
}


def test_written_velocity_keeps_bits(tmp_path):
    """That across a constrained axis, from which what is along it is removed once."""
    body, W = nt.suslov([3, 4, 5], (3, 2, 10)), (-0.301, 1.504, 2.841)
    problem = posed(body, material_angular_velocity=W, project=True, step=0.1)
    problem.write(tmp_path / "run.toml")
    first, again = (
        nt.simulate(one).material_angular_velocity[0] for one in (problem, Problem.read(tmp_path / "run.toml"))
    )
    assert again.values.tolist() == first.values.tolist()


def test_written_inertia_keeps_bits(tmp_path):
    problem = posed(nt.standard([[0.5, 0.02, -0.01], [0.02, 0.42, 0.03], [-0.01, 0.03, 0.25]]))
    problem.write(tmp_path / "run.toml")
    assert Problem.read(tmp_path / "run.toml").system == problem.system
    assert "[0.02, 0.42, 0.03]" in (tmp_path / "run.toml").read_text(encoding="utf-8")


@pytest.mark.parametrize("name", WRITTEN)
def test_written_and_read(name, tmp_path):
    """And its forecast is of the run."""
    problem, path = WRITTEN[name], tmp_path / "run.toml"
    problem.write(path)
    coming, run, again = problem.forecast(), nt.simulate(problem), nt.simulate(Problem.read(path))
    np.testing.assert_allclose(again.directors, run.directors, rtol=0, atol=1e-12)
    np.testing.assert_allclose(again.time, run.time, rtol=0, atol=1e-14)
    assert "run_file" in again.attrs
    Problem.read(path).write(tmp_path / "again.toml")
    assert nt.simulate(Problem.read(tmp_path / "again.toml")).attrs["run_file"] == again.attrs["run_file"]
    if "tolerance" not in problem.given and "events" not in problem.given:
        assert coming.states == run.sizes["time"]
    assert coming.problems == ()
    assert len(coming.loads) == len((problem.load or nt.Load()).terms)


def own_wheel(speed):
    return 0.9 * speed


def test_python_functions_in_a_file(tmp_path):
    for change in (
        {"load": nt.wheel((1, 2, 2), 0.5, 3.0, friction=own_wheel)},
        {"load": nt.wheel((1, 2, 2), 0.5, 3.0, torque=lambda t, speed: 2 - speed)},
        {"load": nt.moment(lambda t, directors, w: (0, 0, -w[2]))},
        {"events": lambda t, state: state.material_angular_velocity[0]},
    ):
        with pytest.raises(ValueError, match="no place in a run file"):
            PROBLEM.replace(**change).write(tmp_path / "run.toml")
    assert not list(tmp_path.iterdir())


def test_existing_and_changed_problems(tmp_path):
    path = tmp_path / "run.toml"
    PROBLEM.write(path)
    with pytest.raises(FileExistsError):
        PROBLEM.write(path)
    PROBLEM.replace(t_end=2).write(path, force=True)
    problem = Problem.read(path)
    assert (problem.t_end, Problem.read(path, set=["time.t_end=4"]).t_end) == (2, 4)
    assert "run_file" in nt.simulate(problem).attrs
    assert "run_file" not in nt.simulate(problem, t_end=3).attrs
    with pytest.raises(ValueError, match="give over="):
        nt.sweep(problem.replace(t_end=3), tmp_path / "store")


def test_forecast_of_impossible_runs():
    assert PROBLEM.replace(integrator="split", load=nt.dry_friction(0.1)).forecast().problems[0][0] == "integrator"


@pytest.mark.parametrize(
    ("scheme", "torque", "is_taken"), [("split", None, False), ("exact", None, True), ("exact", 0.1, False)]
)
def test_wheels_are_forecast(scheme, torque, is_taken):
    """A wheel without friction is marched as a rotor; that is what the integrator takes, or not."""
    problem = PROBLEM.replace(integrator=scheme, step=None, load=nt.wheel("z", 0.5, speed=2, torque=torque))
    told = [reason for _, reason in problem.forecast().problems]
    assert bool(told) is not is_taken
    if is_taken:
        assert abs(nt.simulate(problem).total_momentum.diff("time")).max() < 1e-14
    else:
        with pytest.raises(ValueError, match=f"^{re.escape(told[0])}$"):
            nt.simulate(problem)


def test_gyrations_are_forecast():
    """A momentum wheel makes a satellite gyrate 750 times, in steps that are shorter than it or its orbit suggests."""
    cubesat = Problem(
        nt.standard([0.02, 0.022, 0.006]), t_end=5400, load=nt.rotor("y", 0.01), angular_velocity=(1e-3, 2e-3, 1e-3)
    )
    times = [0, 5400]
    steps = 5400 / nt.simulate(cubesat, times=times).attrs["step"]
    assert 1 / 3 < cubesat.replace(times=times).forecast().steps / steps < 3


def test_copy_is_equal(tmp_path):
    PROBLEM.write(tmp_path / "run.toml")
    expected = nt.integrate(PROBLEM).quaternion
    for problem in (PROBLEM, Problem.read(tmp_path / "run.toml")):
        for again in (pickle.loads(pickle.dumps(problem)), copy.copy(problem), copy.deepcopy(problem)):
            assert np.array_equal(nt.integrate(again).quaternion, expected)
            assert problem == again
            assert hash(problem) == hash(again)


@pytest.mark.parametrize(
    "given",
    [{}, {"load": None, "order": 4, "step": 0.1}, {"store": "end", "integrator": "lie-midpoint", "times": None}],
)
def test_stated_defaults_are_equal(given, tmp_path):
    """A file states what a problem leaves out: the two are equal, and another value of it is not."""
    problem = Problem(BODY, t_end=1, **given)
    problem.write(tmp_path / "run.toml")
    read = Problem.read(tmp_path / "run.toml")
    assert len(read.given) > len(problem.given)
    assert (read, hash(read)) == (problem, hash(problem))
    for other in (
        {"t_start": 0.5},
        {"material_angular_velocity": (0, 1, 0)},
        {"load": nt.damping(1)},
        {"project": True},
    ):
        assert read != problem.replace(**other)


@pytest.mark.parametrize(
    ("changes", "other"),
    [
        ({"t_end": 1.0, "load": nt.sine([0, 0, 1], frequency=0.5)}, {"t_end": 2}),
        ({"material_angular_velocity": [0.1, 2, 0.3]}, {"material_angular_velocity": (0.1, 2)}),
        ({"rotation": Rotation.from_rotvec([0.3, -0.2, 0.5])}, {"rotation": Rotation.from_rotvec([0.3, -0.2, 0.6])}),
        ({"times": np.array([0.5, 1])}, {"times": np.array([0.5, 1.5])}),
        ({"integrator": LieMidpoint(dissipation=0.5)}, {"integrator": LieMidpoint()}),
        ({"start": nt.simulate(BODY, t_end=0.5)}, {"start": nt.simulate(BODY, t_end=0.25)}),
        ({"events": [nt.spin_below]}, {"events": None}),
    ],
)
def test_equal_problems(changes, other):
    first = PROBLEM.replace(**changes)
    assert first == PROBLEM.replace(**copy.deepcopy(changes))
    assert first not in (PROBLEM.replace(**other), first.replace(nt.standard([3, 4, 6])), PROBLEM.system)


def test_body_is_written_in_full(tmp_path):
    body = dataclasses.replace(nt.suslov([3, 4, 5], (5e-9, 0, 1)), name="nontwisting")
    Problem(body, t_end=1, step=0.1, material_angular_velocity=(0, 1, 0)).write(tmp_path / "run.toml")
    again = Problem.read(tmp_path / "run.toml").system
    assert (again.name, again.axis[0]) == ("suslov", pytest.approx(5e-9, rel=1e-9, abs=0))
    WRITTEN["rod"].write(tmp_path / "rod.toml")
    assert Problem.read(tmp_path / "rod.toml").system.name == "nontwisting"  # and not a suslov body, which it is, too


HEAD = '[body]\nkind = "standard"\ninertia = [3, 4, 5]\n[time]\nt_end = 2\nstep = 0.1\n[[load]]\nframe = "body"\n'


def test_constant_moment_has_no_end(tmp_path):
    path = tmp_path / "run.toml"
    path.write_text(HEAD + 'kind = "constant"\nmoment = [1, 0, 0]\n', encoding="utf-8")
    problem = Problem.read(path)
    problem.replace(load=0.5 * nt.constant((2, 0, 0))).write(tmp_path / "again.toml")
    for other in (problem, Problem.read(tmp_path / "again.toml")):
        longer = nt.simulate(other, t_end=4)
        assert longer.material_angular_velocity[-1, 0] == pytest.approx(4 / 3)
    assert 'kind = "constant"' in (tmp_path / "again.toml").read_text(encoding="utf-8")


def test_files_go_along(tmp_path):
    (tmp_path / "t.csv").write_text("t,a,b,c\n0,0,0,1\n2,1,0,0\n", encoding="utf-8")
    (tmp_path / "run.toml").write_text(HEAD + 'kind = "csv"\nfile = "t.csv"\n', encoding="utf-8")
    (tmp_path / "sub").mkdir()
    problem = Problem.read(tmp_path / "run.toml")
    problem.write(tmp_path / "sub" / "again.toml")
    again = Problem.read(tmp_path / "sub" / "again.toml")
    assert np.array_equal(nt.integrate(again).quaternion, nt.integrate(problem).quaternion)


def test_very_light_body(tmp_path):
    """J of 1e-4 kg m² about the pivot leaves no room for 1 kg at 8 mm: only mass times centre acts."""
    top = nt.heavy_top([1e-4, 1e-4, 1e-4], mass=2.0, centre_of_mass=(0, 0, 0.004))
    how = {"t_end": 0.2, "material_angular_velocity": (1, 2, 30)}
    Problem(top, **how).write(tmp_path / "own.toml")
    assert Problem.read(tmp_path / "own.toml").system.dead_force.tobytes() == top.dead_force.tobytes()
    Problem(nt.DirectorSystem.from_json(top.to_json()), **how).write(tmp_path / "top.toml")
    again = Problem.read(tmp_path / "top.toml")
    np.testing.assert_allclose(again.system.dead_force, top.dead_force, rtol=1e-12)
    np.testing.assert_allclose(again.system.inertia, top.inertia, rtol=1e-9)

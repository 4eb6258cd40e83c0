"""What a run will take is forecast before it is spent: said above 10 s or 1 GB, refused above limits."""

import difflib
import os
import re
from time import sleep

import numpy as np
import pytest

import nontwist as nt
from conftest import NONTWISTING, STANDARD, ended
from nontwist.driver import grid, notices
from nontwist.errors import RunFileError, SimulationError
from nontwist.exact import nontwisting_body
from nontwist.integrators import INTEGRATORS, IVP, Continuous, continuous, costs, exact_solution
from nontwist.integrators.costs import Cost, seconds_of_call
from nontwist.models.stack import stacked
from nontwist.runfile import read_run_file
from nontwist.runfile.document import forecast
from nontwist.sweeps.members import Members, values
from refusals import said, says

BODY = '[body]\nkind = "nontwisting"\ninertia = [3, 4, 5]\n[time]\nt_end = 1\nstep = 0.1\n'
SINE = '[[load]]\nkind = "sine"\nframe = "body"\namplitude = [1, 0, 0]\nfrequency = 1e8\n'
EXACT = '[integrator]\nname = "exact"\n'
SWEPT = '[sweep]\nover = [{ key = "body.inertia.0", kind = "grid", start = 3, end = 4, count = 3 }]\n'
MANY = (
    "the closed-form solution needs about 5e+08 subintervals of the load, at most 1e+06 are allowed; a "
    "frequency of 2e+05 Hz would do, or the integrator split"
)
FREE, PUSH = NONTWISTING, {"angular_velocity": [1, 0, 0], "integrator": "exact"}


AUTOMATIC = (
    'body = { kind = "standard", inertia = [3, 4, 5] }\nstart.angular_velocity.body = [0.1, 2, 0]\ntime.t_end = 10\n'
)


@pytest.mark.parametrize(
    "more",
    [
        "time.store = 7",
        "time.times = [1, 2.5, 10]",
        "time.tolerance = 1e-10",
        'load = [{ kind = "damping", coefficient = 1e5 }]',
        'load = [{ kind = "spring", stiffness = 2, anchor = [0, 0, 3], point = [0, 0, 1], rest_length = 1 }]',
        'integrator.name = "lie-midpoint"',
    ],
)
def test_check_forecasts_steps_and_states(write, more):
    file = read_run_file(write(AUTOMATIC + more))
    expected, run = forecast(file), file.prepared.run()
    assert run.segments.steps == expected.steps
    assert run.segments.longest == pytest.approx(expected.step)
    assert expected.states == pytest.approx(len(run.time), rel=0.2)


def told(path):
    with pytest.raises(RunFileError) as info:
        read_run_file(path)
    return info.value.problems


def problem(system, load, steps=10, span=1.0, W=(1.0, 0.0, 0.0)):
    return IVP(stacked(system), np.eye(4)[3:], np.array([W]), load, 0.0, span, steps, np.array([0, steps]))


# exact


def test_sine_of_1e8_hz(here, write, monkeypatch):
    """With warnings as errors, a forecast would come in the place of the refusal."""
    monkeypatch.setattr(exact_solution, "free_members", None)
    load = nt.sine([1, 0, 0], 1e8)
    with pytest.raises(ValueError, match=re.escape(MANY)):
        nt.simulate(FREE, t_start=3, t_end=4, step=0.1, integrator="exact", load=load)
    write(BODY + EXACT + SINE)
    result = ended(3, "check", "run.toml")
    assert result.stdout == ""
    assert result.stderr.startswith(f'run.toml: integrator.name: "exact" ({MANY}) -> ')
    monkeypatch.setattr(nontwisting_body, "unrefined", None)
    with pytest.raises(ValueError, match=re.escape(MANY)):
        nt.exact.loaded_momentum([3, 4, 5], [1, 0, 0], load, [1.0])


def test_million_subintervals(monkeypatch):
    monkeypatch.setattr(nontwisting_body, "MOST", 100)
    load = nt.body_moment(lambda t: (np.sin(1e9 * t * t), 0, 0))
    with says():
        nt.exact.loaded_momentum([3, 4, 5], [1, 0, 0], load, [1.0])
    for count in (299, 301):  # of times; 400 subintervals are expected, a hundred more than times are allowed
        assert (nontwisting_body.too_many(nt.sine([1, 0, 0], 80), np.linspace(2, 3, count)) is None) == (count == 301)


def test_load_that_sampling_misses():
    t = np.append(np.linspace(0, 1, 50_001), [2])
    values = np.zeros((50_002, 3))
    values[25_017] = 3e5, 0, 0
    load = nt.body_moment(t, values)
    assert INTEGRATORS["exact"]().refusal(problem(STANDARD, load)) is None
    with pytest.raises(ValueError, match="a standard body under load"):
        INTEGRATORS["exact"]().march(problem(STANDARD, load))


# the forecast


RUBBED = [[nt.wheel(axis, 0.1, 9, coulomb=c) for axis in axes] for axes, c in (("x", 0.0), ("x", 0.1), ("xyz", 0.1))]


def test_cost_counts_substeps():
    free, pushed = problem(FREE, 0 * nt.pulse([1, 0, 0])), problem(FREE, nt.sine([1, 0, 0], 5), 1000)
    split, closed = INTEGRATORS["split"](), INTEGRATORS["exact"]()
    assert split.cost(pushed, 2).parts == 1000
    assert split.cost(problem(FREE, nt.pulse([1, 0, 0], 0, 0.1), 1000), 2).parts == 100
    assert closed.cost(pushed, 11).parts == 11 + 25
    assert closed.cost(problem(STANDARD, free.load), 11).parts == 0
    rubbed = [nt.Problem(FREE, t_end=9, step=0.05, load=sum(many)).forecast().seconds for many in RUBBED]
    assert rubbed[1] > 10 * rubbed[0]
    oiled = [[nt.wheel(axis, 0.1, 9, viscous=0.1) for axis in axes] for axes in ("x", "xyz")]
    pulled = [[nt.spring(2, point=(0, 0, 1), anchor=(0, 0, 1.5))], RUBBED[0], *oiled]
    how = {"t_end": 9, "step": 0.05, "store": "end"}
    alone, *others = (nt.Problem(FREE, load=sum(many, nt.Load()), **how).forecast().seconds for many in ([], *pulled))
    spring, locked, one, three = (each / alone for each in others)
    assert 1 < locked < 1.5 < one <= spring < 4 < three < 8
    chosen = nt.Problem(FREE, t_end=9000, tolerance=1e-9, store="end", material_angular_velocity=(1, 0, 0)).forecast()
    fixed = nt.Problem(FREE, t_end=9000, step=chosen.step, order=16, store="end").forecast()
    assert 2.2 < chosen.seconds / fixed.seconds < 2.5  # two runs before it
    assert rubbed[2] > 2 * rubbed[1]


def test_calls_are_forecast():
    def slow(t, directors, w):
        sleep(1e-3)
        return -0.1 * w

    at = nt.Problem(STANDARD, load=nt.moment(slow), t_end=100, material_angular_velocity=(0.1, 2, 0)).forecast()
    assert at.seconds > 0.1 * at.steps  # four stages or more, each called often


def test_call_that_waits(monkeypatch):
    """Of calls that take 30, 20, 10 and 1 ms, then of those of 60 ms: a busy machine lets some wait."""
    clock, delays = [0.0], iter([0.03, 0.02, 0.01] + [0.001] * 7 + [0.06] * 3)
    monkeypatch.setattr(costs, "perf_counter", lambda: sum(clock))

    def waiting(t, directors, w):
        clock.append(next(delays))
        return -w

    load = nt.moment(waiting)
    assert seconds_of_call(load, problem(FREE, load)) == pytest.approx(0.001)
    assert seconds_of_call(load, problem(FREE, load)) == pytest.approx(0.06)
    assert len(list(delays)) == 1  # of slow calls two tell enough


def test_seven_outputs_take_fewer_calls():
    calls, counts, ends = 0, [], []

    def drag(t, directors, w):
        nonlocal calls
        calls += 1
        return -0.1 * w

    for how in ({"times": np.linspace(0, 20, 7)}, {"t_end": 20}):
        calls = 0
        run = nt.simulate(STANDARD, load=nt.moment(drag), material_angular_velocity=(0.1, 0.3, 0), **how)
        counts.append(calls)
        ends.append(run.quaternion[-1])
    assert 3 * counts[0] < counts[1]
    np.testing.assert_allclose(*ends, atol=1e-8)


def test_members_in_lanes_are_cheaper():
    """Loads in Python are called for each, whatever the threads."""
    gauss, drawn = INTEGRATORS["gauss"](), problem(FREE, nt.moment(lambda t, d, w: -w))
    for one, is_less in ((problem(FREE, nt.pulse([1, 0, 0])), True), (drawn, False)):
        alone, many = gauss.cost(one, 2).seconds, [notices.members_cost(gauss, one, 800, 2, 0, n) for n in (1, 4)]
        assert (many[0].seconds < 800 * alone / 4) == is_less
        assert many[0].seconds / many[1].seconds == pytest.approx(4 if is_less else 1)
    for scheme in (INTEGRATORS["exact"](), INTEGRATORS["split"]()):  # one after the other, but in one call
        alone = scheme.cost(problem(FREE, nt.pulse([1, 0, 0])), 2).seconds
        assert notices.members_cost(scheme, problem(FREE, nt.pulse([1, 0, 0])), 800, 2).seconds == 800 * alone


PUSH_BODY = '[[load]]\nkind = "pulse"\nframe = "body"\namplitude = [1, 0, 0]\nend = 1\n'
WHEEL = '[[load]]\nkind = "wheel"\naxis = "x"\ninertia = 0.1\n'
FIVE, DRAWN = 'kind = "grid", start = 1, end = 2, count = 5', 'kind = "uniform", low = 3, high = 4'


@pytest.mark.parametrize(
    ("loads", "over", "combine", "count"),
    [
        (PUSH_BODY, {"start.angular_velocity.body.0": FIVE, "body.inertia.0": DRAWN}, "product", 1),
        (PUSH_BODY, {"load.0.scale": FIVE, "body.inertia.0": DRAWN}, "product", 1),
        (PUSH_BODY + WHEEL, {"load.0.scale": FIVE, "body.inertia.0": DRAWN}, "product", 5),
        (WHEEL, {"load.0.torque": DRAWN, "body.inertia.0": FIVE}, "product", 20),
        (WHEEL, {"load.0.torque": FIVE, "load.0.speed": FIVE, "body.inertia.0": DRAWN}, "product", 25),
        (WHEEL, {"load.0.torque": FIVE, "load.0.speed": FIVE, "body.inertia.0": DRAWN}, "together", 5),
    ],
)
def test_forecast_of_a_sweep(loads, over, combine, count, write, monkeypatch):
    """Each takes some ms beside its members; one with wheels, which is by itself, what a run takes."""
    rows = ", ".join(f'{{ key = "{key}", {how} }}' for key, how in over.items())
    file = read_run_file(write(f'{BODY}{loads}[sweep]\nsamples = 4\ncombine = "{combine}"\nover = [{rows}]\n'))
    members, groups = Members(file), []
    monkeypatch.setattr(Members, "_run", lambda self, file, places, *_: groups.append(len(places)))
    members.run(values(file.sweep, 0, len(members)))
    assert (len(groups), file.sweep.ensembles(file.load)) == (count, count)
    least = count * notices.ENSEMBLE_NS * 1e-9
    if loads != PUSH_BODY:
        least += len(members) * file.prepared.scheme.cost(file.prepared.whole, 2).seconds
    assert forecast(file).sweep_seconds > least


def test_extrema_of_sweep_take_longer(write):
    """Each step of each member is looked into at 20 places, which takes longer than the step."""
    text = BODY + '[sweep]\nsamples = 1000\nreduce = ["drift"]\nover = [{ key = "body.inertia.0", ' + DRAWN + " }]\n"
    plain, inside = (forecast(read_run_file(write(one))) for one in (text, text.replace("drift", "extrema")))
    assert inside.sweep_seconds - plain.sweep_seconds == pytest.approx(1000 * plain.steps * 15e-6)


def test_substeps_cost_about_the_same():
    """Those with more to solve take longer."""
    free, held = (problem(body, nt.space_moment([0, 1], np.eye(3)[:2])) for body in (STANDARD, FREE))
    seconds = [
        INTEGRATORS[name]().cost(of, 2).seconds / INTEGRATORS[name]().nodes
        for name, of in (("lie-midpoint", free), ("energy-momentum", free), ("split", held), ("split", free))
    ]
    assert [*seconds] == sorted(seconds)
    assert seconds[-1] < 2.5 * seconds[0]
    assert seconds[1] < INTEGRATORS["gauss"]().cost(free, 2).seconds / 4 < seconds[3]


def test_long_runs_are_announced():
    assert notices.notice(Cost(10, "steps", 10.0, 10**9)) is None
    said(notices.notice(Cost(12_800_000, "steps", 3700.0, 10**6)))
    said(notices.notice(Cost(10, "members", 1.0, 2 * 10**9), "sweep", "on the disk"))


@pytest.fixture
def slow(monkeypatch):
    monkeypatch.setattr(notices, "LONG", 1e-9)


def test_warning_names_the_caller(slow, here, write):
    body = nt.nontwisting([3, 4, 5.25])  # of no other test: a run of which nothing was to say is not looked at again
    with pytest.warns(UserWarning, match=r"^the run will take about .* and 8\.8 kB of memory, for 10 steps$") as seen:
        nt.simulate(body, t_end=1, step=0.1)
    assert [one.filename for one in seen] == [__file__]
    with pytest.warns(UserWarning, match=r"about .* and 80\.8 kB of memory, for 3 steps"):
        nt.simulate(body, t_end=1)
    with pytest.warns(UserWarning, match="for 3 states"):
        nt.simulate(body, times=[0, 0.5, 1], integrator="continuous")
    with pytest.warns(UserWarning, match="the run will take about .* for 30 steps"):
        nt.simulate_ensemble(FREE, t_end=1, step=0.1, angular_velocity=np.eye(3)[[0, 1, 1]])
    with pytest.warns(UserWarning, match="the sweep will take about .* on the disk, for 3 members"):
        nt.sweep(write(BODY + SWEPT), "store", workers=1)
    result = ended(0, "check", "run.toml")
    assert "run.toml: warning: the run will take about" in result.stderr
    assert "without start-up" in result.stdout
    assert "3 members over body.inertia.0, about 4 ms on one core" in result.stdout


def test_subintervals_beyond_memory(write, monkeypatch):
    monkeypatch.setattr(grid, "free_memory", lambda: 10_000_000)
    monkeypatch.setattr(grid, "SMALL", 0)
    with says():
        nt.simulate(FREE, t_end=1, step=0.5, load=nt.sine([1, 0, 0], 1000), **PUSH)
    coming = forecast(read_run_file(write(BODY + EXACT + SINE.replace("1e8", "1000"))))
    assert coming.problems[0].key == "time.store"
    assert "10 MB are free; 2300 subintervals fit" in coming.problems[0].given


# what check may take: counted, not timed


def test_many_unknown_keys(write, monkeypatch):
    asked, near = [], difflib.get_close_matches
    monkeypatch.setattr("difflib.get_close_matches", lambda *a: asked.append(a) or near(*a))
    found = told(write(BODY + "".join(f"step_{i} = 1\n" for i in range(2_000))))
    assert len(found) == 100
    said(str(found[0]))
    assert str(found[-1]) == "the file: at least 100 problems -> none; the first are listed"
    assert len(asked) <= 100


def test_limits_are_named(write):
    for text in (
        SWEPT.replace("3 }", "100_000_000_000 }"),
        SWEPT.replace("[{", "[" + 101 * "{ x = 1 }, " + "{"),
        f"{'k' * 10_000} = 1\n",
        '[output]\npath = ".nc"\n',
    ):
        said(str(told(write(BODY + text))[0]))


def test_the_nearest_step_is_sieved(monkeypatch):
    rng = np.random.default_rng(3)
    for _ in range(100):
        N, q = int(rng.integers(2, 60)), int(rng.integers(2, 30))
        x, near = np.unique(rng.integers(1, q, 3)) / q, sorted(range(1, 100), key=lambda n: abs(n - N))
        assert grid.fitting_count(x, N, range(1, 100)) == next((n for n in near if grid.fits(x, n)), None)
    monkeypatch.setattr(grid, "TRIES", 120)  # the search ends
    assert grid.fitting_count(np.array([0.5, 0.25, 0.125]), 17, range(1, 100)) is None


# files that never end


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no FIFOs here")
def test_fifo(here, write):
    words = "it is a FIFO, not a regular file; copy its content into a file"
    for name in ("pipe", "result.nc"):
        os.mkfifo(name)
    write(f"{BODY}[[load]]\nkind = 'csv'\nframe = 'body'\nfile = 'pipe'\n")
    assert words in told("run.toml")[0].given
    for command in ("run", "check", "twist", "info", "view"):
        result = ended(5, command, "pipe")
        assert result.stdout == ""
        assert words in result.stderr
    refused = ended(5, "run", write(BODY), "--force", "--out", "result.nc")
    assert "is not a file that could be replaced" in refused.stderr


# the solvers of SciPy


STEPPED = {
    "free": (STANDARD, {"material_angular_velocity": (0.1, 2, 0.1)}, 10),
    "a needle": (nt.standard([2e-7, 5.6e-4, 5.6e-4]), {"angular_velocity": (1e-3, -40, 0)}, 0.05),
    "gravity": (nt.heavy_top([3, 4, 5], 1, [0, 0, 0.5]), {"material_angular_velocity": (0, 0.1, 10)}, 2),
    "a sine": (STANDARD, {"load": nt.sine([1, 0, 2], 3)}, 2),
    "damping": (STANDARD, {"load": nt.damping(100), "angular_velocity": (0, 10, 1)}, 3),
    "a table": (FREE, {"load": nt.body_moment(np.linspace(0, 5, 30), np.outer(np.arange(30), (1, 0, 0)))}, 5),
}


SOLVED = [("a needle", "BDF"), ("gravity", "LSODA"), ("a sine", "RK45"), ("damping", "LSODA"), ("a table", "DOP853")]


@pytest.mark.parametrize(("case", "method"), [*(("free", one) for one in continuous.METHODS), *SOLVED])
def test_steps_of_the_solver(case, method, monkeypatch):
    body, how, end = STEPPED[case]
    taken, expected = [], []
    solver, forecast = continuous.solver_of(method), continuous.expected_steps
    counting = type(method, (solver,), {"step": lambda self: taken.append(1) or solver.step(self)})
    monkeypatch.setattr(continuous, "solver_of", lambda method: counting)
    monkeypatch.setattr(continuous, "expected_steps", lambda *task: expected.append(forecast(*task)) or expected[0])
    nt.simulate(body, times=[end], integrator=Continuous(method=method, rtol=1e-6, atol=1e-8), **how)
    least, most = (0.9, 1.3) if case == "free" else (0.25, 25)
    assert least * len(taken) < expected[0] < most * len(taken)


@pytest.mark.parametrize(("every", "after"), [(1000, 601), (100, 100)])
def test_limit_of_continuous(every, after, slow, monkeypatch):
    """Where it is not hopeless from the beginning: that may be fast and soon be over."""
    for name, number in (("MOST", 600), ("CHECK_EVERY", every), ("PATIENCE", every)):
        monkeypatch.setattr(continuous, name, number)
    how = {"t_start": 1000, "times": [1000, 1100], "angular_velocity": (0, 2, 0), "integrator": "continuous"}
    with (
        pytest.warns(UserWarning, match=r"^the run will take about 1\.2 s and 1\.6 kB of memory, for 2 states$"),
        pytest.raises(SimulationError, match=rf"would need more than 600 steps, after {after} it has come ") as info,
    ):
        nt.simulate(STANDARD, **how)
    assert after / float(re.search(r"come (.+) s far", str(info.value))[1]) > 600 / 100

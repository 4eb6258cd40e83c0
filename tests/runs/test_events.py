"""Events: their times against closed forms and SciPy, what ends a run, what the functions may do wrong."""

import csv
import json
import re

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.special import ellipk

import nontwist as nt
from conftest import NONTWISTING, STANDARD, ended
from nontwist.errors import RunFileError, SimulationError, SimulationInterrupt
from nontwist.integrators import Gauss
from nontwist.runfile import read_run_file
from refusals import refused_as, says
from runs.test_times import R0, TOP, top_rates
from runs.test_times import W0 as W_TOP

BODY, W0 = STANDARD, (0, 2.0, 0)
TURNING = {"material_angular_velocity": W0}
EPS = np.finfo(float).eps


def level(t, state):
    return state.directors[2, 2]


def with_attributes(function, **attributes):
    def event(t, state):
        return function(t, state)

    for name, value in attributes.items():
        setattr(event, name, value)
    return event


def lifted(t, state):
    return state.directors[2, 2] + 0.98


@pytest.mark.parametrize("integrator", ["exact", "split", "gauss"])
def test_events_of_a_steady_turn(integrator):
    """The axis d3 is for 0.2 s within 0.2 rad of -e3: both ends of that lie within one step of 1.2 s."""
    how = {"t_end": 14.4, "step": 1.2 if integrator == "gauss" else None, "integrator": integrator, **TURNING}
    first, second = nt.integrate(NONTWISTING, events=[level, lifted], **how).t_events
    k, close = np.arange(10), 1e-12 * 1.2 + 4 * EPS * 14.4 + 4e-15
    assert first == pytest.approx((k[:9] + 0.5) * np.pi / 2, abs=close)
    ends = np.add.outer(k[1::2] * np.pi, np.array([-1, 1]) * np.arccos(0.98)).ravel() / 2
    assert second == pytest.approx(ends, abs=close)


def test_events_by_scipy():
    def faster(t, y):
        return y[6] - 6.2

    faster.direction = 1
    begin, close = [*R0.as_quat(), *W_TOP], {"rtol": 2.3e-14, "atol": 1e-14}
    truth = solve_ivp(top_rates, (0, 5), begin, "DOP853", events=faster, **close).t_events[0]
    mine = with_attributes(lambda t, state: state.material_angular_velocity[2] - 6.2, direction=1)
    how = {"rotation": R0, "material_angular_velocity": W_TOP, "integrator": Gauss(order=16), "step": 0.2}
    (found,) = nt.integrate(TOP, t_end=5, events=mine, **how).t_events
    assert len(truth) > 2
    assert found == pytest.approx(truth, abs=1e-11)


@pytest.mark.parametrize("integrator", ["gauss", "lie-midpoint"])
def test_two_crossings_between_times(integrator):
    """Of a body at rest functions are evaluated at nodes: at 0.5 and 1 s these are positive."""
    events = [lambda t, state, middle=t: (state.time - middle) ** 2 - 1e-4 for t in (0.52, 0.751)]
    run = nt.integrate(BODY, t_end=2, step=0.5, integrator=integrator, events=events)
    assert np.array(run.t_events) == pytest.approx(np.array([[0.51, 0.53], [0.741, 0.761]]), abs=1e-12)


@pytest.mark.parametrize("depth", [1e-6, 1e-10, 0])
def test_faint_crossings_between_times(depth):
    """Of a body that turns by 2 rad in a step, each time about the full turn; where it only touches, none."""
    how = {"t_end": 20, "step": 1, "material_angular_velocity": (0, 0, 2)}
    run = nt.integrate(BODY, events=lambda t, state: state.directors[0, 0] - (1 - depth), **how)
    half, turns = np.arccos(1 - depth) / 2, np.pi * np.arange(1, 7)
    expected = [half, *np.ravel([turns - half, turns + half], "F")] if depth else []
    assert run.t_events[0] == pytest.approx(np.array(expected), abs=1e-10)


@pytest.mark.parametrize(("value", "integrator"), [(1e-3, "continuous"), (1e-7, "gauss")])
def test_slow_turning_of_a_pendulum(value, integrator):
    """At the turnings, every half a period 4 K(sin θ/2)/ω, it accelerates by ω² sin θ."""
    omega, angle = np.sqrt(9.81 / 1.01), np.radians(10)
    how = {"t_end": 10, "rotation": nt.rotations.exp((angle, 0, 0)), "events": nt.spin_below(value)}
    (found,) = nt.integrate(nt.heavy_top([1.01, 1.01, 0.01], 1, (0, 0, -1)), integrator=integrator, **how).t_events
    turnings = np.arange(1, 10) * 2 * ellipk(np.sin(angle / 2) ** 2) / omega
    assert found == pytest.approx(turnings - value / (omega**2 * np.sin(angle)), abs=3e-9)


def test_several_functions_cross():
    """The polynomial through the values of one with a kink there has another, so Brent's method is taken."""

    def shifted(t, state):
        return level(t, state) - 1e-3

    def kinked(t, state):
        return max(level(t, state), 3 * level(t, state))

    how = {"step": 0.5, "integrator": "gauss", "events": [level, shifted, kinked], **TURNING}
    first, second, third = nt.integrate(NONTWISTING, t_end=8, **how).t_events
    assert np.cos(2 * first) == pytest.approx(0, abs=1e-13)
    assert np.cos(2 * second) == pytest.approx(1e-3, abs=1e-13)
    assert third == pytest.approx(first, abs=1e-11)
    assert len(first) == len(second) == 5


def test_state_of_an_event():
    how = {"t_end": 3, "step": 0.5, "integrator": "gauss", "material_angular_velocity": (1, 2, 0.5)}
    run = nt.simulate(BODY, events=level, **how)
    same = nt.simulate(BODY, times=run.t_events.values, **how)
    assert run.event_quaternion.values == pytest.approx(same.quaternion.values, abs=1e-15)
    assert run.event_material_angular_velocity.values == pytest.approx(same.material_angular_velocity.values, abs=1e-14)
    assert abs(same.directors.values[:, 2, 2]).max() < 2e-12
    without = nt.simulate(BODY, **how)
    assert np.array_equal(run.quaternion.values, without.quaternion.values)
    assert run.attrs["memory"] == without.attrs["memory"]


def test_direction_and_names():
    falling, rising = (with_attributes(level, direction=sign) for sign in (-1, 1))
    falling.__name__ = "falling"
    events = [falling, rising, lambda t, state: level(t, state)]
    run = nt.simulate(NONTWISTING, t_end=5, step=0.1, integrator="split", events=events, **TURNING)
    names = ["falling", "event", "event_2"]
    assert run.attrs["events"] == '["falling", "event", "event_2"]'
    times = [run.t_events[run.event_name == name].values for name in names]
    assert times[0] == pytest.approx([np.pi / 4, 5 * np.pi / 4], abs=1e-11)
    assert times[1] == pytest.approx([3 * np.pi / 4], abs=1e-11)
    assert np.array_equal(times[2], np.sort(np.concatenate(times[:2])))


@pytest.mark.parametrize(("name", "terminal", "k"), [("gauss", 3, 2), ("exact", True, 0)])
def test_terminal_event(name, terminal, k):
    event, how = with_attributes(level, terminal=terminal), {"step": 0.5} if name == "gauss" else {}
    run = nt.simulate(NONTWISTING, t_end=50, integrator=name, events=event, **how, **TURNING)
    assert run.time.values[-1] == run.t_events.values[-1] == pytest.approx((k + 0.5) * np.pi / 2, abs=1e-11)
    assert run.attrs["status"] == 0
    assert run.attrs["message"] == f"the event event ended the run at t = {run.time.values[-1]:.12g} s"
    assert len(run.midtime) == len(run.time) - 1
    assert (np.diff(run.time) > 0).all()


def test_means_balance():
    load, event = nt.damping(0.3), with_attributes(lambda t, s: s.material_angular_velocity[1] - 1.2, terminal=True)
    run = nt.simulate(BODY, t_end=60, step=0.3, load=load, integrator="gauss", events=event, store=3, **TURNING)
    gained, lengths = np.diff(run.spatial_momentum.values, axis=0), np.diff(run.time.values)
    assert gained == pytest.approx(lengths[:, None] * run.moment.values, abs=1e-13)
    assert np.diff(run.kinetic_energy.values) == pytest.approx(run.load_work.values, abs=1e-13)
    assert run.t_events.values == pytest.approx([np.log(2 / 1.2) * 4 / 0.3], abs=1e-9)


def test_event_before_a_failure():
    load = nt.moment(lambda t, d, w: np.array([0.0, 0.0, np.where(t > 1.0, np.nan, 0.0)]), compiled=True)
    how = {"t_end": 2, "step": 0.1, "load": load, "integrator": "gauss", **TURNING}
    run = nt.simulate(BODY, events=with_attributes(level, terminal=True), **how)
    assert run.time.values[-1] == pytest.approx(np.pi / 4, abs=1e-9)
    with pytest.raises(SimulationError, match=re.escape("step 10 at t = 1 s: the load")) as info:
        nt.simulate(BODY, events=level, **how)
    assert len(info.value.partial.t_events[0]) == 1


def test_stop_in_an_event_function():
    def stopping(t, state):
        if t > 1.5:
            raise KeyboardInterrupt
        return t - 0.3

    how = {"step": 0.01, "integrator": "gauss", **TURNING}
    with pytest.raises(SimulationInterrupt, match="interrupted at t = ") as info:
        nt.simulate(BODY, t_end=2, events=stopping, **how)
    part = info.value.partial
    assert part.t_events[0].tolist() == pytest.approx([0.3])
    assert 0.5 < part.time[-1] <= 1.5
    rest = nt.simulate(BODY, t_end=2, start=part, integrator="gauss", step=0.01 if part.segments is None else None)
    assert rest.time.values[0] == part.time[-1]


def test_zeros_at_nodes():
    """They count in the direction from which they are reached."""

    def at_start(t, state):
        return t

    def at_node(t, state):
        return t - 0.5

    def falling(t, state):
        return max(0.5 - t, 0.0)

    def rising(t, state):
        return min(t - 0.5, 0.0)

    how = {"t_end": 1, "step": 0.125, "events": [at_start, at_node, falling, rising], "integrator": "gauss", **TURNING}
    assert [times.tolist() for times in nt.integrate(BODY, **how).t_events] == [[], [0.5], [0.5], [0.5]]
    falling.direction, rising.direction = 1, -1
    assert [times.tolist() for times in nt.integrate(BODY, **how).t_events] == [[], [0.5], [], []]
    assert "t_events" not in nt.simulate(BODY, **how | {"events": []})


def test_events_are_saved(tmp_path):
    path, run = tmp_path / "run.nc", nt.simulate(BODY, t_end=3, step=0.1, events=level, **TURNING)
    nt.save_run(run, path)
    assert nt.open_run(path).identical(run)
    found = json.loads(ended(0, "export", path, "--to", "json").stdout)["columns"]
    assert found["t_events [s]"] == run.t_events.values.tolist()
    assert found["event_name"] == run.event_name.values.tolist()
    header, *lines = csv.reader(ended(0, "export", path, "--columns", "event_quaternion").stdout.splitlines())
    assert header == ["event_name", "t_events [s]", *(f"event_quaternion_{one}" for one in "xyzw")]
    assert [line[0] for line in lines] == run.event_name.values.tolist()
    rows = np.array([line[1:] for line in lines], float)
    assert np.array_equal(rows, np.column_stack([run.t_events, run.event_quaternion]))
    both = "export", path, "--columns", "kinetic_energy,t_events", "--out"
    assert "t_events has a line for each event, kinetic_energy has others" in ended(2, *both, tmp_path / "e.csv").stderr
    assert not (tmp_path / "e.csv").exists()
    ended(0, *both, tmp_path / "e.json")
    none = nt.simulate(BODY, t_end=3, step=0.1, events=lambda t, state: 1.0, **TURNING)
    nt.save_run(none, tmp_path / "none.nc")
    assert nt.open_run(tmp_path / "none.nc").identical(none)


def refused_events(events):
    return lambda: nt.simulate(BODY, t_end=1, step=0.1, integrator="gauss", events=events, **TURNING)


test_wrong_events_are_named = refused_as(
    {
        "no function": refused_events(3),
        "one is none": refused_events([level, None]),
        "terminal": refused_events(with_attributes(level, terminal=-1)),
        "direction": refused_events(with_attributes(level, direction="up")),
        "a function that fails": refused_events(lambda t, state: 1 / 0),
        "a function of no number": refused_events(lambda t, state: "high"),
        "no axis": lambda: nt.axis_crosses((0, 0, 0)),
        "cosine": lambda: nt.axis_crosses(cosine=1.0),
        "cosine below": lambda: nt.axis_crosses(cosine=-1.0),
        "spin": lambda: nt.spin_below(0),
    }
)


def test_named_events():
    body, how = NONTWISTING, {"t_end": 4, "step": 0.1, "integrator": "split"}
    tilted = nt.axis_crosses((0, 0, 2), (0, 0, 3), cosine=0.5, direction=-1, name="tilted")
    run = nt.simulate(body, events=[tilted, nt.axis_crosses()], **how, **TURNING)
    assert run.t_events[run.event_name == "tilted"].values == pytest.approx([np.pi / 6, np.pi / 6 + np.pi], abs=1e-11)
    assert repr(tilted) == "<event tilted>"


FILE = """
body = { kind = "nontwisting", inertia = [3, 4, 5] }
start.angular_velocity.body = [0, 2, 0]
time = { t_end = 5, step = 0.1, times = { file = "camera.csv", column = "t" } }
integrator.name = "split"

[[event]]
kind = "axis-crosses"
terminal = 2

[[event]]
kind = "axis-crosses"
name = "tilted"
cosine = 0.5

[[event]]
kind = "spin-below"
value = 1
"""


CAMERA = "t,frame\n0,1\n0.25,2\n1.5,3\n4,4\n"


def test_run_files(here, write):
    write(CAMERA, "camera.csv")
    write(FILE)
    file = read_run_file("run.toml")
    run = nt.simulate(file.problem)
    assert run.time.values == pytest.approx([0, 0.25, 1.5, 3 * np.pi / 4], abs=1e-11)
    assert run.event_name.values.tolist() == ["tilted", "axis_crosses", "axis_crosses"]
    assert run.attrs["message"].startswith("the event axis_crosses ended the run at t = 2.3561944")
    assert 'sha256 = "' in file.text()
    assert nt.simulate(file.problem).equals(run)
    shown = ended(0, "run", "run.toml").output
    assert "event axis_crosses" in shown
    assert "event spin_below" in shown


@pytest.mark.parametrize(("every", "times"), [(2, [0, 2, 4, 5]), (0.1, np.linspace(0, 5, 51)), (7, [0, 5])])
def test_output_times(every, times, write):
    text = FILE[: FILE.index("[[event]]")].replace('{ file = "camera.csv", column = "t" }', f"{{ every = {every} }}")
    run = nt.simulate(read_run_file(write(text)).problem)
    assert run.time.values == pytest.approx(times, rel=1e-14)
    assert run.time.values[-1] == 5


TIMES = '{ file = "camera.csv", column = "t" }'
WRONG = [('column = "t"', 'column = "u"'), (', column = "t"', ""), ("cosine = 0.5", "axis = [0, 0, 0]")]
WRONG += [('"spin-below"', '"spin"'), ("terminal = 2", "terminal = -1")]
WRONG += [(TIMES, new) for new in ("[0, 6]", "{ every = 1e-9 }", "{ every = 0 }", "[0, 1], store = 2")]


def test_wrong_tables_are_named(write):
    write(CAMERA, "camera.csv")
    for old, new in WRONG:
        with says(RunFileError):
            read_run_file(write(FILE.replace(old, new)))


def test_oblique_spin_below():
    axis, how = np.array([0.6, -0.48, 0.64]), {"t_end": 12, "material_angular_velocity": (0.5, -2.0, 1.0)}
    slower = with_attributes(lambda t, state: abs(axis @ state.material_angular_velocity) - 1.2, direction=-1)
    first, second = nt.integrate(BODY, events=[nt.spin_below(1.2, axis), slower], **how).t_events
    assert first.size > 0
    assert first == pytest.approx(second, abs=1e-12)
